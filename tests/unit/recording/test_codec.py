"""Inbox and Outbox come back from a recording bit for bit."""

import json
import struct
from math import copysign, inf, nan

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from companion.recording.codec import (
    RecordError,
    TopicDecoder,
    decode_inbox,
    decode_outbox,
    encode,
    encode_inbox,
    encode_outbox,
    header_of,
    log_time_ns,
    metadata_of,
    monotonic_s,
)
from companion.recording.records import Header, TimingRecord
from companion.types.autopilot import AckSample, Arm, Disarm, EstimatorSample, ParameterSample, TextSample
from companion.types.notices import Code, Notice
from companion.types.tick import Inbox, Outbox
from recordings import inboxes, outboxes

HEADER = Header(
    software="1.2",
    fleet="pair",
    vehicle_id=3,
    session=2**32 - 1,
    part=1,
    unix_s=1.7e9 + 0.123456,
    monotonic_s=12345.678901234,
    fleet_file='{"name": "pair"}',
    vehicle_file="{}",
)


def bits(value: object) -> str:
    """Distinguishes 0.0 from -0.0, and one type from another; NaN is like any NaN."""
    return repr(value)


@settings(deadline=None)
@given(now_s=st.floats(), inbox=inboxes())
def test_an_inbox_comes_back_bit_for_bit(now_s: float, inbox: Inbox) -> None:
    assert bits(decode_inbox(encode_inbox(now_s, inbox))) == bits((now_s, inbox))


@settings(deadline=None)
@given(now_s=st.floats(), outbox=outboxes())
def test_an_outbox_comes_back_bit_for_bit(now_s: float, outbox: Outbox) -> None:
    assert bits(decode_outbox(encode_outbox(now_s, outbox))) == bits((now_s, outbox))


@given(st.floats(allow_nan=False))
def test_the_digits_of_a_float_give_the_same_float(value: float) -> None:
    now_s, _ = decode_inbox(encode_inbox(value, Inbox()))
    assert struct.pack("d", now_s) == struct.pack("d", value)


def test_numbers_that_are_not_finite_are_null_and_named() -> None:
    samples = (EstimatorSample(1.0, nan, inf), TextSample(1.0, 4, "null"), ParameterSample(1.0, "P", -inf))
    data = encode_inbox(1.0, Inbox(samples))
    assert json.loads(data) == {
        "not_finite": ["nan", "inf", "-inf"],
        "now_s": 1.0,
        "telemetry": [
            ["EstimatorSample", 1.0, None, None, True, "not_reported"],
            ["TextSample", 1.0, 4, "null", False],
            ["ParameterSample", 1.0, "P", None],
        ],
        "late_s": 0.0,
        "law_s": 0.0,
    }
    assert bits(decode_inbox(data)) == bits((1.0, Inbox(samples)))


def test_the_order_of_telemetry_stays() -> None:
    samples = (*(ParameterSample(1.0, f"P{i}", float(i)) for i in range(5)), TextSample(1.0, 4, "text"))
    assert decode_inbox(encode_inbox(1.0, Inbox(samples[::-1])))[1].telemetry == samples[::-1]


def test_an_acknowledgement_names_the_types_of_requests() -> None:
    inbox = Inbox((AckSample(1.0, (Arm, Disarm), True, "accepted"),))
    data = encode_inbox(1.0, inbox)
    assert json.loads(data)["telemetry"] == [["AckSample", 1.0, ["Arm", "Disarm"], True, "accepted"]]
    assert decode_inbox(data)[1] == inbox


def test_an_empty_tick_is_short() -> None:
    assert encode_outbox(1.5, Outbox()) == b'{"now_s":1.5}'
    assert encode_inbox(1.5, Inbox()) == b'{"now_s":1.5,"late_s":0.0,"law_s":0.0}'


@pytest.mark.parametrize(
    "data",
    [
        b"",
        b"[]",
        b"\xff\xfe",
        b'{"now_s":"1"}',
        b'{"now_s":null}',
        b'{"now_s":1.0,"unknown":1}',
        b'{"now_s":1.0,"telemetry":[["NoSample",1.0]]}',
        b'{"now_s":1.0,"telemetry":[["TextSample",1.0]]}',
        b'{"now_s":1.0,"telemetry":[["AckSample",1.0,["Inbox"],true,""]]}',
        b'{"now_s":1.0,"peers":[[1.0,[1]]]}',
        b'{"not_finite":1,"now_s":1.0}',
        b'{"not_finite":["nan"],"now_s":1.0}',
        b'{"not_finite":[],"now_s":null}',
        b'{"not_finite":["1e9"],"now_s":null}',
        b'{"not_finite":[],"now_s":' + b"[" * 100_000,
        b'{"now_s":' + b"9" * 100_000 + b"}",
    ],
)
def test_a_damaged_message_is_one_line(data: bytes) -> None:
    for decode in (decode_inbox, decode_outbox):
        with pytest.raises(RecordError) as caught:
            decode(data)
        assert len(str(caught.value)) < 300
        assert "\n" not in str(caught.value)


def test_the_other_messages_are_plain_json() -> None:
    notice = Notice(Code.PEER_STALE, "2: no packet for 0.3 s")
    assert json.loads(encode(notice)) == {"code": "PEER_STALE", "text": "2: no packet for 0.3 s"}
    assert TopicDecoder(Notice).decode(encode(notice)) == notice
    timing = TimingRecord(1.0, 20, 300, 900, None)
    assert TopicDecoder(TimingRecord).decode(encode(timing)) == timing
    with pytest.raises(RecordError):
        TopicDecoder(TimingRecord).decode(encode(notice))


def test_a_header_comes_back_from_metadata() -> None:
    metadata = metadata_of(HEADER)
    assert all(isinstance(value, str) for value in metadata.values())
    assert header_of(metadata) == HEADER


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        ({"format": "other"}, "not a recording"),
        ({"version": "2"}, "version 2 of the format, expected 1"),
        ({"part": "one"}, "header is not valid"),
        ({"unix_s": "nan"}, "header is not valid"),
    ],
)
def test_a_header_of_another_format_is_refused(change: dict[str, str], reason: str) -> None:
    with pytest.raises(RecordError, match=reason):
        header_of(metadata_of(HEADER) | change)


@given(st.floats(0, 1e7))
def test_unix_time_keeps_a_moment_to_the_microsecond(now_s: float) -> None:
    assert abs(monotonic_s(HEADER, log_time_ns(HEADER, now_s)) - now_s) < 1e-6


def test_minus_zero_stays() -> None:
    assert copysign(1.0, decode_inbox(encode_inbox(0.0, Inbox(late_s=-0.0)))[1].late_s) == -1.0
