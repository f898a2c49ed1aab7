"""The folder that `companion init` wrote, and the folders in it that `companion provision` adds.

- DIR/fleet.yaml, DIR/vehicle-N.yaml: the files to edit.
- DIR/authority/: authority.pem, private.key, admitted.json; never copied.
- DIR/copy/NAME/: what goes to the computer of one participant. Users other than root may read all but the keys there: the
  agent gets its key from systemd. The vehicle file is changed on its way there, text to text: it names the identity, and its
  endpoints have TLS instead of TCP.
- DIR/retired/NAME-TIME/: what copy/ held before a renewal or a revocation.
"""

from __future__ import annotations

import re
import secrets
from collections.abc import Iterator
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path
from typing import Any

import yaml

from companion.config.atomic import PRIVATE, write_file
from companion.config.file import ConfigError, StrictLoader, read_regular
from companion.config.fleet_check import load_fleet
from companion.config.vehicle import load_agent
from companion.security.identity import ADMITTED_FILE, make_folder, remove_parts
from companion.security.names import ParticipantName, ParticipantRole, parse_common_name

IDENTITY = "identity"  # the folder, beside the vehicle file
IDENTITY_LINE = f"identity: {IDENTITY}"
COMMENT = "# key and certificate; from here on only admitted participants connect"
TOP_LEVEL = re.compile(r"(?P<key>[A-Za-z_][\w]*)\s*:")
TAIL = re.compile(r"(?:^|\s+)#.*|\s*$", re.DOTALL)  # a comment and the end of the line
TCP = re.compile(r"(?<![\w/.-])tcp/")


class BoardFileError(ValueError):
    """A vehicle file that is written in a way that cannot be changed line by line."""


def board_vehicle_file(text: str) -> str:
    """The text with `identity` and with tls/ endpoints in the section zenoh; comments and all other lines stay as they are.

    Raises BoardFileError where the result would say anything else than that.
    """
    section, lines, has_identity = "", [], False
    for line in text.splitlines(keepends=True):
        if found := TOP_LEVEL.match(line):
            section = found["key"]
        if found and section == "identity":
            line, has_identity = _with_value(line), True
        elif section == "zenoh":
            line = _with_tls(line)
        lines.append(line)
    changed = "".join(lines)
    if not has_identity:
        changed += ("" if changed.endswith("\n") else "\n") + f"{IDENTITY_LINE:<28} {COMMENT}\n"
    if _content(changed) != _with_identity(_content(text)):
        raise BoardFileError(
            "cannot be changed line by line; write zenoh and identity as companion init does, each key in a line of its own"
        )
    return changed


def _with_value(line: str) -> str:
    return IDENTITY_LINE + line[_tail(line) :]


def _with_tls(line: str) -> str:
    tail = _tail(line)
    return TCP.sub("tls/", line[:tail]) + line[tail:]


def _tail(line: str) -> int:
    found = TAIL.search(line)
    return found.start() if found else len(line)


def _content(text: str) -> Any:
    try:
        return yaml.load(text, Loader=StrictLoader)
    except yaml.YAMLError as error:
        raise BoardFileError("is not valid YAML") from error


def _with_identity(content: Any) -> Any:
    if not isinstance(content, dict):
        raise BoardFileError("has no keys")
    zenoh = content.get("zenoh")
    changed = content | {"identity": IDENTITY}
    if isinstance(zenoh, dict):
        changed["zenoh"] = {key: _endpoints(value) for key, value in zenoh.items()}
    return changed


def _endpoints(value: Any) -> Any:
    if not isinstance(value, list):
        return value
    return [re.sub("^tcp/", "tls/", one) if isinstance(one, str) else one for one in value]


FLEET_FILE, MAVLINK_KEY_FILE = "fleet.yaml", "mavlink.key"
MAVLINK_KEY_BYTES = 32


@dataclass(frozen=True, slots=True)
class FleetFiles:
    """The name of the fleet, and the content of its files as they go to the boards."""

    fleet: str
    fleet_file: bytes
    vehicle_files: dict[int, bytes]

    def of(self, name: ParticipantName) -> dict[str, bytes]:
        """The configuration of one participant, by file name. A vehicle that is not in the fleet file has no vehicle file."""
        files = {FLEET_FILE: self.fleet_file}
        if name.role is ParticipantRole.VEHICLE and int(name.id) in self.vehicle_files:
            files[f"vehicle-{name.id}.yaml"] = self.vehicle_files[int(name.id)]
        return files


