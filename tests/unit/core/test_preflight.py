"""Preflight: checks over MAVLink to an autopilot with wrong parameters, and the survey of the telemetry."""

from __future__ import annotations

import pytest

from agent_on_bytes import ARDUPILOT, BOTH, IN_ORDER, PX4, TAKEOFF_M, FlightOnBytes
from common import code_of, codes_of
from companion.core.estimation.wind import DisturbanceObserver
from companion.core.preflight import ASK_PERIOD_S, REFRESH_PERIOD_S, WINDOW_S, Preflight, Survey
from companion.mavlink.autopilot_types import PROFILES
from companion.types.autopilot import (
    AutopilotKind,
    AutopilotMode,
    HeartbeatSample,
    LandedSample,
    LandedState,
    ModeSample,
    ParameterSample,
    PositionSample,
    SystemSample,
    TextSample,
)
from companion.types.commands import CommandName
from companion.types.flight import FlightPhase
from companion.types.notices import Code

C, P = CommandName, FlightPhase
MODE = ModeSample(0.1, AutopilotMode.HOLD, "AUTO.LOITER")


def form(flight: FlightOnBytes) -> tuple[bool, Code, str]:
    flight.tick(C.FORM)
    return flight.replies[-1]


@pytest.mark.parametrize(
    ("kind", "name", "value", "words"),
    [
        (PX4, "COM_OBL_RC_ACT", 0, "COM_OBL_RC_ACT: 0 (position mode: sinks and drifts without a pilot); wanted: 5"),
        (PX4, "COM_OBL_RC_ACT", 7, "COM_OBL_RC_ACT: 7 (disarm: it falls); wanted: 5 (hold) or 4 (land); set"),
        (PX4, "COM_OF_LOSS_T", 30.0, "COM_OF_LOSS_T: 30 s (keeps the last setpoint for this time)"),
        (ARDUPILOT, "GUID_OPTIONS", 0, "GUID_OPTIONS: 0 (thrust is taken as a climb rate); wanted: bit 3 (8) set"),
        (ARDUPILOT, "GUID_TIMEOUT", 5.0, "GUID_TIMEOUT: 5 s (keeps the last attitude and thrust for this time)"),
    ],
)  # fmt: skip
def test_formation_is_refused_until_the_parameter_is_set(
    kind: AutopilotKind, name: str, value: float, words: str
) -> None:
    flight = FlightOnBytes(kind)
    flight.autopilot.parameters[name] = value
    flight.fly_to(P.HOLD)
    accepted, _, reason = form(flight)
    assert not accepted
    assert words in reason
    assert flight.agent.phase is P.HOLD
    assert flight.autopilot.targets == []
    assert any(
        event.text.startswith(f"refusal: {name}") for event in flight.events
    )  # known long before the command form

    flight.autopilot.parameters[name] = IN_ORDER[kind][name]  # by its pilot, from a ground station
    flight.ticks(len(IN_ORDER[kind]) * (REFRESH_PERIOD_S + 0.02) + 0.1)
    assert form(flight)[0]


@BOTH
def test_low_battery_refuses_formation_and_permits_landing(kind: AutopilotKind) -> None:
    flight = FlightOnBytes(kind).fly_to(P.HOLD)
    flight.autopilot.battery_percent = 15
    flight.tick()
    accepted, _, reason = form(flight)
    assert not accepted
    assert reason.startswith("form: battery: 15 %; wanted: at least 40 %")
    assert flight.do(C.LAND) is P.LAND


def test_other_px4_version_is_a_warning() -> None:
    flight = FlightOnBytes(PX4)
    flight.autopilot.parameters = {"COM_OBL_RC_ACT": 5}
    flight.fly_to(P.HOLD)
    assert next(event for event in flight.events if "not found" in event.text).text.startswith(
        "warning: COM_OF_LOSS_T: not found"
    )
    assert form(flight)[0]


def test_no_parameter_is_requested_before_the_heartbeat() -> None:
    preflight = Preflight(DisturbanceObserver(0.5, 0.0, 4.0), PROFILES)
    fitness = preflight.step(0.0, (), None)
    assert preflight.ask(0.0, streams=False) == ()
    assert code_of(fitness.refusal) is Code.AUTOPILOT_UNKNOWN


def test_ardupilot_without_the_thrust_parameter_is_refused() -> None:
    flight = FlightOnBytes(ARDUPILOT)
    del flight.autopilot.parameters["GUID_OPTIONS"]
    flight.fly_to(P.HOLD)
    accepted, _, reason = form(flight)
    assert not accepted
    assert reason.startswith("form: GUID_OPTIONS: not found")


