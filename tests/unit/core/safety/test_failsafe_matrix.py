"""Every health flag in every flight phase with both autopilots. What is expected stands here, not in the table."""

from __future__ import annotations

from math import inf, radians

import pytest
from msgspec.structs import replace

from common import slot_peer, with_fields
from companion.core.consensus.peers import PeerState
from companion.core.consensus.stage import Consensus, LeadView, Neighbours, PeerSets
from companion.core.safety.failsafe import (
    DUPLICATE_FOR_S,
    FAILSAFES,
    OTHER_FAILSAFES,
    FailsafeSettings,
    FailsafeWatch,
    HealthLimits,
    flags_notice,
    leaves_after_s,
    limit_of,
    named_notice,
    schedule,
)
from companion.core.safety.fleet_checks import FleetChecks
from companion.core.safety.limits import OutputLimits
from companion.core.safety.return_check import ReturnCheck
from companion.core.safety.safeguard import (
    LATE_TICK_S,
    SILENT_TOO_LONG_S,
    SafeguardStage,
    Safety,
)
from companion.geometry.airspace import Fence
from companion.mavlink.autopilot_types import PROFILES
from companion.types.autopilot import (
    AutopilotKind,
    AutopilotMode,
    LandedState,
    PositionError,
    VehicleState,
)
from companion.types.flight import (
    FLAG_TEXTS,
    STREAMING,
    FailsafeAction,
    Flight,
    FlightPhase,
    HealthFlag,
    PhaseChange,
    Role,
)
from companion.types.notices import Code, Notice
from companion.types.status import NearestVehicle, SeparationReport
from companion.types.tick import Inbox
from companion.types.values import Place

F, P, A = HealthFlag, FlightPhase, FailsafeAction
KINDS = list(AutopilotKind)
TICK_S = 0.1
RETURNS = ReturnCheck(3, separation_m=1.0, braking_m_s2=2.0, responds_s=0.45, goes_on_s=0.55)
CHECKS = FleetChecks(3, slots_have_height=True, ground_spread_m=1.0, separation_m=1.0, returns=RETURNS)
SETTINGS = FailsafeSettings(low_battery_action=A.LAND, land_after_s=10.0, leader_holds_after_s=5.0)
LIMITS = HealthLimits(
    OutputLimits(radians(25.0), 2.0, 0.3, 1.6, 10.0, Fence((-50.0, -50.0, -5.0), (50.0, 50.0, 50.0))),
    low_battery_percent=25.0,
    critical_battery_percent=10.0,
)

