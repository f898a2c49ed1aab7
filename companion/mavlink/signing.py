"""MAVLink 2 signing: a time stamp and 48 bits of SHA-256 over a secret key and the packet. No sockets, clocks or files.

See https://mavlink.io/en/guide/message_signing.html.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from dataclasses import dataclass, field

from companion.mavlink.messages import mavlink
from companion.types.notices import Code

KEY_BYTES = 32
UNITS_PER_S = 100_000  # a stamp counts 10 us
EPOCH_UNIX_S = 1_420_070_400  # from 2015-01-01 UTC
HASH_BYTES = 6

SIGNATURE_CODES = (Code.MAVLINK_UNSIGNED, Code.MAVLINK_WRONG_KEY, Code.MAVLINK_OLD_SIGNATURE)


@dataclass(frozen=True, slots=True)
class SigningKey:
    """Secret, link id and clock of one end of a signed link."""

    secret: bytes = field(repr=False)
    link_id: int
    unix_time_s: Callable[[], float]


class SignedMavlink(mavlink.MAVLink):
    """A MAVLink end that signs all packets and accepts only correctly signed ones.

    pymavlink accepts a time stamp before it checks the signature, so one forged packet would make the genuine ones look old.
    Here the signature is checked first.

    A stamp never goes backwards, even if the clock does. A clock that is behind, as on a computer without a battery, is
    corrected by the stamps of the other end, which has kept the newest ones it received.
    """

    def __init__(self, system_id: int, component_id: int, key: SigningKey) -> None:
        super().__init__(None, srcSystem=system_id, srcComponent=component_id)
        self._unix_time_s = key.unix_time_s
        self._secret = self.signing.secret_key = key.secret
        self.signing.link_id = key.link_id
        self.signing.sign_outgoing = True
        self.signing.allow_unsigned_callback = _refuse_unsigned

    def keep_time(self) -> None:
        """Advance the next stamp to now, unless it is later already."""
        now = int((self._unix_time_s() - EPOCH_UNIX_S) * UNITS_PER_S)
        self.signing.timestamp = max(self.signing.timestamp, now)

    def check_signature(self, msgbuf: bytearray, srcSystem: int, srcComponent: int) -> bool:  # noqa: N803
        """True for a correct signature. Raises MAVError with one of SIGNATURE_CODES otherwise."""
        digest = hashlib.sha256(self._secret + msgbuf[:-HASH_BYTES]).digest()
        if digest[:HASH_BYTES] != msgbuf[-HASH_BYTES:]:
            raise mavlink.MAVError(Code.MAVLINK_WRONG_KEY)
        self.keep_time()
        if not super().check_signature(msgbuf, srcSystem, srcComponent):
            raise mavlink.MAVError(Code.MAVLINK_OLD_SIGNATURE)
        self.signing.timestamp += 1  # newer than every stamp that the other end has received
        return True


def _refuse_unsigned(_mav: mavlink.MAVLink, _message_id: int) -> bool:
    """Refuse unsigned packets. The protocol would accept RADIO_STATUS, inserted by a radio; the agent does not use it."""
    raise mavlink.MAVError(Code.MAVLINK_UNSIGNED)
