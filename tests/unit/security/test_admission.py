"""Admission lists: only the authority's own bytes are accepted, and only forwards."""

import json
from datetime import UTC, datetime
from typing import Any

import msgspec
import pytest
from cryptography.hazmat.primitives.asymmetric import ec
from hypothesis import given
from hypothesis import strategies as st
from msgspec.structs import replace

from companion.security.admission import (
    HASH,
    MAX_LIST_BYTES,
    MAX_PARTICIPANTS,
    MAX_REVOKED,
    AdmissionError,
    Admitted,
    AdmittedParticipant,
    RevokedParticipant,
    accept,
    authority_certificate,
    key_der,
    new_key,
    sign,
    verify,
)
from companion.security.names import ParticipantRole, parse_common_name

NOW = datetime(2026, 11, 22, 12, 0, 0, tzinfo=UTC)
KEY = new_key()
AUTHORITY = authority_certificate("alpha", KEY, NOW)
PUBLIC_KEY = key_der(KEY.public_key())


def entry(name: str, serial: str) -> AdmittedParticipant:
    return AdmittedParticipant(name=name, serial=serial, public_key=PUBLIC_KEY, expires_at=NOW)


ADMITTED = Admitted(
    fleet="alpha",
    number=7,
    issued_at=NOW,
    participants=(entry("vehicle-1", "a1"), entry("vehicle-3.2", "a2"), entry("ground-anna", "a3")),
    revoked=(RevokedParticipant(name="vehicle-3", serial="b1", revoked_at=NOW),),
)
DATA = sign(ADMITTED, KEY, AUTHORITY)
CONTENT: dict[str, Any] = json.loads(msgspec.json.encode(ADMITTED))


def signed_content(content: object, key: ec.EllipticCurvePrivateKey = KEY) -> bytes:
    """A file with a right signature over any JSON, as an authority of another version would write it."""
    payload = json.dumps(content, separators=(",", ":"), allow_nan=True).encode()
    signature = key.sign(payload, ec.ECDSA(HASH))
    return msgspec.json.encode({"payload": payload.decode(), "signature": signature}) + b"\n"


def refused(data: bytes) -> str:
    with pytest.raises(AdmissionError) as caught:
        verify(data, AUTHORITY)
    text = str(caught.value)
    assert text.isprintable()
    return text


def test_a_signed_list_is_read_as_it_was_written() -> None:
    assert verify(DATA, AUTHORITY) == ADMITTED
    assert verify(signed_content(CONTENT), AUTHORITY) == ADMITTED


def test_the_current_name_of_a_participant_is_found() -> None:
    assert ADMITTED.name_of(ParticipantRole.VEHICLE, 3) == "vehicle-3.2"
    assert ADMITTED.name_of(ParticipantRole.VEHICLE, 2) is None
    assert ADMITTED.name_of(ParticipantRole.GROUND, "anna") == "ground-anna"
    assert ADMITTED.names(ParticipantRole.VEHICLE) == ("vehicle-1", "vehicle-3.2")
    assert ADMITTED.participant("vehicle-3") is None
    assert ADMITTED.revocation("vehicle-3") is not None
    found = ADMITTED.participant("vehicle-1")
    assert found is not None
    assert found.key() == KEY.public_key()


def test_the_next_name_was_never_revoked() -> None:
    names = {text: str(ADMITTED.next_name(parse_common_name(text))) for text in ("vehicle-3", "vehicle-9")}
    assert names == {"vehicle-3": "vehicle-3.2", "vehicle-9": "vehicle-9"}


def test_every_changed_byte_is_refused() -> None:
    for position in range(len(DATA)):
        changed = bytearray(DATA)
        changed[position] ^= 1 << position % 8
        refused(bytes(changed))


def test_every_removed_or_added_byte_is_refused() -> None:
    for position in range(len(DATA)):
        refused(DATA[:position] + DATA[position + 1 :])
    for added in (b" ", b"\n", b"\x00", b"=", b"}"):
        refused(added + DATA)
        refused(DATA + added)


def test_another_authority_of_the_same_fleet_is_refused() -> None:
    other = new_key()
    assert "not signed by alpha authority" in refused(sign(ADMITTED, other, authority_certificate("alpha", other, NOW)))


def test_another_fleet_is_refused() -> None:
    assert refused(signed_content(CONTENT | {"fleet": "beta"})) == 'is of fleet "beta", expected "alpha"'


