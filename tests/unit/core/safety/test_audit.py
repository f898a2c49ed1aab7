"""The audit table, for every rule: ok, warning, refusal, and values that may be set."""

from __future__ import annotations

from dataclasses import replace

import pytest

from companion.core.autopilot import Judgement, ParameterRule, SentFrom
from companion.core.safety.audit import AuditFinding, Facts, FleetFence, FoundHome, PositionCheck, Verdict, audit, worst
from companion.core.safety.fleet_checks import NO_ALTITUDE, TWO_STREAMS
from companion.mavlink.autopilot_types import PROFILES, VISION_PROFILES
from companion.types.autopilot import AutopilotKind
from companion.types.notices import Code

PX4, ARDUPILOT = AutopilotKind.PX4, AutopilotKind.ARDUPILOT
OK, WARNING, REFUSAL = Verdict.OK, Verdict.WARNING, Verdict.REFUSAL
HOVER = 0.49
RULES = {kind: profile.parameters for kind, profile in PROFILES.items()}

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
    (PX4, "COM_OBL_RC_ACT", 0, REFUSAL, 5.0),
    (PX4, "COM_OBL_RC_ACT", 1, REFUSAL, 5.0),
    (PX4, "COM_OBL_RC_ACT", 2, REFUSAL, 5.0),
    (PX4, "COM_OBL_RC_ACT", None, REFUSAL, None),
    (PX4, "COM_OBL_RC_ACT", 3, WARNING, 5.0),
    (PX4, "COM_OBL_RC_ACT", 6, REFUSAL, 5.0),
    (PX4, "COM_OBL_RC_ACT", 7, REFUSAL, 5.0),
    (PX4, "COM_OBL_RC_ACT", -5, REFUSAL, 5.0),
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
    (PX4, "RTL_TYPE", 0, OK, None),
    (PX4, "RTL_TYPE", 1, WARNING, None),
    (PX4, "RTL_TYPE", 5, WARNING, None),
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
    (ARDUPILOT, "FENCE_TYPE", 7, OK, None),
    (ARDUPILOT, "FENCE_TYPE", 3, OK, None),
    (ARDUPILOT, "FENCE_TYPE", 0, WARNING, None),  # enabled, and no fence all the same
    (ARDUPILOT, "FENCE_TYPE", 1, WARNING, None),
    (ARDUPILOT, "FENCE_TYPE", 2, WARNING, None),
    (ARDUPILOT, "FENCE_TYPE", 12, WARNING, None),  # polygons and the floor
    (ARDUPILOT, "FENCE_RADIUS", 150.0, OK, None),  # compared where the fleet's fence is known
    (ARDUPILOT, "FENCE_ALT_MAX", 100.0, OK, None),
    (ARDUPILOT, "FENCE_ACTION", 1, OK, None),
    (ARDUPILOT, "FENCE_ACTION", 4, OK, None),
    (ARDUPILOT, "FENCE_ACTION", 0, WARNING, 1.0),
    (ARDUPILOT, "RALLY_TOTAL", 0, OK, None),
    (ARDUPILOT, "RALLY_TOTAL", 2, WARNING, None),
    (ARDUPILOT, "MOT_THST_HOVER", 0.47, OK, None),
    (ARDUPILOT, "MOT_THST_HOVER", 0.2, WARNING, None),
]


def finding(facts: Facts) -> AuditFinding:
    (only,) = audit(facts)
    return only


@pytest.mark.parametrize(("autopilot", "name", "value", "verdict", "fix"), CASES)
def test_verdict_of_every_parameter_value(
    autopilot: AutopilotKind, name: str, value: float | None, verdict: Verdict, fix: float | None
) -> None:
    found = finding(Facts(RULES[autopilot], {name: value}, HOVER))
    assert (found.subject, found.verdict, found.fix) == (name, verdict, fix)
    assert found.wanted
    assert bool(found.remedy) is (verdict is not OK)  # every warning has a remedy
    if fix is not None:
        assert f"set {name} to {fix:g}" in found.remedy


