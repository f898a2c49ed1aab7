"""What tests of all packages need: the repository, codes of notices, packets with other fields, waiting, counted work."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar

from msgspec import Struct
from msgspec.structs import replace

from companion.core.consensus.peers import PeerState
from companion.types.autopilot import PositionError
from companion.types.commands import CommandReply
from companion.types.flight import FlightPhase, Role
from companion.types.formation import FlownSlot
from companion.types.notices import Answer, Code, Notice
from companion.types.peers import LeaderReport, Motion, PeerPacket, Sender
from companion.types.values import ZERO3, Part, Vector3

ROOT = Path(__file__).parents[2]


def code_of(notice: Notice | None) -> Code | None:
    return notice.code if notice else None


def codes_of(notices: Iterable[Notice]) -> list[Code]:
    return [notice.code for notice in notices]


def texts_of(notices: Iterable[Notice]) -> list[str]:
    return [notice.text for notice in notices]


def outcome(answer: Answer | CommandReply | None) -> tuple[bool, Code]:
    """Whether it was accepted, and the code of why."""
    assert answer is not None
    return (answer.accepted, answer.code if isinstance(answer, CommandReply) else answer.notice.code)


M = TypeVar("M", bound=Struct)


def with_fields(message: M, **values: Any) -> M:
    """A message with some fields changed, wherever its parts hold them.

    `values` by the name of the field, in the message itself or in one of its parts.
    """
    own = {name: value for name, value in values.items() if name in message.__struct_fields__}
    for name in message.__struct_fields__:
        part = getattr(message, name)
        if isinstance(part, Part):
            inner = {key: value for key, value in values.items() if key in part.__struct_fields__ and key not in own}
            if inner:
                own[name] = replace(part, **inner)
    known = own.keys() | {key for part in own.values() if isinstance(part, Part) for key in part.__struct_fields__}
    assert values.keys() <= known, f"{type(message).__name__} has no {sorted(values.keys() - known)}"
    return replace(message, **own)


@dataclass
class Work:
    """How many functions were called, those in C included: the same on every machine, unlike a time."""

    calls: int = 0


@contextmanager
def count_calls() -> Iterator[Work]:
    """Count the function calls of the block."""
    work = Work()

    def observe(_frame: object, event: str, _argument: object) -> None:
        work.calls += event in ("call", "c_call")

    sys.setprofile(observe)
    try:
        yield work
    finally:
        sys.setprofile(None)


def until(condition: Callable[[], object], timeout_s: float = 20.0, each: Callable[[], object] = lambda: None) -> None:
    """Wait for another thread or process: repeat `each` until the condition holds."""
    end_s = time.monotonic() + timeout_s
    while not condition():
        assert time.monotonic() < end_s, f"condition not met within {timeout_s} s"
        each()
        time.sleep(0.01)


AT_REST = PeerPacket(
    sender=Sender(vehicle_id=1, session=1, sequence=1, formation_hash=0),
    phase=FlightPhase.FORMATION,
    role=Role.FOLLOWER,
    motion=Motion(
        position_enu_m=ZERO3, velocity_enu_m_s=ZERO3, acceleration_enu_m_s2=ZERO3, state_age_s=0.0, sent_s=0.0
    ),
    leader=LeaderReport(prc=2, beacon=None),
    slot=FlownSlot(ZERO3),
)
PEER_SLOTS: dict[int, Vector3] = {1: (0.0, 0.0, 0.0), 2: (-2.0, 0.0, 0.0), 3: (-4.0, 0.0, 0.0)}
FLEET: Vector3 = (10.0, 0.0, 5.0)
NOW_S = 100.0


def peer(vehicle_id: int, moves_m_s: Vector3 = ZERO3, **changes: object) -> PeerState:
    """A follower in its slot of PEER_SLOTS, where the fleet is at FLEET."""
    x, y, z = (r + d for r, d in zip(FLEET, PEER_SLOTS[vehicle_id], strict=True))
    packet = with_fields(
        AT_REST,
        vehicle_id=vehicle_id,
        position_enu_m=(x, y, z),
        velocity_enu_m_s=moves_m_s,
        slot=FlownSlot(PEER_SLOTS[vehicle_id]),
    )
    return PeerState(with_fields(packet, **changes), NOW_S, NOW_S, NOW_S)


SLOTS: dict[int, Vector3] = {1: (0.0, 0.0, 0.0), 2: (-1.5, 0.0, 0.0), 3: (-3.0, 0.0, 0.0), 4: (-3.0, 0.0, 1.0)}


def slot_peer(vehicle_id: int, z_m: float = 0.0, error: PositionError | None = None, air: bool = False) -> PeerPacket:
    """A follower that does not form yet, 3 m beside the next one."""
    return with_fields(
        AT_REST,
        vehicle_id=vehicle_id,
        phase=FlightPhase.HOLD if air else FlightPhase.READY,
        position_enu_m=(3.0 * vehicle_id - 6.0, 0.0, z_m),
        slot=FlownSlot(SLOTS[vehicle_id]),
        position_error=error,
    )
