"""The agent at the audit's door: real MAVLink bytes to an autopilot whose parameters are not in order."""

from __future__ import annotations

import pytest
from test_manners import ARDUPILOT, BOTH, IN_ORDER, PX4, Flight

from companion.core.disturbance import DisturbanceObserver
from companion.core.preflight import ASK_PERIOD_S, REFRESH_PERIOD_S, Preflight
from companion.types import AutopilotKind, CommandName, FlightPhase, ParameterSample

C, P = CommandName, FlightPhase


def form(flight: Flight) -> tuple[bool, str]:
    flight.tick(C.FORM)
    return flight.replies[-1]


@pytest.mark.parametrize(
    ("kind", "name", "value", "words"),
    [
        (PX4, "COM_OBL_RC_ACT", 7, "COM_OBL_RC_ACT: 7 (disarm: it falls); wanted: 5 (hold) or 4 (land); set"),
        (PX4, "COM_OF_LOSS_T", 30.0, "COM_OF_LOSS_T: 30 s (so long it flies its last setpoint on)"),
        (ARDUPILOT, "GUID_OPTIONS", 0, "GUID_OPTIONS: 0 (thrust would be taken as a climb rate); wanted: bit 3 (8) set"),
        (ARDUPILOT, "GUID_TIMEOUT", 5.0, "GUID_TIMEOUT: 5 s (so long it flies its last attitude and thrust on)"),
    ],
)  # fmt: skip
def test_formation_is_refused_in_the_audits_words_until_it_is_set(
    kind: AutopilotKind, name: str, value: float, words: str
) -> None:
    flight = Flight(kind)
    flight.autopilot.parameters[name] = value
    flight.fly_to(P.HOLD)
    accepted, reason = form(flight)
    assert not accepted
    assert words in reason
    assert flight.agent.phase is P.HOLD
    assert flight.autopilot.targets == []
    assert any(event.startswith(f"refusal: {name}") for event in flight.events)  # known long before it is asked to form

    flight.autopilot.parameters[name] = IN_ORDER[kind][name]  # by its pilot, from a ground station
    flight.ticks(len(IN_ORDER[kind]) * REFRESH_PERIOD_S + 0.1)
    assert form(flight)[0]


@BOTH
def test_an_empty_battery_refuses_formation_and_not_the_landing(kind: AutopilotKind) -> None:
    flight = Flight(kind).fly_to(P.HOLD)
    flight.autopilot.battery_percent = 15
    flight.tick()
    accepted, reason = form(flight)
    assert not accepted
    assert reason.startswith("form: battery: 15 %; wanted: at least 40 %")
    assert flight.do(C.LAND) is P.LAND


def test_px4_of_another_version_is_warned_of_and_flies() -> None:
    flight = Flight(PX4)
    flight.autopilot.parameters = {}
    flight.fly_to(P.HOLD)
    assert next(event for event in flight.events if "not found" in event).startswith(
        "warning: COM_OF_LOSS_T: not found"
    )
    assert form(flight)[0]


def test_nothing_is_asked_of_an_autopilot_that_has_not_said_what_it_is() -> None:
    preflight = Preflight(DisturbanceObserver(0.5, 0.0, 4.0))
    preflight.hear(0.0, (), None)
    assert preflight.ask(0.0) == ()
    assert preflight.refusal() == "the autopilot has not said yet what it is"


def test_ardupilot_that_does_not_tell_what_thrust_means_is_refused() -> None:
    flight = Flight(ARDUPILOT)
    del flight.autopilot.parameters["GUID_OPTIONS"]
    flight.fly_to(P.HOLD)
    accepted, reason = form(flight)
    assert not accepted
    assert reason.startswith("form: GUID_OPTIONS: not found")


@BOTH
def test_what_is_in_order_is_not_spoken_of_and_warnings_once(kind: AutopilotKind) -> None:
    quiet = Flight(kind)
    quiet.ticks(5.0)
    assert quiet.events == []
    warned = Flight(kind)
    name, value = ("COM_OBL_RC_ACT", 0) if kind is PX4 else ("GUID_TIMEOUT", 3.0)
    warned.autopilot.parameters[name] = value
    warned.ticks(20.0)
    (event,) = warned.events
    assert event.startswith(f"warning: {name}: {value:g}")


@BOTH
def test_it_reads_by_turns_not_in_formation_and_never_sets(kind: AutopilotKind) -> None:
    flight = Flight(kind)
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


def lacks(flight: Flight) -> tuple[str, ...]:
    flight.ticks(0.2)  # until the next status
    assert flight.status is not None
    return flight.status.lacks


@BOTH
def test_what_a_vehicle_on_the_ground_lacks_is_in_its_status_until_it_lacks_nothing(kind: AutopilotKind) -> None:
    flight = Flight(kind)
    flight.autopilot.may_arm = False
    assert lacks(flight)[0].startswith("not read yet: ")
    flight.ticks(1.0)
    assert lacks(flight) == ("cannot be armed: its checks before arming do not pass",)
    flight.autopilot.may_arm, flight.autopilot.battery_percent = True, 15
    assert lacks(flight) == ("battery: 15 %; wanted: at least 40 %; charge or change it",)
    flight.autopilot.battery_percent = 90
    assert lacks(flight) == ()


@BOTH
def test_of_an_armed_vehicle_nothing_is_said_to_be_lacking(kind: AutopilotKind) -> None:
    flight = Flight(kind).fly_to(P.ARMED)
    flight.autopilot.may_arm = False
    assert lacks(flight) == ()


@pytest.mark.parametrize(("kind", "name"), [(PX4, "MPC_THR_HOVER"), (ARDUPILOT, "MOT_THST_HOVER")])
def test_the_observer_begins_with_the_hover_thrust_that_the_autopilot_has(kind: AutopilotKind, name: str) -> None:
    observer = DisturbanceObserver(0.5, 0.0, 4.0)
    preflight = Preflight(observer)
    preflight.hear(0.0, (ParameterSample(0.0, name, 0.35),), kind)
    assert observer.hover_thrust_norm == 0.35
