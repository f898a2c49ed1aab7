"""The wire format: what goes in comes out, and whatever else comes in is a WireError and nothing worse."""

from __future__ import annotations

from math import inf, isnan, nan

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from msgspec.structs import replace

from companion.types import (
    CONTENT,
    EAST,
    Command,
    CommandName,
    CommandReply,
    FlightPhase,
    FlownSlot,
    FormationChange,
    Heading,
    HealthFlag,
    HeldReference,
    LandedState,
    Lead,
    LeaderWord,
    PeerPacket,
    PositionError,
    ReferenceChange,
    Role,
    Status,
    TargetSample,
)
from companion.wire.ground import (
    OPERATOR,
    Percentiles,
    StatusReport,
    Timing,
    decode_command,
    decode_reply,
    decode_report,
    encode,
)
from companion.wire.peer import decode_peer, encode_peer
from companion.wire.target import decode_target, encode_target
from companion.wire.version import WIRE_VERSION, WireError

numbers = st.floats(allow_nan=False)
vectors = st.tuples(numbers, numbers, numbers)
counts = st.integers(0, 2**63 - 1)
texts = st.text(max_size=40)
headings = st.builds(Heading, numbers, numbers, numbers)
leader_words = st.none() | st.builds(
    LeaderWord, st.integers(1, 250), counts, counts, numbers, st.integers(0, 250), st.just(EAST) | headings
)

flown_slots = st.builds(FlownSlot, vectors, vectors, vectors, counts, counts, st.booleans())
packets = st.builds(
    PeerPacket,
    vehicle_id=st.integers(1, 250),
    session=counts,
    sequence=counts,
    formation_hash=st.integers(0, 2**64 - 1),
    phase=st.sampled_from(FlightPhase),
    role=st.sampled_from(Role),
    position_enu_m=vectors,
    velocity_enu_m_s=vectors,
    acceleration_enu_m_s2=vectors,
    state_age_s=numbers,
    sent_s=numbers,
    prc=st.integers(1, 250),
    leader_word=leader_words,
    slot=flown_slots,
    reference=st.none() | st.builds(HeldReference, counts, counts, numbers),
    change=st.none() | st.builds(FormationChange, counts, st.tuples(st.tuples(counts, vectors)), numbers, numbers),
)
percentiles = st.builds(Percentiles, numbers, numbers, numbers)
reports = st.builds(
    StatusReport,
    st.builds(
        Status,
        vehicle_id=st.integers(1, 250),
        session=counts,
        fleet=texts,
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
        leader_word=leader_words,
        leader_word_age_s=st.none() | numbers,
        neighbours=st.lists(st.integers(1, 250), max_size=5).map(tuple),
        slot=flown_slots,
        reference_enu_m=st.none() | vectors,
        flags=st.lists(st.sampled_from(HealthFlag), max_size=3).map(tuple),
        rejected=st.dictionaries(texts, counts, max_size=3),
        last_event=texts,
    ),
    st.builds(Timing, numbers, counts, counts, percentiles, percentiles, numbers, numbers),
)
leads = st.builds(Lead, st.lists(st.integers(1, 250), max_size=5).map(tuple), counts)
changes = st.builds(
    FormationChange, counts, st.lists(st.tuples(st.integers(1, 250), vectors), max_size=5).map(tuple), numbers, numbers
)
described = st.booleans() | texts | numbers | st.lists(numbers | st.lists(numbers, max_size=3), max_size=3)
references = st.builds(ReferenceChange, counts, st.dictionaries(texts, described, max_size=3), numbers)
others = st.sampled_from([name for name in CommandName if name not in CONTENT])
operators = st.from_regex(OPERATOR, fullmatch=True)
command_numbers = st.integers(1, 2**63 - 1)
commands = (
    st.builds(Command, others, command_numbers, operators, counts)
    | st.builds(Command, st.just(CommandName.LEAD), command_numbers, operators, counts, leads)
    | st.builds(Command, st.just(CommandName.FORMATION), command_numbers, operators, counts, changes)
    | st.builds(Command, st.just(CommandName.REFERENCE), command_numbers, operators, counts, references)
)
replies = st.builds(CommandReply, st.integers(1, 250), counts, st.booleans(), texts)


@given(packets)
def test_a_peer_packet_comes_out_as_it_went_in(packet: PeerPacket) -> None:
    assert decode_peer(encode_peer(packet)) == packet


@given(reports)
def test_a_status_report_comes_out_as_it_went_in(report: StatusReport) -> None:
    assert decode_report(encode(report)) == report


@given(commands, replies)
def test_commands_and_replies_come_out_as_they_went_in(command: Command, reply: CommandReply) -> None:
    assert decode_command(encode(command)) == command
    assert decode_reply(encode(reply)) == reply


