"""Common names of participants: one spelling each, and compatible with the names in keys and fleet files."""

import re

import pytest
from hypothesis import given
from hypothesis import strategies as st

from companion.link.fleet.zenoh_link import TRAFFIC_NAME
from companion.security.names import ParticipantName, ParticipantRole, parse_common_name, participant_name
from companion.types.values import FLEET_NAME


@pytest.mark.parametrize(
    ("text", "role", "id_", "generation"),
    [
        ("vehicle-3", "vehicle", "3", 1),
        ("vehicle-250.12", "vehicle", "250", 12),
        ("ground-anna", "ground", "anna", 1),
        ("monitor-tower-2.3", "monitor", "tower-2", 3),
        ("target-beacon", "target", "beacon", 1),
        ("traffic-4CA_1-", "traffic", "4CA_1-", 1),
    ],
)
def test_common_names(text: str, role: str, id_: str, generation: int) -> None:
    name = parse_common_name(text)
    assert name == ParticipantName(ParticipantRole(role), id_, generation)
    assert str(name) == text
    assert name.participant == f"{role}-{id_}"


@pytest.mark.parametrize(
    "text",
    [
        "", "vehicle", "vehicle-", "vehicle-0", "vehicle-03", "vehicle-251", "vehicle-٣", "vehicle-3.1", "vehicle-3.0",
        "vehicle-3.02", "vehicle-3.10000", "vehicle-3.2.3", "vehicle-3\n", " vehicle-3", "Vehicle-3", "drone-3",
        "ground-Anna", "ground--a", "ground-" + "a" * 33, "target-Beacon", "traffic-" + "a" * 33, "ground-a/b",
        "ground-*", "alpha authority",
    ],
)  # fmt: skip
def test_other_texts_are_no_common_names(text: str) -> None:
    with pytest.raises(ValueError, match="expected"):
        parse_common_name(text)


@given(st.text())
def test_any_text_is_a_name_in_its_one_spelling_or_refused(text: str) -> None:
    try:
        name = parse_common_name(text)
    except ValueError:
        return
    assert str(name) == text


@given(st.from_regex(re.compile(FLEET_NAME[:-1] + r"\Z", re.ASCII)))
def test_every_name_of_a_target_reference_has_a_common_name(name: str) -> None:
    assert parse_common_name(str(participant_name(ParticipantRole.TARGET, name))).id == name


@given(st.from_regex(TRAFFIC_NAME, fullmatch=True))
def test_every_name_of_traffic_has_a_common_name(name: str) -> None:
    assert parse_common_name(str(participant_name(ParticipantRole.TRAFFIC, name))).id == name
