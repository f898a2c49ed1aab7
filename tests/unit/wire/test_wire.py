"""The wire format: round trips, and WireError for all invalid input."""

from __future__ import annotations

import subprocess
import sys
from math import inf, isnan, nan

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from msgspec.structs import replace

from common import with_fields
from companion.types.autopilot import LandedState, PositionError
from companion.types.commands import (
    CONTENT,
    MAX_EPOCH,
    OPERATOR,
    Command,
    CommandName,
    CommandReply,
    Lead,
    ReferenceChange,
)
from companion.types.flight import FlightPhase, HealthFlag, Role
from companion.types.formation import EAST, FlownSlot, FormationChange, Heading, HeldReference, LeaderBeacon
from companion.types.notices import Code, Notice
from companion.types.peers import LeaderReport, LostVehicle, Motion, PeerPacket, Sender, TargetSample, TermProof
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
from companion.types.values import FLEET_NAME, MAX_CHANGE_S, MAX_COORDINATE_M, MAX_MISSION_S, MAX_NUMBER
from companion.wire.messages import (
    STATUS_FORM,
    WIRE_VERSION,
    Percentiles,
    StatusReport,
    Timing,
    WireError,
    decode_command,
    decode_peer,
    decode_reply,
    decode_report,
    decode_target,
    encode,
    encode_peer,
)

numbers = st.floats(allow_nan=False, allow_infinity=False)
vectors = st.tuples(numbers, numbers, numbers)
counts = st.integers(0, MAX_NUMBER)
ids = st.integers(1, 250)
coordinates = st.floats(-MAX_COORDINATE_M, MAX_COORDINATE_M)
places = st.tuples(coordinates, coordinates, coordinates)
slots = st.lists(st.tuples(ids, places), max_size=5).map(tuple)
changes = st.builds(
    FormationChange,
    counts,
    slots,
    st.floats(0.0, MAX_MISSION_S),
    st.floats(0.0, MAX_CHANGE_S),
    st.lists(ids, max_size=5).map(tuple),
)
texts = st.text(st.characters(exclude_categories=["C"]), max_size=40)
notices = st.builds(Notice, st.sampled_from(Code), texts)
headings = st.builds(Heading, numbers, numbers, numbers)
leader_beacons = st.none() | st.builds(
    LeaderBeacon, st.integers(1, 250), counts, counts, numbers, st.integers(0, 250), st.just(EAST) | headings
)
proofs = st.none() | st.builds(TermProof, counts, st.binary(min_size=64, max_size=64))

