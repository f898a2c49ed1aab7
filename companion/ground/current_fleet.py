"""The fleet file and the endpoints of a command, and why an endpoint is not reached.

They come from the options of the command, the environment or the saved current fleet.
"""

from __future__ import annotations

import os
import re
import socket
from collections.abc import Collection, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path

import msgspec

from companion.config.file import ConfigError, read_regular
from companion.config.validation import in_plain_words

FLEET_VARIABLE, CONNECT_VARIABLE = "COMPANION_FLEET", "COMPANION_CONNECT"
IDENTITY_VARIABLE = "COMPANION_IDENTITY"
SIMULATION_PORT = 7447  # plus the vehicle id: where the agent of a simulated vehicle listens for Zenoh


class CurrentFleet(msgspec.Struct, frozen=True):
    """A fleet file as an absolute path, Zenoh endpoints of its vehicles, and the folder of the own identity."""

    fleet: str
    connect: tuple[str, ...] = ()
    identity: str = ""  # an absolute path; empty without one


@dataclass(frozen=True, slots=True)
class Selection:
    """A fleet file (None where none is named), endpoints and identity, each with the source of its value.

    Without endpoints: the addresses of the fleet file, or those of a simulation.
    """

    fleet: Path | None
    fleet_source: str
    connect: tuple[str, ...]
    connect_source: str
    identity: Path | None

    def __str__(self) -> str:
        fleet = f"fleet file {self.fleet} ({self.fleet_source})" if self.fleet else "no current fleet"
        endpoints = f"{', '.join(self.connect)} ({self.connect_source})" if self.connect else "of the fleet file"
        identity = f"identity {self.identity}" if self.identity else "no identity"
        return f"{fleet}; endpoints {endpoints}; {identity}"


def select(
    fleet: Path | None, connect: Sequence[str], identity: Path | None, environment: Mapping[str, str]
) -> Selection:
    """An option wins over the environment, the environment over the saved current fleet. Raises ConfigError.

    The saved endpoints and the saved identity belong to the saved fleet file: they are not used with another one.
    """
    saved = None if fleet is not None and connect else load_current(environment)
    named = environment.get(FLEET_VARIABLE, "")
    chosen: Path | None
    if fleet is not None:
        chosen, fleet_source = fleet, "--fleet"
    elif named:
        chosen, fleet_source = Path(named), FLEET_VARIABLE
    else:
        chosen, fleet_source = (Path(saved.fleet), "current fleet") if saved else (None, "")
    if saved and chosen is not None and chosen.absolute() != Path(saved.fleet):
        saved = None
    folder = environment.get(IDENTITY_VARIABLE, "") or (saved.identity if saved else "")
    identity = identity or (Path(folder) if folder else None)
    listed = tuple(re.split(r"[\s,]+", environment.get(CONNECT_VARIABLE, "").strip(" ,")))
    if connect:
        return Selection(chosen, fleet_source, tuple(connect), "--connect", identity)
    if listed != ("",):
        return Selection(chosen, fleet_source, listed, CONNECT_VARIABLE, identity)
    if saved and saved.connect:
        return Selection(chosen, fleet_source, saved.connect, "current fleet", identity)
    return Selection(chosen, fleet_source, (), "", identity)


def simulation_endpoints(vehicle_ids: Sequence[int]) -> tuple[str, ...]:
    """Where the agents of these vehicles listen in a simulation on this machine with its default ports."""
    return tuple(f"tcp/127.0.0.1:{SIMULATION_PORT + vehicle_id}" for vehicle_id in vehicle_ids)


def current_file(environment: Mapping[str, str]) -> Path:
    """Of the saved current fleet, by the XDG base directory specification."""
    base = Path(environment.get("XDG_CONFIG_HOME", ""))
    return (base if base.is_absolute() else Path.home() / ".config") / "companion" / "current_fleet.json"


def load_current(environment: Mapping[str, str]) -> CurrentFleet | None:
    """None where none is saved. Raises ConfigError."""
    file = current_file(environment)
    try:
        return msgspec.json.decode(read_regular(file)[0], type=CurrentFleet)
    except FileNotFoundError:
        return None
    except (OSError, msgspec.DecodeError) as error:
        problem = (
            f"cannot be used: {in_plain_words(error)}; delete it with companion fleet use --clear, or save another"
        )
        raise ConfigError(file, "", problem) from error


def save_current(fleet: Path, connect: Sequence[str], identity: Path | None, environment: Mapping[str, str]) -> Path:
    """The file written. Raises ConfigError."""
    file = current_file(environment)
    folder = str(identity.absolute()) if identity else ""
    content = msgspec.json.encode(CurrentFleet(str(fleet.absolute()), tuple(connect), folder))
    try:
        file.parent.mkdir(parents=True, exist_ok=True)
        part = file.with_name(f"{file.name}.{os.getpid()}")
        part.write_bytes(content)
        part.replace(file)  # at once: another command may read it now
    except OSError as error:
        raise ConfigError(file, "", f"cannot be written: {error.strerror}") from error
    return file


def forget_current(environment: Mapping[str, str]) -> None:
    """Without effect where none is saved. Raises ConfigError."""
    try:
        current_file(environment).unlink(missing_ok=True)
    except OSError as error:
        raise ConfigError(current_file(environment), "", f"cannot be deleted: {error.strerror}") from error


CONNECT_WITHIN_S = 1.0
OVER_TCP = ("tcp", "tls")


def unreachable(endpoints: Sequence[str], linked: Collection[str]) -> dict[str, str]:
    """The reason by endpoint; `linked` has the remote addresses of the session's links.

    An endpoint over TCP is tried with a connection of its own; any other is unreachable where it has no link.
    """
    with ThreadPoolExecutor(max_workers=16) as workers:
        reasons = workers.map(lambda endpoint: "" if endpoint in linked else _reason(endpoint), endpoints)
        return {endpoint: reason for endpoint, reason in zip(endpoints, reasons, strict=True) if reason}


def _reason(endpoint: str) -> str:
    """ "" where the endpoint answers."""
    protocol, _, address = endpoint.partition("/")
    host, port = _host_and_port(address)
    try:
        if protocol in OVER_TCP:
            socket.create_connection((host, port), CONNECT_WITHIN_S).close()
            return ""
        addresses = socket.getaddrinfo(host, port, type=socket.SOCK_DGRAM)
    except TimeoutError:
        return f"no answer within {CONNECT_WITHIN_S:g} s; check the address and the network"
    except ConnectionRefusedError:
        return "connection refused; no agent listens there"
    except socket.gaierror:
        return f"unknown host {host}"
    except OSError as error:
        return error.strerror or str(error)
    return f"no link over {protocol} to {addresses[0][4][0]}; check that an agent listens there"


def _host_and_port(address: str) -> tuple[str, int]:
    """Of "HOST:PORT" or "[HOST]:PORT", with Zenoh's metadata behind it."""
    host, _, port = re.split("[?#]", address)[0].rpartition(":")
    return host.strip("[]"), int(port)