# Seconds after the flag is raised in formation -> what is requested.
IN_FORMATION: dict[HealthFlag, dict[str, float]] = {
    F.POSITION_STALE: {"stop": 0.0},
    F.ATTITUDE_STALE: {"stop": 0.0},
    F.MODE_STALE: {"stop": 0.0},
    F.FRAME_UNKNOWN: {"stop": 0.0},
    F.GROUND_UNKNOWN: {"stop": 0.0},
    F.ARMED_STALE: {"hold": 0.0},
    F.LANDED_STALE: {"hold": 0.0},
    F.LEADER_AWAITED: {"warn": 0.0},
    F.LEADER_LOST: {"hold": 0.0},
    F.FLEET_LINK_LOST: {"warn": 0.0, "hold": 5.0},
    F.DUPLICATE_ID: {"warn": 0.0},
    F.SEPARATION_VIOLATED: {"warn": 0.0},
    F.NOT_SHAKEN_OFF: {"warn": 0.0},
    F.PEER_IN_DOUBT: {"warn": 0.0},
    F.OUTSIDE_FENCE: {"hold": 0.0},
    F.FRAME_CONTRADICTED: {"hold": 0.0},
    F.POSITION_JUMPED: {"hold": 0.0},
    F.ESTIMATOR_BAD: {"warn": 0.0, "hold": 1.0},
    F.POSITION_UNAIDED: {"warn": 0.0, "hold": 1.0},
    F.POSE_LOST: {"warn": 0.0, "hold": 0.3},
    F.POSE_REFUSED: {"warn": 0.0},
    F.FAILSAFE_ACTIVE: {"warn": 0.0, "hold": 3.0},
    F.TILT_EXCEEDED: {"warn": 0.0, "hold": 0.3},
    F.TICK_LATE: {"warn": 0.0, "hold": 5.0},
    F.LAW_SLOW: {"warn": 0.0, "hold": 1.0},
    F.BATTERY_LOW: {"warn": 0.0, "hold": 3.0},
    F.BATTERY_CRITICAL: {"warn": 0.0, "hold": 3.0},
}
# After the hold that the flag led to, still raised: seconds since it was raised in formation -> what is requested.
AFTERWARDS: dict[HealthFlag, dict[str, float]] = {
    F.LEADER_LOST: {"land": 10.0},
    F.FLEET_LINK_LOST: {"land": 15.0},
    F.POSITION_UNAIDED: {"land": 1.0},
    F.POSE_LOST: {"land": 1.8},
    F.FAILSAFE_ACTIVE: {"land": 3.0},
    F.BATTERY_LOW: {"land": 3.0},
    F.BATTERY_CRITICAL: {"land": 3.0},
}
IN_A_COMMANDED_HOLD: dict[HealthFlag, dict[str, float]] = {
    F.BATTERY_CRITICAL: {"land": 3.0},
    F.POSITION_UNAIDED: {"land": 1.0},
    F.POSE_LOST: {"land": 1.8},
}
STOPS = (F.POSITION_STALE, F.ATTITUDE_STALE, F.MODE_STALE, F.FRAME_UNKNOWN, F.GROUND_UNKNOWN)
LATCHED = (F.BATTERY_LOW, F.BATTERY_CRITICAL, F.FAILSAFE_ACTIVE)  # a recovered voltage says nothing
STAYS_S = {F.TICK_LATE: 1.0, F.LAW_SLOW: 0.2}  # they clear so long after the last tick that was late or slow
NOT_FLOWN_BY_THE_AGENT = sorted(set(P) - STREAMING - {P.HOLD, P.RELEASE})
LEAVING = (P.RELEASE, P.LAND, P.RETURN)  # out of formation they begin with the stream


