"""The safeguard stage alone: what it requests, with which reason, and from which moment on. The matrix has all flags."""

from __future__ import annotations

from math import inf, radians

import pytest
from msgspec.structs import replace

from common import slot_peer, with_fields
from companion.core.consensus.peers import PeerState
from companion.core.consensus.stage import Consensus, LeadView, Neighbours, PeerSets
from companion.core.safety.failsafe import FailsafeSettings, HealthLimits, flags_notice
from companion.core.safety.fleet_checks import FleetChecks
from companion.core.safety.limits import OutputLimits
from companion.core.safety.return_check import ReturnCheck
from companion.core.safety.safeguard import SAFE, SafeguardStage, Safety
from companion.geometry.airspace import Fence
from companion.mavlink.autopilot_types import PROFILES
from companion.types.autopilot import AutopilotKind, AutopilotMode, LandedState, VehicleState
from companion.types.flight import (
    FLAG_TEXTS,
    FailsafeAction,
    Flight,
    FlightPhase,
    HealthFlag,
    PhaseChange,
    PhaseRequest,
    Role,
)
from companion.types.notices import Code, Notice
from companion.types.status import SeparationReport
from companion.types.tick import Inbox
from companion.types.values import Place

F, P, A = HealthFlag, FlightPhase, FailsafeAction
RETURNS = ReturnCheck(3, separation_m=1.0, braking_m_s2=2.0, responds_s=0.45, goes_on_s=0.55)
CHECKS = FleetChecks(3, slots_have_height=True, ground_spread_m=1.0, separation_m=1.0, returns=RETURNS)
ENVELOPE = OutputLimits(radians(25.0), 2.0, 0.3, 1.6, 10.0, Fence((-50.0, -50.0, -5.0), (50.0, 50.0, 50.0)))
WELL = VehicleState(
    position_enu_m=(0.0, 0.0, 5.0),
    mode=AutopilotMode.OFFBOARD,
    autopilot=AutopilotKind.ARDUPILOT,
    armed=True,
    landed=LandedState.IN_AIR,
    frame_known=True,
    home_enu_m=(9.0, 0.0),
)
FORMS, HOLDS = Flight(phase=P.FORMATION, streams=True, in_formation=True), Flight(phase=P.HOLD)
SAMPLES = ("position_time_s", "attitude_time_s", "mode_time_s", "heartbeat_time_s", "landed_time_s")


class Watched:
    """The stage with a vehicle, a peer and a leader that are well."""

    def __init__(self, settings: FailsafeSettings | None = None) -> None:
        limits = HealthLimits(ENVELOPE, low_battery_percent=25.0)
        self.stage = SafeguardStage(CHECKS, limits, settings or FailsafeSettings(), PROFILES)
        self.peers, self.separation, self.role = PeerSets(), SeparationReport(), Role.FOLLOWER

    def at(
        self,
        now_s: float,
        flight: Flight = FORMS,
        inbox: Inbox | None = None,
        last_setpoint_s: float = inf,
        commanded: bool = False,
        **changes: object,
    ) -> Safety:
        vehicle = replace(WELL, **dict.fromkeys(SAMPLES, now_s) | changes)
        lead = LeadView(self.role, (0, 0), None, 0.0, None, reference_s=0.0, heading=None)
        consensus = Consensus(prc=1, lead=lead, neighbours=Neighbours(), peers=self.peers)
        return self.stage.step(
            now_s, vehicle, flight, consensus, self.separation, last_setpoint_s, commanded, inbox or Inbox()
        )


def kinds(safety: Safety) -> list[PhaseChange]:
    return [request.kind for request in safety.requests]


def test_nothing_is_said_where_nothing_is_wrong() -> None:
    watched = Watched()
    assert watched.at(1.0) is SAFE
    assert watched.at(1.0, HOLDS) is SAFE
    watched.at(1.02, inbox=Inbox(late_s=0.2))
    assert watched.at(2.02) is SAFE


@pytest.mark.parametrize(
    ("flag", "usual", "wrong", "stays_s"),
    [
        (F.TICK_LATE, Inbox(late_s=0.1), Inbox(late_s=0.101), 1.0),
        (F.LAW_SLOW, Inbox(law_s=0.002), Inbox(law_s=0.0021), 0.2),
    ],
)
def test_a_late_tick_or_a_slow_law_is_remembered_for_a_while(
    flag: HealthFlag, usual: Inbox, wrong: Inbox, stays_s: float
) -> None:
    watched = Watched()
    assert watched.at(0.0, inbox=usual).flags == set()
    assert watched.at(0.0, inbox=wrong).flags == {flag}
    assert watched.at(0.999 * stays_s).flags == {flag}
    assert watched.at(stays_s).flags == set()


