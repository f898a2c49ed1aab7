"""The setpoint of one tick: what each phase flies, what is sent, and what is believed and published of it."""

from __future__ import annotations

from collections.abc import Sequence
from math import cos, radians, tan

import pytest
from msgspec.structs import replace

from common import slot_peer, with_fields
from companion.assembly import safety_filter_of
from companion.core.autopilot import LAG_S
from companion.core.consensus.law import FlownLaw
from companion.core.consensus.peers import PeerState
from companion.core.consensus.stage import Consensus, LeadView, Neighbours, PeerSets
from companion.core.control.setpoint import STOPS_IN_S, Setpoint, SetpointStage, SetpointStream, level_acceleration
from companion.core.estimation.wind import DisturbanceObserver
from companion.core.formation.guidance import Guidance
from companion.core.safety.assurance import CommandMonitor
from companion.core.safety.limits import OutputLimits
from companion.core.safety.safeguard import SAFE, Safety
from companion.geometry.airspace import Airspace, Fence
from companion.laws import Law, Neighbour, Own, Values
from companion.types.autopilot import AttitudeTarget, AutopilotKind, AutopilotMode, LandedState, VehicleState
from companion.types.flight import COOPERATING, FailsafeAction, Flight, FlightPhase, Role
from companion.types.formation import FlownSlot, FormationState, Gains
from companion.types.notices import Code
from companion.types.peers import ReceivedTraffic, TrafficSample
from companion.types.status import SeparationReport
from companion.types.values import GRAVITY_M_S2, ZERO3, Vector3
from one_agent import FLEET

P = FlightPhase
FENCE = Fence((-50.0, -50.0, -5.0), (50.0, 50.0, 50.0))
LIMITS = OutputLimits(radians(25.0), radians(200.0), 0.3, 1.6, 10.0, FENCE)
GAINS = Gains(1.5, 2.0)  # of the altitude hold
DRAG_1_S, FLOWN_FOR_S, HOVER = 0.25, 0.04, 0.5
TICK_S = 1.0 / 64.0  # so that sums of times are exact
FLIES = VehicleState(
    position_enu_m=(1.0, 2.0, 10.0),
    yaw_rad=0.7,
    mode=AutopilotMode.OFFBOARD,
    autopilot=AutopilotKind.PX4,
    armed=True,
    landed=LandedState.IN_AIR,
)
HOLDS, FORMS = Flight(phase=P.HOLD, on_ground=False), Flight(phase=P.FORMATION, streams=True, in_formation=True)
SILENCE = Safety(action=FailsafeAction.STOP_STREAM)
REFERENCE = FormationState((1.0, 2.0, 10.0), ZERO3, ZERO3)


class Steady(Law, frozen=True):
    """Wants the same in each slot, and publishes its own position and whether it leads."""

    publishes = 1
    wants: Vector3 = (0.6, -0.4, 0.3)

    def acceleration(self, *_: object) -> Vector3:
        return self.wants

    def publish(self, own: Own, neighbours: Sequence[Neighbour], reference: FormationState | None) -> Values:
        return (
            (
                own.position_enu_m[0],
                own.acceleration_enu_m_s2[0],
                float(len(neighbours)) + 0.5 * (reference is not None),
            ),
        )


class Stage:
    """The stage of a vehicle that is far from all others, and flies as it is commanded without moving."""

    def __init__(self, law: Law | None = None, flies_altitude: bool = True, bandwidth_1_s: float = 0.0) -> None:
        self.observer = DisturbanceObserver(HOVER, DRAG_1_S, bandwidth_1_s)
        self.stream = SetpointStream(LIMITS, self.observer, CommandMonitor(1.0, Airspace(FENCE), LIMITS))
        self.filter = safety_filter_of(FLEET, 2)
        self.stage = SetpointStage(
            law=FlownLaw(law or Steady(), DRAG_1_S),
            law_flies_altitude=flies_altitude,
            altitude_hold_gains=GAINS,
            safety_filter=self.filter,
            stream=self.stream,
            flown_for_s=FLOWN_FOR_S,
            drag_1_s=DRAG_1_S,
        )
        self.now_s, self.vehicle, self.flight = 0.0, FLIES, HOLDS
        self.guidance, self.peers, self.states = Guidance(reference=REFERENCE), PeerSets(), ()
        self.traffic: tuple[ReceivedTraffic, ...] = ()

    def tick(self, flight: Flight, safety: Safety = SAFE, new_position: bool = True, **changes: object) -> Setpoint:
        self.now_s += TICK_S
        times = {"attitude_time_s": self.now_s} | ({"position_time_s": self.now_s} if new_position else {})
        self.vehicle = replace(self.vehicle, **times | changes)
        lead = LeadView(Role.LEADER, (0, 0), None, 0.0, None, reference_s=0.0, heading=None)
        consensus = Consensus(prc=1, lead=lead, neighbours=Neighbours((), self.states), peers=self.peers)
        before, self.flight = self.flight, flight
        return self.stage.step(self.now_s, self.vehicle, before, flight, consensus, self.guidance, safety, self.traffic)

    def settled(self, flight: Flight, **changes: object) -> Setpoint:
        """After the slew of attitude and thrust."""
        return [self.tick(flight, **changes) for _ in range(20)][-1]