@pytest.mark.parametrize(
    ("value", "accepted"), [(0, WARNING), (1, WARNING), (2, WARNING), (None, WARNING), (6, REFUSAL), (7, REFUSAL)]
)
def test_a_vehicle_file_accepts_a_descent_in_silence_but_no_fall(value: float | None, accepted: Verdict) -> None:
    facts = Facts(RULES[PX4], {"COM_OBL_RC_ACT": value}, HOVER)
    assert finding(facts).verdict is REFUSAL
    assert finding(replace(facts, accepts_uncontrolled_descent=True)).verdict is accepted


@pytest.mark.parametrize("autopilot", AutopilotKind)
def test_every_rule_is_tested(autopilot: AutopilotKind) -> None:
    assert {rule.name for rule in RULES[autopilot]} == {name for kind, name, *_ in CASES if kind is autopilot}


@pytest.mark.parametrize("autopilot", AutopilotKind)
def test_values_set_by_fix_pass_the_audit(autopilot: AutopilotKind) -> None:
    for kind, name, value, _verdict, fix in CASES:
        if kind is autopilot and fix is not None:
            assert finding(Facts(RULES[kind], {name: fix}, HOVER)).verdict is OK, (name, value)


@pytest.mark.parametrize("autopilot", AutopilotKind)
def test_unknown_parameter_value_is_reported(autopilot: AutopilotKind) -> None:
    nothing = audit(Facts(RULES[autopilot], {rule.name: None for rule in RULES[autopilot]}, HOVER))
    assert {found.found for found in nothing} == {"not found"}
    assert all(found.wanted for found in nothing)
    assert len(nothing) == len(RULES[autopilot])


def test_missing_hover_thrust_parameter_is_reported_with_the_configured_value() -> None:
    assert str(finding(Facts(RULES[PX4], {"MPC_THR_HOVER": None}, HOVER))) == (
        "MPC_THR_HOVER: not found; wanted: near hover_thrust_norm of the vehicle file, 0.49;"
        " update the firmware, or check the link for packet loss"
    )


FENCE = FleetFence(((-40.0, -30.0), (-40.0, 30.0), (40.0, 30.0), (40.0, -30.0)), 15.0, 3.0)
FENCE_PARAMETERS = {
    PX4: ("GF_MAX_HOR_DIST", "GF_MAX_VER_DIST", {"GF_ACTION": 2}),
    ARDUPILOT: ("FENCE_RADIUS", "FENCE_ALT_MAX", {"FENCE_ENABLE": 1, "FENCE_TYPE": 7, "FENCE_ACTION": 1}),
}


@pytest.mark.parametrize("autopilot", AutopilotKind)
@pytest.mark.parametrize(
    ("radius_m", "ceiling_m", "home", "verdicts", "words"),
    [
        (50.0, 15.0, (0.0, 0.0), (OK, OK), "at least 50.0 m around home"),
        (49.0, 15.0, (0.0, 0.0), (WARNING, OK), "49 m (inside the fleet's fence"),
        (80.0, 15.0, (-40.0, -30.0), (WARNING, OK), "at least 100.0 m around home"),  # in a corner
        (50.0, 15.0, None, (OK, OK), ""),  # as in the middle
        (50.0, 14.0, (0.0, 0.0), (OK, WARNING), "at least 15.0 m above home"),
        (50.0, 3.0, (0.0, 0.0), (OK, REFUSAL), "3 m (not above the take-off height, 3 m)"),
        (5.0, 2.0, (0.0, 0.0), (WARNING, REFUSAL), "2 m (not above the take-off height, 3 m)"),
    ],
)
def test_the_autopilot_s_fence_leaves_room_for_the_fleet_s(
    autopilot: AutopilotKind,
    radius_m: float,
    ceiling_m: float,
    home: tuple[float, float] | None,
    verdicts: tuple[Verdict, Verdict],
    words: str,
) -> None:
    radius, ceiling, others = FENCE_PARAMETERS[autopilot]
    parameters = {**others, radius: radius_m, ceiling: ceiling_m}
    facts = Facts(RULES[autopilot], parameters, HOVER, fence=replace(FENCE, home_enu_m=home))
    found = {finding.subject: finding for finding in audit(facts)}
    assert (found[radius].verdict, found[ceiling].verdict) == verdicts
    assert words in f"{found[radius]}; {found[ceiling]}"
    for line, size_m in ((found[radius], radius_m), (found[ceiling], ceiling_m)):
        assert line.code is (None if line.verdict is OK else Code.AUTOPILOT_FENCE_SMALL)
        assert bool(line.remedy) is (line.verdict is not OK)
        assert line.found.startswith(f"{size_m:g} m")