flown_slots = st.builds(FlownSlot, vectors, vectors, vectors, counts, counts, st.floats(0.0, 600.0))
packets = st.builds(
    PeerPacket,
    sender=st.builds(Sender, st.integers(1, 250), counts, counts, st.integers(0, 2**64 - 1)),
    phase=st.sampled_from(FlightPhase),
    role=st.sampled_from(Role),
    motion=st.builds(Motion, vectors, vectors, vectors, numbers, numbers),
    leader=st.builds(LeaderReport, st.integers(1, 250), leader_beacons, proofs),
    slot=flown_slots,
    reference=st.none() | st.builds(HeldReference, counts, counts, numbers),
    change=st.none() | changes,
    rft=st.none() | st.tuples(vectors, vectors, vectors),
    home_enu_m=st.none() | st.tuples(st.floats(-MAX_COORDINATE_M, MAX_COORDINATE_M), st.floats(-9.0, 9.0)),
    lost=st.lists(st.builds(LostVehicle, ids, places, vectors, st.floats(0.0, 600.0)), max_size=8).map(tuple),
)
percentiles = st.builds(Percentiles, numbers, numbers, numbers)
reports = st.builds(
    StatusReport,
    st.builds(
        STATUS_FORM.type,
        vehicle_id=st.integers(1, 250),
        session=counts,
        fleet=st.from_regex(FLEET_NAME[:-1], fullmatch=True),
        formation_hash=st.integers(0, 2**64 - 1),
        law=texts,
        phase=st.sampled_from(FlightPhase),
        mode_name=texts,
        armed=st.booleans(),
        landed=st.sampled_from(LandedState),
        position_enu_m=vectors,
        velocity_enu_m_s=vectors,
        state_age_s=numbers,
        hover_thrust_norm=numbers,
        disturbance_enu_m_s2=vectors,
        role=st.sampled_from(Role),
        epoch=counts,
        prc=st.integers(1, 250),
        leader_beacon=leader_beacons,
        leader_beacon_age_s=st.none() | numbers,
        neighbours=st.lists(st.integers(1, 250), max_size=5).map(tuple),
        slot=flown_slots,
        reference_enu_m=st.none() | vectors,
        flags=st.lists(st.sampled_from(HealthFlag), max_size=3).map(tuple),
        rejected=st.dictionaries(texts, counts, max_size=3),
        last_event=st.none() | notices,
    ).map(STATUS_FORM.whole),
    st.builds(Timing, numbers, counts, counts, percentiles, percentiles, numbers, numbers),
)
leads = st.builds(Lead, st.lists(ids, max_size=5).map(tuple), st.integers(0, MAX_EPOCH))
printable = texts.filter(str.isprintable)  # a decoder refuses others here, such as a no-break space
described = st.booleans() | printable | numbers | st.lists(numbers | st.lists(numbers, max_size=3), max_size=3)
references = st.builds(
    ReferenceChange, counts, st.dictionaries(texts, described, max_size=3), st.floats(0.0, MAX_MISSION_S)
)
others = st.sampled_from([name for name in CommandName if name not in CONTENT])
operators = st.from_regex(OPERATOR, fullmatch=True)
command_numbers = st.integers(1, MAX_NUMBER)
commands = (
    st.builds(Command, others, command_numbers, operators, counts)
    | st.builds(Command, st.just(CommandName.LEAD), command_numbers, operators, counts, leads)
    | st.builds(Command, st.just(CommandName.FORMATION), command_numbers, operators, counts, changes)
    | st.builds(Command, st.just(CommandName.REFERENCE), command_numbers, operators, counts, references)
)
replies = st.builds(CommandReply, st.integers(1, 250), counts, st.booleans(), st.sampled_from(Code), texts, operators)


@given(packets)
def test_peer_packet_round_trip(packet: PeerPacket) -> None:
    assert decode_peer(encode_peer(packet)) == packet


@given(reports)
def test_status_report_round_trip(report: StatusReport) -> None:
    assert decode_report(encode(report)) == report


@given(commands, replies)
def test_command_and_reply_round_trip(command: Command, reply: CommandReply) -> None:
    assert decode_command(encode(command)) == command
    assert decode_reply(encode(reply)) == reply


