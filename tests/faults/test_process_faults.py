"""Every kind of process of a flying fleet is killed or frozen."""

import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from companion.types.flight import FlightPhase, Role
from companion.types.notices import Code
from fault_table import FaultRow
from process_fleet import CONVERGED_M, FOLLOWERS, IDS, LEADER, LOST_S, FaultyFleet, demanded, faulty_fleet
from sitl.links.ports import zenoh_endpoint

pytestmark = [pytest.mark.fleet, pytest.mark.timeout(240)]

LAST_SETPOINT_S = 0.04  # acceptance: after an agent was killed or frozen
FROZEN_S = 3.0
OTHERS = (1, 2, 3)  # than the faulty follower
EVENTS_S = 5.0


def last_setpoint(flight: FaultyFleet, vehicle_id: int, row: FaultRow) -> None:
    last_s = flight.last_setpoint_s(vehicle_id)
    row.measured.append(f"last setpoint {last_s * 1000:.0f} ms later")
    assert last_s <= LAST_SETPOINT_S


def followers_lose_the_leader(flight: FaultyFleet, row: FaultRow) -> None:
    flight.wait(lambda: all(flight.phase(i) is FlightPhase.HOLD for i in FOLLOWERS), 10.0)
    lost_s = max(event.after_s for i in FOLLOWERS if (event := flight.event(i, Code.LEADER_LOST)))
    row.measured.append(f"followers leave formation after {lost_s:.2f} s")
    row.outcome = "all hold"
    assert lost_s < LOST_S


@pytest.mark.every_fault
def test_followers_hold_when_the_agent_of_the_leader_is_killed(flight: FaultyFleet, row: FaultRow) -> None:
    row.fault, row.demanded = "SIGKILL of the leader's agent, no successors", demanded(Code.LEADER_LOST)
    flight.fault()
    flight.kill("agent 1")
    followers_lose_the_leader(flight, row)
    flight.ground.listen(EVENTS_S)
    last_setpoint(flight, LEADER, row)
    flight.check(row)
    flight.land(FOLLOWERS)


@pytest.mark.every_fault
def test_a_successor_leads_when_the_agent_of_the_leader_is_killed(tmp_path: Path, row: FaultRow) -> None:
    row.fault, row.demanded = "SIGKILL of the leader's agent, `successors: [2]`", demanded(Code.LEADER_AWAITED)
    with faulty_fleet(tmp_path, "fleet.successors=[2]", "fleet.vehicles[1].may_lead=true") as flight:
        flight.form()
        flight.fault()
        flight.kill("agent 1")
        flight.wait(lambda: flight.ground.newest[2].leadership.role is Role.LEADER, 5.0)
        leads_s = time.monotonic() - flight.since.monotonic_s  # by its status, ten times a second
        row.measured.append(f"vehicle 2 leads after {leads_s:.1f} s")
        flight.ground.listen(EVENTS_S)
        flight.check_formation(FOLLOWERS)
        last_setpoint(flight, LEADER, row)
        row.outcome = "the others fly on behind vehicle 2"
        assert leads_s < 1.2
        flight.check(row)
        flight.land(FOLLOWERS)


@pytest.mark.every_fault
def test_the_others_fly_on_when_the_agent_of_a_follower_is_killed(flight: FaultyFleet, row: FaultRow) -> None:
    row.fault, row.demanded = "SIGKILL of a follower's agent", "last setpoint at most 40 ms later"
    flight.fault()
    flight.kill("agent 4")
    flight.ground.listen(EVENTS_S)
    flight.check_formation(OTHERS)
    last_setpoint(flight, 4, row)
    row.outcome = "the others fly on; its autopilot holds by itself"
    flight.check(row)


@pytest.mark.every_fault
@pytest.mark.parametrize("vehicle_id", [LEADER, 4], ids=["leader", "follower"])
def test_a_frozen_agent_sends_nothing_and_does_not_resume(flight: FaultyFleet, vehicle_id: int, row: FaultRow) -> None:
    leads = vehicle_id == LEADER
    row.fault = f"SIGSTOP of the {'leader' if leads else 'follower'}'s agent for {FROZEN_S:g} s"
    row.demanded = demanded(Code.NO_SETPOINT)
    flight.fault()
    flight.kill(f"agent {vehicle_id}", signal.SIGSTOP)
    time.sleep(FROZEN_S)
    last_setpoint(flight, vehicle_id, row)
    resumed_s = time.monotonic()
    flight.kill(f"agent {vehicle_id}", signal.SIGCONT)
    flight.ground.listen(3.0)
    late = flight.taps[vehicle_id].setpoints_since(resumed_s)
    row.measured.append(f"{len(late)} setpoints after SIGCONT")
    assert late == []
    assert flight.phase(vehicle_id) is FlightPhase.OBSERVE, flight.logged()
    if leads:
        followers_lose_the_leader(flight, row)
    else:
        flight.check_formation(OTHERS)
        row.outcome = "the others fly on; it observes"
    flight.check(row)


@pytest.mark.every_fault
@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGSTOP])
def test_setpoints_end_with_the_autopilots_telemetry(
    flight: FaultyFleet, number: signal.Signals, row: FaultRow
) -> None:
    row.fault, row.demanded = f"{number.name} of a follower's autopilot", demanded(Code.POSITION_STALE)
    flight.fault()
    flight.kill("autopilot 4", number)
    flight.ground.listen(EVENTS_S)
    last_s = flight.last_setpoint_s(4)
    row.measured.append(f"last setpoint {last_s * 1000:.0f} ms later")
    assert last_s < 0.1
    flight.check_formation(OTHERS)
    row.outcome = "the others fly on"
    flight.check(row)


@pytest.mark.every_fault
def test_all_hold_when_the_network_process_is_killed(flight: FaultyFleet, row: FaultRow) -> None:
    row.fault, row.demanded = "SIGKILL of the network (the radio of all vehicles)", demanded(Code.FLEET_LINK_LOST)
    flight.fault()
    flight.kill("network")
    followers_lose_the_leader(flight, row)
    flight.wait(lambda: flight.phase(LEADER) is FlightPhase.HOLD, 10.0)
    leader_s = next(event.after_s for event in flight.events(LEADER) if "formation -> release" in event.text)
    row.measured.append(f"the leader after {leader_s:.2f} s")
    flight.check(row)
    flight.land()


@pytest.mark.every_fault
@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGSTOP])
def test_the_fleet_flies_on_without_its_ground_station(
    flight: FaultyFleet, number: signal.Signals, row: FaultRow
) -> None:
    """A second ground station, which is also connected to every agent."""
    row.fault, row.demanded = f"{number.name} of a ground station", "the formation does not depend on it"
    endpoints = [zenoh_endpoint(i, flight.port_offset) for i in IDS]
    command = [sys.executable, "-m", "companion", "monitor", "--listen", "127.0.0.1:0", "--connect", *endpoints]
    monitor = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, stdin=subprocess.DEVNULL)
    try:
        flight.ground.listen(3.0)
        assert monitor.poll() is None, monitor.communicate()[0]
        flight.fault()
        monitor.send_signal(number)
        flight.ground.listen(EVENTS_S)
        error_m = flight.largest_error_m(last_s=EVENTS_S - 1.0)
        row.measured.append(f"largest error {error_m:.3f} m")
        row.outcome = "all in formation"
        flight.check_formation()
        assert error_m < CONVERGED_M
        flight.check(row)
    finally:
        monitor.kill()
        monitor.communicate()
