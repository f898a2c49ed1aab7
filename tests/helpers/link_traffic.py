"""What tests of Zenoh links send, and waiting for its arrival."""

import time
from collections.abc import Callable

from companion.types.flight import FlightPhase, Role
from companion.types.formation import FlownSlot
from companion.types.peers import PeerPacket

ZERO = (0.0, 0.0, 0.0)
PACKET = PeerPacket(1, 7, 1, 5, FlightPhase.HOLD, Role.LEADER, ZERO, ZERO, ZERO, 0.01, 0.0, 1, None, FlownSlot(ZERO))


def until(condition: Callable[[], object], each: Callable[[], object] = lambda: None, timeout_s: float = 10.0) -> None:
    """Repeat `each` until the condition holds."""
    end_s = time.monotonic() + timeout_s
    while not condition():
        assert time.monotonic() < end_s, "it never came true"
        each()
        time.sleep(0.01)