@pytest.mark.parametrize(("autopilot", "action"), [(PX4, "GF_ACTION"), (ARDUPILOT, "FENCE_ACTION")])
def test_a_low_ceiling_that_is_only_reported_is_a_warning(autopilot: AutopilotKind, action: str) -> None:
    _, ceiling, others = FENCE_PARAMETERS[autopilot]
    facts = Facts(RULES[autopilot], {**others, ceiling: 2.0, action: 0}, HOVER, fence=FENCE)
    assert verdicts(facts)[ceiling] is WARNING


@pytest.mark.parametrize(
    ("others", "judged"),
    [
        ({"FENCE_ENABLE": 0, "FENCE_TYPE": 7}, set()),
        ({"FENCE_ENABLE": 1, "FENCE_TYPE": 0}, set()),
        ({"FENCE_ENABLE": 1, "FENCE_TYPE": 1}, {"FENCE_ALT_MAX"}),
        ({"FENCE_ENABLE": 1, "FENCE_TYPE": 2}, {"FENCE_RADIUS"}),
        ({"FENCE_ENABLE": 1, "FENCE_TYPE": None}, {"FENCE_RADIUS", "FENCE_ALT_MAX"}),  # it may be on
    ],
)
def test_only_a_fence_that_is_on_is_compared(others: dict[str, float | None], judged: set[str]) -> None:
    sizes = {"FENCE_RADIUS": 5.0, "FENCE_ALT_MAX": 2.0}
    found = verdicts(Facts(RULES[ARDUPILOT], {**others, **sizes}, HOVER, fence=FENCE))
    assert found.keys() & sizes.keys() == judged


BENCH = Facts(
    RULES[PX4],
    {},
    HOVER,
    rates_hz={"positions": 50.0, "attitudes": 50.0, "modes": 3.0, "landed states": 10.0},
    failing_checks="",
    position_check=PositionCheck.INSIDE,
    position_enu_m=(1.0, 2.0, -0.0),
    home=FoundHome(0.4, 1.5),
    battery_percent=90.0,
    mode_name="AUTO.LOITER",
    armed=False,
)


SENT_FROM = SentFrom("EXTENDED_SYS_STATE", "PX4 1.13 and later", "upgrade")
NO_LANDED_STATES = replace(
    BENCH, rates_hz={**BENCH.rates_hz, "landed states": 0.0}, messages={"landed states": SENT_FROM}
)


def verdicts(facts: Facts) -> dict[str, Verdict]:
    return {found.subject: found.verdict for found in audit(facts)}


def test_vehicle_in_order_has_no_findings() -> None:
    assert set(verdicts(BENCH).values()) == {OK}
    assert list(verdicts(BENCH)) == [
        "positions", "attitudes", "modes", "landed states", "estimator and checks", "origin", "home", "battery", "mode",
    ]  # fmt: skip
    assert "1.0, 2.0, 0.0 m" in next(found.found for found in audit(BENCH) if found.subject == "origin")
    assert str(audit(BENCH)[-1]) == "mode: AUTO.LOITER, disarmed; wanted: disarmed"