def peer_at(position_enu_m: Vector3, now_s: float) -> PeerSets:
    packet = with_fields(slot_peer(1), phase=P.FORMATION, position_enu_m=position_enu_m)
    state = {1: PeerState(packet, now_s, 0.0, now_s)}
    return PeerSets(known=state, present=state, fresh=state)


# ---------------------------------------------------------------- what each phase flies


def test_in_formation_it_flies_what_the_law_wants_and_what_its_slot_does() -> None:
    at = Stage()
    at.guidance = Guidance(slot=FlownSlot(ZERO3, acceleration_enu_m_s2=(0.2, 0.1, -0.1)), reference=REFERENCE)
    found = at.settled(FORMS)
    assert found.acceleration_enu_m_s2 == pytest.approx((0.8, -0.3, 0.2))
    assert found.target == at.stream.sent
    assert (found.sent_s, found.hover_thrust_norm) == (at.now_s, HOVER)


def test_a_law_that_does_not_fly_the_altitude_holds_that_of_the_beginning() -> None:
    at = Stage(flies_altitude=False)
    at.tick(Flight(phase=P.ENGAGE, streams=True))  # at 10 m
    moves = FlownSlot(ZERO3, acceleration_enu_m_s2=(0.2, 0.1, -0.1))
    at.guidance = Guidance(slot=moves, reference=REFERENCE)  # whose height is not wanted
    found = at.settled(FORMS, position_enu_m=(1.0, 2.0, 10.4), velocity_enu_m_s=(0.0, 0.0, -0.2))
    assert found.acceleration_enu_m_s2 == pytest.approx((0.8, -0.3, -1.5 * 0.4 + 2.0 * 0.2))


def test_a_hand_over_begins_at_the_altitude_that_the_law_has_reached() -> None:
    at, up = Stage(), (1.0, 2.0, 12.0)
    at.settled(FORMS)
    at.settled(FORMS, position_enu_m=up)
    leaves = Flight(phase=P.RELEASE, streams=True)
    assert at.settled(leaves).acceleration_enu_m_s2 == pytest.approx(ZERO3)
    sunk = at.settled(leaves, position_enu_m=(1.0, 2.0, 11.8), velocity_enu_m_s=(0.3, -0.1, 0.1))
    assert sunk.acceleration_enu_m_s2 == pytest.approx((-0.6, 0.2, 1.5 * 0.2 - 2.0 * 0.1))


def test_out_of_formation_it_brakes_as_vehicles_behind_it_expect_and_levels_in_the_end() -> None:
    at = Stage()
    at.settled(FORMS)
    fast = {"velocity_enu_m_s": (3.0, -4.0, 0.1)}
    brakes = at.settled(Flight(phase=P.RELEASE, streams=True), **fast).acceleration_enu_m_s2
    alone_m_s2 = at.filter.braking_alone_m_s2
    assert alone_m_s2 < 10.0
    assert brakes == pytest.approx((-0.6 * alone_m_s2, 0.8 * alone_m_s2, -0.2))
    level = at.settled(Flight(phase=P.RELEASE, streams=True, levels=True), **fast)
    assert level.acceleration_enu_m_s2 == pytest.approx((0.0, 0.0, -0.2))