PACKET = PeerPacket(
    sender=Sender(vehicle_id=3, session=2**32 - 1, sequence=10**6, formation_hash=2**64 - 1),
    phase=FlightPhase.FORMATION,
    role=Role.FOLLOWER,
    motion=Motion(
        position_enu_m=(1.0, 2.0, 3.0),
        velocity_enu_m_s=(0.1, 0.2, 0.3),
        acceleration_enu_m_s2=(0.01, 0.02, 0.03),
        state_age_s=0.021,
        sent_s=1234.5,
    ),
    leader=LeaderReport(prc=4, beacon=LeaderBeacon(1, 7, 60, 12.5)),
    slot=FlownSlot((-3.0, 0.0, 0.5), (0.1, 0.0, 0.0), (0.2, 0.0, 0.0), 2, 3),
    position_error=PositionError(0.29, 0.28),
    reference=HeldReference(1, 2, 3.5),
)
REPORT = StatusReport(
    Status(
        agent=AgentIdentity(vehicle_id=3, session=1, fleet="platoon", formation_hash=5, law="weighted"),
        phase=FlightPhase.HOLD,
        autopilot=AutopilotReport(mode_name="AUTO.LOITER", armed=True, landed=LandedState.IN_AIR),
        motion=MotionReport(position_enu_m=(1.0, 2.0, 3.0), velocity_enu_m_s=(0.0, 0.0, 0.0), state_age_s=0.02),
        control=ControlReport(hover_thrust_norm=0.49, disturbance_enu_m_s2=(1.0, -2.0, 0.0)),
        leadership=LeadershipReport(role=Role.FOLLOWER, epoch=7, prc=2, leader_beacon=None, leader_beacon_age_s=None),
        neighbourhood=NeighbourReport(neighbours=(2, 4)),
        formation=FormationReport(slot=FlownSlot((-3.0, 0.0, 0.0)), reference_enu_m=None),
        safety=SafetyReport(flags=(HealthFlag.OUTSIDE_FENCE,)),
        rejected={"malformed": 3},
        last_event=Notice(Code.PHASE_CHANGED, "takeoff -> hold"),
    ),
    Timing(50.0, 3000, 0, Percentiles(1.0, 2.0, 3.0), Percentiles(4.0, 5.0, 6.0), 5.1, 49.0),
)
DECODERS = {
    "peer packet": (decode_peer, encode_peer(PACKET)),
    "status report": (decode_report, encode(REPORT)),
    "target": (decode_target, encode(TargetSample(1, 2, 3.5, (1.0, 0.0, 0.0), (4.0, 5.0, 6.0)))),
    "command": (decode_command, encode(Command(CommandName.LEAD, 9, "anna@ground", 7, Lead((2,), 8)))),
    "command reply": (decode_reply, encode(CommandReply(3, 9, True, Code.PHASE_CHANGED, "engage", "anna@ground"))),
}


def test_peer_packet_size_is_bounded() -> None:
    assert len(encode_peer(PACKET)) < 300
    turns = LeaderBeacon(1, 7, 60, 12.5, heading=Heading(1.0, 0.2, 0.1))
    assert len(encode_peer(with_fields(PACKET, beacon=turns))) < 330
    assert len(encode_peer(with_fields(PACKET, beacon=turns, proof=TermProof(2**32 - 1, bytes(64))))) < 405


@pytest.mark.parametrize("name", DECODERS)
@given(data=st.data())
@settings(max_examples=400)
def test_mutated_bytes_raise_only_wire_errors(name: str, data: st.DataObject) -> None:
    decode, good = DECODERS[name]
    damaged = bytearray(good)
    for _ in range(data.draw(st.integers(1, 4), "mutations")):
        at = data.draw(st.integers(0, max(0, len(damaged) - 1)), "at")
        match data.draw(st.sampled_from(["flip", "cut", "insert", "drop"]), "kind"):
            case "flip" if damaged:
                damaged[at] = data.draw(st.integers(0, 255), "byte")
            case "cut":
                del damaged[at:]
            case "insert":
                damaged[at:at] = data.draw(st.binary(max_size=20), "bytes")
            case "drop" if damaged:
                del damaged[at]
    try:
        decode(bytes(damaged))
    except WireError as error:
        assert 0 < len(str(error)) < 100


@pytest.mark.parametrize("name", DECODERS)
@given(payload=st.binary(max_size=200))
def test_arbitrary_bytes_raise_only_wire_errors(name: str, payload: bytes) -> None:
    decode, _ = DECODERS[name]
    for message in (payload, bytes((WIRE_VERSION,)) + payload):
        try:
            decode(message)
        except WireError as error:
            assert str(error)


@pytest.mark.parametrize("name", DECODERS)
@pytest.mark.parametrize("payload", [b"\x91" * 100_000, b"\x81\xa1x" + b"\x91" * 100_000, b"\xdd\xff\xff\xff\xff"])
def test_deep_nesting_and_huge_counts_are_malformed(name: str, payload: bytes) -> None:
    decode, _ = DECODERS[name]
    with pytest.raises(WireError, match="malformed"):
        decode(bytes((WIRE_VERSION,)) + payload)


