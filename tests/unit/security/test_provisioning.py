"""Folders of a fleet: what is written, what is never overwritten, and what a failure leaves."""

import os
import shutil
from collections.abc import Iterator
from datetime import timedelta
from pathlib import Path

import pytest

from companion.config.file import ConfigError
from companion.config.vehicle import Signing
from companion.link.autopilot_link import read_signing_key
from companion.security.admission import accept
from companion.security.identity import load_identity, one_at_a_time, open_authority
from companion.security.names import ParticipantName, ParticipantRole, participant_name
from companion.security.provision_report import new_text, renew_text
from companion.security.provisioning import Provisioned, open_provisioned, provision_new, renew, revoke
from secured_fleet import GROUND_ANNA, NOW, fleet_files, provisioned_by_operator, tree

LATER = NOW + timedelta(days=30)
TOWER = participant_name(ParticipantRole.MONITOR, "tower")
BEN = participant_name(ParticipantRole.GROUND, "ben")


@pytest.fixture
def field(tmp_path: Path) -> Path:
    """A fleet with two vehicles and ground-anna."""
    provisioned_by_operator(tmp_path / "field")
    return tmp_path / "field"


@pytest.fixture(params=[0o000, 0o077, 0o777])
def umask(request: pytest.FixtureRequest) -> Iterator[int]:
    before = os.umask(request.param)
    yield request.param
    os.umask(before)


def again(field: Path, *wanted: ParticipantName) -> Provisioned:
    return provision_new(field, wanted, GROUND_ANNA, 365, LATER)


def names(field: Path) -> list[str]:
    return [one.name for one in open_provisioned(field).admitted.participants]


def lists(field: Path) -> set[bytes]:
    return {path.read_bytes() for path in field.rglob("admitted.json") if "retired" not in path.parts}


def test_each_participant_has_what_it_needs_and_the_authority_its_key_for_itself(field: Path) -> None:
    identity = {"authority.pem", "certificate.pem", "private.key", "admitted.json"}
    files = {
        copy.name: {str(path.relative_to(copy)) for path in copy.rglob("*") if path.is_file()}
        for copy in (field / "copy").iterdir()
    }
    common = {f"identity/{name}" for name in identity} | {"fleet.yaml"}
    assert files == {
        "vehicle-1": common | {"vehicle-1.yaml", "mavlink.key"},
        "vehicle-2": common | {"vehicle-2.yaml", "mavlink.key"},
        "ground-anna": common,
    }
    secret = (field / "authority" / "private.key").read_bytes()
    assert not any(path.read_bytes() == secret for path in (field / "copy").rglob("*.key"))
    assert len(lists(field)) == 1
    for copy in (field / "copy").iterdir():
        assert load_identity(copy / "identity", NOW).common_name == copy.name


def test_keys_are_private_and_different_whatever_the_umask(tmp_path: Path, umask: int) -> None:
    field = tmp_path / "field"
    os.umask(0o022)
    fleet_files(field)
    os.umask(umask)
    again(field)
    modes = {str(path.relative_to(field)): path.stat().st_mode & 0o777 for path in field.rglob("*")}
    keys = list(field.rglob("*.key"))
    assert len({path.read_bytes() for path in keys}) == len(keys) == 6
    assert {modes[str(path.relative_to(field))] for path in keys} == {0o600}
    assert {modes[name] for name in ("authority", "copy")} == {0o700}
    assert {modes[name] for name in ("copy/vehicle-1", "copy/vehicle-1/identity")} == {0o755}
    assert modes["copy/vehicle-1/identity/certificate.pem"] == modes["copy/vehicle-1/fleet.yaml"] == 0o644


def test_the_mavlink_key_is_one_that_the_agent_reads(field: Path) -> None:
    vehicle_file = field / "copy" / "vehicle-1" / "vehicle-1.yaml"
    assert len(read_signing_key(vehicle_file, Signing(key_file="mavlink.key")).secret) == 32


def test_a_second_time_changes_nothing(field: Path) -> None:
    before = tree(field)
    assert again(field).names == ()
    assert tree(field) == before


def test_a_participant_that_is_added_changes_only_the_lists(field: Path) -> None:
    before = tree(field)
    assert again(field, TOWER, BEN).names == ("monitor-tower", "ground-ben")
    after = tree(field)
    changed = {path for path in before if after[path] != before[path]}
    assert {Path(path).name for path in changed} == {"admitted.json"}
    assert len(lists(field)) == 1
    assert open_provisioned(field).admitted.number == 2