def test_a_warning_names_what_it_is_about() -> None:
    watched = Watched()
    watched.peers, watched.separation = PeerSets(in_doubt=(4,)), SeparationReport(unshaken=("7",))
    events = watched.at(1.0, pose_refused_s=0.9, pose_fault="it jumps").events
    assert sorted(event.text for event in events) == sorted(
        [
            f"{FLAG_TEXTS[F.PEER_IN_DOUBT]}: 4",
            f"{FLAG_TEXTS[F.NOT_SHAKEN_OFF]}: 7",
            f"{FLAG_TEXTS[F.POSE_REFUSED]}: it jumps",
        ]
    )


def test_each_peer_in_doubt_has_a_name_once_in_five_seconds() -> None:
    """Also a second one, while the flag is raised already; those that are refused as well; in formation alone."""
    watched, text = Watched(), FLAG_TEXTS[F.PEER_IN_DOUBT]

    def named(
        now_s: float, in_doubt: tuple[int, ...], refused: tuple[int, ...] = (), flight: Flight = FORMS
    ) -> list[str]:
        watched.peers = PeerSets(in_doubt=in_doubt, refused=refused)
        found = watched.at(now_s, flight)
        assert found.flags == ({F.PEER_IN_DOUBT} if in_doubt or refused else set())
        assert {event.code for event in found.events} <= {Code.PEER_IN_DOUBT}
        return [event.text for event in found.events]

    assert named(0.0, (7,)) == [f"{text}: 7"]
    assert named(0.1, (7,)) == []
    assert named(0.2, (7,), (9, 4)) == [f"{text}: 4, 9"]
    assert named(0.3, (7,), (4, 9)) == []
    assert named(1.0, (7,)) == []
    assert named(5.3, (7,), (4,)) == []  # 5 s ago 4 was still in doubt
    assert named(10.301, (7,), (4,)) == [f"{text}: 4, 7"]  # nothing was heard of both for a while
    assert named(10.4, (), ()) == []
    assert named(16.0, (7,), (7,)) == [f"{text}: 7"]
    assert named(16.1, (7, 8), flight=HOLDS) == []
    assert named(16.2, (7, 8)) == [f"{text}: 8"]


@pytest.mark.parametrize(
    ("flag", "changes", "change"),
    [
        (F.OUTSIDE_FENCE, {"position_enu_m": (51.0, 0.0, 5.0)}, PhaseChange.HAND_OVER),
        (F.FRAME_CONTRADICTED, {"frame_contradicted": True}, PhaseChange.HAND_OVER_LEVEL),
        (F.POSITION_JUMPED, {"held_back_m": 6.0, "jump_time_s": 0.0}, PhaseChange.HAND_OVER_LEVEL),
    ],
)
def test_it_leaves_formation_braking_or_level_where_the_velocity_may_be_wrong(
    flag: HealthFlag, changes: dict[str, object], change: PhaseChange
) -> None:
    found = Watched().at(1.0, **changes)
    assert found == Safety(frozenset({flag}), A.HOLD, (PhaseRequest(change, flags_notice([flag])),), ())


@pytest.mark.parametrize("name", ["position_unaided", "estimator", "tilt"])
def test_it_levels_too_where_it_drifts_or_tilts_too_far(name: str) -> None:
    changes: dict[str, object] = {
        "position_unaided": {"position_unaided": True},
        "estimator": {"estimator_healthy": False},
        "tilt": {"roll_rad": radians(36.0)},
    }[name]
    watched = Watched()
    watched.at(1.0, **changes)
    assert kinds(watched.at(2.0, **changes)) == [PhaseChange.HAND_OVER_LEVEL]


LOW = {"battery_percent": 20.0}


def lands(
    settings: FailsafeSettings, peers: PeerSets | None = None, role: Role = Role.FOLLOWER, **changes: object
) -> Safety:
    """What a low battery requests in the hold that it led to."""
    watched = Watched(settings)
    watched.role = role
    watched.at(0.0, **LOW)
    watched.at(3.0, **LOW)
    watched.peers = peers or PeerSets()
    assert watched.at(3.1, Flight(phase=P.RELEASE, streams=True), **LOW).action is settings.low_battery_action
    return watched.at(3.2, HOLDS, **LOW | changes)


def near(
    position_enu_m: tuple[float, float, float], phase: FlightPhase = P.HOLD, home: Place | None = None
) -> PeerSets:
    packet = with_fields(slot_peer(4), phase=phase, position_enu_m=position_enu_m, home_enu_m=home)
    state = {4: PeerState(packet, 3.2, 0.0, 3.2)}
    return PeerSets(known=state, present=state, fresh=state)


