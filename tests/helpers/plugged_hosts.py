"""Computers of a fleet on this machine: a network namespace for each, on one switch. Linux, as root, with iproute2.

Unlike processes that are killed or stopped, a computer whose plug is pulled acknowledges nothing: its connections hear neither
an end nor a reset. Unlike the radio of tests/bench/hosts.py the switch is the kernel's own, with neighbour tables and IGMP.
"""

from __future__ import annotations

import subprocess
from collections.abc import Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path

from tests.bench.hosts import HostsError, inside, ip, namespace

SWITCH = 0  # number of its namespace
INTERFACE = "w0"  # of every computer
NETWORK = "10.78.0"
OWN_FILES = Path("/etc/netns")  # read by `ip netns exec`
NEEDS = "needs root and network namespaces (ip of iproute2): sudo make link-faults"


def address(host: int) -> str:
    return f"{NETWORK}.{host}"


def can_make_hosts() -> bool:
    """Whether this process may make network namespaces."""
    try:
        made = subprocess.run(["ip", "netns", "add", namespace(SWITCH)], capture_output=True, check=False).returncode
        if made == 0:
            ip("netns", "delete", namespace(SWITCH))
    except (FileNotFoundError, HostsError):
        return False
    return made == 0


@dataclass(frozen=True)
class PluggedHosts:
    """Switch and computers; `host` is the last number of an address."""

    numbers: tuple[int, ...]

    def inside(self, host: int) -> list[str]:
        """What a command begins with that runs on this computer."""
        return inside(host)

    def unplug(self, *hosts: int) -> None:
        for host in hosts:
            ip("-n", namespace(SWITCH), "link", "set", _port(host), "down")

    def plug_in(self, *hosts: int) -> None:
        for host in hosts:
            ip("-n", namespace(SWITCH), "link", "set", _port(host), "up")

    def remove_interface(self, host: int) -> None:
        """As when a USB adapter is drawn, or its driver ends."""
        ip("-n", namespace(host), "link", "delete", INTERFACE)

    def make_interface(self, host: int) -> None:
        """With the name and address that every computer has from the start."""
        own, switch = namespace(host), namespace(SWITCH)
        ip("link", "add", INTERFACE, "netns", own, "type", "veth", "peer", "name", _port(host), "netns", switch)
        ip("-n", switch, "link", "set", _port(host), "master", "switch", "up")
        ip("-n", own, "address", "add", f"{address(host)}/24", "dev", INTERFACE)
        ip("-n", own, "link", "set", INTERFACE, "up")


@contextmanager
def plugged_hosts(numbers: Sequence[int], names: Mapping[int, str] | None = None) -> Iterator[PluggedHosts]:
    """Computers with all plugs in, removed with the block. Raises HostsError.

    `names`: the content of /etc/hosts of these computers.
    """
    hosts = PluggedHosts(tuple(numbers))
    with ExitStack() as undo:
        for host in (SWITCH, *numbers):
            ip("netns", "add", namespace(host))
            undo.callback(ip, "netns", "delete", namespace(host))
            ip("-n", namespace(host), "link", "set", "lo", "up")
        for host, text in (names or {}).items():
            _name_hosts(undo, host, text)
        ip("-n", namespace(SWITCH), "link", "add", "switch", "type", "bridge", "mcast_snooping", "0")
        ip("-n", namespace(SWITCH), "link", "set", "switch", "up")
        for host in numbers:
            hosts.make_interface(host)
        yield hosts


def _name_hosts(undo: ExitStack, host: int, text: str) -> None:
    folder = OWN_FILES / namespace(host)
    folder.mkdir(parents=True)
    undo.callback(folder.rmdir)
    (folder / "hosts").write_text(text)
    undo.callback((folder / "hosts").unlink)


def _port(host: int) -> str:
    return f"port{host}"