def test_while_the_autopilot_takes_the_stream_the_vehicle_goes_on() -> None:
    at, engages = Stage(), Flight(phase=P.ENGAGE, streams=True)
    tilted = {"roll_rad": 0.1, "pitch_rad": -0.05, "velocity_enu_m_s": (3.0, 0.0, 0.0)}
    found = at.tick(engages, **tilted)
    expected = AttitudeTarget(0.1, -0.05, 0.7, HOVER / (cos(0.1) * cos(0.05)))
    assert found.target is not None
    assert [
        getattr(found.target, name) for name in ("roll_rad", "pitch_rad", "yaw_rad", "thrust_norm")
    ] == pytest.approx([expected.roll_rad, expected.pitch_rad, expected.yaw_rad, expected.thrust_norm])
    assert found.acceleration_enu_m_s2 == ZERO3
    assert at.tick(engages, new_position=False, **tilted).target is None


def test_a_descent_is_level_and_begins_anew_with_each_stream() -> None:
    at, descends = Stage(), Flight(phase=P.LAND, streams=True, descends=True)
    fast = {"velocity_enu_m_s": (3.0, 0.0, 0.0)}
    assert at.settled(descends, **fast).acceleration_enu_m_s2 == pytest.approx((0.0, 0.0, -1.4))
    for _ in range(60):
        found = at.tick(descends)
    assert found.acceleration_enu_m_s2 == pytest.approx((0.0, 0.0, -6.0))
    at.tick(HOLDS)
    assert at.settled(descends).acceleration_enu_m_s2 == pytest.approx((0.0, 0.0, -1.4))


def test_a_new_stream_begins_with_the_present_heading() -> None:
    at = Stage()
    at.settled(FORMS)
    at.tick(HOLDS, yaw_rad=-1.0)
    found = at.tick(FORMS)
    assert found.target is not None and found.target.yaw_rad == -1.0


# ---------------------------------------------------------------- when nothing is sent


def test_without_a_new_position_nothing_is_decided_and_the_last_decision_is_flown_for_a_while() -> None:
    at = Stage()
    at.settled(FORMS)
    found = [at.tick(FORMS, new_position=False) for _ in range(3)]
    assert [each.target for each in found] == [None] * 3
    assert [each.acceleration_enu_m_s2[0] for each in found] == pytest.approx([0.6, 0.6, 0.0])


@pytest.mark.parametrize("phase", [P.HOLD, P.READY, P.LAND, P.OBSERVE])
def test_without_a_stream_nothing_is_sent(phase: FlightPhase) -> None:
    found = Stage().tick(Flight(phase=phase))
    assert (found.target, found.acceleration_enu_m_s2, found.separation) == (None, ZERO3, SeparationReport())


@pytest.mark.parametrize("kind", list(AutopilotKind))
@pytest.mark.parametrize(
    ("mode", "roll_rad", "ends"),
    [(AutopilotMode.OFFBOARD, 0.0, True), (AutopilotMode.HOLD, 0.0, False), (AutopilotMode.OFFBOARD, 2.0, False)],
)
def test_silence_begins_with_one_last_setpoint_while_the_autopilot_follows_and_is_upright(
    kind: AutopilotKind, mode: AutopilotMode, roll_rad: float, ends: bool
) -> None:
    at = Stage()
    at.settled(FORMS)
    found = [at.tick(FORMS, SILENCE, autopilot=kind, mode=mode, roll_rad=roll_rad).target for _ in range(15)]
    sent = [target for target in found if target is not None]
    assert len(sent) == ends
    if ends:
        assert found[:3] == [None, None, sent[0]]  # after 0.04 s: a position may still come


@pytest.mark.parametrize(("age_s", "flies_on_s"), [(0.0, LAG_S), (0.05, LAG_S + 0.05), (0.2, LAG_S + 0.2), (0.21, 0.0)])
def test_the_last_setpoint_brakes_what_the_commands_before_it_still_lead_to(age_s: float, flies_on_s: float) -> None:
    """A vehicle that had just begun to evade drifted at 0.5 m/s for a second."""
    at = Stage(Steady(wants=(2.0, -1.0, 0.0)))
    at.now_s = -101 * TICK_S  # at 0 all ages are exact
    for _ in range(5):
        at.settled(FORMS)
    at.vehicle = replace(at.vehicle, velocity_enu_m_s=(0.3, 0.0, 0.0))
    last = at.tick(Flight(phase=P.HOLD), SILENCE, position_time_s=at.now_s + TICK_S - age_s).target
    assert last is not None
    east_m_s2, north_m_s2 = level_acceleration(last.roll_rad, last.pitch_rad, last.yaw_rad)
    assert east_m_s2 == pytest.approx(-(0.3 + 2.0 * flies_on_s) / STOPS_IN_S, abs=0.02)
    assert north_m_s2 == pytest.approx(1.0 * flies_on_s / STOPS_IN_S, abs=0.02)