class Vehicle:
    """The safeguard of one vehicle with everything in order, except for the flags that are raised."""

    def __init__(self, kind: AutopilotKind, settings: FailsafeSettings = SETTINGS) -> None:
        self.kind = kind
        self.stage = SafeguardStage(CHECKS, LIMITS, settings, PROFILES)
        self.now_s = 100.0
        self.raised: set[HealthFlag] = set()
        self.phase = P.FORMATION
        self.commanded = False
        self.silent_since_s: float | None = None
        self.stopping = False
        self.home_enu_m: Place | None = (0.0, 0.0)
        self.leaves_formation = False
        self._last_s = dict.fromkeys(STAYS_S, -inf)

    def tick(self) -> Safety:
        self.now_s += TICK_S
        streams = self.phase in STREAMING or (self.leaves_formation and self.phase in LEAVING)
        flight = Flight(phase=self.phase, streams=streams, in_formation=self.phase is P.FORMATION)
        state = self._state()
        safety = self.stage.step(
            self.now_s,
            state,
            flight,
            self._consensus(),
            self._separation(),
            self.now_s if self.silent_since_s is None else self.silent_since_s,
            self.commanded,
            Inbox(
                stopping=self.stopping,
                late_s=0.2 if F.TICK_LATE in self.raised else 0.0,
                law_s=0.003 if F.LAW_SLOW in self.raised else 0.002,
            ),
        )
        assert safety.flags == self._expected_flags()
        self.commanded = False
        return safety

    def requested(self, for_s: float = 30.0) -> dict[str, float]:
        """What is requested while the present flags and phase last: the first time of each, seconds from now."""
        begin_s, first = self.now_s + TICK_S, {}
        for _ in range(round(for_s / TICK_S)):
            for label in labels(self.tick()):
                first.setdefault(label, pytest.approx(self.now_s - begin_s, abs=1.5 * TICK_S))
        return first

    def _expected_flags(self) -> set[HealthFlag]:
        expected = set(self.raised)
        for flag, stays_s in STAYS_S.items():
            if flag in self.raised:
                self._last_s[flag] = self.now_s
            if self.now_s - self._last_s[flag] < stays_s:
                expected.add(flag)
        if self.phase not in (P.ENGAGE, P.FORMATION, P.RELEASE, P.HOLD):
            expected.discard(F.FLEET_LINK_LOST)  # on its own nothing depends on the others
        return expected

    def _state(self) -> VehicleState:
        now_s, raised = self.now_s, self.raised
        age = {flag: 10.0 if flag in raised else 0.0 for flag in F}
        percent = 5.0 if F.BATTERY_CRITICAL in raised else 20.0 if F.BATTERY_LOW in raised else 90.0
        if F.BATTERY_CRITICAL in raised:
            raised.add(F.BATTERY_LOW)  # never one without the other
        return VehicleState(
            position_enu_m=(80.0 if F.OUTSIDE_FENCE in raised else 0.0, 0.0, 5.0),
            position_time_s=now_s - age[F.POSITION_STALE],
            roll_rad=radians(36.0 if F.TILT_EXCEEDED in raised else 20.0),
            attitude_time_s=now_s - age[F.ATTITUDE_STALE],
            mode=AutopilotMode.OFFBOARD,
            mode_time_s=now_s - age[F.MODE_STALE],
            autopilot=self.kind,
            armed=True,
            heartbeat_time_s=now_s - age[F.ARMED_STALE],
            landed=LandedState.IN_AIR,
            landed_time_s=now_s - age[F.LANDED_STALE],
            home_enu_m=self.home_enu_m,
            frame_known=F.FRAME_UNKNOWN not in raised,
            ground_unknown=F.GROUND_UNKNOWN in raised,
            frame_contradicted=F.FRAME_CONTRADICTED in raised,
            held_back_m=6.0 if F.POSITION_JUMPED in raised else 0.0,
            jump_time_s=0.0 if F.POSITION_JUMPED in raised else -inf,
            position_error=PositionError(6.0 if F.ESTIMATOR_BAD in raised else 0.3, 0.3),
            position_unaided=F.POSITION_UNAIDED in raised,
            pose_time_s=now_s - 10.0 if F.POSE_LOST in raised else inf,
            pose_refused_s=now_s if F.POSE_REFUSED in raised else -inf,
            failsafe_s=now_s if F.FAILSAFE_ACTIVE in raised else -inf,
            battery_percent=percent,
        )

    def _consensus(self) -> Consensus:
        other = {4: PeerState(with_fields(slot_peer(4), position_enu_m=(30.0, 30.0, 5.0)), self.now_s, 0.0, self.now_s)}
        leaderless = next((flag for flag in (F.LEADER_AWAITED, F.LEADER_LOST) if flag in self.raised), None)
        in_time = {} if F.FLEET_LINK_LOST in self.raised else other
        return Consensus(
            prc=1,
            lead=LeadView(Role.LEADER, (0, 0), None, 0.0, leaderless, reference_s=0.0, heading=None),
            neighbours=Neighbours(),
            peers=PeerSets(
                known=other,
                present=in_time,
                fresh=in_time,
                duplicate_id_s=self.now_s if F.DUPLICATE_ID in self.raised else -inf,
                in_doubt=(4,) if F.PEER_IN_DOUBT in self.raised else (),
            ),
        )

    def _separation(self) -> SeparationReport:
        violated, unshaken = F.SEPARATION_VIOLATED in self.raised, ("4",) if F.NOT_SHAKEN_OFF in self.raised else ()
        return SeparationReport(NearestVehicle("4", 1.1, 1.3), violated=violated, unshaken=unshaken)


def labels(safety: Safety) -> list[str]:
    names = {
        PhaseChange.HAND_OVER: "hold",
        PhaseChange.HAND_OVER_LEVEL: "hold",
        PhaseChange.HAND_OVER_NOW: "hold without levelling",
        PhaseChange.GIVE_UP: "leave",
        PhaseChange.ABANDON: "abandon",
        PhaseChange.LAND: "land",
        PhaseChange.RETURN: "return",
        PhaseChange.END_STREAM: "end the stream",
    }
    found = [names[request.kind] for request in safety.requests]
    if safety.action is A.STOP_STREAM:
        found.append("stop")
    return found + ["warn" for event in safety.events if event.code in set(F)]


def raised_in_formation(kind: AutopilotKind, flag: HealthFlag) -> Vehicle:
    vehicle = Vehicle(kind)
    for _ in range(5):
        assert labels(vehicle.tick()) == []
    vehicle.raised = {flag}
    return vehicle