@pytest.mark.parametrize("name", DECODERS)
def test_other_wire_version_is_not_reported_as_malformed(name: str) -> None:
    decode, good = DECODERS[name]
    with pytest.raises(WireError, match=f"wire version {WIRE_VERSION + 1}, expected {WIRE_VERSION}"):
        decode(bytes((WIRE_VERSION + 1,)) + good[1:])
    with pytest.raises(WireError, match=f"malformed {name}"):
        decode(good[:-1])
    with pytest.raises(WireError, match="empty message"):
        decode(b"")


@pytest.mark.parametrize(
    ("command", "reason"),
    [
        (Command(CommandName.LEAD, 9, "anna@ground", 7), "command lead with NoneType, expected Lead"),
        (Command(CommandName.FORM, 9, "anna@ground", 7, Lead((2,), 8)), "command form with Lead, expected NoneType"),
        (Command(CommandName.FORM, 9, "", 7), r"malformed command at \$.operator"),
        (Command(CommandName.FORM, 9, "an\x1bna", 7), r"malformed command at \$.operator"),
        (Command(CommandName.FORM, 9, "anna\n", 7), r"malformed command at \$.operator"),
        (Command(CommandName.FORM, 9, "a" * 64, 7), r"malformed command at \$.operator"),
        (Command(CommandName.FORM, 0, "anna", 7), r"malformed command at \$.number"),
        (Command(CommandName.FORM, 2**63, "anna", 7), r"malformed command at \$.number"),
    ],
)
def test_invalid_command_is_refused(command: Command, reason: str) -> None:
    with pytest.raises(WireError, match=reason):
        decode_command(encode(command))


SLOTS = ((1, (0.0, 0.0, 0.0)), (2, (-2.0, 0.0, 0.0)))
WRONG_CHANGES = [
    FormationChange(1, ((1, (nan, 0.0, 0.0)), SLOTS[1]), 10.0, 5.0),
    FormationChange(1, ((1, (0.0, 3e4, 0.0)), SLOTS[1]), 10.0, 5.0),
    FormationChange(1, ((0, (0.0, 0.0, 0.0)), SLOTS[1]), 10.0, 5.0),
    FormationChange(1, SLOTS * 200, 10.0, 5.0),
    FormationChange(-1, SLOTS, 10.0, 5.0),
    FormationChange(2**63, SLOTS, 10.0, 5.0),
    FormationChange(1, SLOTS, nan, 5.0),
    FormationChange(1, SLOTS, 1e300, 5.0),
    FormationChange(1, SLOTS, 10.0, inf),
    FormationChange(1, SLOTS, 10.0, 1e300),
    FormationChange(1, SLOTS, 10.0, 5.0, absent=(2**40,)),
]


@pytest.mark.parametrize("change", WRONG_CHANGES)
def test_formation_change_out_of_bounds_is_malformed(change: FormationChange) -> None:
    with pytest.raises(WireError, match="malformed command at"):
        decode_command(encode(Command(CommandName.FORMATION, 9, "anna", 7, change)))
    with pytest.raises(WireError, match="malformed peer packet at"):
        decode_peer(encode_peer(replace(PACKET, change=change)))


@pytest.mark.parametrize(
    "content",
    [
        Lead((2,), -1),
        Lead((2,), 2**40),
        Lead((2,) * 300, 1),
        Lead((-2,), 1),
        ReferenceChange(-1, {}, 1.0),
        ReferenceChange(1, {}, nan),
        ReferenceChange(1, {str(i): 1.0 for i in range(50)}, 1.0),
        ReferenceChange(1, {"radius_m": nan}, 1.0),
        ReferenceChange(1, {"points_enu_m": [[0.0, inf, 0.0]]}, 1.0),
        ReferenceChange(1, {"points_enu_m": [[0.0, 0.0, 0.0]] * 300}, 1.0),
        ReferenceChange(1, {"kind": "\x1b[2J"}, 1.0),
        ReferenceChange(1, {"kind\u202e": "point"}, 1.0),
        ReferenceChange(1, {"kind": "x" * 1000}, 1.0),
    ],
)
def test_content_out_of_bounds_is_malformed(content: Lead | ReferenceChange) -> None:
    name = CommandName.LEAD if isinstance(content, Lead) else CommandName.REFERENCE
    with pytest.raises(WireError, match=r"malformed command|control characters"):
        decode_command(encode(Command(name, 9, "anna", 7, content)))