@pytest.mark.parametrize(
    "change",
    [
        {"number": -1},
        {"number": 2**40},
        {"number": 1.5},
        {"number": float("nan")},
        {"number": "7"},
        {"issued_at": "2026-11-22T12:00:00"},
        {"issued_at": 1e400},
        {"fleet": "alpha\n"},
        {"more": 1},
        {"participants": None},
        {"participants": CONTENT["participants"] * 100},
        {"revoked": CONTENT["revoked"] * (MAX_REVOKED + 1)},
    ],
)
def test_a_signed_content_out_of_bounds_is_refused(change: dict[str, Any]) -> None:
    assert "content that this version does not accept" in refused(signed_content(CONTENT | change))


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"name": "vehicle-999"}, "vehicle-999"),
        ({"name": "vehicle-1.1"}, "vehicle-1.1"),
        ({"name": "drone-1"}, "drone-1"),
        ({"name": "vehicle-3.3"}, "participant vehicle-3 twice"),
        ({"name": "vehicle-3"}, "participant vehicle-3 twice"),
        ({"name": "vehicle-*"}, "does not accept"),
        ({"serial": "a2"}, "serial a2 twice"),
        ({"serial": "b1"}, "serial b1 twice"),
        ({"serial": "0a"}, "does not accept"),
        ({"serial": "A1"}, "does not accept"),
        ({"public_key": "AAAA"}, "does not accept"),
        ({"public_key": "A" * 121 + "A=="[:3]}, "public key of vehicle-1"),
    ],
)
def test_a_signed_entry_that_contradicts_is_refused(change: dict[str, Any], words: str) -> None:
    first, *others = CONTENT["participants"]
    assert words in refused(signed_content(CONTENT | {"participants": [first | change, *others]}))


def test_a_name_that_was_revoked_cannot_be_admitted_again() -> None:
    again = replace(ADMITTED, participants=(entry("vehicle-3", "c1"),))
    with pytest.raises(AdmissionError, match="the name vehicle-3 twice"):
        sign(again, KEY, AUTHORITY)


def test_the_largest_list_fits_and_a_larger_file_is_refused_at_once() -> None:
    participants = tuple(entry(f"target-{'a' * 38}{i:03}", f"a{i:039x}") for i in range(MAX_PARTICIPANTS))
    revoked = tuple(
        RevokedParticipant(name=f"target-{'b' * 38}{i:03}.1000", serial=f"b{i:039x}", revoked_at=NOW)
        for i in range(MAX_REVOKED)
    )
    largest = replace(ADMITTED, participants=participants, revoked=revoked)
    assert verify(sign(largest, KEY, AUTHORITY), AUTHORITY) == largest
    assert refused(b"{" * (MAX_LIST_BYTES + 1)) == "larger than 256 kB"


@given(
    st.binary(max_size=300)
    | st.recursive(st.none() | st.text(), lambda x: st.lists(x)).map(lambda x: json.dumps(x).encode())
)
def test_any_bytes_are_refused_with_the_one_error(data: bytes) -> None:
    refused(data)


@given(
    st.recursive(
        st.none() | st.floats() | st.integers() | st.text(), lambda x: st.lists(x) | st.dictionaries(st.text(), x)
    )
)
def test_any_signed_content_is_refused_with_the_one_error(content: object) -> None:
    refused(signed_content(content))


@given(st.sampled_from(sorted(CONTENT)), st.none() | st.floats() | st.integers() | st.text() | st.lists(st.text()))
def test_any_signed_field_is_read_or_refused_with_the_one_error(field: str, value: object) -> None:
    try:
        admitted = verify(signed_content(CONTENT | {field: value}), AUTHORITY)
    except AdmissionError:
        return
    assert admitted.fleet == "alpha"


def test_deep_nesting_is_refused() -> None:
    refused(b'{"payload":' + b"[" * 200_000)
    refused(signed_content(json.loads("[" * 500 + "]" * 500)))


@pytest.mark.parametrize(
    ("number", "words"), [(6, "list 7 is held, an older one is refused"), (7, "with another content")]
)
def test_a_list_that_is_not_newer_is_refused(number: int, words: str) -> None:
    older = replace(ADMITTED, number=number, participants=ADMITTED.participants[:1])
    with pytest.raises(AdmissionError, match=words):
        accept(sign(older, KEY, AUTHORITY), AUTHORITY, ADMITTED)


def test_the_list_held_and_a_newer_one_are_accepted() -> None:
    newer = replace(ADMITTED, number=9, participants=())
    assert accept(DATA, AUTHORITY, ADMITTED) == ADMITTED
    assert accept(sign(newer, KEY, AUTHORITY), AUTHORITY, ADMITTED) == newer