def test_every_flag_is_expected_here_and_stands_once_in_the_table() -> None:
    assert set(IN_FORMATION) == set(F)
    assert sorted(row.condition for row in FAILSAFES) == sorted(Code(flag) for flag in F)
    assert not {row.condition for row in OTHER_FAILSAFES} & {Code(flag) for flag in F}


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("phase", sorted(STREAMING))
@pytest.mark.parametrize("flag", list(F))
def test_the_action_while_setpoints_are_sent(flag: HealthFlag, phase: FlightPhase, kind: AutopilotKind) -> None:
    vehicle = raised_in_formation(kind, flag)
    vehicle.phase = phase
    assert vehicle.requested() == IN_FORMATION[flag]


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("flag", list(F))
def test_what_follows_in_the_hold_that_a_flag_led_to(flag: HealthFlag, kind: AutopilotKind) -> None:
    vehicle = raised_in_formation(kind, flag)
    raised_s = vehicle.now_s + TICK_S
    if "hold" in IN_FORMATION[flag]:
        while "hold" not in labels(vehicle.tick()):
            pass
    vehicle.phase = P.RELEASE
    assert set(vehicle.requested(0.3)) <= {"stop"}
    vehicle.phase = P.HOLD
    begin_s = vehicle.now_s - raised_s
    after = {label: begin_s + at_s.expected for label, at_s in vehicle.requested().items() if label != "stop"}
    expected = AFTERWARDS.get(flag, {})
    assert after == {label: pytest.approx(at_s, abs=0.7) for label, at_s in expected.items()}


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("flag", list(F))
def test_what_follows_in_a_commanded_hold(flag: HealthFlag, kind: AutopilotKind) -> None:
    vehicle = Vehicle(kind)
    vehicle.tick()
    vehicle.phase, vehicle.commanded = P.HOLD, True
    vehicle.tick()
    vehicle.raised = {flag}
    stops = {"stop": 0.0} if flag in STOPS else {}
    assert vehicle.requested() == stops | IN_A_COMMANDED_HOLD.get(flag, {})


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("phase", NOT_FLOWN_BY_THE_AGENT)
@pytest.mark.parametrize("flag", list(F))
def test_nothing_is_requested_of_a_vehicle_that_others_fly(
    flag: HealthFlag, phase: FlightPhase, kind: AutopilotKind
) -> None:
    """The autopilot, a pilot, or the ground. Without a stream, `stop` has nothing to stop."""
    vehicle = Vehicle(kind)
    vehicle.phase, vehicle.raised = phase, {flag}
    assert set(vehicle.requested()) <= {"stop"}


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("raised_before", [False, True])
@pytest.mark.parametrize("phase", LEAVING)
@pytest.mark.parametrize("flag", list(F))
def test_a_stream_that_leaves_formation_is_only_stopped(
    flag: HealthFlag, phase: FlightPhase, raised_before: bool, kind: AutopilotKind
) -> None:
    """Also by a flag that was raised in formation. A hold the phase machine carries out in formation only:
    tests/unit/core/safety/test_flags_and_commands.py.
    """
    vehicle = Vehicle(kind)
    vehicle.leaves_formation = True
    if raised_before:
        vehicle.raised = {flag}
        vehicle.tick()
    vehicle.phase, vehicle.raised = phase, {flag}
    requested = vehicle.requested()
    requested.pop("hold", None)
    assert requested == ({"stop": 0.0} if flag in STOPS else {})