def test_out_of_hold_it_lands_or_returns_as_the_fleet_file_chooses() -> None:
    reason = flags_notice([F.BATTERY_LOW])
    assert lands(FailsafeSettings(A.LAND)).requests == (PhaseRequest(PhaseChange.LAND, reason),)
    assert lands(FailsafeSettings(A.RETURN)).requests == (PhaseRequest(PhaseChange.RETURN, reason),)
    assert lands(FailsafeSettings(A.HOLD)).requests == ()


def test_where_the_way_home_is_not_free_it_lands_and_says_why() -> None:
    (request,) = lands(FailsafeSettings(A.RETURN), near((5.0, 0.0, 5.0))).requests
    assert (request.kind, request.reason.code) == (PhaseChange.LAND, Code.BATTERY_LOW)
    assert request.reason.text.startswith(f"{FLAG_TEXTS[F.BATTERY_LOW]}; no return: separation: ")
    (request,) = lands(FailsafeSettings(A.RETURN), home_enu_m=None).requests
    assert "; no return: its home is unknown" in request.reason.text


def test_the_way_home_of_a_leader_alone_keeps_off_where_its_followers_stop() -> None:
    """One that flies on for a while without a leader stops nearer to the way."""
    (state,) = near((4.0, -1.6, 5.0), P.FORMATION, (-20.0, 0.0)).present.values()
    moves = {4: PeerState(with_fields(state.packet, velocity_enu_m_s=(0.0, 0.6, 0.0)), 3.2, 0.0, 3.2)}
    peers = PeerSets(known=moves, present=moves, fresh=moves)
    found = {role: kinds(lands(FailsafeSettings(A.RETURN), peers, role)) for role in (Role.FOLLOWER, Role.LEADER)}
    assert found == {Role.FOLLOWER: [PhaseChange.RETURN], Role.LEADER: [PhaseChange.LAND]}


# ---------------------------------------------------------------- silence

UNSURE = {"position_time_s": 0.0}


def test_half_a_second_without_a_setpoint_ends_the_stream() -> None:
    assert Watched().at(0.5, last_setpoint_s=0.0) is SAFE
    assert kinds(Watched().at(0.501, last_setpoint_s=0.0)) == [PhaseChange.HAND_OVER_NOW, PhaseChange.END_STREAM]
    assert Watched().at(9.0, HOLDS, last_setpoint_s=0.0) is SAFE


def test_the_reason_of_an_end_is_the_flag_or_that_no_position_is_new() -> None:
    first, last = Watched().at(1.0, last_setpoint_s=0.0).requests
    assert last.reason == Notice(Code.NO_SETPOINT, "no new position to decide on")
    assert first.reason == Notice(Code.NO_SETPOINT, "no setpoint for 0.5 s: no new position to decide on")
    first, last = Watched().at(1.0, last_setpoint_s=0.0, **UNSURE).requests
    assert last.reason == flags_notice([F.POSITION_STALE])
    assert first.reason == flags_notice([F.POSITION_STALE]).about("no setpoint for 0.5 s")


@pytest.mark.parametrize(
    ("kind", "mode_age_s", "change"),
    [
        (AutopilotKind.ARDUPILOT, 0.19, PhaseChange.HAND_OVER_NOW),
        (AutopilotKind.ARDUPILOT, 0.2, PhaseChange.GIVE_UP),
        (AutopilotKind.PX4, 0.0, PhaseChange.GIVE_UP),
        (None, 0.0, None),
    ],
)
def test_an_autopilot_that_flies_on_is_asked_to_hold_unless_a_pilot_may_have_taken_over(
    kind: AutopilotKind | None, mode_age_s: float, change: PhaseChange | None
) -> None:
    found = Watched().at(0.2, last_setpoint_s=-1.0, autopilot=kind, mode_time_s=0.2 - mode_age_s)
    assert kinds(found) == [*([change] if change else []), PhaseChange.END_STREAM]


def test_a_stream_that_leaves_formation_only_ends() -> None:
    found = Watched().at(1.0, Flight(phase=P.RELEASE, streams=True), last_setpoint_s=0.0)
    assert kinds(found) == [PhaseChange.END_STREAM]


OBSERVES = Flight(phase=P.OBSERVE)
STILL_WAITS = Notice(Code.NO_SETPOINT, "telemetry is in time again, and the autopilot still waits for setpoints")


def gave_up() -> Watched:
    """At 1 s, with a mode that was too old to ask for a hold."""
    watched = Watched()
    assert kinds(watched.at(1.0, last_setpoint_s=0.0, mode_time_s=0.5)) == [PhaseChange.GIVE_UP, PhaseChange.END_STREAM]
    return watched