@pytest.mark.parametrize("kind", list(AutopilotKind))
def test_a_stream_that_ends_by_decision_ends_with_one_at_once(kind: AutopilotKind) -> None:
    at = Stage()
    at.settled(FORMS)
    found = [at.tick(Flight(phase=P.HOLD), SILENCE, autopilot=kind).target for _ in range(3)]
    assert [target is not None for target in found] == [True, False, False]


def test_a_vehicle_that_never_streamed_ends_nothing() -> None:
    at = Stage()
    assert [at.tick(HOLDS, SILENCE).target for _ in range(6)] == [None] * 6


# ---------------------------------------------------------------- other vehicles


def test_another_vehicle_counts_in_the_filter_and_in_the_monitor() -> None:
    at = Stage(Steady(wants=(2.0, 0.0, 0.0)))
    free = at.settled(FORMS).acceleration_enu_m_s2
    at.peers = peer_at((2.3, 2.0, 10.0), at.now_s)
    found = at.tick(FORMS)
    assert found.acceleration_enu_m_s2[0] < free[0] - 1.0
    assert found.separation.nearest is not None and found.separation.nearest.name == "1"
    at.tick(FORMS, new_position=False)
    assert at.tick(HOLDS).separation == SeparationReport()


def test_traffic_is_heard_in_every_phase_and_forgotten_later() -> None:
    at = Stage()
    at.traffic = (ReceivedTraffic(0.02, "crane", TrafficSample((1.5, 2.0, 10.0), ZERO3, 0.5, 0.5, 0.0)),)
    at.tick(HOLDS)
    assert list(at.filter.traffic) == ["crane"]
    at.traffic = ()
    found = at.tick(FORMS)
    assert found.separation.nearest is not None and found.separation.nearest.name == "crane"
    at.now_s += 600.0
    at.tick(HOLDS)
    assert not at.filter.traffic


def test_a_stream_that_another_mode_has_ended_flies_nothing_any_more() -> None:
    """A pilot has it, or a mode of the autopilot: no last setpoint is sent, and none is believed to be flown."""
    at = Stage()
    assert at.settled(FORMS).acceleration_enu_m_s2 != ZERO3
    found = at.tick(HOLDS, mode=AutopilotMode.HOLD)
    assert (found.target, found.acceleration_enu_m_s2) == (None, ZERO3)


def kept_off(flies_altitude: bool = True, wants_m_s2: float = 2.0) -> Stage:
    """Its filter takes 1.2 m/s^2 of 2 from the law, and as much less as that wants less."""
    at = Stage(Steady(wants=(wants_m_s2, 0.0, 0.0)), flies_altitude)
    at.tick(FORMS)
    at.peers = peer_at((2.3, 2.0, 10.0), at.now_s)
    at.tick(FORMS)
    return at


def test_kept_off_its_slot_it_publishes_what_the_law_steers_to() -> None:
    at = kept_off()
    at.guidance = Guidance(
        slot=FlownSlot((5.0, 0.0, 0.0)), reference=replace(REFERENCE, velocity_enu_m_s=(0.1, 0.0, 0.0))
    )
    found = at.tick(FORMS)
    assert found.rft == at.guidance.reference
    assert found.law_values[0][0] == REFERENCE.position_enu_m[0]  # as if it flew in its slot
    assert Stage().tick(FORMS).rft is None


def test_six_tenths_of_a_metre_per_second_squared_keep_it_off_and_two_tenths_are_noise() -> None:
    for wants_m_s2, is_kept_off in ((1.5, True), (1.1, False)):
        at = kept_off(wants_m_s2=wants_m_s2)
        assert (at.tick(FORMS).rft is not None) is is_kept_off


@pytest.mark.parametrize("flies_altitude", [True, False])
def test_it_is_back_once_it_is_in_its_slot_where_no_height_is_wanted_at_any_height(flies_altitude: bool) -> None:
    at = kept_off(flies_altitude)
    at.peers = PeerSets()
    back = replace(REFERENCE, position_enu_m=(1.0, 2.0, 9.0))
    at.guidance = Guidance(slot=FlownSlot((0.0, 0.0, 0.5)), reference=back)
    for _ in range(200):  # 3.1 s
        found = at.tick(FORMS)
    assert (found.rft is None) is not flies_altitude
    at.guidance = Guidance(slot=FlownSlot((0.0, 0.0, 1.0)), reference=back)
    assert at.tick(FORMS).rft is None