@pytest.mark.parametrize(
    ("kind", "expected"), [(AutopilotKind.PX4, "leave"), (AutopilotKind.ARDUPILOT, "hold without levelling")]
)
@pytest.mark.parametrize("flag", [None, *STOPS])
def test_silence_leaves_px4_to_its_failsafe_and_brakes_arducopter(
    flag: HealthFlag | None, kind: AutopilotKind, expected: str
) -> None:
    vehicle = raised_in_formation(kind, flag) if flag else Vehicle(kind)
    if flag is F.MODE_STALE:
        expected = "leave"  # a pilot may have taken over unseen
    vehicle.silent_since_s = vehicle.now_s
    found = {label for label in vehicle.requested() if label != "stop"}
    assert found == {expected, "end the stream"}
    assert not {"leave", "hold without levelling"} & set(Vehicle(kind).requested(0.4))


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("phase", sorted(P))
@pytest.mark.parametrize("leaves_formation", [False, True])
def test_silence_in_every_phase(leaves_formation: bool, phase: FlightPhase, kind: AutopilotKind) -> None:
    """Only a stream can be silent. One that leaves formation ends; the request of the autopilot's mode goes on."""
    vehicle = Vehicle(kind)
    vehicle.phase, vehicle.leaves_formation, vehicle.silent_since_s = phase, leaves_formation, vehicle.now_s
    in_formation = {AutopilotKind.PX4: "leave", AutopilotKind.ARDUPILOT: "hold without levelling"}[kind]
    expected = set()
    if phase in STREAMING:
        expected = {in_formation, "end the stream"}
    elif leaves_formation and phase in LEAVING:
        expected = {"end the stream"}
    assert set(vehicle.requested()) == expected


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("phase", sorted(P))
@pytest.mark.parametrize("leaves_formation", [False, True])
def test_a_stopping_agent_holds_and_gives_up_a_stream_after_6_s(
    leaves_formation: bool, phase: FlightPhase, kind: AutopilotKind
) -> None:
    """The phase machine carries a hold out in formation only: tests/unit/core/safety/test_flags_and_commands.py."""
    vehicle = Vehicle(kind)
    vehicle.phase, vehicle.leaves_formation, vehicle.stopping = phase, leaves_formation, True
    streams = phase in STREAMING or phase is P.RELEASE or (leaves_formation and phase in LEAVING)
    assert vehicle.requested() == {"hold": 0.0} | ({"abandon": 6.1} if streams else {})


@pytest.mark.parametrize("kind", KINDS)
def test_the_highest_action_of_several_flags_is_taken(kind: AutopilotKind) -> None:
    vehicle = raised_in_formation(kind, F.TICK_LATE)
    vehicle.raised |= {F.LEADER_LOST, F.POSITION_STALE}
    assert labels(vehicle.tick()) == ["stop", "warn"]
    vehicle.raised -= {F.POSITION_STALE}
    assert labels(vehicle.tick()) == ["hold"]


def cleared(vehicle: Vehicle) -> None:
    vehicle.raised = set()
    for _ in range(round(max(STAYS_S.values()) / TICK_S) + 1):
        vehicle.tick()


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("phase", sorted(STREAMING))
@pytest.mark.parametrize("flag", list(F))
def test_a_flag_that_is_cleared_before_its_last_step_begins_again_at_the_first(
    flag: HealthFlag, phase: FlightPhase, kind: AutopilotKind
) -> None:
    vehicle = raised_in_formation(kind, flag)
    vehicle.phase = phase
    last_s = max(IN_FORMATION[flag].values())
    lasts_s = max(TICK_S, last_s - 2 * TICK_S)
    if flag in STAYS_S:
        lasts_s -= STAYS_S[flag]  # it is raised for so long after the last late tick
    assert set(vehicle.requested(lasts_s)) == {label for label, at_s in IN_FORMATION[flag].items() if at_s <= lasts_s}
    cleared(vehicle)
    assert vehicle.requested() == {}
    vehicle.raised = {flag}
    assert vehicle.requested() == IN_FORMATION[flag]  # the last warning is more than 5 s ago


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("flag", list(F))
def test_a_flag_that_is_cleared_after_its_last_step_requests_nothing_more(
    flag: HealthFlag, kind: AutopilotKind
) -> None:
    """Except for a low battery, which has ended the formation. A hold that has begun is completed by the phase machine."""
    vehicle = raised_in_formation(kind, flag)
    assert vehicle.requested(10.0) == IN_FORMATION[flag]
    cleared(vehicle)
    assert set(vehicle.requested()) == ({"hold"} if flag in LATCHED else set())


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("flag", [flag for flag in F if "hold" in IN_FORMATION[flag]])
def test_a_flag_that_is_cleared_in_its_hold(flag: HealthFlag, kind: AutopilotKind) -> None:
    """Only a low battery lands nevertheless; any other flag begins again."""
    vehicle = held_by(flag, kind=kind)
    cleared(vehicle)
    if flag in LATCHED:
        assert vehicle.requested() == {"land": 0.0}
        return
    assert vehicle.requested() == {}
    vehicle.raised = {flag}
    assert vehicle.requested() == AFTERWARDS.get(flag, {})


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("flag", list(F))
def test_a_flag_that_is_cleared_in_a_commanded_hold_begins_again(flag: HealthFlag, kind: AutopilotKind) -> None:
    vehicle = Vehicle(kind)
    vehicle.tick()
    vehicle.phase, vehicle.commanded = P.HOLD, True
    vehicle.tick()
    vehicle.raised = {flag}
    vehicle.requested(2.5)
    cleared(vehicle)
    assert vehicle.requested() == {}
    vehicle.raised = {flag}
    stops = {"stop": 0.0} if flag in STOPS else {}
    assert vehicle.requested() == stops | IN_A_COMMANDED_HOLD.get(flag, {})