def test_after_it_gave_up_a_hold_is_requested_once_when_the_mode_is_known_again() -> None:
    watched = gave_up()
    for now_s, mode_time_s in ((1.1, 0.9), (1.2, 1.0)):
        assert not watched.at(now_s, OBSERVES, mode_time_s=mode_time_s).requests
    assert watched.at(1.3, OBSERVES, mode_time_s=1.001).requests == (PhaseRequest(PhaseChange.HOLD, STILL_WAITS),)
    assert not watched.at(1.4, OBSERVES).requests


def test_while_it_streams_or_telemetry_is_late_it_waits_for_a_mode_from_after_that() -> None:
    for waits in ({"flight": FORMS}, {"flight": OBSERVES, "position_time_s": 1.9}):
        watched = gave_up()
        assert not [kind for kind in kinds(watched.at(2.0, **waits)) if kind is PhaseChange.HOLD]  # type: ignore[arg-type]
        assert not watched.at(2.1, OBSERVES, mode_time_s=2.0).requests
        assert kinds(watched.at(2.2, OBSERVES, mode_time_s=2.001)) == [PhaseChange.HOLD]


@pytest.mark.parametrize(("flight", "mode"), [(HOLDS, AutopilotMode.OFFBOARD), (OBSERVES, AutopilotMode.HOLD)])
def test_a_pilot_or_the_autopilot_that_took_over_is_left_alone(flight: Flight, mode: AutopilotMode) -> None:
    watched = gave_up()
    for now_s, flown, in_mode in ((1.1, flight, mode), (1.2, OBSERVES, AutopilotMode.OFFBOARD)):
        assert not watched.at(now_s, flown, mode=in_mode).requests


# ---------------------------------------------------------------- the end of the agent

STOPS = Inbox(stopping=True)


def test_a_stopping_agent_hands_over_and_gives_up_after_six_seconds() -> None:
    watched = Watched()
    found = [watched.at(now_s, inbox=STOPS).requests for now_s in (10.0, 16.0, 16.001)]
    hands_over = PhaseRequest(PhaseChange.HAND_OVER, Notice(Code.AGENT_STOPPING, "this agent is stopping"))
    assert found[:2] == [(hands_over,)] * 2
    assert found[2] == (
        PhaseRequest(
            PhaseChange.ABANDON,
            Notice(Code.HAND_OVER_FAILED, "this agent is stopping, and the autopilot does not take over"),
        ),
    )
    assert watched.at(20.0, HOLDS, STOPS).requests == (hands_over,)  # it has taken over


@pytest.mark.parametrize("heard", ["attitude_time_s", "mode_time_s", "heartbeat_time_s", None])
def test_an_autopilot_that_sends_nothing_for_a_second_and_a_half_has_ended(heard: str | None) -> None:
    """One of these messages is enough, and the time before the agent began to stop does not count."""
    silent = {"attitude_time_s": 5.0, "mode_time_s": 5.0, "heartbeat_time_s": 5.0}
    watched = Watched()
    watched.at(10.0, inbox=STOPS, **silent)
    if heard:
        silent[heard] = 11.0
    ends_s = 12.5 if heard else 11.5
    found = [watched.at(now_s, inbox=STOPS, **silent).requests[0] for now_s in (ends_s, ends_s + 0.001)]
    assert [each.kind for each in found] == [PhaseChange.HAND_OVER, PhaseChange.ABANDON]
    assert found[1].reason == Notice(
        Code.HAND_OVER_FAILED, "this agent is stopping, and its autopilot sends nothing any more"
    )
    assert kinds(watched.at(30.0, HOLDS, STOPS, **silent)) == [PhaseChange.HAND_OVER]


def test_a_stopping_agent_still_leaves_formation_for_a_flag() -> None:
    found = Watched().at(1.0, inbox=STOPS, position_enu_m=(51.0, 0.0, 5.0))
    assert [request.reason.code for request in found.requests] == [Code.AGENT_STOPPING, Code.OUTSIDE_FENCE]
    silent = Watched().at(1.0, inbox=STOPS, last_setpoint_s=0.0)
    assert kinds(silent) == [PhaseChange.HAND_OVER, PhaseChange.HAND_OVER_NOW, PhaseChange.END_STREAM]


def test_a_command_ends_the_landing_that_a_flag_began() -> None:
    watched = Watched(FailsafeSettings(A.LAND))
    watched.at(0.0, **LOW)
    watched.at(3.0, **LOW)
    assert kinds(watched.at(3.1, HOLDS, **LOW)) == [PhaseChange.LAND]
    assert kinds(watched.at(3.2, HOLDS, commanded=True, **LOW)) == []
    assert kinds(watched.at(9.0, HOLDS, **LOW)) == []