@pytest.mark.parametrize(
    ("facts", "subject", "verdict"),
    [
        (replace(BENCH, rates_hz={**BENCH.rates_hz, "positions": 39.9}), "positions", REFUSAL),
        (replace(BENCH, rates_hz={**BENCH.rates_hz, "attitudes": 10.0}), "attitudes", REFUSAL),
        (replace(BENCH, rates_hz={**BENCH.rates_hz, "modes": 1.0}), "modes", REFUSAL),  # HEARTBEAT's alone
        (replace(BENCH, rates_hz={**BENCH.rates_hz, "landed states": 0.0}), "landed states", REFUSAL),
        (replace(BENCH, rates_hz={}), "positions", REFUSAL),
        (replace(BENCH, failing_checks="Preflight Fail: no GPS"), "estimator and checks", REFUSAL),
        (replace(BENCH, position_check=PositionCheck.UNKNOWN), "origin", REFUSAL),
        (replace(BENCH, position_check=PositionCheck.NO_ORIGIN), "origin", REFUSAL),
        (replace(BENCH, position_check=PositionCheck.OUTSIDE), "origin", REFUSAL),
        (replace(BENCH, lacks_altitude=True), "take-off", REFUSAL),
        (replace(BENCH, home=FoundHome(1.5, 1.5)), "home", WARNING),
        (replace(BENCH, home=FoundHome(None, 1.5)), "home", WARNING),
        (replace(BENCH, home=FoundHome(0.4, 1.5, "rally points")), "home", WARNING),
        (replace(BENCH, battery_percent=39.0), "battery", WARNING),
        (replace(BENCH, battery_percent=19.0), "battery", REFUSAL),
        (replace(BENCH, battery_percent=-1.0), "battery", WARNING),
        (replace(BENCH, armed=True), "mode", WARNING),
        (replace(BENCH, interleaves=True), "autopilot", REFUSAL),
        (replace(BENCH, round_trip_s=0.11), "round trip", REFUSAL),
        (replace(NO_LANDED_STATES, missing={"landed states"}), "landed states", REFUSAL),
    ],
)
def test_each_defect_has_one_finding(facts: Facts, subject: str, verdict: Verdict) -> None:
    assert verdicts(facts)[subject] is verdict
    found = next(found for found in audit(facts) if found.subject == subject)
    assert found.remedy
    assert found.remedy in str(found)


# Of each line of the audit: the code, what was found, and a number or name that is wanted.
LINES = [
    (BENCH, "positions", None, "50.0 Hz", "40 Hz"),
    (
        replace(BENCH, rates_hz={**BENCH.rates_hz, "positions": 39.94}),
        "positions",
        Code.TELEMETRY_SLOW,
        "39.9 Hz",
        "40 Hz",
    ),
    (replace(BENCH, rates_hz={}), "attitudes", Code.TELEMETRY_SLOW, "0.0 Hz", "40 Hz"),
    (replace(BENCH, rates_hz={}), "modes", Code.TELEMETRY_SLOW, "0.0 Hz", "1.5 Hz"),
    (replace(BENCH, rates_hz={}), "landed states", Code.TELEMETRY_SLOW, "0.0 Hz", "2 Hz"),
    (replace(BENCH, round_trip_s=0.0), "round trip", None, "0.0 ms", "100 ms"),
    (replace(BENCH, round_trip_s=0.1), "round trip", None, "100.0 ms", "100 ms"),
    (replace(BENCH, round_trip_s=0.1001), "round trip", Code.TELEMETRY_LATE, "100.1 ms", "100 ms"),
    (BENCH, "estimator and checks", None, "passed", "preflight checks"),
    (
        replace(BENCH, failing_checks="no GPS"),
        "estimator and checks",
        Code.ARMING_CHECKS_FAILED,
        "no GPS",
        "preflight checks",
    ),
    (BENCH, "origin", None, "inside the fleet's fence at 1.0, 2.0, 0.0 m", "inside"),
    (
        replace(BENCH, position_check=PositionCheck.OUTSIDE),
        "origin",
        Code.POSITION_OUTSIDE_FENCE,
        "outside the fleet's fence at 1.0, 2.0, 0.0 m",
        "inside",
    ),
    (
        replace(BENCH, position_check=PositionCheck.NO_ORIGIN),
        "origin",
        Code.ORIGIN_MISSING,
        "position, but no origin of its local frame",
        "inside",
    ),
    (replace(BENCH, position_check=PositionCheck.UNKNOWN), "origin", Code.POSITION_MISSING, "no position", "inside"),
    (replace(BENCH, position_enu_m=None), "origin", None, "inside the fleet's fence", "inside"),
    (replace(BENCH, lacks_altitude=True), "take-off", Code.ALTITUDE_UNKNOWN, NO_ALTITUDE, "GPS_GLOBAL_ORIGIN"),
    (BENCH, "home", None, "0.4 m from the vehicle", "1.5 m"),
    (replace(BENCH, home=FoundHome(1.49, 1.5)), "home", None, "1.5 m from the vehicle", "1.5 m"),
    (replace(BENCH, home=FoundHome(1.5, 1.5)), "home", Code.HOME_ELSEWHERE, "1.5 m from the vehicle", "1.5 m"),
    (replace(BENCH, home=FoundHome(None, 1.5)), "home", Code.HOME_UNKNOWN, "not reported", "1.5 m"),
    (replace(BENCH, home=FoundHome(0.4, 1.5, "rally points")), "home", Code.RETURNS_ELSEWHERE, "rally points", "1.5 m"),
    (replace(BENCH, battery_percent=40.0), "battery", None, "40 %", "40 %"),
    (replace(BENCH, battery_percent=39.9), "battery", Code.BATTERY_LOW, "40 %", "40 %"),
    (replace(BENCH, battery_percent=20.0), "battery", Code.BATTERY_LOW, "20 %", "40 %"),
    (replace(BENCH, battery_percent=0.0), "battery", Code.BATTERY_LOW, "0 %", "40 %"),
    (replace(BENCH, battery_percent=-1.0), "battery", Code.BATTERY_UNKNOWN, "not reported", "40 %"),
    (BENCH, "mode", None, "AUTO.LOITER, disarmed", "disarmed"),
    (replace(BENCH, armed=True), "mode", Code.VEHICLE_ARMED, "AUTO.LOITER, armed", "disarmed"),
    (replace(BENCH, mode_name=None), "mode", None, "unknown, disarmed", "disarmed"),
    (replace(BENCH, interleaves=True), "autopilot", Code.AUTOPILOT_ID_SHARED, TWO_STREAMS, "one stream"),
    (
        replace(NO_LANDED_STATES, missing={"landed states"}),
        "landed states",
        Code.MESSAGE_MISSING,
        "no EXTENDED_SYS_STATE",
        "EXTENDED_SYS_STATE",
    ),
    (replace(BENCH, awaits_poses=True), "position", None, "by poses, which only the agent gets", "prepare"),
]