def test_a_vehicle_that_is_added_to_the_fleet_file_gets_an_identity_and_differing_copies_are_named(
    field: Path, tmp_path: Path
) -> None:
    shutil.copytree(fleet_files(tmp_path / "three", 3, "alpha"), field, dirs_exist_ok=True)
    before = (field / "copy/vehicle-1/fleet.yaml").read_bytes()
    done = again(field)
    assert done.names == ("vehicle-3",)
    assert {path.parent.name for path in done.different if path.name == "fleet.yaml"} == {
        "vehicle-1", "vehicle-2", "ground-anna"
    }  # fmt: skip
    assert (field / "copy/vehicle-1/fleet.yaml").read_bytes() == before
    for path in done.different:
        path.unlink()
    assert again(field).different == ()
    assert (field / "copy/vehicle-1/fleet.yaml").read_bytes() == (field / "fleet.yaml").read_bytes()


def test_a_vehicle_that_left_the_fleet_file_is_named(tmp_path: Path) -> None:
    provisioned_by_operator(tmp_path / "field", vehicles=3)
    fleet = fleet_files(tmp_path / "two", 2, "alpha")
    shutil.copy(fleet / "fleet.yaml", tmp_path / "field")
    assert again(tmp_path / "field").not_in_fleet == ("vehicle-3",)


def test_a_copy_that_was_removed_stays_away(field: Path) -> None:
    shutil.rmtree(field / "copy" / "vehicle-1")
    assert again(field, TOWER).names == ("monitor-tower",)
    assert not (field / "copy" / "vehicle-1").exists()


def test_the_default_ground_is_for_fleets_without_one(tmp_path: Path) -> None:
    done = provisioned_by_operator(tmp_path / "field", BEN)
    assert done.names == ("vehicle-1", "vehicle-2", "ground-ben")
    revoke(tmp_path / "field", ["ground-ben"], NOW)
    assert again(tmp_path / "field").names == ("ground-anna",)


def test_a_renewal_keeps_the_name_and_the_old_key(field: Path) -> None:
    before = tree(field)
    old = load_identity(field / "copy/vehicle-1/identity", NOW)
    done = renew(field, ["vehicle-1"], 100, LATER)
    new = load_identity(field / "copy/vehicle-1/identity", LATER)
    assert done.names == (new.common_name,) == (old.common_name,)
    assert new.expires_at == LATER + timedelta(days=100)
    assert new.admitted.participant("vehicle-1") != old.admitted.participant("vehicle-1")
    (retired,) = (field / "retired").iterdir()
    for name in ("private.key", "certificate.pem"):
        assert (retired / name).read_bytes() == before[f"copy/vehicle-1/identity/{name}"][1]
        assert (field / "copy/vehicle-1/identity" / name).read_bytes() != (retired / name).read_bytes()
    assert (retired.stat().st_mode & 0o777, (field / "retired").stat().st_mode & 0o777) == (0o755, 0o700)
    assert len(lists(field)) == 1
    after = tree(field)
    others = [path for path in before if "vehicle-1" not in path and Path(path).name != "admitted.json"]
    assert {path: after[path] for path in others} == {path: before[path] for path in others}


def test_all_are_renewed_twice_in_one_second_and_nothing_is_lost(field: Path) -> None:
    assert len(renew(field, None, 365, LATER).names) == 3
    renew(field, None, 365, LATER)
    keys = {path.read_bytes() for path in field.rglob("private.key")}
    assert len(keys) == 1 + 3 * 3
    assert open_provisioned(field).admitted.number == 3


def test_a_renewal_without_the_copy_writes_all_but_the_key_that_the_autopilot_has(field: Path) -> None:
    before = tree(field / "copy/vehicle-1")
    shutil.rmtree(field / "copy")
    done = renew(field, ["vehicle-1"], 365, LATER)
    assert [str(name) for name in done.removed] == ["vehicle-1"]
    assert load_identity(field / "copy/vehicle-1/identity", LATER).common_name == "vehicle-1"
    after = tree(field / "copy/vehicle-1")
    assert before.keys() - after.keys() == {"mavlink.key"}
    assert all(after[name] == before[name] for name in ("fleet.yaml", "vehicle-1.yaml"))
    text = renew_text(done)
    assert f"removed: {field}/copy/vehicle-1, without mavlink.key" in text


