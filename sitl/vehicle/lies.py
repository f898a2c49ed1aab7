"""What a vehicle that lies says of itself: its agent flies by the truth, and its packets say something else.

The liar is an admitted vehicle: its packets are authentic, of this fleet and well formed. Several lies of one vehicle are added
in their order, so a position that drifts and a velocity that is off make a position that its velocity contradicts.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from math import cos, floor, pi, sin
from typing import Annotated, Any, Literal, get_args

from msgspec import Meta, Struct
from msgspec.structs import replace

from companion.config.values import PositionM, Section, VehicleId
from companion.geometry.frames import wrap_pi
from companion.geometry.vectors import minus, plus, scaled
from companion.types.autopilot import PositionError
from companion.types.flight import FlightPhase, Role
from companion.types.peers import LostVehicle, PeerPacket
from companion.types.values import ZERO3, Vector3

Vectors = Literal["position", "velocity", "acceleration", "slot", "rft", "law_values"]
Numbers = Literal[
    "prc", "epoch", "claim", "stamp", "mission_time", "heading", "sequence", "age", "sent", "error", "formation"
]
Words = Literal["phase", "leader", "disarmed", "lost"]
State = tuple[Vector3, Vector3, Vector3]
LOST_AGE_S = 5.0


class Lie(Section, frozen=True):
    """A time in which the packets of one vehicle say something false.

    says: what is false. `phase`, `leader` (names itself), `disarmed` and `lost` (vehicle `other` fell silent at
        `by_enu`) need no kind
    kind: `constant`: off by this; `drift`: the error grows for `over_s`; `jump`: off in every second half of `over_s`;
        `swing`: to and fro once in `over_s`; `mirror`: the way since the beginning, or the vector, is reversed;
        `chase`: a position that comes to that of vehicle `other` plus `by_enu` within `over_s`; `frozen`: as at the beginning
    by_enu: error of a vector (m, m/s, m/s2)
    by: error of a number (s, m, rad, ms of the stamp)
    over_s: as the kind says; the velocity agrees with a position that drifts, swings, chases or is mirrored
    other: the other vehicle of `chase` and `lost`
    phase: the phase that it says
    from_s: time of the flight
    until_s: time of the flight
    """

    vehicle: VehicleId
    says: Vectors | Numbers | Words = "position"
    kind: Literal["constant", "drift", "jump", "swing", "mirror", "chase", "frozen"] = "constant"
    by_enu: PositionM = (0.0, 0.0, 0.0)
    by: Annotated[float, Meta(ge=-1e9, le=1e9)] = 0.0
    over_s: Annotated[float, Meta(gt=0, le=36_000)] = 1.0
    other: VehicleId | None = None
    phase: FlightPhase = FlightPhase.HOLD
    from_s: Annotated[float, Meta(ge=0, le=36_000)] = 0.0
    until_s: Annotated[float, Meta(ge=0, le=36_000)] = 36_000.0

    def contradictions(self) -> Iterator[tuple[str, str]]:
        """Keys that contradict others, each with the problem."""
        if self.kind == "chase" and self.says != "position":
            yield "kind", f"chase, expected with position, not with {self.says}"
        if self.kind == "mirror" and self.says not in get_args(Vectors):
            yield "kind", f"mirror, expected with one of {', '.join(get_args(Vectors))}"
        if self.other is None and (self.kind == "chase" or self.says == "lost"):
            yield "other", "expected with chase and with lost"
        if self.until_s <= self.from_s:
            yield "until_s", f"{self.until_s:g}, expected later than from_s"

    def lasts(self, now_s: float) -> bool:
        """Whether the vehicle lies now."""
        return self.from_s <= now_s < self.until_s

    def share(self, now_s: float) -> tuple[float, float, float]:
        """How much of the error is there now, and its first and second derivative by time."""
        after_s = now_s - self.from_s
        match self.kind:
            case "drift" | "chase":
                return (after_s / self.over_s, 1.0 / self.over_s, 0.0) if after_s < self.over_s else (1.0, 0.0, 0.0)
            case "jump":
                return float(floor(2.0 * after_s / self.over_s) % 2), 0.0, 0.0
            case "swing":
                rate = 2.0 * pi / self.over_s
                return sin(rate * after_s), rate * cos(rate * after_s), -rate * rate * sin(rate * after_s)
            case _:
                return 1.0, 0.0, 0.0


class Told(Struct, frozen=True):
    """A lie that is told now: the share of its error and the derivatives, and the true packets that it refers to.

    `first` is the packet of the liar at the beginning of the lie, `newest` the last one of each vehicle.
    """

    lie: Lie
    share: tuple[float, float, float]
    first: PeerPacket
    newest: Mapping[int, PeerPacket]


class Liars:
    """The lies of a flight."""

    def __init__(self, lies: Sequence[Lie]) -> None:
        self._lies = lies
        self._first: dict[int, PeerPacket] = {}  # by the number of the lie
        self._newest: dict[int, PeerPacket] = {}

    def stated(self, packet: PeerPacket, now_s: float) -> PeerPacket:
        """What the vehicle sends in place of this true packet."""
        sender_id = packet.sender.vehicle_id
        true = self._newest[sender_id] = packet
        for number, lie in enumerate(self._lies):
            if lie.vehicle == sender_id and lie.lasts(now_s):
                first = self._first.setdefault(number, true)
                packet = _OF[lie.says](packet, Told(lie, lie.share(now_s), first, self._newest))
        return packet


_Says = Callable[[PeerPacket, Told], PeerPacket]


def _off(vector: Vector3, told: Told, first: Vector3) -> Vector3:
    if told.lie.kind == "mirror":
        return scaled(vector, -1.0)
    return first if told.lie.kind == "frozen" else plus(vector, scaled(told.lie.by_enu, told.share[0]))


def _state(state: State, told: Told, first: State, aim: State | None = None) -> State:
    """Position, velocity and acceleration; the last two agree with the first one where it moves."""
    lie, (x, v, a), (share, rate, bend) = told.lie, state, told.share
    if lie.kind == "frozen":
        return first[0], v, a
    if lie.kind == "mirror":
        return minus(scaled(first[0], 2.0), x), scaled(v, -1.0), scaled(a, -1.0)
    if lie.kind == "chase" and aim is not None:
        way = minus(plus(aim[0], lie.by_enu), x)
        moves = plus(scaled(minus(aim[1], v), share), scaled(way, rate))
        return plus(x, scaled(way, share)), plus(v, moves), a
    return plus(x, scaled(lie.by_enu, share)), plus(v, scaled(lie.by_enu, rate)), plus(a, scaled(lie.by_enu, bend))


def _motion_of(packet: PeerPacket) -> State:
    motion = packet.motion
    return motion.position_enu_m, motion.velocity_enu_m_s, motion.acceleration_enu_m_s2


def _position(packet: PeerPacket, told: Told) -> PeerPacket:
    aim = told.newest.get(told.lie.other) if told.lie.other is not None else None
    x, v, a = _state(_motion_of(packet), told, _motion_of(told.first), _motion_of(aim) if aim else None)
    motion = replace(packet.motion, position_enu_m=x, velocity_enu_m_s=v, acceleration_enu_m_s2=a)
    return replace(packet, motion=motion)


def _of_motion(name: str) -> _Says:
    def says(packet: PeerPacket, told: Told) -> PeerPacket:
        vector = _off(getattr(packet.motion, name), told, getattr(told.first.motion, name))
        return replace(packet, motion=replace(packet.motion, **{name: vector}))

    return says


def _slot(packet: PeerPacket, told: Told) -> PeerPacket:
    slot, first = packet.slot, (told.first.slot.position_enu_m, ZERO3, ZERO3)
    x, v, a = _state((slot.position_enu_m, slot.velocity_enu_m_s, slot.acceleration_enu_m_s2), told, first)
    return replace(packet, slot=replace(slot, position_enu_m=x, velocity_enu_m_s=v, acceleration_enu_m_s2=a))


def _rft(packet: PeerPacket, told: Told) -> PeerPacket:
    """As a vehicle that is kept off its slot; without an RFT of its own its position minus its slot is the true one."""
    return replace(packet, rft=_state(_rft_of(packet), told, _rft_of(told.first)))


def _rft_of(packet: PeerPacket) -> State:
    x, v, a = _motion_of(packet)
    return packet.rft or (minus(x, packet.slot.position_enu_m), minus(v, packet.slot.velocity_enu_m_s), a)


def _law_values(packet: PeerPacket, told: Told) -> PeerPacket:
    values = zip(packet.law_values, told.first.law_values, strict=False)
    return replace(packet, law_values=tuple([_off(value, told, before) for value, before in values]))


def _number(value: Any, told: Told, first: Any) -> Any:
    """Off by the error; of an integer without its fraction, and never negative."""
    if told.lie.kind == "frozen":
        return first
    return max(type(value)(value + told.lie.by * told.share[0]), type(value)(0))


def _of_part(part: str, name: str) -> _Says:
    """A number of a part of the packet."""

    def says(packet: PeerPacket, told: Told) -> PeerPacket:
        own = getattr(packet, part)
        number = _number(getattr(own, name), told, getattr(getattr(told.first, part), name))
        return replace(packet, **{part: replace(own, **{name: number})})

    return says


def _of_beacon(name: str) -> _Says:
    """A number of the beacon that it passes on, where it has one."""

    def says(packet: PeerPacket, told: Told) -> PeerPacket:
        beacon, before = packet.leader.beacon, told.first.leader.beacon
        if beacon is None:
            return packet
        number = _number(getattr(beacon, name), told, getattr(before or beacon, name))
        return replace(packet, leader=replace(packet.leader, beacon=replace(beacon, **{name: number})))

    return says


def _heading(packet: PeerPacket, told: Told) -> PeerPacket:
    """Of the formation, in the beacon; turned at once."""
    beacon = packet.leader.beacon
    if beacon is None:
        return packet
    turned = replace(beacon.heading, angle_rad=wrap_pi(beacon.heading.angle_rad + told.lie.by * told.share[0]))
    return replace(packet, leader=replace(packet.leader, beacon=replace(beacon, heading=turned)))


def _error(packet: PeerPacket, told: Told) -> PeerPacket:
    error_m = max(0.0, told.lie.by * told.share[0])
    return replace(packet, position_error=PositionError(error_m, error_m))


def _phase(packet: PeerPacket, told: Told) -> PeerPacket:
    return replace(packet, phase=told.lie.phase)


def _leader(packet: PeerPacket, _told: Told) -> PeerPacket:
    """It says that it leads, in a newer term."""
    beacon, sender_id = packet.leader.beacon, packet.sender.vehicle_id
    newer = beacon and replace(beacon, leader_id=sender_id, epoch=beacon.epoch + 1, claim=0)
    return replace(packet, role=Role.LEADER, leader=replace(packet.leader, prc=1, beacon=newer))


def _disarmed(packet: PeerPacket, _told: Told) -> PeerPacket:
    return replace(packet, armed=False)


def _lost(packet: PeerPacket, told: Told) -> PeerPacket:
    lost = LostVehicle(told.lie.other or 1, told.lie.by_enu, ZERO3, LOST_AGE_S)
    return replace(packet, lost=(lost,))


_OF: Mapping[str, _Says] = {
    "position": _position,
    "velocity": _of_motion("velocity_enu_m_s"),
    "acceleration": _of_motion("acceleration_enu_m_s2"),
    "slot": _slot,
    "rft": _rft,
    "law_values": _law_values,
    "prc": _of_part("leader", "prc"),
    "epoch": _of_beacon("epoch"),
    "claim": _of_beacon("claim"),
    "stamp": _of_beacon("stamp"),
    "mission_time": _of_beacon("reference_s"),
    "heading": _heading,
    "sequence": _of_part("sender", "sequence"),
    "age": _of_part("motion", "state_age_s"),
    "sent": _of_part("motion", "sent_s"),
    "formation": _of_part("slot", "formation"),
    "error": _error,
    "phase": _phase,
    "leader": _leader,
    "disarmed": _disarmed,
    "lost": _lost,
}
