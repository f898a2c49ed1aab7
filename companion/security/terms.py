"""What a leader signs: that it leads in a term. Vehicles pass this on with its beacon. No files, no clocks.

The statement names the fleet, its file, the leader, the session of its agent, the epoch and the rank of the claim, so it is
good for nothing else. It begins with words that neither a certificate (DER) nor a list (JSON) begins with. The session is
drawn at each start of an agent: who has heard the leader since then does not believe what it stated in an earlier flight.
"""

from __future__ import annotations

import msgspec
from cryptography.exceptions import InvalidSignature
from cryptography.hazmat.primitives.asymmetric import ec
from cryptography.hazmat.primitives.asymmetric.utils import decode_dss_signature, encode_dss_signature
from msgspec import Struct

from companion.security.admission import HASH

PURPOSE = b"formation-companion term\x00"
NUMBER_BYTES = 32  # of r and of s on P-256


class TermStatement(Struct, array_like=True, frozen=True):
    """`leader_id` leads in this epoch; `claim` is its rank as a successor, 0 for a commanded leader."""

    fleet: str
    formation_hash: int
    leader_id: int
    session: int
    epoch: int
    claim: int


def sign_term(statement: TermStatement, key: ec.EllipticCurvePrivateKey) -> bytes:
    """The signature: r and s. 0.1 ms on a laptop, some 0.5 ms on a board."""
    r, s = decode_dss_signature(key.sign(_content(statement), ec.ECDSA(HASH)))
    return r.to_bytes(NUMBER_BYTES) + s.to_bytes(NUMBER_BYTES)


def is_signed(statement: TermStatement, signature: bytes, key: ec.EllipticCurvePublicKey) -> bool:
    """Whether the holder of this key has signed the statement. As long as `sign_term`."""
    if len(signature) != 2 * NUMBER_BYTES:
        return False
    r, s = int.from_bytes(signature[:NUMBER_BYTES]), int.from_bytes(signature[NUMBER_BYTES:])
    try:
        key.verify(encode_dss_signature(r, s), _content(statement), ec.ECDSA(HASH))
    except InvalidSignature:
        return False
    return True


def _content(statement: TermStatement) -> bytes:
    return PURPOSE + msgspec.msgpack.encode(statement)