def test_a_copy_without_its_identity_is_named_with_what_to_do(field: Path) -> None:
    shutil.rmtree(field / "copy/vehicle-1/identity")
    done = again(field)
    assert [str(name) for name in done.removed] == ["vehicle-1"]
    assert f"  companion provision renew {field} vehicle-1\n" in new_text(done)
    assert again(field).names == ()


def test_a_revoked_vehicle_returns_under_a_new_name_with_new_keys(field: Path) -> None:
    held = open_provisioned(field).admitted
    old = tree(field / "copy" / "vehicle-1")
    revoke(field, ["vehicle-1"], NOW)
    assert names(field) == ["vehicle-2", "ground-anna"]
    assert not (field / "copy" / "vehicle-1").exists()
    (retired,) = (field / "retired").iterdir()
    assert tree(retired) == old
    assert again(field).names == ("vehicle-1.2",)
    new = tree(field / "copy" / "vehicle-1")
    for name in ("identity/private.key", "identity/certificate.pem", "mavlink.key"):
        assert new[name] != old[name]
    authority = open_provisioned(field)
    data = (field / "copy/ground-anna/identity/admitted.json").read_bytes()
    admitted = accept(data, authority.certificate, held)
    assert admitted.name_of(ParticipantRole.VEHICLE, 1) == "vehicle-1.2"
    revoke(field, ["vehicle-1.2"], NOW)
    assert again(field).names == ("vehicle-1.3",)


@pytest.mark.parametrize("name", ["vehicle-1.2", "vehicle-9", "anna", "", "\x1b[2J"])
def test_names_that_are_not_admitted_are_refused_and_change_nothing(field: Path, name: str) -> None:
    before = tree(field)
    with pytest.raises(ConfigError, match="is not admitted; companion provision list DIR") as caught:
        revoke(field, ["vehicle-1", name], NOW)
    assert str(caught.value).isprintable()
    with pytest.raises(ConfigError, match="is not admitted; companion provision list DIR"):
        renew(field, [name], 365, NOW)
    assert tree(field) == before


@pytest.mark.parametrize("file", ["private.key", "authority.pem", "admitted.json"])
def test_without_a_file_of_the_authority_nothing_is_made(field: Path, file: str) -> None:
    (field / "authority" / file).unlink()
    before = tree(field)
    with pytest.raises(ConfigError, match=file):
        again(field, TOWER)
    assert tree(field) == before


def test_a_lost_authority_is_not_replaced_silently(field: Path) -> None:
    shutil.rmtree(field / "authority")
    before = tree(field)
    with pytest.raises(ConfigError, match="restore that folder from its backup"):
        again(field)
    assert tree(field) == before


def test_the_key_of_another_authority_is_refused(field: Path, tmp_path: Path) -> None:
    provisioned_by_operator(tmp_path / "other")
    shutil.copy(tmp_path / "other/authority/private.key", field / "authority")
    with pytest.raises(ConfigError, match=r"private.key: is not the key of authority.pem"):
        again(field, TOWER)


def test_a_fleet_keeps_its_name(field: Path, tmp_path: Path) -> None:
    shutil.copy(fleet_files(tmp_path / "beta", name="beta") / "fleet.yaml", field)
    with pytest.raises(ConfigError, match=r'"beta", but .* is of fleet "alpha"'):
        again(field)


def test_a_clock_before_the_authority_is_refused(field: Path) -> None:
    with pytest.raises(ConfigError, match="set the clock"):
        renew(field, None, 365, NOW - timedelta(days=2))


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda field: (field / "vehicle-2.yaml").unlink(), "write one for vehicle 2"),
        (lambda field: shutil.copy(field / "vehicle-1.yaml", field / "vehicle-2.yaml"), "id: 1, expected 2"),
        (lambda field: (field / "fleet.yaml").unlink(), "companion init writes it"),
        (lambda field: replace_text(field / "vehicle-1.yaml", "fleet.yaml", "../field/fleet.yaml"), "copied beside"),
        (lambda field: replace_text(field / "vehicle-1.yaml", "id: 1", "id: one"), "one"),
    ],
)
def test_files_that_no_agent_could_use_are_refused_before_anything_is_made(
    tmp_path: Path, change: object, words: str
) -> None:
    field = fleet_files(tmp_path / "field")
    change(field)  # type: ignore[operator]
    before = tree(field)
    with pytest.raises(ConfigError, match=words):
        again(field)
    assert tree(field) == before


