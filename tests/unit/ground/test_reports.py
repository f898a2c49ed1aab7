"""Status and readiness of vehicles as lines and data."""

from math import pi

import pytest

from common import with_fields
from companion.ground.belief import Doubt
from companion.ground.reports import (
    checks_of,
    leader_check,
    readiness_as_data,
    readiness_lines,
    status_as_data,
    status_lines,
)
from companion.types.autopilot import PositionError
from companion.types.flight import HealthFlag, Role
from companion.types.formation import FlownSlot, Heading, HeldReference
from companion.types.notices import Code, Notice
from companion.types.status import NO_STATE_AGE_S
from companion.types.values import ZERO3
from ground_fleet import directed_status

READY = with_fields(directed_status(1), peers=(2,), battery_percent=80.0, position_error=PositionError(0.1, 0.2))


def test_a_vehicle_without_findings_is_ready() -> None:
    checks = checks_of(with_fields(READY, flags=(HealthFlag.LEADER_LOST,)), (1, 2), 1)
    assert all(check.passed for check in checks)
    lines = readiness_lines({1: checks}, [], 3.0)
    assert lines[0] == "vehicle 1  ready"
    assert "  battery     ok  80 %" in lines
    assert "  estimator   ok  error 0.10 m horizontal, 0.20 m vertical" in lines
    assert readiness_as_data({1: checks}, [2])[1] == {"vehicle_id": 2, "ready": False, "checks": []}


@pytest.mark.parametrize(
    ("change", "name", "code"),
    [
        ({"flags": (HealthFlag.MODE_STALE,)}, "autopilot", Code.MODE_STALE),
        ({"flags": (HealthFlag.POSITION_JUMPED,)}, "estimator", Code.POSITION_JUMPED),
        ({"flags": (HealthFlag.FRAME_UNKNOWN,)}, "origin", Code.FRAME_UNKNOWN),
        ({"flags": (HealthFlag.OUTSIDE_FENCE,)}, "origin", Code.OUTSIDE_FENCE),
        ({"peers": ()}, "peers", Code.PEER_STALE),
        ({"formation_hash": 2}, "fleet file", Code.FLEET_FILE_DIFFERS),
        ({"lacks": (Notice(Code.BATTERY_LOW, "battery: 15 %"),)}, "battery", Code.BATTERY_LOW),
        ({"lacks": (Notice(Code.VEHICLE_TOO_CLOSE, "0.40 m"),)}, "separation", Code.VEHICLE_TOO_CLOSE),
        ({"lacks": (Notice(Code.ALTITUDES_DIFFER, "3.0 m above"),)}, "separation", Code.ALTITUDES_DIFFER),
        ({"lacks": (Notice(Code.AUDIT_REFUSAL, "COM_OF_LOSS_T: not found"),)}, "parameters", Code.AUDIT_REFUSAL),
    ],
)
def test_each_finding_fails_one_check(change: dict[str, object], name: str, code: Code) -> None:
    checks = checks_of(with_fields(READY, **change), (1, 2), 1)  # type: ignore[arg-type]
    failed = [check for check in checks if not check.passed]
    assert [(check.name, check.codes) for check in failed] == [(name, (code,))]
    assert failed[0].found.startswith(f"{code}: ")
    assert readiness_lines({1: checks}, [], 3.0)[0] == "vehicle 1  not ready"


def test_warnings_of_the_audit_are_shown_and_fail_no_check() -> None:
    fence = Notice(Code.AUTOPILOT_FENCE_OFF, "GF_ACTION: 0 (nothing)")
    slow = Notice(Code.BRAKES_SLOWLY, "braking: from 0.7 m/s")
    warned = with_fields(READY, warnings=(fence, Notice(Code.BATTERY_LOW, "battery: 35 %"), slow))
    checks = checks_of(warned, (1, 2), 1, [Notice(Code.LOOKS_LIKE_DEGREES, "vehicles[0].slot_enu_m")])
    assert all(check.passed for check in checks)
    found = {check.name: check.found for check in checks}
    assert found["parameters"].endswith("arming checks pass; warning: AUTOPILOT_FENCE_OFF: GF_ACTION: 0 (nothing)")
    assert found["battery"] == "80 %; warning: BATTERY_LOW: battery: 35 %"
    assert found["separation"] == "kept; warning: BRAKES_SLOWLY: braking: from 0.7 m/s"
    assert found["fleet file"] == "the same; warning: LOOKS_LIKE_DEGREES: vehicles[0].slot_enu_m"
    lines = readiness_lines({1: checks}, [], 3.0)
    assert lines[0] == "vehicle 1  ready, with warnings"
    assert lines[-1] == "verdict  all 1 ready, with warnings"
    data = {check["check"]: check["warnings"] for check in readiness_as_data({1: checks}, [])[0]["checks"]}
    assert data["parameters"] == [Code.AUTOPILOT_FENCE_OFF]