@pytest.mark.parametrize(("facts", "subject", "code", "found", "wanted"), LINES)
def test_each_line_says_what_was_found_and_what_is_wanted(
    facts: Facts, subject: str, code: Code | None, found: str, wanted: str
) -> None:
    (line,) = [line for line in audit(facts) if line.subject == subject]
    assert (line.code, line.found) == (code, found)
    assert wanted in line.wanted
    assert (line.verdict is OK) is (code is None)
    assert (line.remedy == "") is (code is None)
    assert str(line) == f"{subject}: {found}; wanted: {line.wanted}" + (f"; {line.remedy}" if code else "")


def test_a_rate_that_is_missing_is_named_by_its_message_only_where_the_message_is_known_to_be_missing() -> None:
    """Not where it comes, though slowly; nor where the telemetry has no message of its own."""
    never = replace(NO_LANDED_STATES, missing={"landed states"})
    slow = replace(never, rates_hz={**BENCH.rates_hz, "landed states": 2.0})
    assert verdicts(slow)["landed states"] is OK
    for facts in (NO_LANDED_STATES, replace(never, messages={}), replace(never, missing={"modes"})):
        (line,) = [line for line in audit(facts) if line.subject == "landed states"]
        assert line.code is Code.TELEMETRY_SLOW
    (line,) = [line for line in audit(never) if line.code is Code.MESSAGE_MISSING]
    assert line.remedy == "upgrade"


def test_an_empty_battery_is_refused_and_a_low_one_is_not() -> None:
    found = {
        percent: verdicts(replace(BENCH, battery_percent=percent))["battery"] for percent in (19.9, 20.0, 39.9, 40.0)
    }
    assert found == {19.9: REFUSAL, 20.0: WARNING, 39.9: WARNING, 40.0: OK}


@pytest.mark.parametrize(("value", "verdict"), [(0.54, OK), (0.55, WARNING), (0.445, OK), (0.44, WARNING), (0.49, OK)])
def test_the_hover_thrust_may_differ_by_a_tenth_of_the_larger_one(value: float, verdict: Verdict) -> None:
    """0.49 is nine tenths of 0.544, and 0.441 nine tenths of 0.49."""
    found = finding(Facts(RULES[PX4], {"MPC_THR_HOVER": value}, 0.49))
    assert (found.verdict, found.found) == (verdict, f"{value:.3g}")
    assert found.wanted.endswith(", 0.49")
    assert bool(found.code) is bool(found.remedy) is (verdict is not OK)