def read_fleet_files(folder: Path) -> FleetFiles:
    """The fleet file and the file of each of its vehicles. Raises ConfigError for files that an agent would refuse."""
    if not (folder / FLEET_FILE).is_file():
        raise ConfigError(folder / FLEET_FILE, "", "no such file; companion init writes it, with the vehicle files")
    fleet = load_fleet(folder / FLEET_FILE)
    vehicles = {member.id: _vehicle_file(folder, member.id) for member in fleet.vehicles}
    return FleetFiles(fleet.name, _read(folder / FLEET_FILE), vehicles)


def _vehicle_file(folder: Path, vehicle_id: int) -> bytes:
    path = folder / f"vehicle-{vehicle_id}.yaml"
    if not path.is_file():
        raise ConfigError(path, "", f"no such file; write one for vehicle {vehicle_id} of {FLEET_FILE}")
    vehicle = load_agent(path).vehicle
    if vehicle.id != vehicle_id:
        raise ConfigError(path, "id", f"{vehicle.id}, expected {vehicle_id} as in the name of the file")
    if Path(vehicle.fleet) != Path(FLEET_FILE):
        raise ConfigError(path, "fleet", f'"{vehicle.fleet}", expected {FLEET_FILE}, which is copied beside this file')
    try:
        return board_vehicle_file(_read(path).decode("utf-8")).encode("utf-8")
    except BoardFileError as error:
        raise ConfigError(path, "", str(error)) from error


def _read(path: Path) -> bytes:
    try:
        return read_regular(path)[0]
    except OSError as error:
        raise ConfigError(path, "", f"cannot be read: {error.strerror}; check the path") from error


class FleetFolder:
    """The folders that provisioning writes. Methods that write raise OSError."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.authority = folder / "authority"
        self.copy = folder / "copy"
        self.retired = folder / "retired"

    def copy_of(self, name: ParticipantName) -> Path:
        """The folder of a participant, the same for all generations."""
        return self.copy / name.participant

    def copies(self) -> Iterator[tuple[ParticipantName, Path]]:
        """The folders of participants, sorted; other folders are left alone."""
        for folder in sorted(self.copy.glob("*")) if self.copy.is_dir() else ():
            try:
                name = parse_common_name(folder.name)
            except ValueError:
                continue
            if name.generation == 1 and folder.is_dir():
                yield name, folder

    def tidy(self, admitted: set[str], now: datetime) -> None:
        """Retires the folders of participants (ROLE-ID) that are not admitted, and removes what a killed run left."""
        for name, folder in list(self.copies()):
            remove_parts(folder)
            if name.participant not in admitted:
                self.retire(folder, name.participant, now)
        for folder in (self.folder, self.copy):
            remove_parts(folder)

    def retire(self, path: Path, name: str, now: datetime) -> Path:
        """Moves a folder out of copy/; its new path."""
        if not self.retired.exists():
            make_folder(self.retired)
        label = f"{name}-{now:%Y%m%dT%H%M%SZ}"
        count = sum(1 for _ in self.retired.glob(f"{label}*"))
        return path.rename(self.retired / (f"{label}-{count + 1}" if count else label))

    def distribute(self, admission_list: bytes) -> int:
        """Writes the list into every identity in copy/. Returns their number."""
        folders = [folder / IDENTITY for _, folder in self.copies() if (folder / IDENTITY).is_dir()]
        for folder in folders:
            write_file(folder / ADMITTED_FILE, admission_list)
        return len(folders)


def write_configuration(folder: Path, files: dict[str, bytes]) -> list[Path]:
    """Writes the files that are absent. Returns those that exist with another content, which stay as they are."""
    different = []
    for name, content in files.items():
        path = folder / name
        if not path.exists():
            write_file(path, content)
        elif _read(path) != content:
            different.append(path)
    return different


def write_mavlink_key(folder: Path) -> None:
    """A new random key for signed MAVLink, as hexadecimal digits."""
    write_file(folder / MAVLINK_KEY_FILE, f"{secrets.token_hex(MAVLINK_KEY_BYTES)}\n".encode(), PRIVATE)
