"""Identities as an agent loads them: what is accepted, and the one line for everything else."""

import shutil
from datetime import datetime, timedelta
from pathlib import Path

import pytest

from companion.security.identity import IdentityError, load_identity
from companion.security.names import ParticipantRole, participant_name
from companion.security.provisioning import provision_new, revoke
from secured_fleet import GROUND_ANNA, NOW, provisioned_by_operator


@pytest.fixture(scope="module")
def fleets(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two fleets, `alpha` and `beta`, and `again`: alpha with another authority."""
    top = tmp_path_factory.mktemp("fleets")
    for folder, name in (("alpha", "alpha"), ("beta", "beta"), ("again", "alpha")):
        provisioned_by_operator(top / folder, name=name)
    return top


@pytest.fixture
def folder(fleets: Path, tmp_path: Path) -> Path:
    """The identity of vehicle 1 of alpha, to be changed."""
    return shutil.copytree(fleets / "alpha/copy/vehicle-1/identity", tmp_path / "identity")


def refused(folder: Path, file: str, words: str, now: datetime = NOW, credentials: Path | None = None) -> None:
    with pytest.raises(IdentityError) as caught:
        load_identity(folder, now, credentials)
    line = str(caught.value)
    assert "\n" not in line
    assert file in line.split(": ")[0]
    assert words in line


def test_a_provisioned_identity_loads(folder: Path) -> None:
    identity = load_identity(folder, NOW)
    assert (identity.fleet, identity.common_name) == ("alpha", "vehicle-1")
    assert (identity.role, identity.id) == (ParticipantRole.VEHICLE, "1")
    assert identity.expires_at == NOW + timedelta(days=365)
    assert identity.key_file == folder / "private.key"
    assert identity.admitted.names(ParticipantRole.VEHICLE) == ("vehicle-1", "vehicle-2")


def test_a_credential_comes_before_the_key_in_the_folder(folder: Path, tmp_path: Path) -> None:
    credentials = tmp_path / "credentials"
    credentials.mkdir()
    assert load_identity(folder, NOW, credentials).key_file == folder / "private.key"
    credential = credentials / "identity.key"
    (folder / "private.key").rename(credential)
    credential.chmod(0o440)  # systemd gives a credential to its service by an access control list
    assert load_identity(folder, NOW, credentials).key_file == credential
    refused(folder, "private.key", "cannot be read: No such file")


def test_the_word_none_as_a_credential_is_no_key(folder: Path, tmp_path: Path) -> None:
    credentials = tmp_path / "credentials"
    credentials.mkdir()
    (credentials / "identity.key").write_text("none")
    assert load_identity(folder, NOW, credentials).key_file == folder / "private.key"


@pytest.mark.parametrize("file", ["authority.pem", "certificate.pem", "private.key", "admitted.json"])
def test_every_file_is_needed_regular_bounded_and_whole(folder: Path, file: str) -> None:
    content = (folder / file).read_bytes()
    (folder / file).unlink()
    refused(folder, file, "No such file")
    (folder / file).mkdir(0o700)
    refused(folder, file, "Is a directory")
    (folder / file).rmdir()
    (folder / file).touch(0o600)
    (folder / file).write_bytes(content + b" " * 300_000)
    refused(folder, file, "larger than")
    (folder / file).write_bytes(content[: len(content) // 2])
    refused(folder, file, "")
    (folder / file).write_bytes(b"")
    refused(folder, file, "")


@pytest.mark.parametrize("mode", [0o640, 0o604, 0o620, 0o602])
def test_a_key_that_others_may_read_is_refused(folder: Path, mode: int) -> None:
    (folder / "private.key").chmod(mode)
    refused(folder, "private.key", f"chmod 600 {folder / 'private.key'}")


@pytest.mark.parametrize("name", ["", "authority.pem", "certificate.pem", "admitted.json"])
@pytest.mark.parametrize("mode", [0o020, 0o002])
def test_what_others_may_write_is_refused(folder: Path, name: str, mode: int) -> None:
    path = folder / name
    path.chmod(path.stat().st_mode | mode)
    refused(folder, str(path), f"chmod go-w {path}")
    path.chmod(path.stat().st_mode & ~mode)
    assert load_identity(folder, NOW).fleet == "alpha"


def test_the_key_of_another_participant_is_refused(folder: Path, fleets: Path) -> None:
    shutil.copy(fleets / "alpha/copy/vehicle-2/identity/private.key", folder)
    refused(folder, "private.key", "is not the key of")


@pytest.mark.parametrize("other", ["again", "beta"])
def test_a_certificate_of_a_foreign_authority_is_refused(folder: Path, fleets: Path, other: str) -> None:
    shutil.copy(fleets / other / "authority/authority.pem", folder)
    refused(folder, "certificate.pem", "was not issued by the authority")


@pytest.mark.parametrize("other", ["again", "beta"])
def test_a_list_of_a_foreign_authority_is_refused(folder: Path, fleets: Path, other: str) -> None:
    shutil.copy(fleets / other / "authority/admitted.json", folder)
    refused(folder, "admitted.json", "is not signed by alpha authority")


def test_the_certificate_of_the_authority_is_no_identity(folder: Path, fleets: Path) -> None:
    shutil.copy(folder / "authority.pem", folder / "certificate.pem")
    shutil.copy(fleets / "alpha/authority/private.key", folder)
    refused(folder, "certificate.pem", "expected ROLE-ID")


def test_an_expired_certificate_and_a_clock_that_was_not_set(folder: Path) -> None:
    refused(folder, "certificate.pem", "has expired on 2027-11-22", NOW + timedelta(days=366))
    refused(folder, "authority.pem", "has expired", NOW + timedelta(days=3651))
    refused(folder, ".pem", "set the clock", NOW - timedelta(hours=2))
    assert load_identity(folder, NOW - timedelta(minutes=59)).id == "1"


def test_a_revoked_identity_and_its_successor(tmp_path: Path) -> None:
    provisioned_by_operator(tmp_path)
    board = shutil.copytree(tmp_path / "copy/vehicle-1/identity", tmp_path / "board")
    revoke(tmp_path, ["vehicle-1"], NOW)
    shutil.copy(tmp_path / "authority/admitted.json", board)
    refused(board, "admitted.json", "vehicle-1 is revoked since 2026-11-22")
    provision_new(tmp_path, [], GROUND_ANNA, 365, NOW)
    successor = load_identity(tmp_path / "copy/vehicle-1/identity", NOW)
    assert (successor.common_name, successor.id) == ("vehicle-1.2", "1")


def test_a_list_from_before_the_participant_does_not_admit_it(tmp_path: Path) -> None:
    provisioned_by_operator(tmp_path)
    old = (tmp_path / "authority/admitted.json").read_bytes()
    provision_new(tmp_path, [participant_name(ParticipantRole.MONITOR, "tower")], GROUND_ANNA, 365, NOW)
    identity = tmp_path / "copy/monitor-tower/identity"
    (identity / "admitted.json").write_bytes(old)
    refused(identity, "admitted.json", "does not admit monitor-tower")