PACKET = PeerPacket(
    3, 2**32 - 1, 10**6, 2**64 - 1, FlightPhase.FORMATION, Role.FOLLOWER, (1.0, 2.0, 3.0), (0.1, 0.2, 0.3),
    (0.01, 0.02, 0.03), 0.021, 1234.5, 4, LeaderWord(1, 7, 60, 12.5),
    FlownSlot((-3.0, 0.0, 0.5), (0.1, 0.0, 0.0), (0.2, 0.0, 0.0), 2, 3),
    PositionError(0.29, 0.28), HeldReference(1, 2, 3.5),
)  # fmt: skip
REPORT = StatusReport(
    Status(
        3, 1, "platoon", 5, "weighted", FlightPhase.HOLD, "AUTO.LOITER", True, LandedState.IN_AIR, (1.0, 2.0, 3.0),
        (0.0, 0.0, 0.0), 0.02, 0.49, (1.0, -2.0, 0.0), Role.FOLLOWER, 7, 2, None, None, (2, 4),
        FlownSlot((-3.0, 0.0, 0.0)), None,
        (HealthFlag.FENCE,),
        {"malformed": 3}, "takeoff -> hold",
    ),
    Timing(50.0, 3000, 0, Percentiles(1.0, 2.0, 3.0), Percentiles(4.0, 5.0, 6.0), 5.1, 49.0),
)  # fmt: skip
DECODERS = {
    "peer packet": (decode_peer, encode_peer(PACKET)),
    "status report": (decode_report, encode(REPORT)),
    "target": (decode_target, encode_target(TargetSample(1, 2, 3.5, (1.0, 0.0, 0.0), (4.0, 5.0, 6.0)))),
    "command": (decode_command, encode(Command(CommandName.LEAD, 9, "anna@ground", 7, Lead((2,), 8)))),
    "command reply": (decode_reply, encode(CommandReply(3, 9, True, "engage"))),
}


def test_a_peer_packet_stays_small() -> None:
    assert len(encode_peer(PACKET)) < 290
    turns = LeaderWord(1, 7, 60, 12.5, heading=Heading(1.0, 0.2, 0.1))
    assert len(encode_peer(replace(PACKET, leader_word=turns))) < 320


@pytest.mark.parametrize("name", DECODERS)
@given(data=st.data())
@settings(max_examples=400)
def test_mutated_bytes_raise_nothing_but_wire_errors(name: str, data: st.DataObject) -> None:
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
        assert 0 < len(str(error)) < 80  # it is counted by its text


@pytest.mark.parametrize("name", DECODERS)
@given(payload=st.binary(max_size=200))
def test_any_bytes_raise_nothing_but_wire_errors(name: str, payload: bytes) -> None:
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
def test_another_version_is_told_from_damage(name: str) -> None:
    decode, good = DECODERS[name]
    with pytest.raises(WireError, match=f"wire version 9, expected {WIRE_VERSION}"):
        decode(b"\x09" + good[1:])
    with pytest.raises(WireError, match=f"malformed {name}"):
        decode(good[:-1])
    with pytest.raises(WireError, match="empty message"):
        decode(b"")


@pytest.mark.parametrize(
    ("command", "reason"),
    [
        (Command(CommandName.LEAD, 9, "anna@ground", 7), "command lead with NoneType, expected Lead"),
        (Command(CommandName.FORM, 9, "anna@ground", 7, Lead((2,), 8)), "command form with Lead, expected NoneType"),
        (Command(CommandName.FORM, 9, "", 7), "command form of an operator without a proper name"),
        (Command(CommandName.FORM, 9, "an\x1bna", 7), "command form of an operator without a proper name"),
        (Command(CommandName.FORM, 9, "anna\n", 7), "command form of an operator without a proper name"),
        (Command(CommandName.FORM, 9, "a" * 64, 7), "command form of an operator without a proper name"),
        (Command(CommandName.FORM, 0, "anna", 7), "command form with a number out of range"),
        (Command(CommandName.FORM, 2**63, "anna", 7), "command form with a number out of range"),
    ],
)
def test_a_command_that_is_none_is_refused(command: Command, reason: str) -> None:
    with pytest.raises(WireError, match=reason):
        decode_command(encode(command))


def test_the_command_reference_brings_a_description_as_a_file_has_it() -> None:
    circle = {"kind": "circle", "centre_enu_m": [0.0, 1.0, 2.0], "radius_m": 4, "period_s": 20.0}
    command = Command(CommandName.REFERENCE, 9, "anna@ground", 7, ReferenceChange(3, circle, 21.5))
    assert decode_command(encode(command)) == command
    with pytest.raises(WireError, match="command reference with NoneType, expected ReferenceChange"):
        decode_command(encode(Command(CommandName.REFERENCE, 9, "anna@ground", 7)))


@pytest.mark.parametrize("value", [None, {"a": 1.0}, [[[1.0]]], [["a"]]])
def test_a_description_of_other_things_than_a_file_s_section_holds_is_refused(value: object) -> None:
    change = ReferenceChange(3, {"kind": value}, 21.5)  # type: ignore[dict-item]
    with pytest.raises(WireError, match="malformed command"):
        decode_command(encode(Command(CommandName.REFERENCE, 9, "anna@ground", 7, change)))


def test_a_target_with_and_without_a_position_comes_out_as_it_went_in() -> None:
    for position in (None, (4.0, 5.0, 6.0)):
        sample = TargetSample(2**32 - 1, 7, 12.5, (1.0, -2.0, 0.5), position)
        assert decode_target(encode_target(sample)) == sample


@pytest.mark.parametrize("name", DECODERS)
def test_a_message_of_another_kind_is_refused(name: str) -> None:
    decode, _ = DECODERS[name]
    for other, (_, message) in DECODERS.items():
        if other != name:
            with pytest.raises(WireError):
                decode(message)


def test_numbers_that_are_not_finite_pass_the_wire_and_are_left_to_the_core() -> None:
    packet = PeerPacket(
        1,
        1,
        1,
        1,
        FlightPhase.HOLD,
        Role.LEADER,
        (nan, inf, -inf),
        (0.0, 0.0, 0.0),
        (0.0, 0.0, 0.0),
        0.0,
        0.0,
        1,
        None,
        FlownSlot((0.0, 0.0, 0.0)),
    )
    x, y, z = decode_peer(encode_peer(packet)).position_enu_m
    assert isnan(x)
    assert (y, z) == (inf, -inf)
