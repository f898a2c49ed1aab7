"""The audit's table, over every rule: what is in order, what is warned of, what is refused, and what may be set."""

from __future__ import annotations

from dataclasses import replace

import pytest

from companion.core.audit import Facts, Finding, Place, Verdict, audit, parameter_names, worst
from companion.core.audit_parameters import RULES
from companion.types import AutopilotKind

PX4, ARDUPILOT = AutopilotKind.PX4, AutopilotKind.ARDUPILOT
OK, WARNING, REFUSAL = Verdict.OK, Verdict.WARNING, Verdict.REFUSAL
HOVER = 0.49

# (autopilot, parameter, value, verdict, what --fix would set)
CASES: list[tuple[AutopilotKind, str, float | None, Verdict, float | None]] = [
    (PX4, "COM_OF_LOSS_T", 1.0, OK, None),
    (PX4, "COM_OF_LOSS_T", 2.0, OK, None),
    (PX4, "COM_OF_LOSS_T", 2.1, REFUSAL, 1.0),
    (PX4, "COM_OF_LOSS_T", 60.0, REFUSAL, 1.0),
    (PX4, "COM_OF_LOSS_T", 0.5, WARNING, 1.0),  # not longer than the agent's own patience
    (PX4, "COM_OF_LOSS_T", 0.0, REFUSAL, 1.0),
    (PX4, "COM_OF_LOSS_T", None, WARNING, None),
    (PX4, "COM_OBL_RC_ACT", 5, OK, None),
    (PX4, "COM_OBL_RC_ACT", 4, OK, None),
    (PX4, "COM_OBL_RC_ACT", 0, WARNING, 5.0),
    (PX4, "COM_OBL_RC_ACT", 1, WARNING, 5.0),
    (PX4, "COM_OBL_RC_ACT", 2, WARNING, 5.0),
    (PX4, "COM_OBL_RC_ACT", 3, WARNING, 5.0),
    (PX4, "COM_OBL_RC_ACT", 6, REFUSAL, 5.0),
    (PX4, "COM_OBL_RC_ACT", 7, REFUSAL, 5.0),
    (PX4, "COM_OBL_RC_ACT", -5, WARNING, 5.0),
    (PX4, "NAV_DLL_ACT", 0, OK, None),
    (PX4, "NAV_DLL_ACT", 1, WARNING, None),
    (PX4, "NAV_DLL_ACT", 2, WARNING, None),
    (PX4, "NAV_DLL_ACT", 3, WARNING, None),
    (PX4, "NAV_DLL_ACT", 5, REFUSAL, None),
    (PX4, "NAV_DLL_ACT", 6, REFUSAL, None),
    (PX4, "NAV_DLL_ACT", 99, WARNING, None),
    (PX4, "COM_RC_OVERRIDE", 3, OK, None),
    (PX4, "COM_RC_OVERRIDE", 2, OK, None),
    (PX4, "COM_RC_OVERRIDE", 1, WARNING, 3.0),
    (PX4, "COM_RC_OVERRIDE", 0, WARNING, 2.0),
    (PX4, "GF_ACTION", 2, OK, None),
    (PX4, "GF_ACTION", 3, OK, None),
    (PX4, "GF_ACTION", 5, OK, None),
    (PX4, "GF_ACTION", 0, WARNING, 2.0),
    (PX4, "GF_ACTION", 1, WARNING, 2.0),
    (PX4, "GF_ACTION", 4, REFUSAL, 2.0),
    (PX4, "GF_MAX_HOR_DIST", 60.0, OK, None),
    (PX4, "GF_MAX_HOR_DIST", 0.0, WARNING, None),
    (PX4, "GF_MAX_VER_DIST", 30.0, OK, None),
    (PX4, "GF_MAX_VER_DIST", 0.0, WARNING, None),
    (PX4, "MPC_THR_HOVER", 0.5, OK, None),
    (PX4, "MPC_THR_HOVER", 0.3, WARNING, None),
    (ARDUPILOT, "GUID_OPTIONS", 8, OK, None),
    (ARDUPILOT, "GUID_OPTIONS", 9, OK, None),
    (ARDUPILOT, "GUID_OPTIONS", 0, REFUSAL, 8.0),
    (ARDUPILOT, "GUID_OPTIONS", 5, REFUSAL, 13.0),  # the other bits stay
    (ARDUPILOT, "GUID_OPTIONS", None, REFUSAL, None),  # thrust might be a climb rate
    (ARDUPILOT, "ATC_ANGLE_BOOST", 1, OK, None),
    (ARDUPILOT, "ATC_ANGLE_BOOST", 0, WARNING, 1.0),
    (ARDUPILOT, "GUID_TIMEOUT", 1.0, OK, None),
    (ARDUPILOT, "GUID_TIMEOUT", 3.0, WARNING, 1.0),  # as it comes
    (ARDUPILOT, "GUID_TIMEOUT", 5.0, REFUSAL, 1.0),
    (ARDUPILOT, "GUID_TIMEOUT", 0.1, WARNING, 1.0),
    (ARDUPILOT, "FS_GCS_ENABLE", 0, OK, None),
    (ARDUPILOT, "FS_GCS_ENABLE", 1, WARNING, None),
    (ARDUPILOT, "FENCE_ENABLE", 1, OK, None),
    (ARDUPILOT, "FENCE_ENABLE", 0, WARNING, None),
    (ARDUPILOT, "FENCE_ACTION", 1, OK, None),
    (ARDUPILOT, "FENCE_ACTION", 4, OK, None),
    (ARDUPILOT, "FENCE_ACTION", 0, WARNING, 1.0),
    (ARDUPILOT, "MOT_THST_HOVER", 0.47, OK, None),
    (ARDUPILOT, "MOT_THST_HOVER", 0.2, WARNING, None),
]