def test_a_flag_that_comes_and_goes_warns_once_in_5_s() -> None:
    vehicle, warnings = Vehicle(AutopilotKind.PX4), 0
    for tick in range(100):
        vehicle.raised = {F.SEPARATION_VIOLATED} if tick % 2 else set()
        warnings += "warn" in labels(vehicle.tick())
    assert warnings == 2


def held_by(
    flag: HealthFlag, settings: FailsafeSettings = SETTINGS, kind: AutopilotKind = AutopilotKind.PX4
) -> Vehicle:
    """A vehicle in the hold that this flag led to."""
    vehicle = Vehicle(kind, settings)
    vehicle.raised = {flag}
    while "hold" not in labels(vehicle.tick()):
        pass
    vehicle.phase = P.HOLD
    return vehicle


def test_a_recovered_voltage_does_not_end_a_low_battery() -> None:
    vehicle = held_by(F.BATTERY_LOW)
    vehicle.raised = set()
    assert vehicle.requested(1.0) == {"land": 0.0}


def test_a_leader_that_appears_postpones_the_landing() -> None:
    vehicle = held_by(F.LEADER_LOST)
    assert vehicle.requested(8.0) == {}
    vehicle.raised = set()
    assert vehicle.requested(8.0) == {}
    vehicle.raised = {F.LEADER_LOST}
    assert vehicle.requested() == {"land": 10.0}


@pytest.mark.parametrize("flag", [F.LEADER_LOST, F.BATTERY_LOW, F.FLEET_LINK_LOST])
def test_a_command_ends_the_escalation(flag: HealthFlag) -> None:
    vehicle = held_by(flag)
    vehicle.commanded = True
    assert vehicle.requested() == {}


def test_a_command_ends_a_critical_landing_until_the_flag_is_raised_again() -> None:
    vehicle = held_by(F.BATTERY_CRITICAL)
    assert "land" in labels(vehicle.tick())
    vehicle.phase = P.LAND
    vehicle.tick()
    vehicle.phase, vehicle.commanded = P.HOLD, True
    assert vehicle.requested() == {}
    vehicle.raised = set()
    vehicle.tick()
    vehicle.raised = {F.BATTERY_CRITICAL}
    assert vehicle.requested() == {"land": 3.0}


def test_a_pilot_ends_the_escalation() -> None:
    vehicle = held_by(F.LEADER_LOST)
    vehicle.phase = P.OBSERVE
    vehicle.tick()
    vehicle.phase = P.HOLD  # by a later command
    assert vehicle.requested() == {}


@pytest.mark.parametrize(
    ("action", "home_enu_m", "expected"),
    [
        (A.HOLD, (0.0, 0.0), set()),
        (A.RETURN, (9.0, 0.0), {"return"}),
        (A.RETURN, (60.0, 60.0), {"land"}),  # through vehicle 4
        (A.RETURN, None, {"land"}),
        (A.LAND, (0.0, 0.0), {"land"}),
    ],
)
def test_the_fleet_file_chooses_what_a_low_battery_does(
    action: FailsafeAction, home_enu_m: Place | None, expected: set[str]
) -> None:
    vehicle = held_by(F.BATTERY_LOW, FailsafeSettings(low_battery_action=action))
    vehicle.home_enu_m = home_enu_m
    assert set(vehicle.requested()) == expected


def test_steps_without_a_configured_time_are_never_taken() -> None:
    vehicle = held_by(F.LEADER_LOST, FailsafeSettings(land_after_s=None))
    assert vehicle.requested(600.0) == {}


@pytest.mark.parametrize("kind", KINDS)
def test_the_audit_judges_every_parameter_that_the_matrix_relies_on(kind: AutopilotKind) -> None:
    assert set(PROFILES[kind].decide_in_silence) <= {rule.name for rule in PROFILES[kind].parameters}