def test_a_value_is_shown_with_its_unit_and_meaning_and_what_is_to_be_set() -> None:
    def judge(value: float) -> Judgement:
        return Judgement(OK if value == 1.0 else WARNING, "too much" if value > 1.0 else "")

    rule = ParameterRule("A_LIMIT", Code.PARAMETER_MISSING, "one", judge, unit="m", remedy="ask somebody")
    found = {value: finding(Facts((rule,), {"A_LIMIT": value}, HOVER)) for value in (1.0, 0.0, 2.0)}
    assert [found[value].found for value in found] == ["1 m", "0 m", "2 m (too much)"]
    assert {line.wanted for line in found.values()} == {"one"}
    assert [found[value].remedy for value in found] == ["", "ask somebody", "ask somebody"]
    assert [found[value].code for value in found] == [None, rule.code, rule.code]
    unitless = finding(Facts((replace(rule, unit="", safe=lambda _: 0.0),), {"A_LIMIT": 2.0}, HOVER))
    assert (unitless.found, unitless.remedy, unitless.fix) == ("2 (too much)", "set A_LIMIT to 0", 0.0)
    assert audit(Facts((rule,), {}, HOVER)) == ()


def test_a_short_round_trip_is_in_order() -> None:
    assert verdicts(replace(BENCH, round_trip_s=0.003))["round trip"] is OK


def test_a_message_that_never_comes_is_named_with_its_senders() -> None:
    (found,) = [f for f in audit(replace(NO_LANDED_STATES, missing={"landed states"})) if f.verdict is REFUSAL]
    assert found.code is Code.MESSAGE_MISSING
    assert "EXTENDED_SYS_STATE, which PX4 1.13 and later send" in found.wanted


def test_facts_that_are_not_checked_have_no_finding() -> None:
    assert audit(Facts(RULES[PX4], {}, HOVER)) == ()


def test_worst_verdict_counts() -> None:
    assert worst(audit(BENCH)) is OK
    assert worst(audit(replace(BENCH, battery_percent=-1.0))) is WARNING
    assert worst(audit(replace(BENCH, battery_percent=-1.0, rates_hz={}))) is REFUSAL


VISION_RULES = {kind: profile.vision_parameters for kind, profile in PROFILES.items()}
BY_POSES = {
    AutopilotKind.PX4: {"EKF2_EV_CTRL": 11.0, "EKF2_HGT_REF": 3.0, "EKF2_GPS_CTRL": 0.0},
    AutopilotKind.ARDUPILOT: {"VISO_TYPE": 1.0}
    | {f"EK3_SRC1_{part}": 6.0 for part in ("POSXY", "VELXY", "POSZ", "YAW")},
}


@pytest.mark.parametrize("kind", list(AutopilotKind))
def test_an_autopilot_that_gets_poses_must_use_them(kind: AutopilotKind) -> None:
    """Each wrong value is found, and the value that doctor sets instead is right."""
    for rule in VISION_RULES[kind]:
        right = BY_POSES[kind][rule.name]
        assert rule.judge is not None
        assert rule.safe is not None
        assert rule.judge(right).verdict is Verdict.OK
        wrong = rule.judge(right + 4.0)
        assert (wrong.verdict is Verdict.OK) is (rule.name == "EKF2_EV_CTRL")  # velocity may be used beside
        assert rule.judge(right - 1.0).verdict is not Verdict.OK
        assert rule.judge(rule.safe(right - 1.0)).verdict is Verdict.OK
    assert {rule.name for rule in VISION_RULES[kind]} == set(BY_POSES[kind])


def test_only_fleets_with_external_vision_are_asked_for_it() -> None:
    for kind, profile in PROFILES.items():
        assert VISION_PROFILES[kind].parameters == profile.parameters + profile.vision_parameters
        assert not {rule.name for rule in profile.parameters} & set(BY_POSES[kind])


def test_what_needs_poses_is_left_to_the_agent() -> None:
    """They do not reach doctor: without them ArduCopter sends no position, and no arming check passes."""
    rates_hz = {"positions": 0.0, "attitudes": 50.0, "modes": 2.0, "landed states": 5.0}
    findings = audit(Facts((), {}, HOVER, rates_hz=rates_hz, awaits_poses=True))
    assert {finding.verdict for finding in findings} == {Verdict.OK}
    assert [finding.subject for finding in findings] == ["attitudes", "modes", "landed states", "position"]
    assert worst(audit(Facts((), {}, HOVER, rates_hz=rates_hz))) is Verdict.REFUSAL