def finding(facts: Facts) -> Finding:
    (only,) = audit(facts)
    return only


@pytest.mark.parametrize(("autopilot", "name", "value", "verdict", "fix"), CASES)
def test_every_value_of_a_parameter(
    autopilot: AutopilotKind, name: str, value: float | None, verdict: Verdict, fix: float | None
) -> None:
    found = finding(Facts(autopilot, {name: value}, HOVER))
    assert (found.subject, found.verdict, found.fix) == (name, verdict, fix)
    assert found.wanted
    assert bool(found.remedy) is (verdict is not OK)  # who is warned is told what to do
    if fix is not None:
        assert f"set {name} to {fix:g}" in found.remedy


@pytest.mark.parametrize("autopilot", AutopilotKind)
def test_no_rule_is_left_untried(autopilot: AutopilotKind) -> None:
    assert set(parameter_names(autopilot)) == {name for kind, name, *_ in CASES if kind is autopilot}


@pytest.mark.parametrize("autopilot", AutopilotKind)
def test_what_fix_sets_is_in_order(autopilot: AutopilotKind) -> None:
    for kind, name, value, _verdict, fix in CASES:
        if kind is autopilot and fix is not None:
            assert finding(Facts(kind, {name: fix}, HOVER)).verdict is OK, (name, value)


@pytest.mark.parametrize("autopilot", AutopilotKind)
def test_a_parameter_of_no_known_firmware_is_words_and_no_crash(autopilot: AutopilotKind) -> None:
    nothing = audit(Facts(autopilot, dict.fromkeys(parameter_names(autopilot)), HOVER))
    assert {found.found for found in nothing} == {"not found"}
    assert all(found.wanted for found in nothing)
    assert len(nothing) == len(RULES[autopilot])


def test_a_hover_thrust_that_was_not_found_says_what_it_would_be_compared_with() -> None:
    assert str(finding(Facts(PX4, {"MPC_THR_HOVER": None}, HOVER))) == (
        "MPC_THR_HOVER: not found; wanted: near hover_thrust_norm of the vehicle file, 0.49;"
        " older firmware, or a link that loses much"
    )


BENCH = Facts(
    PX4,
    {},
    HOVER,
    rates_hz={"positions": 50.0, "attitudes": 50.0, "modes": 3.0, "landed states": 10.0},
    checks_lack="",
    place=Place.INSIDE,
    position_enu_m=(1.0, 2.0, -0.0),
    battery_percent=90.0,
    mode_name="AUTO.LOITER",
    armed=False,
)


def verdicts(facts: Facts) -> dict[str, Verdict]:
    return {found.subject: found.verdict for found in audit(facts)}


def test_a_vehicle_on_the_bench_that_is_in_order() -> None:
    assert set(verdicts(BENCH).values()) == {OK}
    assert list(verdicts(BENCH)) == [
        "positions", "attitudes", "modes", "landed states", "estimator and checks", "origin", "battery", "mode",
    ]  # fmt: skip
    assert "1.0, 2.0, 0.0 m" in next(found.found for found in audit(BENCH) if found.subject == "origin")


@pytest.mark.parametrize(
    ("facts", "subject", "verdict"),
    [
        (replace(BENCH, rates_hz={**BENCH.rates_hz, "positions": 39.9}), "positions", REFUSAL),
        (replace(BENCH, rates_hz={**BENCH.rates_hz, "attitudes": 10.0}), "attitudes", REFUSAL),
        (replace(BENCH, rates_hz={**BENCH.rates_hz, "modes": 1.0}), "modes", REFUSAL),  # HEARTBEAT's alone
        (replace(BENCH, rates_hz={**BENCH.rates_hz, "landed states": 0.0}), "landed states", REFUSAL),
        (replace(BENCH, rates_hz={}), "positions", REFUSAL),
        (replace(BENCH, checks_lack="Preflight Fail: no GPS"), "estimator and checks", REFUSAL),
        (replace(BENCH, place=Place.UNKNOWN), "origin", REFUSAL),
        (replace(BENCH, place=Place.NO_ORIGIN), "origin", REFUSAL),
        (replace(BENCH, place=Place.OUTSIDE), "origin", REFUSAL),
        (replace(BENCH, battery_percent=39.0), "battery", WARNING),
        (replace(BENCH, battery_percent=19.0), "battery", REFUSAL),
        (replace(BENCH, battery_percent=-1.0), "battery", WARNING),
        (replace(BENCH, armed=True), "mode", WARNING),
    ],
)
def test_what_is_not_in_order(facts: Facts, subject: str, verdict: Verdict) -> None:
    assert verdicts(facts)[subject] is verdict
    found = next(found for found in audit(facts) if found.subject == subject)
    assert found.remedy
    assert found.remedy in str(found)


def test_what_a_door_does_not_look_at_is_not_spoken_of() -> None:
    assert audit(Facts(PX4, {}, HOVER)) == ()


def test_the_gravest_verdict_counts() -> None:
    assert worst(audit(BENCH)) is OK
    assert worst(audit(replace(BENCH, battery_percent=-1.0))) is WARNING
    assert worst(audit(replace(BENCH, battery_percent=-1.0, rates_hz={}))) is REFUSAL
