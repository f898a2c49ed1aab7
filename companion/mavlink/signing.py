"""MAVLink 2 signing: a time stamp and 48 bits of SHA-256 over a secret key and the packet. No sockets, clocks or files.

After the protocol's own description, https://mavlink.io/en/guide/message_signing.html.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from dataclasses import dataclass, field

# The development dialect is common.xml and the few messages that PX4 already sends, CURRENT_MODE (436) among them.
from pymavlink.dialects.v20 import development as mavlink

KEY_BYTES = 32
UNITS_PER_S = 100_000  # a stamp counts 10 us
EPOCH_UNIX_S = 1_420_070_400  # from 2015-01-01 UTC
SIGNATURE_BYTES = 6

NOT_SIGNED = "MAVLink packet that is not signed"
WRONG_KEY = "MAVLink packet signed with another key"
OLD_STAMP = "MAVLink packet with an old signature"
REASONS = (NOT_SIGNED, WRONG_KEY, OLD_STAMP)


@dataclass(frozen=True, slots=True)
class SigningKey:
    """What one end of a signed link has: the secret, the number of its link, and the time of day."""

    secret: bytes = field(repr=False)
    link_id: int
    unix_time_s: Callable[[], float]


class SignedMavlink(mavlink.MAVLink):  # type: ignore[misc]  # pymavlink has no types
    """pymavlink's signing, of everything that goes out, and with nothing let in that is not signed as it must be.

    pymavlink believes a stamp before it has checked the signature, so that one forged packet would make the true ones
    look old. Here the signature comes first.

    A stamp never goes backwards, whatever the clock does. Where the clock is behind, as on a computer that forgets the
    time without power, the stamps of the other end, which has kept those sent to it before, put it right.
    """

    def __init__(self, system_id: int, component_id: int, key: SigningKey) -> None:
        super().__init__(None, srcSystem=system_id, srcComponent=component_id)
        self._unix_time_s = key.unix_time_s
        self.signing.secret_key = key.secret
        self.signing.link_id = key.link_id
        self.signing.sign_outgoing = True
        self.signing.allow_unsigned_callback = _refuse_unsigned

    def keep_time(self) -> None:
        """Move the next stamp on to now, if it is not past that already."""
        now = int((self._unix_time_s() - EPOCH_UNIX_S) * UNITS_PER_S)
        self.signing.timestamp = max(self.signing.timestamp, now)

    def check_signature(self, msgbuf: bytearray, srcSystem: int, srcComponent: int) -> bool:  # noqa: N803
        """Raises MAVError, with one of REASONS, for all but a right signature."""
        digest = hashlib.sha256(self.signing.secret_key + msgbuf[:-SIGNATURE_BYTES]).digest()
        if digest[:SIGNATURE_BYTES] != msgbuf[-SIGNATURE_BYTES:]:
            raise mavlink.MAVError(WRONG_KEY)
        self.keep_time()
        if not super().check_signature(msgbuf, srcSystem, srcComponent):
            raise mavlink.MAVError(OLD_STAMP)
        self.signing.timestamp += 1  # newer than all that the other end has heard
        return True


def _refuse_unsigned(_mav: mavlink.MAVLink, _message_id: int) -> bool:
    """The protocol lets RADIO_STATUS in, which a radio inserts; the agent has no use for it."""
    raise mavlink.MAVError(NOT_SIGNED)