# ---------------------------------------------------------------- the table


def test_the_table_names_the_values_that_the_code_uses() -> None:
    rows = {row.condition: row for row in (*FAILSAFES, *OTHER_FAILSAFES)}
    assert rows[Code.POSITION_STALE].raised == f"position {limit_of(Code.POSITION_STALE):g} s old"
    assert rows[Code.DUPLICATE_ID].clears == f"{DUPLICATE_FOR_S:g} s without such a packet"
    assert rows[Code.TICK_LATE].raised == f"a tick {LATE_TICK_S:g} s late"
    assert rows[Code.NO_SETPOINT].raised == f"{SILENT_TOO_LONG_S:g} s without a setpoint"
    assert rows[Code.OUTSIDE_FENCE].raised == "at once"
    assert not [row.condition for row in rows.values() if "{" in row.raised + row.clears]


def test_each_step_is_due_at_its_time_exactly() -> None:
    for row in FAILSAFES:
        flag = HealthFlag(row.condition)
        due_s = {due_s for due_s, _ in schedule(row.steps, SETTINGS)}
        expected = {*IN_FORMATION[flag].values(), *AFTERWARDS.get(flag, {}).values()}
        assert sorted(due_s) == pytest.approx(sorted(expected))


def test_what_the_fleet_file_does_not_choose() -> None:
    """A low battery lands, a leader alone holds after 5 s, and nothing else lands by itself."""
    chosen = FailsafeSettings()
    assert (chosen.low_battery_action, chosen.land_after_s, chosen.leader_holds_after_s) == (A.LAND, None, 5.0)
    (row,) = (row for row in FAILSAFES if row.condition is Code.FLEET_LINK_LOST)
    assert schedule(row.steps, chosen) == ((0.0, A.WARN), (5.0, A.HOLD))


def test_a_handed_over_stream_ends_after_this_time() -> None:
    """The autopilot gets 6 s at the end of an agent, and half a second after a defect or without setpoints."""
    assert [leaves_after_s(code) for code in (Code.AGENT_STOPPING, Code.AGENT_FAILED)] == [6.0, 0.5]
    assert limit_of(Code.NO_SETPOINT) == 0.5


# ---------------------------------------------------------------- the watch alone


def watch_of(flag: HealthFlag, seconds: list[float]) -> list[FailsafeAction]:
    watch = FailsafeWatch(SETTINGS)
    return [watch.update(now_s, P.FORMATION, {flag}, False).action for now_s in seconds]


def test_a_step_is_taken_at_its_time_and_not_before() -> None:
    assert watch_of(F.TICK_LATE, [0.0, 4.999, 5.0]) == [A.WARN, A.WARN, A.HOLD]
    assert watch_of(F.POSE_LOST, [0.0, 0.299, 0.3, 1.799, 1.8]) == [A.WARN, A.WARN, A.HOLD, A.HOLD, A.LAND]


def test_the_watch_warns_of_a_flag_once_in_five_seconds() -> None:
    watch = FailsafeWatch(SETTINGS)
    both = {F.BATTERY_LOW, F.DUPLICATE_ID}
    assert watch.update(0.0, P.FORMATION, both, False).warnings == (F.BATTERY_LOW, F.DUPLICATE_ID)
    for now_s, warned in ((4.9, ()), (5.0, (F.DUPLICATE_ID,))):
        watch.update(now_s - 0.05, P.FORMATION, set(), False)
        assert watch.update(now_s, P.FORMATION, {F.DUPLICATE_ID}, False).warnings == warned


def test_the_watch_is_idle_once_nothing_is_remembered() -> None:
    watch = FailsafeWatch(SETTINGS)
    assert watch.is_idle
    watch.update(0.0, P.FORMATION, {F.BATTERY_LOW}, False)
    assert not watch.is_idle
    watch.update(3.0, P.FORMATION, {F.BATTERY_LOW}, False)
    watch.update(3.1, P.HOLD, set(), False)
    assert not watch.is_idle  # it still lands
    watch.update(3.2, P.OBSERVE, set(), False)
    assert watch.is_idle