def test_a_warning_of_several_vehicles_is_one_line_and_the_last_one_is_the_verdict() -> None:
    low = with_fields(READY, warnings=(Notice(Code.BATTERY_LOW, "battery: 35 %"),))
    of_low, good = checks_of(low, (1, 2), 1), checks_of(READY, (1, 2), 1)
    lines = readiness_lines({1: of_low, 2: good, 4: of_low}, [], 3.0)
    assert [line for line in lines if "BATTERY_LOW" in line] == ["  battery     1, 4: BATTERY_LOW: battery: 35 %"]
    assert lines[-1] == "verdict  all 3 ready, with warnings"
    assert readiness_lines({1: good, 2: good}, [], 3.0)[-1] == "verdict  all 2 ready"
    alone = checks_of(with_fields(READY, peers=()), (1, 2), 1)
    assert readiness_lines({1: alone, 2: good}, [3], 3.0)[-1] == "verdict  not ready: 1; no report: 3"


def test_a_fleet_without_a_leader_is_not_ready() -> None:
    follower, leader = with_fields(READY, role=Role.FOLLOWER), with_fields(READY, role=Role.LEADER)
    missing = leader_check({1: follower, 2: follower}, (1, 2))
    assert missing.codes == (Code.LEADER_LOST,)
    assert "companion fleet leader ID" in missing.found
    assert leader_check({1: follower, 2: leader}, (1, 2)).found == "vehicle 2"
    assert leader_check({1: follower}, (1, 2)).passed  # the other one may lead


def test_each_health_flag_fails_one_check() -> None:
    for flag in set(HealthFlag) - {HealthFlag.LEADER_LOST, HealthFlag.LEADER_AWAITED}:
        checks = checks_of(with_fields(READY, flags=(flag,)), (1, 2), 1)
        assert sum(not check.passed for check in checks) == 1, flag


def test_the_status_names_the_operator_and_missing_vehicles() -> None:
    lines = status_lines({1: with_fields(READY, holder="anna@ground")}, [2], 3.0)
    assert "operator anna@ground" in lines[1]
    assert lines[-1] == "vehicle 2   missing  NO_REPORT: no report for 3 s"


@pytest.mark.parametrize("columns", ["80", "100", "160"])
def test_the_status_fits_the_terminal(columns: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("COLUMNS", columns)
    event = Notice(Code.PROCEDURE_FAILED, "arm -> ready (arm failed: " + "the autopilot refuses; " * 6 + ")")
    busy = with_fields(READY, position_enu_m=(-1234.56, 1234.56, 123.4), mode_name="AUTO.PRECLAND", last_event=event)
    lines = status_lines({250: with_fields(busy, vehicle_id=250, holder="a" * 63, target_age_s=0.3)}, [], 3.0)
    assert max(map(len, lines)) <= min(int(columns), 100)


@pytest.mark.parametrize(
    ("slot", "text"),
    [
        (FlownSlot(ZERO3, formation=3, waiting=3), "3"),
        (FlownSlot(ZERO3, formation=3, waiting=4), "3, then 4"),
        (FlownSlot(ZERO3, (0.1, 0.0, 0.0), formation=4, waiting=4, moves_for_s=1.0), "changing to 4"),
    ],
)
def test_the_status_shows_the_flown_formation_and_the_next(slot: FlownSlot, text: str) -> None:
    assert f" formation {text}, reference -, operator -" in status_lines({1: with_fields(READY, slot=slot)}, [], 3.0)[1]


def test_the_status_shows_the_heading_of_a_turned_formation() -> None:
    assert " formation 0 at 90 deg, " in status_lines({1: with_fields(READY, heading=Heading(pi / 2.0))}, [], 3.0)[1]


@pytest.mark.parametrize(
    ("held", "target_age_s", "text"),
    [
        (HeldReference(2, 2), None, "2"),
        (HeldReference(2, 3), None, "2, then 3"),
        (HeldReference(2, 2), 0.31, "2, target 0.3 s old"),
    ],
)
def test_the_status_shows_the_reference_and_the_age_of_its_target(
    held: HeldReference, target_age_s: float | None, text: str
) -> None:
    lines = status_lines({1: with_fields(READY, reference=held, target_age_s=target_age_s)}, [], 3.0)
    assert f" reference {text}, operator -, battery 80 %" in lines[1]


def test_what_cannot_be_true_is_named_below_its_vehicle() -> None:
    doubt = Doubt(1, "slot", "0, -900, 0 m", "at most 141 m from the reference")
    text = " ".join(" ".join(status_lines({1: READY}, [], 3.0, [doubt])).split())
    assert "REPORT_IMPLAUSIBLE: reports slot 0, -900, 0 m; expected at most 141 m" in text
    (data,) = status_as_data({1: READY}, [], [doubt])
    assert [(one["field"], one["code"]) for one in data["doubts"]] == [("slot", "REPORT_IMPLAUSIBLE")]


def test_a_vehicle_without_a_position_is_shown_at_none() -> None:
    nowhere = with_fields(READY, position_enu_m=(0.0, 0.0, 0.0), state_age_s=NO_STATE_AGE_S)
    assert "position unknown" in status_lines({1: nowhere}, [], 3.0)[0]
    (data,) = status_as_data({1: nowhere}, [])
    assert (data["position_enu_m"], data["velocity_enu_m_s"]) == (None, None)


def test_the_data_marks_missing_vehicles() -> None:
    data = status_as_data({1: READY}, [2])
    assert (data[0]["reported"], data[0]["vehicle_id"], data[1]) == (True, 1, {"vehicle_id": 2, "reported": False})