def replace_text(path: Path, old: str, new: str) -> None:
    path.write_text(path.read_text().replace(old, new))


def test_too_many_participants_are_refused_before_anything_is_written(field: Path) -> None:
    before = tree(field)
    many = [participant_name(ParticipantRole.TARGET, f"t{number}") for number in range(254)]
    with pytest.raises(ConfigError, match="length <= 256"):
        again(field, *many)
    assert tree(field) == before


def test_a_failed_write_leaves_the_participants_as_they_were(field: Path) -> None:
    """A file has the name of the second new folder."""
    in_the_way = field / "copy" / TOWER.participant
    in_the_way.write_text("mine")
    before = tree(field)
    with pytest.raises(ConfigError, match=f"{TOWER.participant}.*: .*; then run the same command again"):
        again(field, BEN, TOWER)
    after = tree(field)
    assert {path: after[path] for path in before} == before
    assert {Path(path).parts[0] for path in after.keys() - before.keys()} == {"retired"}
    in_the_way.unlink()
    assert again(field, BEN, TOWER).names == ("ground-ben", "monitor-tower")
    assert sorted(path.name for path in (field / "copy").iterdir()) == [
        "ground-anna", "ground-ben", "monitor-tower", "vehicle-1", "vehicle-2"
    ]  # fmt: skip


def test_a_run_that_was_killed_before_the_list_is_completed(field: Path) -> None:
    """The folders of new participants are there, their list is not."""
    authority = tree(field / "authority")
    saved = shutil.copytree(field / "authority", field.parent / "saved")
    again(field, TOWER)
    shutil.rmtree(field / "authority")
    shutil.copytree(saved, field / "authority")
    assert tree(field / "authority") == authority
    assert again(field, TOWER).names == ("monitor-tower",)
    assert load_identity(field / "copy/monitor-tower/identity", LATER).admitted.number == 2
    assert len(lists(field)) == 1
    assert [path.name.partition("-2")[0] for path in (field / "retired").iterdir()] == ["monitor-tower"]


def test_a_run_that_was_killed_after_the_list_is_completed(field: Path) -> None:
    """The authority has a newer list than the copies."""
    revoke(field, ["vehicle-1"], NOW)
    data = (field / "authority" / "admitted.json").read_bytes()
    (field / "copy/ground-anna/identity/admitted.json").write_bytes(b"old")
    shutil.copytree(next((field / "retired").iterdir()), field / "copy" / "vehicle-1")
    revoke(field, ["vehicle-2"], NOW)
    assert not (field / "copy" / "vehicle-1").exists()
    assert lists(field) == {(field / "authority" / "admitted.json").read_bytes()} != {data}


def test_folders_that_are_no_participants_stay(field: Path) -> None:
    for name in ("notes", "vehicle-1.2", "vehicle-x"):
        (field / "copy" / name).mkdir()
    again(field)
    assert {"notes", "vehicle-1.2", "vehicle-x"} <= {path.name for path in (field / "copy").iterdir()}


def test_two_runs_at_once_are_refused(field: Path) -> None:
    with one_at_a_time(field), pytest.raises(ConfigError, match="another companion provision is at work"):
        again(field, TOWER)
    assert open_authority(field / "authority").admitted.number == 1


def test_the_same_revocation_twice_keeps_the_identity_that_came_after(field: Path) -> None:
    revoke(field, ["vehicle-1"], NOW)
    with pytest.raises(
        ConfigError, match=r"vehicle-1: is revoked since .*; companion provision new DIR makes its next"
    ):
        revoke(field, ["vehicle-1"], NOW)
    provision_new(field, [], GROUND_ANNA, 365, NOW)
    with pytest.raises(ConfigError, match=r"vehicle-1: is revoked since .*; its present identity is vehicle-1\.2"):
        revoke(field, ["vehicle-1"], NOW)
    assert open_provisioned(field).admitted.participant("vehicle-1.2")