@BOTH
def test_warnings_are_reported_once(kind: AutopilotKind) -> None:
    quiet = FlightOnBytes(kind)
    quiet.ticks(5.0)
    assert quiet.events == []
    warned = FlightOnBytes(kind)
    name, value = ("COM_OBL_RC_ACT", 3) if kind is PX4 else ("GUID_TIMEOUT", 3.0)
    warned.autopilot.parameters[name] = value
    warned.ticks(20.0)
    (event,) = warned.events
    assert event.code is (Code.SETPOINT_LOSS_ACTION_UNSAFE if kind is PX4 else Code.SETPOINT_TIMEOUT_UNSAFE)
    assert event.text.startswith(f"warning: {name}: {value:g}")


@BOTH
def test_parameters_are_read_in_turn_and_never_set(kind: AutopilotKind) -> None:
    flight = FlightOnBytes(kind)
    flight.ticks(len(IN_ORDER[kind]) * ASK_PERIOD_S + 0.3)
    assert sorted(set(flight.autopilot.read)) == sorted(IN_ORDER[kind])
    read = len(flight.autopilot.read)
    flight.ticks(10.0)
    assert len(flight.autopilot.read) - read == pytest.approx(10.0 / REFRESH_PERIOD_S, abs=1)
    flight.fly_to(P.FORMATION)
    read = len(flight.autopilot.read)
    flight.ticks(2.0)
    assert len(flight.autopilot.read) == read
    assert "PARAM_SET" not in {message.get_type() for message in flight.autopilot.commands}


def lacks(flight: FlightOnBytes) -> list[Code]:
    flight.ticks(0.2)  # until the next status
    assert flight.status is not None
    return codes_of(flight.status.safety.lacks)


@BOTH
def test_status_lists_findings_on_the_ground_until_they_are_solved(kind: AutopilotKind) -> None:
    flight = FlightOnBytes(kind)
    flight.autopilot.may_arm = False
    assert lacks(flight)[0] is Code.PARAMETERS_UNREAD
    flight.ticks(1.0)
    assert lacks(flight) == [Code.ARMING_CHECKS_FAILED]
    flight.autopilot.may_arm, flight.autopilot.battery_percent = True, 15
    assert lacks(flight) == [Code.BATTERY_LOW]
    flight.autopilot.battery_percent = 90
    assert lacks(flight) == []


@BOTH
def test_status_lists_no_findings_when_armed(kind: AutopilotKind) -> None:
    flight = FlightOnBytes(kind).fly_to(P.ARMED)
    flight.autopilot.may_arm = False
    assert lacks(flight) == []


@pytest.mark.parametrize(("kind", "name"), [(PX4, "MPC_THR_HOVER"), (ARDUPILOT, "MOT_THST_HOVER")])
def test_observer_starts_from_the_hover_thrust_parameter(kind: AutopilotKind, name: str) -> None:
    observer = DisturbanceObserver(0.5, 0.0, 4.0)
    preflight = Preflight(observer, PROFILES)
    preflight.step(0.0, (ParameterSample(0.0, name, 0.35),), kind)
    assert observer.hover_thrust_norm == 0.35


@BOTH
def test_a_warning_of_the_audit_stays_in_the_status_on_the_ground(kind: AutopilotKind) -> None:
    flight = FlightOnBytes(kind)
    flight.autopilot.parameters["GF_ACTION" if kind is PX4 else "FENCE_ENABLE"] = 0
    flight.fly_to(P.READY)
    flight.ticks(1.0)
    assert flight.status
    code = Code.FENCE_ACTION_UNSAFE if kind is PX4 else Code.AUTOPILOT_FENCE_OFF
    assert [notice.code for notice in flight.status.safety.warnings] == [code]
    assert flight.status.safety.lacks == ()
    flight.fly_to(P.HOLD)
    assert flight.status.safety.warnings == ()


# ---------------------------------------------------------------- survey of the telemetry


POSITION = PositionSample(0.0, 0.0, (0.0, 0.0, 0.0), (0.0, 0.0, 0.0))


def test_rates_are_of_the_last_complete_window() -> None:
    survey = Survey()
    survey.update(10.0, [POSITION] * 500)  # what had piled up before
    survey.update(11.0, [POSITION] * 60)
    assert survey.rates_hz is None
    survey.update(10.0 + WINDOW_S, [POSITION] * 40 + [LandedSample(12.0, LandedState.ON_GROUND)] * 4)
    assert survey.rates_hz == {"positions": 50.0, "attitudes": 0.0, "modes": 0.0, "landed states": 2.0}
    survey.update(13.0, [POSITION] * 50)
    assert survey.rates_hz["positions"] == 50.0
    survey.update(14.5, ())  # a wake that came late counts by its own length
    assert survey.rates_hz["positions"] == pytest.approx(20.0)


