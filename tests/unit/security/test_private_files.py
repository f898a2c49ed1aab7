"""Files and folders that are complete or absent."""

import errno
import os
from collections.abc import Iterator
from pathlib import Path

import pytest

from companion.config.file import ConfigError
from companion.security.identity import PRIVATE, new_folder, one_at_a_time, remove_parts, write_file


@pytest.fixture(params=[0o000, 0o022, 0o777])
def umask(request: pytest.FixtureRequest) -> Iterator[int]:
    before = os.umask(request.param)
    yield request.param
    os.umask(before)


@pytest.mark.usefixtures("umask")
def test_permissions_do_not_depend_on_the_umask(tmp_path: Path) -> None:
    with new_folder(tmp_path / "folder") as part:
        write_file(part / "key", b"secret", PRIVATE)
        write_file(part / "public", b"")
    modes = {path.name: path.stat().st_mode & 0o777 for path in tmp_path.rglob("*")}
    assert modes == {"folder": 0o700, "key": 0o600, "public": 0o644}


def test_a_file_that_cannot_be_written_leaves_the_old_one_and_no_other(tmp_path: Path) -> None:
    path = tmp_path / "list"
    write_file(path, b"old")
    with pytest.raises(TypeError):
        write_file(path, "text")  # type: ignore[arg-type]  # fails at the write, after the file was opened
    assert {one.name: one.read_bytes() for one in tmp_path.iterdir()} == {"list": b"old"}


def test_a_file_cannot_take_the_name_of_a_folder_and_leaves_nothing(tmp_path: Path) -> None:
    (tmp_path / "list").mkdir()
    with pytest.raises(OSError):
        write_file(tmp_path / "list", b"new")
    assert [one.name for one in tmp_path.iterdir()] == ["list"]


def test_a_link_is_replaced_and_its_target_stays(tmp_path: Path) -> None:
    (tmp_path / "target").write_bytes(b"target")
    (tmp_path / "list").symlink_to(tmp_path / "target")
    write_file(tmp_path / "list", b"new")
    assert not (tmp_path / "list").is_symlink()
    assert (tmp_path / "target").read_bytes() == b"target"


def test_a_folder_that_is_interrupted_leaves_nothing(tmp_path: Path) -> None:
    with pytest.raises(KeyboardInterrupt), new_folder(tmp_path / "folder") as part:
        write_file(part / "key", b"secret", PRIVATE)
        raise KeyboardInterrupt
    assert list(tmp_path.iterdir()) == []


def test_a_folder_never_replaces_one_with_files(tmp_path: Path) -> None:
    (tmp_path / "folder").mkdir()
    write_file(tmp_path / "folder" / "mine", b"1")
    with pytest.raises(OSError) as caught, new_folder(tmp_path / "folder") as part:
        write_file(part / "mine", b"2")
    assert caught.value.errno == errno.ENOTEMPTY
    assert [path.name for path in tmp_path.iterdir()] == ["folder"]
    assert (tmp_path / "folder" / "mine").read_bytes() == b"1"


def test_what_a_killed_run_left_is_removed_and_nothing_else(tmp_path: Path) -> None:
    (tmp_path / ".vehicle-1.77.part").mkdir()
    write_file(tmp_path / ".vehicle-1.77.part" / "key", b"1")
    write_file(tmp_path / ".list.77.part", b"1")
    write_file(tmp_path / "mine.part", b"1")
    remove_parts(tmp_path)
    assert [path.name for path in tmp_path.iterdir()] == ["mine.part"]


def test_a_second_process_is_refused(tmp_path: Path) -> None:
    with one_at_a_time(tmp_path), pytest.raises(ConfigError, match="is at work here"), one_at_a_time(tmp_path):
        pass
    with one_at_a_time(tmp_path):
        pass