def test_the_flags_that_act_in_any_hold_and_those_that_are_latched() -> None:
    acting, latched = set(), set()
    for flag in F:
        held = FailsafeWatch(SETTINGS)
        held.update(0.0, P.HOLD, {flag}, False)
        if held.update(60.0, P.HOLD, {flag}, False).action in (A.RETURN, A.LAND):
            acting.add(flag)
        ended = FailsafeWatch(SETTINGS)
        for now_s in (0.0, 60.0):
            ended.update(now_s, P.FORMATION, {flag}, False)
        if ended.update(60.1, P.HOLD, set(), False).action is not A.NONE:
            latched.add(flag)
    assert acting == set(IN_A_COMMANDED_HOLD)
    assert latched == set(LATCHED)


def test_the_watch_is_not_idle_while_it_remembers_what_ended_the_formation() -> None:
    """Else a later command would not make it forget."""
    watch = FailsafeWatch(SETTINGS)
    watch.update(0.0, P.FORMATION, {F.OUTSIDE_FENCE}, False)
    watch.update(0.1, P.HOLD, set(), False)
    assert not watch.is_idle
    watch.update(0.2, P.HOLD, set(), True)
    assert watch.is_idle


def test_each_flag_that_has_ended_a_formation_counts_in_the_hold_and_one_that_only_warned_does_not() -> None:
    watch, actions = FailsafeWatch(SETTINGS), []
    watch.update(0.0, P.FORMATION, {F.LEADER_LOST, F.FLEET_LINK_LOST}, False)
    watch.update(0.1, P.FORMATION, {F.OUTSIDE_FENCE}, False)
    watch.update(0.2, P.HOLD, set(), False)
    for flag in (F.FLEET_LINK_LOST, F.LEADER_LOST):
        watch.update(1.0, P.HOLD, {flag}, False)
        actions.append(watch.update(30.0, P.HOLD, {flag}, False).action)
        watch.update(31.0, P.HOLD, set(), False)
    assert actions == [A.WARN, A.LAND]


def test_a_landing_that_a_pilot_ends_is_still_ended_by_a_later_command() -> None:
    watch, low = FailsafeWatch(SETTINGS), {F.BATTERY_CRITICAL}
    assert [watch.update(now_s, P.HOLD, low, False).action for now_s in (0.0, 3.0)] == [A.WARN, A.LAND]
    watch.update(3.1, P.OBSERVE, low, False)
    assert watch.update(4.0, P.HOLD, low, False).action is A.WARN
    watch.update(4.1, P.HOLD, low, True)
    assert watch.update(60.0, P.HOLD, low, False).action is A.WARN


def test_the_watch_names_the_flags_of_the_highest_action_in_order() -> None:
    watch = FailsafeWatch(SETTINGS)
    found = watch.update(0.0, P.FORMATION, {F.OUTSIDE_FENCE, F.ARMED_STALE, F.DUPLICATE_ID}, False)
    assert (found.action, found.flags) == (
        A.HOLD,
        tuple(flag for flag in F if flag in {F.ARMED_STALE, F.OUTSIDE_FENCE}),
    )


def test_the_notice_of_a_flag_names_what_it_is_about() -> None:
    lead = LeadView(Role.LEADER, (0, 0), None, 0.0, None, reference_s=0.0, heading=None)
    consensus = Consensus(prc=1, lead=lead, neighbours=Neighbours(), peers=PeerSets(in_doubt=(4, 7)))
    separation, vehicle = SeparationReport(unshaken=("4", "crane")), VehicleState(pose_fault="it jumps")
    named = {F.NOT_SHAKEN_OFF: ": 4, crane", F.PEER_IN_DOUBT: ": 4, 7", F.POSE_REFUSED: ": it jumps"}
    for flag in F:
        found = named_notice(flag, vehicle, consensus, separation)
        assert found == Notice(Code(flag), FLAG_TEXTS[flag] + named.get(flag, ""))
    nameless = replace(consensus, peers=PeerSets())
    for flag in named:
        found = named_notice(flag, VehicleState(), nameless, SeparationReport())
        assert found == Notice(Code(flag), FLAG_TEXTS[flag])


def test_several_flags_are_named_in_their_order_under_the_code_of_the_first() -> None:
    first, second = [flag for flag in F if flag in {F.BATTERY_LOW, F.DUPLICATE_ID}]
    assert flags_notice({second, first}) == Notice(Code(first), f"{FLAG_TEXTS[first]}, {FLAG_TEXTS[second]}")
