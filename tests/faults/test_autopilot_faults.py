"""Faults at one vehicle of a flying fleet: its autopilot, its pilot, its sensors, its disk, its identity."""

import resource
import socket
import subprocess
import sys
import time
from pathlib import Path

import pytest

from companion.mavlink.codec import MavlinkCodec, mavlink
from companion.types.commands import CommandName
from companion.types.flight import FlightPhase
from companion.types.notices import Code
from fault_table import FaultRow
from process_fleet import FAULT_AT_S, IDS, LEADER, FaultyFleet, demanded, faulty_fleet
from sitl.links.ports import LOOPBACK, ports_of
from wire_autopilots import PX4, HoveringAutopilot

pytestmark = [pytest.mark.fleet, pytest.mark.timeout(240)]

AFTER_TAKEOVER_S = 0.1  # acceptance: no setpoint later than this after the change is visible
OTHERS = (1, 2, 3)
WITHIN_S = 60.0


@pytest.mark.every_fault
@pytest.mark.parametrize(("seconds", "returns"), [(0.3, True), (3.0, False)])
def test_setpoints_end_while_the_link_to_the_autopilot_is_interrupted(
    flight: FaultyFleet, seconds: float, returns: bool, row: FaultRow
) -> None:
    row.fault, row.demanded = f"telemetry of a follower interrupted for {seconds:g} s", demanded(Code.POSITION_STALE)
    tap = flight.taps[4]
    flight.fault()
    tap.is_cut = True
    time.sleep(seconds)
    last_s = flight.last_setpoint_s(4)
    tap.is_cut = False
    flight.ground.listen(4.0)
    row.measured.append(f"last setpoint {last_s * 1000:.0f} ms later")
    assert last_s < 0.1
    flight.check_formation(OTHERS)
    assert flight.phase(4) is (FlightPhase.FORMATION if returns else FlightPhase.OBSERVE), flight.logged()
    row.outcome = "it flies on in its slot" if returns else "it observes; its autopilot holds; the others fly on"
    flight.check(row)


def test_the_agent_lets_go_when_a_pilot_takes_over(flight: FaultyFleet, row: FaultRow) -> None:
    row.fault, row.demanded = "a pilot changes the mode", demanded(Code.MODE_CHANGED_BY_OTHERS)
    codec = MavlinkCodec(255, mavlink.MAV_COMP_ID_MISSIONPLANNER)
    change = mavlink.MAVLink_command_long_message(4, 1, mavlink.MAV_CMD_DO_SET_MODE, 0, 1, *PX4.pilots_mode, 0, 0, 0, 0)
    tap = flight.taps[4]
    flight.fault()
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as ground_station:
        ground_station.sendto(codec.encode(change), (LOOPBACK, ports_of(4, flight.port_offset).ground_link))
        visible = flight.since.monotonic_s
        flight.wait(lambda: any(at_s > visible for at_s in tap.other_modes_s), 5.0)
    flight.ground.listen(4.0)
    seen_s = next(at_s for at_s in tap.other_modes_s if at_s > visible)
    last_s = max([0.0, *(setpoint.at_s - seen_s for setpoint in tap.setpoints_since(visible))])
    row.measured.append(f"last setpoint {last_s * 1000:.0f} ms after the change is visible")
    row.outcome = "it observes; the others fly on"
    assert last_s <= AFTER_TAKEOVER_S
    assert flight.phase(4) is FlightPhase.OBSERVE
    flight.check_formation(OTHERS)
    flight.check(row)


@pytest.mark.every_fault
@pytest.mark.parametrize("shift_m", [0.5, 10.0])
@pytest.mark.parametrize("vehicle_id", [LEADER, 3], ids=["leader", "follower"])
def test_an_estimator_reset_causes_no_step(tmp_path: Path, shift_m: float, vehicle_id: int, row: FaultRow) -> None:
    who = "leader" if vehicle_id == LEADER else "follower"
    row.fault, row.demanded = (
        f"position of the {who}'s estimator reset by {shift_m:g} m",
        demanded(Code.POSITION_JUMPED),
    )
    reset = f"{{vehicle: {vehicle_id}, at_s: {FAULT_AT_S}, shift_enu_m: [0.0, {shift_m}, 0.0]}}"
    with faulty_fleet(tmp_path, f"stand_in.estimator_resets=[{reset}]") as flight:
        flight.form_before_the_fault()
        flight.ground.listen(8.0)
        events = [event.code for event in flight.events(vehicle_id)]
        row.measured.append(", ".join(f"`{code}`" for code in dict.fromkeys(events)) or "no event")
        phase = flight.phase(vehicle_id)
        row.outcome = f"phase {phase}; others: {', '.join(sorted({flight.phase(i) for i in IDS if i != vehicle_id}))}"
        assert phase is (FlightPhase.HOLD if shift_m > 5.0 else FlightPhase.FORMATION), flight.logged()
        flight.check(row)
        flight.land()


