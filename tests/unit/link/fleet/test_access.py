"""Who may publish what to whom: the access control of each participant."""

from __future__ import annotations

import shutil
from itertools import product
from pathlib import Path

import pytest

from companion.link.fleet.identity import load
from companion.link.fleet.zenoh_session import access_control, keys_between
from companion.security.identity import ADMITTED_FILE
from companion.security.names import ParticipantName, parse_common_name
from secured_fleet import provisioned

NAMES = (
    "vehicle-1", "vehicle-2", "vehicle-3.2", "ground-anna", "ground-ben", "monitor-tower", "target-beacon", "traffic-adsb",
    "mocap-hall",
)  # fmt: skip
PARTICIPANTS = tuple(map(parse_common_name, NAMES))


def keys(sender: str, receiver: str) -> set[str]:
    samples, _ = keys_between(parse_common_name(sender), parse_common_name(receiver), "f")
    return {key.removeprefix("formation/f/") for key in samples}


@pytest.mark.parametrize(
    ("sender", "receiver", "expected"),
    [
        ("vehicle-1", "vehicle-2", {"peer/1", "distant/1", "pairing/1/2"}),
        ("vehicle-3.2", "vehicle-2", {"peer/3", "distant/3", "pairing/3/2"}),
        ("vehicle-1", "ground-anna", {"peer/1", "status/1", "reply/1"}),
        ("vehicle-1", "monitor-tower", {"peer/1", "status/1", "reply/1"}),
        (
            "ground-anna",
            "vehicle-2",
            {"command/2/ground-anna", "check/2/ground-anna", "abort/2/ground-anna", "admitted/ground-anna"},
        ),
        ("target-beacon", "vehicle-2", {"target/beacon"}),
        ("traffic-adsb", "vehicle-2", {"traffic/adsb/*"}),
        ("mocap-hall", "vehicle-2", {"pose/hall/2"}),
        ("monitor-tower", "vehicle-2", set()),
        ("ground-anna", "ground-ben", set()),
        ("vehicle-1", "target-beacon", set()),
    ],
)
def test_each_role_publishes_its_own_keys(sender: str, receiver: str, expected: set[str]) -> None:
    assert keys(sender, receiver) == expected


def test_no_two_participants_publish_the_same_key() -> None:
    for receiver, one, other in product(NAMES, NAMES, NAMES):
        if one != other:
            assert not keys(one, receiver) & keys(other, receiver)


@pytest.mark.parametrize("own", PARTICIPANTS, ids=str)
def test_all_that_no_rule_permits_is_denied(own: ParticipantName) -> None:
    control = access_control(own, "f", PARTICIPANTS)
    assert control["enabled"] is True
    assert control["default_permission"] == "deny"
    assert {rule["permission"] for rule in control["rules"]} == {"allow"}
    assert {message for rule in control["rules"] for message in rule["messages"]} <= {"put", "declare_subscriber"}
    subjects = {subject["id"]: subject["cert_common_names"] for subject in control["subjects"]}
    assert str(own) not in subjects
    assert all(names == [subject] for subject, names in subjects.items())
    ids = [rule["id"] for rule in control["rules"]]
    assert len(ids) == len(set(ids)), "Zenoh needs rules with different ids"
    assert {name for policy in control["policies"] for name in policy["rules"]} == set(ids)


def test_what_one_end_sends_the_other_end_receives() -> None:
    def rules(own: ParticipantName, other: ParticipantName, message: str, flow: str) -> set[str]:
        control = access_control(own, "f", PARTICIPANTS)
        names = {
            name for policy in control["policies"] if policy["subjects"] == [str(other)] for name in policy["rules"]
        }
        return {
            key
            for rule in control["rules"]
            if rule["id"] in names and rule["messages"] == [message] and rule["flows"] == [flow]
            for key in rule["key_exprs"]
        }

    for own, other in product(PARTICIPANTS, PARTICIPANTS):
        for message in ("put", "declare_subscriber"):
            assert rules(own, other, message, "egress") == rules(other, own, message, "ingress")


# ---------------------------------------------------------------- the admission list in use


def test_the_newer_of_two_lists_is_used(tmp_path: Path) -> None:
    fleet = provisioned(tmp_path / "fleet")
    own, state = fleet.folder_of("vehicle-1"), {"STATE_DIRECTORY": str(tmp_path)}
    first = shutil.copy(own / ADMITTED_FILE, tmp_path / "first.json")
    newer = fleet.revoke("ground-ben").read_bytes()
    for copied, kept in ((newer, first.read_bytes()), (first.read_bytes(), newer)):
        (own / ADMITTED_FILE).write_bytes(copied)
        (tmp_path / ADMITTED_FILE).write_bytes(kept)
        assert load(own, state).admitted.revocation("ground-ben")


def test_a_list_of_an_earlier_authority_is_left_alone(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    earlier, fleet = provisioned(tmp_path / "earlier"), provisioned(tmp_path / "fleet")
    (tmp_path / ADMITTED_FILE).write_bytes(earlier.revoke("ground-ben").read_bytes())
    own = fleet.folder_of("vehicle-1")
    assert load(own, {"STATE_DIRECTORY": str(tmp_path)}).admitted == load(own, {}).admitted
    assert f"the list in {own} is used" in caplog.text