def test_out_of_formation_or_in_doubt_of_a_peer_it_publishes_no_rft() -> None:
    at = kept_off()
    at.peers = replace(at.peers, in_doubt=(1,))
    assert at.tick(FORMS).rft is None
    at.peers = PeerSets()
    assert at.tick(FORMS).rft is None  # it has ended
    at = kept_off()
    at.tick(Flight(phase=P.RELEASE, streams=True))
    at.peers = PeerSets()
    assert at.tick(FORMS).rft is None


def test_a_follower_publishes_the_mean_of_those_that_it_follows() -> None:
    """By the weights of the paper where the law tells none: of PrC 1 and 2, two thirds and one third."""
    at = kept_off()
    at.guidance = Guidance()
    at.states = (
        Neighbour((3.0, 0.0, 6.0), (0.3, 0.0, 0.0), ZERO3, prc=1),
        Neighbour((0.0, 3.0, 0.0), (0.0, 0.6, 0.0), (0.9, 0.0, 0.0), prc=2),
    )
    rft = at.tick(FORMS).rft
    assert rft is not None
    assert rft.position_enu_m == pytest.approx((2.0, 1.0, 4.0))
    assert rft.velocity_enu_m_s == pytest.approx((0.2, 0.2, 0.0))
    assert rft.acceleration_enu_m_s2 == pytest.approx((0.3, 0.0, 0.0))


def test_without_a_reference_and_without_neighbours_there_is_no_rft() -> None:
    at = kept_off()
    at.guidance = Guidance()
    assert at.tick(FORMS).rft is None


# ---------------------------------------------------------------- what peers hear


@pytest.mark.parametrize("phase", sorted(P))
def test_a_vehicle_that_cooperates_publishes_the_values_of_its_law(phase: FlightPhase) -> None:
    at = Stage()
    at.guidance = Guidance(slot=FlownSlot((0.25, 0.0, 0.0)), reference=REFERENCE)
    found = at.tick(Flight(phase=phase)).law_values
    assert found == (((0.75, 0.0, 0.5),) if phase in COOPERATING else ())


def test_without_a_position_or_a_law_that_publishes_there_are_no_values() -> None:
    class Silent(Steady, frozen=True):
        publishes = 0

    assert Stage().tick(HOLDS, new_position=False).law_values == ()
    assert Stage(Silent()).tick(HOLDS).law_values == ()


LEANS = {"roll_rad": 0.1, "pitch_rad": -0.15, "velocity_enu_m_s": (2.0, -1.0, 0.5)}


def test_peers_hear_of_a_pilots_turn_by_the_attitude() -> None:
    """In still air less the drag, with the disturbance; level."""
    at = Stage()
    at.now_s = 50.0
    at.observer.disturbance_enu_m_s2 = (0.3, -0.2, 0.0)
    found = at.tick(Flight(), **LEANS).acceleration_enu_m_s2
    x, y = level_acceleration(0.1, -0.15, 0.7)
    assert found == pytest.approx((x - DRAG_1_S * 2.0 + 0.3, y + DRAG_1_S * 1.0 - 0.2, 0.0))
    steep = at.tick(Flight(), **LEANS | {"pitch_rad": 1.2}).acceleration_enu_m_s2
    assert sum(part * part for part in steep) ** 0.5 == pytest.approx(GRAVITY_M_S2 * tan(radians(25.0)))


@pytest.mark.parametrize("phase", [P.HOLD, P.TAKEOFF, P.LAND, P.RETURN])
def test_of_the_autopilots_own_modes_they_hear_nothing(phase: FlightPhase) -> None:
    assert Stage().tick(Flight(phase=phase), **LEANS).acceleration_enu_m_s2 == ZERO3


def test_an_attitude_is_believed_for_a_tenth_of_a_second_and_in_the_air() -> None:
    at = Stage()
    at.now_s = 0.1 - TICK_S
    assert at.tick(Flight(), attitude_time_s=0.0, **LEANS).acceleration_enu_m_s2 != ZERO3
    assert at.tick(Flight(), attitude_time_s=0.0, **LEANS).acceleration_enu_m_s2 == ZERO3
    assert at.tick(Flight(), landed=LandedState.ON_GROUND, **LEANS).acceleration_enu_m_s2 == ZERO3


# ---------------------------------------------------------------- hover thrust and wind


