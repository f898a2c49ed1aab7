"""Network interfaces that go and come back, and host names that are the computer's own: network namespaces, as root."""

import time
from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path

import pytest

from companion.cli.main import main
from plugged_hosts import NEEDS, PluggedHosts, address, can_make_hosts, plugged_hosts
from tests.bench.processes import Program, module, wait_for
from tests.bench.programs.datagram_vehicle import Heard

pytestmark = [pytest.mark.timeout(60), pytest.mark.skipif(not can_make_hosts(), reason=NEEDS)]

HOSTS = {1: 11, 2: 12}
AWAY_S, BACK_WITHIN_S = 2.0, 2.0
SETTLED_S = 1.0
DEBIAN = "127.0.0.1 localhost\n127.0.1.1 board{own}\n"
OTHERS = "{address} board{other}\n"


@pytest.fixture
def stack() -> Iterator[ExitStack]:
    with ExitStack() as stack:
        yield stack


def vehicles(stack: ExitStack, hosts: PluggedHosts, folder: Path, where: str) -> dict[int, Program]:
    """Two that send their states by multicast."""
    shape = ["--vehicles", "2", "--origin", "indoor", "--security", "none", "--address", where]
    assert main(["init", str(folder), *shape]) == 0
    fleet = folder / "fleet.yaml"
    if "multicast" not in fleet.read_text():  # not the default, for vehicles with names
        fleet.write_text(fleet.read_text() + "multicast: 239.255.77.1:7446\n")
    program = "tests.bench.programs.datagram_vehicle"
    return {
        i: Program(stack, [*hosts.inside(host), *module(program, str(folder / f"vehicle-{i}.yaml"))])
        for i, host in HOSTS.items()
    }


def heard(programs: dict[int, Program]) -> dict[int, Heard]:
    for program in programs.values():
        program.end_input()
    return {i: program.result(Heard) for i, program in programs.items()}


def test_a_group_is_joined_again_when_the_interface_is_made_again(tmp_path: Path, stack: ExitStack) -> None:
    hosts = stack.enter_context(plugged_hosts([*HOSTS.values()]))
    programs = vehicles(stack, hosts, tmp_path / "field", "10.78.0.{id+10}")
    wait_for([*programs.values()], "heard")
    for program in programs.values():
        program.begin()
    hosts.remove_interface(HOSTS[1])
    time.sleep(AWAY_S)
    hosts.make_interface(HOSTS[1])
    time.sleep(BACK_WITHIN_S + SETTLED_S)
    for i, result in heard(programs).items():
        assert AWAY_S / 2.0 < result.longest_s < AWAY_S + BACK_WITHIN_S
        assert result.since_s < SETTLED_S
        again = [line for line in result.logged if "joined again" in line]
        assert len(again) == (1 if i == 1 else 0), result.logged
        assert len(result.logged) <= 2


def test_a_group_is_joined_as_soon_as_there_is_an_interface(tmp_path: Path, stack: ExitStack) -> None:
    hosts = stack.enter_context(plugged_hosts([*HOSTS.values()]))
    hosts.remove_interface(HOSTS[1])
    programs = vehicles(stack, hosts, tmp_path / "field", "10.78.0.{id+10}")
    time.sleep(AWAY_S)
    hosts.make_interface(HOSTS[1])
    wait_for([*programs.values()], "heard")


def names(known: bool) -> dict[int, str]:
    """/etc/hosts as Debian writes it; `known`: with the other vehicle."""
    return {
        HOSTS[own]: DEBIAN.format(own=own)
        + (OTHERS.format(address=address(HOSTS[other]), other=other) if known else "")
        for own, other in ((1, 2), (2, 1))
    }


def test_an_own_name_on_loopback_does_not_keep_the_vehicles_apart(tmp_path: Path, stack: ExitStack) -> None:
    hosts = stack.enter_context(plugged_hosts([*HOSTS.values()], names(known=True)))
    programs = vehicles(stack, hosts, tmp_path / "field", "board{id}")
    wait_for([*programs.values()], "heard")


def test_a_name_that_leads_to_no_network_is_refused(tmp_path: Path, stack: ExitStack) -> None:
    hosts = stack.enter_context(plugged_hosts([*HOSTS.values()], names(known=False)))
    programs = vehicles(stack, hosts, tmp_path / "field", "board{id}")
    assert '"board1" is 127.0.1.1 on this computer' in programs[1].line()