def test_it_is_told_whether_what_is_found_has_changed() -> None:
    survey = Survey()
    assert not survey.update(10.0, [POSITION])
    assert survey.update(10.1, [SystemSample(10.1, 80.0, may_arm=True)])
    assert not survey.update(10.2, [SystemSample(10.2, 80.0, may_arm=True), POSITION])
    assert survey.update(10.3, [SystemSample(10.3, 79.0, may_arm=True)])
    assert not survey.update(10.4, [TextSample(10.4, 6, "all is well")])
    assert survey.update(10.5, [TextSample(10.5, 4, "Preflight Fail: no GPS")])
    assert survey.update(10.0 + WINDOW_S, [])  # the first rates
    assert not survey.update(10.1 + WINDOW_S, [POSITION])


def test_failed_arming_checks_are_named() -> None:
    survey = Survey()
    assert survey.failing_checks is None
    survey.update(0.0, [])
    survey.update(0.1, [SystemSample(0.1, 80.0, may_arm=False)])
    assert (survey.battery_percent, survey.failing_checks) == (80.0, "the autopilot's preflight checks do not pass")
    survey.update(0.2, [TextSample(0.2, 6, "all is well"), TextSample(0.2, 4, "Preflight Fail: no GPS")])
    assert survey.failing_checks == "Preflight Fail: no GPS"
    survey.update(0.3, [SystemSample(0.3, 79.0, may_arm=True)])
    assert survey.failing_checks == ""


@BOTH
def test_indoors_px4_is_not_armed_without_an_origin_and_arducopter_takes_off(kind: AutopilotKind) -> None:
    """Motion capture gives a local position alone."""
    flight = FlightOnBytes(kind)
    flight.autopilot.withheld = ("GPS_GLOBAL_ORIGIN",)
    flight.ticks(1.0)
    if kind is ARDUPILOT:
        assert flight.fly_to(P.HOLD).autopilot.up_m == TAKEOFF_M
        return
    flight.do(C.PREPARE)
    flight.tick(C.ARM)
    accepted, code, reason = flight.replies[-1]
    assert (accepted, code) == (False, Code.ALTITUDE_UNKNOWN)
    assert "SET_GPS_GLOBAL_ORIGIN" in reason
    assert flight.status is not None
    assert Code.ALTITUDE_UNKNOWN in [notice.code for notice in flight.status.safety.lacks]
    flight.autopilot.withheld = ()
    flight.ticks(1.1)
    assert flight.fly_to(P.HOLD).autopilot.up_m == TAKEOFF_M


def test_a_fence_below_the_take_off_height_refuses_formation() -> None:
    flight = FlightOnBytes(PX4)
    flight.autopilot.parameters["GF_MAX_VER_DIST"] = 1.5
    flight.fly_to(P.HOLD)  # as this one's autopilot does not mind
    accepted, code, reason = form(flight)
    assert (accepted, code) == (False, Code.AUDIT_REFUSAL)
    assert "GF_MAX_VER_DIST: 1.5 m (not above the take-off height, 2 m)" in reason


@pytest.mark.parametrize(
    ("kind", "message", "found"),
    [
        (PX4, "CURRENT_MODE", "modes: no CURRENT_MODE; wanted: CURRENT_MODE, which PX4 v1.15 and newer send; update"),
        (
            PX4,
            "EXTENDED_SYS_STATE",
            "landed states: no EXTENDED_SYS_STATE; wanted: EXTENDED_SYS_STATE, which PX4 v1.15",
        ),
        (ARDUPILOT, "ATTITUDE_QUATERNION", "which ArduCopter 4.5 and newer send; update the firmware"),
        (ARDUPILOT, "LOCAL_POSITION_NED", "wait: it comes once the estimator has a position"),
    ],
)
def test_a_message_that_never_comes_is_named_with_the_version_that_sends_it(
    kind: AutopilotKind, message: str, found: str
) -> None:
    flight = FlightOnBytes(kind)
    flight.autopilot.withheld = (message,)
    flight.ticks(2.0 * WINDOW_S + 0.1)
    assert flight.status is not None
    (missing,) = [notice for notice in flight.status.safety.lacks if notice.code is Code.MESSAGE_MISSING]
    assert found in missing.text
    assert "line" not in missing.text
    assert Code.TELEMETRY_SLOW not in [notice.code for notice in flight.status.safety.lacks]


def test_a_message_that_comes_too_seldom_is_slow() -> None:
    survey = Survey()
    survey.update(0.0, [])
    survey.update(WINDOW_S, [HeartbeatSample(0.1, False, PX4), MODE, MODE, POSITION])
    assert survey.missing == {"attitudes", "landed states"}
    survey.update(2.0 * WINDOW_S, [HeartbeatSample(0.1, False, PX4), MODE, POSITION])
    assert survey.missing == {"attitudes", "landed states", "modes"}