@pytest.mark.parametrize(
    "changes",
    [
        {"fleet": "../x"},
        {"mode_name": "\x1b[2J"},
        {"law": "x" * 100},
        {"epoch": -1},
        {"command_number": 2**63},
        {"position_enu_m": (nan, 0.0, 0.0)},
        {"battery_percent": inf},
        {"rejected": {str(i): 1 for i in range(600)}},
        {"last_event": Notice(Code.PHASE_CHANGED, "two\nlines")},
        {"holder": "\u202eanna"},
        {"neighbours": (0,)},
    ],
)
def test_status_out_of_bounds_is_malformed(changes: dict[str, object]) -> None:
    assert decode_report(encode(REPORT)) == REPORT
    with pytest.raises(WireError, match="malformed status report"):
        decode_report(encode(replace(REPORT, status=with_fields(REPORT.status, **changes))))


def test_reference_command_has_the_description_of_a_file() -> None:
    circle = {"kind": "circle", "centre_enu_m": [0.0, 1.0, 2.0], "radius_m": 4, "period_s": 20.0}
    command = Command(CommandName.REFERENCE, 9, "anna@ground", 7, ReferenceChange(3, circle, 21.5))
    assert decode_command(encode(command)) == command
    with pytest.raises(WireError, match="command reference with NoneType, expected ReferenceChange"):
        decode_command(encode(Command(CommandName.REFERENCE, 9, "anna@ground", 7)))


@pytest.mark.parametrize("value", [None, {"a": 1.0}, [[[1.0]]], [["a"]]])
def test_description_with_other_types_than_yaml_is_refused(value: object) -> None:
    change = ReferenceChange(3, {"kind": value}, 21.5)  # type: ignore[dict-item]
    with pytest.raises(WireError, match="malformed command"):
        decode_command(encode(Command(CommandName.REFERENCE, 9, "anna@ground", 7, change)))


def test_target_round_trip_with_and_without_position() -> None:
    for position in (None, (4.0, 5.0, 6.0)):
        sample = TargetSample(2**32 - 1, 7, 12.5, (1.0, -2.0, 0.5), position)
        assert decode_target(encode(sample)) == sample


@pytest.mark.parametrize("name", DECODERS)
def test_message_of_another_kind_is_refused(name: str) -> None:
    decode, _ = DECODERS[name]
    for other, (_, message) in DECODERS.items():
        if other != name:
            with pytest.raises(WireError):
                decode(message)


def test_non_finite_numbers_pass_the_decoder() -> None:
    packet = PeerPacket(
        sender=Sender(vehicle_id=1, session=1, sequence=1, formation_hash=1),
        phase=FlightPhase.HOLD,
        role=Role.LEADER,
        motion=Motion(
            position_enu_m=(nan, inf, -inf),
            velocity_enu_m_s=(0.0, 0.0, 0.0),
            acceleration_enu_m_s2=(0.0, 0.0, 0.0),
            state_age_s=0.0,
            sent_s=0.0,
        ),
        leader=LeaderReport(prc=1, beacon=None),
        slot=FlownSlot((0.0, 0.0, 0.0)),
    )
    x, y, z = decode_peer(encode_peer(packet)).motion.position_enu_m
    assert isnan(x)
    assert (y, z) == (inf, -inf)


def test_decoders_leave_the_interpreter_whole() -> None:
    """msgspec frees the decoders at the end: a type that it lays out wrongly aborts the process there."""
    ended = subprocess.run(
        [sys.executable, "-c", "import companion.wire.messages, companion.wire.messages"], check=False
    )
    assert ended.returncode == 0