@pytest.mark.every_fault
@pytest.mark.parametrize(
    ("percent", "code", "key"),
    [(15, Code.BATTERY_LOW, "leave_below_percent=20"), (5, Code.BATTERY_CRITICAL, "land_below_percent=10")],
)
def test_a_vehicle_with_a_low_battery_lands(tmp_path: Path, percent: int, code: Code, key: str, row: FaultRow) -> None:
    row.fault, row.demanded = f"battery of a follower falls to {percent} %, `{key.replace('=', ': ')}`", demanded(code)
    level = f"{{vehicle: 4, at_s: {FAULT_AT_S}, percent: {percent}}}"
    with faulty_fleet(tmp_path, f"fleet.{key}", f"stand_in.batteries=[{level}]") as flight:
        flight.form_before_the_fault()
        flight.wait(lambda: flight.event(4, code), 10.0)
        raised_s = next(event.after_s for event in flight.events(4) if event.code == code)
        flight.wait(lambda: any("formation -> " in event.text for event in flight.events(4)), 10.0)
        left_s = next(event.after_s for event in flight.events(4) if "formation -> " in event.text)
        row.measured.append(f"leaves formation {left_s - raised_s:.1f} s after the flag")
        flight.wait(lambda: not flight.ground.newest[4].autopilot.armed, 30.0)
        row.outcome = "it lands and disarms; the others fly on"
        flight.check_formation(OTHERS)
        flight.check(row)


@pytest.mark.every_fault
def test_agents_fly_on_with_a_full_disk(flight: FaultyFleet, row: FaultRow) -> None:
    row.fault, row.demanded = "no agent can write its log or its recording (RLIMIT_FSIZE)", "no effect on the flight"
    flight.fault()
    for i in IDS:
        size = (flight.folder / f"agent_{i}.log").stat().st_size
        resource.prlimit(flight.pid(f"agent {i}"), resource.RLIMIT_FSIZE, (size, size))
    held_s = time.monotonic()
    flight.ground.order(CommandName.HOLD, FlightPhase.HOLD, IDS)  # events to log
    flight.ground.order(CommandName.FORM, FlightPhase.FORMATION, IDS)
    flight.ground.listen(5.0)
    flight.check_formation()
    assert not any(flight.events(i) for i in IDS)
    assert all(flight.ground.newest[i].recording.state == "dropping" for i in IDS)
    row.measured.append(f"hold and form again within {time.monotonic() - held_s - 5.0:.0f} s, nothing logged")
    row.outcome = "all in formation, then landed"
    flight.check(row)
    flight.land()


@pytest.mark.every_fault
def test_the_fleet_stays_on_the_ground_when_one_may_not_arm(tmp_path: Path, row: FaultRow) -> None:
    row.fault, row.demanded = (
        "an autopilot refuses to arm",
        "`arm` is refused with the reason; the vehicle stays on the ground",
    )
    with faulty_fleet(tmp_path, "stand_in.armable_after_s=600") as flight:
        flight.wait(lambda: len(flight.ground.newest) == len(IDS), 20.0)
        flight.ground.order(CommandName.PREPARE, FlightPhase.READY, IDS)
        flight.fault()
        flight.session.command(IDS, CommandName.ARM, 1.0)
        flight.ground.listen(15.0)
        codes = sorted({event.code for i in IDS for event in flight.events(i)})
        row.measured.append(", ".join(f"`{code}`" for code in codes))
        row.outcome = f"phase {', '.join(sorted(flight.ground.phases(IDS)))}; disarmed"
        assert not any(status.autopilot.armed for status in flight.ground.newest.values())
        assert flight.ground.phases(IDS) <= {FlightPhase.READY, FlightPhase.OBSERVE}, flight.logged()


@pytest.mark.every_fault
def test_a_second_agent_with_an_id_of_the_fleet_does_not_disturb_it(flight: FaultyFleet, row: FaultRow) -> None:
    """It has an autopilot of its own, which hovers at the origin, and sends its states to all others."""
    row.fault, row.demanded = "a second agent with the id of a follower", demanded(Code.DUPLICATE_ID)
    port = ports_of(4, flight.port_offset).companion + 13_000
    listens = ports_of(4, flight.port_offset).zenoh
    file = flight.folder / "vehicle_double.yaml"
    text = (flight.folder / "vehicle_4.yaml").read_text(encoding="utf-8")
    text = text.replace(f":{port - 1000}", f":{port}").replace(f"127.0.0.1:{listens}", f"127.0.0.1:{listens + 50}")
    file.write_text(text, encoding="utf-8")
    before_m = flight.largest_error_m(last_s=1.0)
    with (flight.folder / "double.log").open("wb") as log, HoveringAutopilot(4, port):
        flight.fault()
        double = subprocess.Popen([sys.executable, "-m", "companion", "agent", "--config", str(file)], stderr=log)
        try:
            flight.ground.listen(10.0)
            assert double.poll() is None, (flight.folder / "double.log").read_text()
            error_m = flight.largest_error_m(last_s=5.0)
            flagged = {i for i in IDS if flight.event(i, Code.DUPLICATE_ID)}
            row.measured.append(f"reported by {len(flagged)} vehicles; error {error_m:.3f} m, before {before_m:.3f} m")
            row.outcome = "all in formation"
            flight.check_formation()
            assert flagged
            flight.check(row)
        finally:
            double.kill()
            double.wait()
