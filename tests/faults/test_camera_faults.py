"""The motion-capture system of a flying fleet loses a body, shows it wrongly, or ends."""

from pathlib import Path

import pytest

from companion.types.flight import FlightPhase
from companion.types.notices import Code
from fault_table import FaultRow
from process_fleet import FAULT_AT_S, IDS, FaultyFleet, demanded, faulty_fleet

pytestmark = [pytest.mark.fleet, pytest.mark.timeout(240), pytest.mark.every_fault]

PLACE = "{latitude_deg: 47.397742, longitude_deg: 8.545594, altitude_amsl_m: 488.0}"
INDOORS = (
    "fleet.origin=indoor",
    f"fleet.external_vision={{place: {PLACE}}}",
    "stand_in.positioning=external_vision",
)
SWAPPED = "kind: swapped, vehicle: 4, other: 3"


def laboratory_fault(what: str, for_s: float) -> str:
    return f"stand_in.capture_faults=[{{{what}, at_s: {FAULT_AT_S}, for_s: {for_s}}}]"


def measure(flight: FaultyFleet, ids: tuple[int, ...], row: FaultRow) -> None:
    """When the bodies were flagged, left formation, and were commanded to land."""
    for i in ids:
        flagged = flight.event(i, Code.POSE_LOST)
        assert flagged, flight.logged()
        steps = {
            name: next((e.after_s - flagged.after_s for e in flight.events(i) if text in e.text), None)
            for name, text in (("leaves formation", "formation -> "), ("lands", "-> land"))
        }
        row.measured.append(
            f"vehicle {i}: " + ", ".join(f"{n} {s:.2f} s after the flag" for n, s in steps.items() if s)
        )
        assert steps["leaves formation"] == pytest.approx(0.3, abs=0.1), flight.logged()
        assert steps["lands"] is not None, flight.logged()
        assert steps["lands"] < 2.1


@pytest.mark.parametrize(
    ("words", "what", "ids"),
    [
        ("lost", "kind: lost, vehicle: 4", (4,)),
        ("swapped with another", SWAPPED, (3, 4)),
        ("turned by 90 degrees", "kind: flipped, vehicle: 4, turn_deg: 90", (4,)),
        ("turned by 180 degrees", "kind: flipped, vehicle: 4", (4,)),
        ("frozen", "kind: frozen, vehicle: 4", (4,)),
        ("0.3 s late", "kind: late, vehicle: 4", (4,)),
    ],
)
def test_a_body_that_is_shown_wrongly_for_6_s(
    tmp_path: Path, words: str, what: str, ids: tuple[int, ...], row: FaultRow
) -> None:
    row.fault, row.demanded = f"the cameras show the body of a follower {words}, for 6 s", demanded(Code.POSE_LOST)
    with faulty_fleet(tmp_path, *INDOORS, laboratory_fault(what, 6.0)) as flight:
        flight.form_before_the_fault()
        flight.wait(lambda: all(flight.phase(i) is FlightPhase.LAND for i in ids), 12.0)
        measure(flight, ids, row)
        flight.wait(lambda: not any(flight.ground.newest[i].autopilot.armed for i in ids), 30.0)
        if words != "lost":
            reason = flight.event(ids[0], Code.POSE_REFUSED)
            assert reason, flight.logged()
            row.measured.append(f"refused as {reason.text.rpartition('passed on: ')[2]}")
        others = tuple(i for i in IDS if i not in ids)
        row.outcome = f"it lands and disarms; others: {', '.join(sorted(flight.ground.phases(others)))}"
        flight.check(row, blind=ids)
        flight.land(others)


@pytest.mark.parametrize(("lost_s", "ends"), [(0.4, FlightPhase.FORMATION), (2.0, FlightPhase.HOLD)])
def test_a_body_that_comes_back(tmp_path: Path, lost_s: float, ends: FlightPhase, row: FaultRow) -> None:
    row.fault, row.demanded = f"the cameras lose the body of a follower for {lost_s:g} s", demanded(Code.POSE_LOST)
    with faulty_fleet(tmp_path, *INDOORS, laboratory_fault("kind: lost, vehicle: 4", lost_s)) as flight:
        flight.form_before_the_fault()
        flight.wait(lambda: flight.event(4, Code.POSE_LOST), 8.0)
        flight.ground.listen(4.0)
        assert flight.phase(4) in (ends, FlightPhase.LAND if lost_s > 0.5 else ends), flight.logged()
        row.outcome = f"phase {flight.phase(4)}; the others fly on"
        flight.check_formation((1, 2, 3))
        flight.check(row)


@pytest.mark.parametrize("name", ["mocap", "cameras"])
def test_all_land_when_no_pose_comes_at_all(tmp_path: Path, name: str, row: FaultRow) -> None:
    program = "`companion mocap run`" if name == "mocap" else "the camera system"
    row.fault, row.demanded = f"SIGKILL of {program}", demanded(Code.POSE_LOST)
    with faulty_fleet(tmp_path, *INDOORS) as flight:
        flight.form()
        flight.fault()
        flight.kill(name)
        flight.wait(lambda: all(flight.phase(i) is FlightPhase.LAND for i in IDS), 10.0)
        measure(flight, IDS, row)
        flight.wait(lambda: not any(flight.ground.newest[i].autopilot.armed for i in IDS), 30.0)
        row.outcome = "all land and disarm"
        flight.check(row, blind=IDS)