def estimate(at: Stage, flight: Flight, safety: Safety = SAFE, ticks: int = 50, **changes: object) -> float:
    """The hover thrust after a second in which the vehicle hovers by more thrust than was assumed."""
    for _ in range(ticks):
        at.tick(flight, safety, thrust_norm=0.6, **{"thrust_time_s": at.now_s} | changes)
    return at.observer.hover_thrust_norm


@pytest.mark.parametrize("phase", sorted(P))
def test_the_hover_thrust_is_estimated_where_the_vehicle_flies_under_a_known_thrust(phase: FlightPhase) -> None:
    learns = estimate(Stage(bandwidth_1_s=2.0), Flight(phase=phase)) > 0.51
    assert learns is (phase in COOPERATING)


@pytest.mark.parametrize(("climb_m_s", "learns"), [(0.3, False), (0.31, True)])
def test_in_a_take_off_it_is_estimated_once_the_vehicle_climbs(climb_m_s: float, learns: bool) -> None:
    at = Stage(bandwidth_1_s=2.0)
    found = estimate(at, Flight(phase=P.TAKEOFF), velocity_enu_m_s=(0.0, 0.0, climb_m_s), landed=LandedState.TAKEOFF)
    assert (found > 0.51) is learns


@pytest.mark.parametrize("landed", sorted(LandedState))
def test_it_is_estimated_off_the_ground_alone(landed: LandedState) -> None:
    found = estimate(Stage(bandwidth_1_s=2.0), HOLDS, landed=landed)
    assert (found > 0.51) is (landed in (LandedState.IN_AIR, LandedState.TAKEOFF))


def test_it_is_not_estimated_in_silence_or_by_an_old_thrust() -> None:
    assert estimate(Stage(bandwidth_1_s=2.0), HOLDS, SILENCE) == HOVER
    at = Stage(bandwidth_1_s=2.0)
    estimate(at, HOLDS, ticks=15, thrust_time_s=0.0)
    found = []
    for now_s in (0.29, 0.3, 0.301, 0.32):
        at.now_s = now_s - TICK_S
        found.append(estimate(at, HOLDS, ticks=1, thrust_time_s=0.0))
    assert HOVER < found[0] < found[1] == found[2] == found[3]


def test_under_a_stream_the_thrust_is_the_one_that_was_sent() -> None:
    """Whatever the autopilot reports; under a pilot its own counts again."""
    at = Stage(Steady(wants=ZERO3), bandwidth_1_s=2.0)
    at.settled(FORMS)
    assert estimate(at, FORMS) == pytest.approx(HOVER, abs=0.005)
    assert estimate(at, FORMS, mode=AutopilotMode.HOLD) > 0.51


def test_the_disturbance_is_forgotten_once_disarmed() -> None:
    at = Stage()
    at.observer.disturbance_enu_m_s2 = (1.0, 0.0, 0.0)
    assert at.tick(HOLDS).disturbance_enu_m_s2 == (1.0, 0.0, 0.0)
    assert at.tick(HOLDS, armed=False).disturbance_enu_m_s2 == ZERO3


def test_what_was_rejected_and_the_largest_step_are_reported() -> None:
    at = Stage()
    at.settled(FORMS)
    assert at.tick(FORMS, roll_rad=2.0).rejected == {Code.SETPOINT_IMPOSSIBLE: 1}
    assert at.tick(FORMS).largest_step_deg == at.stream.largest_step_deg > 0.0


def test_what_the_stream_commanded_is_no_longer_flown_once_it_has_ended() -> None:
    at = Stage()
    at.settled(FORMS)
    assert at.tick(HOLDS).acceleration_enu_m_s2 == ZERO3


def test_outside_formation_no_other_vehicle_takes_a_share() -> None:
    """More room is kept then, as all of the way is this vehicle's."""
    kept_m = []
    for flight in (FORMS, Flight(phase=P.RELEASE, streams=True)):
        at = Stage()
        at.settled(FORMS)
        at.peers = peer_at((2.3, 2.0, 10.0), at.now_s + TICK_S)
        at.guidance = Guidance(slot=FlownSlot((-1.5, 0.0, 0.0)), reference=REFERENCE)
        nearest = at.tick(flight).separation.nearest
        assert nearest is not None
        kept_m.append(nearest.required_m)
    assert kept_m[1] > kept_m[0] + 0.1


def test_before_the_first_position_nothing_keeps_it_off_its_slot() -> None:
    assert Stage().tick(FORMS, new_position=False).rft is None
