"""Every decoder under damaged bytes and damaged values: it returns a message within bounds, or refuses with its own error."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from random import Random
from time import thread_time
from typing import Any, NamedTuple

import msgspec
from msgspec import Struct

from companion.mavlink.translator import Translator
from companion.types.autopilot import AutopilotKind, LandedState, PositionError
from companion.types.commands import Command, CommandName, CommandReply, Lead, ReferenceChange
from companion.types.flight import FlightPhase, HealthFlag, Role
from companion.types.formation import FlownSlot, FormationChange, HeldReference, LeaderBeacon
from companion.types.notices import Code, Notice
from companion.types.peers import LeaderReport, Motion, PeerPacket, Sender, TargetSample, TermProof, TrafficSample
from companion.types.status import (
    AgentIdentity,
    AutopilotReport,
    ControlReport,
    FormationReport,
    LeadershipReport,
    MotionReport,
    NeighbourReport,
    SafetyReport,
    Status,
)
from companion.wire.keys import (
    pairing_key,
    pairing_sender_of,
    reply_fleet_of,
    reply_key,
    target_key,
    target_of,
    traffic_key,
    traffic_of,
)
from companion.wire.messages import (
    StatusReport,
    WireError,
    decode_command,
    decode_peer,
    decode_reply,
    decode_report,
    decode_target,
    decode_traffic,
    encode,
    encode_peer,
)
from sitl.flight.virtual_vehicle import NOT_TIMED
from sitl.workers import report_progress
from tests.fuzz.mavlink import mavlink_packets, resealed
from tests.fuzz.mutation import damaged, mutated
from tests.fuzz.stream import DESCRIBED

SLOTS = ((1, (0.0, 0.0, 0.0)), (2, (-2.0, 0.0, 0.0)), (3, (-4.0, 0.0, 0.0)))
CHANGE = FormationChange(1, SLOTS, 12.0, 8.0, (3,))
PACKET = PeerPacket(
    sender=Sender(vehicle_id=1, session=7, sequence=100, formation_hash=42),
    phase=FlightPhase.FORMATION,
    role=Role.LEADER,
    motion=Motion(
        position_enu_m=(1.0, 2.0, 3.0),
        velocity_enu_m_s=(0.1, 0.2, 0.3),
        acceleration_enu_m_s2=(0.0, 0.1, 0.0),
        state_age_s=0.02,
        sent_s=100.0,
    ),
    leader=LeaderReport(1, LeaderBeacon(1, 2, 100_000, 12.5), TermProof(7, bytes(range(64)))),
    slot=FlownSlot((0.0, 0.0, 0.0), formation=1, waiting=2),
    position_error=PositionError(0.3, 0.4),
    reference=HeldReference(1, 2, 3.0),
    change=CHANGE,
    armed=True,
    rft=((1.0, 2.0, 3.0), (0.1, 0.2, 0.3), (0.0, 0.1, 0.0)),
)
STATUS = Status(
    agent=AgentIdentity(vehicle_id=3, session=1, fleet="platoon", formation_hash=5, law="weighted"),
    phase=FlightPhase.HOLD,
    autopilot=AutopilotReport(mode_name="AUTO.LOITER", armed=True, landed=LandedState.IN_AIR),
    motion=MotionReport(position_enu_m=(1.0, 2.0, 3.0), velocity_enu_m_s=(0.0, 0.0, 0.0), state_age_s=0.02),
    control=ControlReport(hover_thrust_norm=0.49, disturbance_enu_m_s2=(1.0, -2.0, 0.0)),
    leadership=LeadershipReport(
        role=Role.FOLLOWER, epoch=7, prc=2, leader_beacon=LeaderBeacon(1, 2, 3), leader_beacon_age_s=0.1
    ),
    neighbourhood=NeighbourReport(neighbours=(2, 4)),
    formation=FormationReport(slot=FlownSlot((-3.0, 0.0, 0.0)), reference_enu_m=(0.0, 1.0, 2.0)),
    safety=SafetyReport(flags=(HealthFlag.OUTSIDE_FENCE,)),
    rejected={"PEER_LATE 2": 3},
    last_event=Notice(Code.PHASE_CHANGED, "takeoff -> hold"),
)
COMMANDS = (
    Command(CommandName.HOLD, 9, "anna@ground", 7),
    Command(CommandName.LEAD, 9, "anna@ground", 7, Lead((2,), 8)),
    Command(CommandName.FORMATION, 9, "anna@ground", 7, CHANGE),
    *(Command(CommandName.REFERENCE, 9, "anna@ground", 7, ReferenceChange(3, dict(d), 21.5)) for d in DESCRIBED),
)
# True keys, and such as a stranger may send: key expressions, too few and too many parts, empty ones, 4 kB, other scripts
KEYS = (
    *(traffic_key("platoon", "main", "4b1805"), target_key("platoon", "walker")),
    *(reply_key("platoon", 3), pairing_key("platoon", 2, 1)),
    *(
        "**",
        "*",
        "**/*",
        "formation/**",
        "formation/*/traffic/*/*",
        "formation/platoon/pairing/*/1",
        "formation/$*/reply/3",
    ),
    *("", "/", "formation", "formation//reply/3", "formation/platoon/reply/", "a/" * 2048, "formation/" + "x" * 4096),
    *(
        "formation/platoon/target/\u0661",
        "formation/platoon/pairing/\u0662/1",
        "formation/\x1b[2J/reply/3",
        "\ud55c/\x00",
    ),
)
RESEALED_EACH = 3
ROUNDS_KEPT = 64  # bytes of damaged values are damaged again so often before new values are made


class Decoder(NamedTuple):
    """A decoder with its own error, and true inputs: values with their encoder, and bytes."""

    decode: Callable[[bytes], Any]
    refuses: tuple[type[Exception], ...]
    values: Sequence[Struct] = ()
    encode: Callable[[Any], bytes] | None = None
    messages: Sequence[bytes] = ()
    reseal: Callable[[bytes], bytes] | None = None  # a true checksum, so that damaged values reach what reads them


class Fuzzed(Struct):
    """Result for one decoder. `passed` counts inputs that gave a message or a sample.

    `failures` are inputs that raised another exception, or passed with a number out of bounds.
    """

    name: str
    inputs: int
    passed: int
    cpu_s: float
    failures: list[str]


def decoders() -> dict[str, Decoder]:
    """All decoders of received bytes, by name. Those with a state are created for each call."""
    px4, copter = Translator(1, AutopilotKind.PX4), Translator(1, AutopilotKind.ARDUPILOT)
    packets = mavlink_packets()
    read = [packet for packet in packets if Translator(1, AutopilotKind.PX4).telemetry(packet, 100.0)]
    packets += read * (len(packets) // len(read))  # half of the inputs are messages that the agent reads
    return {
        "peer packet": Decoder(decode_peer, (WireError,), (PACKET,), encode_peer),
        "command": Decoder(decode_command, (WireError,), COMMANDS, encode),
        "target sample": Decoder(
            decode_target, (WireError,), (TargetSample(1, 2, 3.0, (1.0, 0.0, 0.0), (4.0, 5.0, 6.0)),), encode
        ),
        "traffic sample": Decoder(
            decode_traffic,
            (WireError,),
            (TrafficSample((1.0, 2.0, 3.0), (4.0, 5.0, 6.0), 0.5, 2.0, "unknown"),),
            encode,
        ),
        "status report": Decoder(decode_report, (WireError,), (StatusReport(STATUS, NOT_TIMED),), encode),
        "command reply": Decoder(
            decode_reply, (WireError,), (CommandReply(3, 9, True, Code.PHASE_CHANGED, "engage", "anna@ground"),), encode
        ),
        "Zenoh keys": Decoder(_keys_of, (), messages=[key.encode() for key in KEYS]),
        "MAVLink, PX4": Decoder(lambda data: px4.telemetry(data, 100.0), (), messages=packets, reseal=resealed),
        "MAVLink, ArduCopter": Decoder(
            lambda data: copter.telemetry(data, 100.0), (), messages=packets, reseal=resealed
        ),
    }


def _keys_of(data: bytes) -> list[Any]:
    """What the decoders of received keys find. Zenoh gives a subscriber text, whatever was sent."""
    key = data.decode(errors="replace")
    found = [decode(key) for decode in (target_of, traffic_of, pairing_sender_of, reply_fleet_of)]
    return [one for one in found if one is not None]


def fuzz(name: str, inputs: int, seed: int) -> Fuzzed:
    """Give a decoder this many seeded inputs: damaged values, damaged bytes, and both."""
    decoder, rng = decoders()[name], Random(f"{name} {seed}")
    passed, failures, begin_s = 0, list[str](), thread_time()
    source, decode, reseal = b"", decoder.decode, decoder.reseal
    for index in range(inputs):
        if index % ROUNDS_KEPT == 0:
            data = source = _source(decoder, rng)
            report_progress(index / inputs)
        else:
            data = damaged(rng, source)
            if reseal and index % RESEALED_EACH == 0:
                data = reseal(data)
        try:
            message = decode(data)
        except decoder.refuses:
            continue
        except Exception as error:  # noqa: BLE001 -- every exception is a finding
            failures.append(f"{type(error).__name__}: {str(error)[:80]}: {data[:200].hex()}")
            continue
        passed += message != []
        if index % 16 == 0 and not _is_bounded(message):
            failures.append(f"a number that is not finite: {data[:200].hex()}")
    return Fuzzed(name, inputs, passed, thread_time() - begin_s, failures[:20])


def _source(decoder: Decoder, rng: Random) -> bytes:
    if not decoder.encode:
        return rng.choice(decoder.messages)
    for _ in range(20):
        try:
            return decoder.encode(mutated(rng, rng.choice(decoder.values), rng.choice((0, 1, 1, 2, 3))))
        except (OverflowError, UnicodeEncodeError):  # no sender can encode such a value
            continue
    return decoder.encode(decoder.values[0])


def _is_bounded(message: Any) -> bool:
    """Whether the receivers of a decoded message need no check of its numbers; peer packets and targets have theirs."""
    if isinstance(message, PeerPacket | TargetSample | list | tuple):
        return True
    return b"NaN" not in msgspec.json.encode(message) if isinstance(message, Struct) else True
