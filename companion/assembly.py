"""Configuration -> Agent. All alternatives are selected here, once, and never in a tick."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from math import hypot, radians, tan
from pathlib import Path

from msgspec import convert, to_builtins

from companion.analysis.pace import following_steps
from companion.analysis.response import USUAL_DRAG_1_S
from companion.config.file import ConfigError, refuse
from companion.config.fleet import EdgeNeighbours, FleetConfig
from companion.config.law import law_of
from companion.config.reference import Reference, TargetReference, commanded
from companion.config.reference_check import accepted_values, most_pace, reference_checks
from companion.config.validation import Problem, needs, without_pauses
from companion.config.vehicle import AgentConfig
from companion.core.agent import Agent
from companion.core.autopilot import LAG_S, Profiles
from companion.core.command.arbitration import CommandArbitration, CommandDispatcher
from companion.core.command.hand_over import LEVEL_BEFORE_HAND_OVER_S
from companion.core.command.phase import PhaseMachine
from companion.core.consensus.coherence import UNFLOWN_S
from companion.core.consensus.law import FlownLaw
from companion.core.consensus.neighbours import DistantLimits, DistantPeers, EdgeRule, NeighbourRule, RangeRule
from companion.core.consensus.peers import FleetLimits, PeerTable
from companion.core.consensus.stage import ConsensusStage
from companion.core.control.setpoint import SetpointStage, SetpointStream
from companion.core.election.beacon import BeaconMonitor
from companion.core.election.leadership import TURN_S, Leadership, Succession
from companion.core.estimation.corrections import VelocityCorrection
from companion.core.estimation.vehicle import VehicleTracker
from companion.core.estimation.wind import DisturbanceObserver
from companion.core.filter.filter import Bounds, SafetyFilter, SpeedLimit
from companion.core.filter.solver import AccelerationLimits
from companion.core.filter.vehicles import PLANNED_SHARE, SeparationSettings
from companion.core.formation.entry import FormationEntry, Joining, LeadIn
from companion.core.formation.gaps import GapFilling
from companion.core.formation.guidance import GuidanceStage
from companion.core.formation.limits import FormationLimits
from companion.core.formation.paths import FormingTogether, law_within_m
from companion.core.formation.slots import SlotPlan
from companion.core.preflight import Preflight
from companion.core.reference.blend import BlendLimits, ReferenceTrajectory, along
from companion.core.reference.heading import CourseHeading
from companion.core.reference.plan import LiveReference, ReferencePlan, Rft
from companion.core.reference.target import Box, TargetLimits
from companion.core.report import ReportStage
from companion.core.safety.assurance import CommandMonitor
from companion.core.safety.audit import FleetFence
from companion.core.safety.failsafe import FailsafeSettings, HealthLimits, limit_of
from companion.core.safety.fleet_checks import FleetChecks, slow_to_brake
from companion.core.safety.limits import OutputLimits
from companion.core.safety.return_check import ReturnCheck
from companion.core.safety.safeguard import SafeguardStage
from companion.geometry.airspace import Airspace
from companion.geometry.formations import to_separation_metric
from companion.laws import Law
from companion.laws._feedback_gains import feedback_gains
from companion.mavlink.autopilot_types import PROFILES, VISION_PROFILES
from companion.types.autopilot import SetOrigin
from companion.types.commands import Described
from companion.types.flight import FailsafeAction, Role
from companion.types.formation import Gains
from companion.types.notices import Code, Notice
from companion.types.status import AgentIdentity
from companion.types.steps import Steps
from companion.types.values import GRAVITY_M_S2, Vector3

MOST_SLOWED = 3  # times that a refused reference is made slower, to find one that is accepted
COMMANDED = Path("command")  # in place of a file name in error messages
LONGEST_REASON = 300  # characters; keys and values of a command have no limit of length


def build_agent(config: AgentConfig, session: int, formation_hash: int | None = None, law: Law | None = None) -> Agent:
    """The agent of a vehicle. `session` differs between two starts of the agent of one vehicle.

    `law` flies in place of the configured one: the same, with a clock around it.

    `formation_hash` is that of the fleet file without a value. With that of other vehicles it accepts their packets although
    its own settings differ: for a replay of recorded inputs.
    """
    fleet, member, section, vehicle = config.fleet, config.member, config.fleet.law, config.vehicle
    law = law or law_of(section)
    if formation_hash is None:
        formation_hash = fleet.formation_hash()
    identity = AgentIdentity(member.id, session, fleet.name, formation_hash, section.name)
    envelope = output_limits_of(fleet)
    observer = DisturbanceObserver(vehicle.hover_thrust_norm, vehicle.drag_1_s, section.disturbance_bandwidth_1_s)
    health = HealthLimits(envelope, fleet.leave_below_percent, fleet.land_below_percent)
    safety_filter = safety_filter_of(fleet, member.id)
    returns = ReturnCheck(
        own_id=member.id,
        separation_m=fleet.separation_m,
        braking_m_s2=safety_filter.braking_alone_m_s2,
        responds_s=LAG_S + LEVEL_BEFORE_HAND_OVER_S,
        goes_on_s=fleet.peers.leader_beacon_max_age_s + TURN_S,
    )
    checks = FleetChecks(
        own_id=member.id,
        slots_have_height=section.altitude == "formation",
        ground_spread_m=fleet.ground_spread_m,
        separation_m=fleet.separation_m,
        returns=returns,
        successors=frozenset(fleet.successors),
        take_off_by_altitude=frozenset(kind for kind, profile in PROFILES.items() if profile.takes_off_by_altitude),
        slow_to_brake=_slow_to_brake(fleet, member.id, safety_filter.braking_alone_m_s2),
    )
    return Agent(
        vehicle_id=member.id,
        perception=tracker_of(fleet),
        preflight=Preflight(observer, profiles_of(fleet), vehicle.accept_uncontrolled_descent, fleet_fence_of(fleet)),
        phases=PhaseMachine(fleet.takeoff_height_m, PROFILES),
        arbitration=CommandArbitration(session),
        consensus=_consensus(fleet, member.id, identity.formation_hash, law.publishes),
        guidance=_guidance(config),
        safeguard=SafeguardStage(checks, health, _failsafes(fleet), PROFILES),
        dispatcher=CommandDispatcher(checks),
        setpoint=_setpoint(
            config,
            law,
            safety_filter,
            SetpointStream(envelope, observer, CommandMonitor(fleet.separation_m, fleet.airspace, envelope)),
            limit_of(Code.POSITION_STALE),
        ),
        distant_peers=_distant_peers(fleet, member.id) if fleet.has_distant_peers else None,
        reporter=ReportStage(identity, law, checks),
    )


def _slow_to_brake(fleet: FleetConfig, own_id: int, braking_m_s2: float) -> Notice | None:
    has_height = fleet.law.altitude == "formation"
    slots = {member.id: to_separation_metric(member.slot_enu_m, has_height) for member in fleet.vehicles}
    return slow_to_brake(own_id, slots, fleet.separation_m, braking_m_s2, fleet.envelope.max_tilt_deg)


def fleet_fence_of(fleet: FleetConfig) -> FleetFence:
    """What the autopilots' own fences must leave room for. Heights are above the take-off, or the origin near it."""
    envelope = fleet.envelope
    (x, y, _), (far_x, far_y, ceiling_m) = envelope.fence_min_enu_m, envelope.fence_max_enu_m
    corners = envelope.fence_corners_enu_m or ((x, y), (x, far_y), (far_x, far_y), (far_x, y))
    return FleetFence(tuple(corners), ceiling_m, fleet.takeoff_height_m)


def _failsafes(fleet: FleetConfig) -> FailsafeSettings:
    action = FailsafeAction[fleet.low_battery_action.upper()]
    return FailsafeSettings(action, fleet.land_after_s, fleet.leader_holds_after_s)


def _consensus(fleet: FleetConfig, own_id: int, formation_hash: int, law_values: int) -> ConsensusStage:
    leadership = Leadership(
        own_id,
        [m.id for m in fleet.vehicles if m.role is Role.LEADER],
        [m.id for m in fleet.vehicles if m.can_lead],
    )
    peers = PeerTable(
        own_id,
        {m.id: m.can_lead for m in fleet.vehicles},
        formation_hash,
        fleet.peers.max_age_s,
        fleet_limits(fleet),
        fleet.successors,
    )
    leader, succession = BeaconMonitor(fleet.peers.leader_beacon_max_age_s), Succession(own_id, fleet.successors)
    rule = _neighbour_rule(fleet, own_id)
    return ConsensusStage(own_id, leadership, len(fleet.vehicles), peers, rule, leader, succession, law_values)


def _distant_peers(fleet: FleetConfig, own_id: int) -> DistantPeers:
    """Neighbours, leaders and successors are never distant."""
    at_full_rate = {m.id for m in fleet.vehicles if m.role is Role.LEADER}
    neighbours, range_m = fleet.neighbours, 0.0
    if isinstance(neighbours, EdgeNeighbours):
        at_full_rate.update(*(edge for edge in neighbours.edges if own_id in edge))
    else:
        range_m = neighbours.range_m + neighbours.hysteresis_m
    tilt_m_s2 = GRAVITY_M_S2 * tan(output_limits_of(fleet).max_tilt_rad)
    limits = DistantLimits(at_full_rate.union(fleet.successors), range_m, fleet.separation_m, tilt_m_s2)
    return DistantPeers(limits)


def _guidance(config: AgentConfig) -> GuidanceStage:
    fleet, own_id, reference = config.fleet, config.member.id, config.vehicle.reference
    has_height = fleet.law.altitude == "formation"
    limits = FormationLimits(
        fleet.separation_m, fleet.slot_speed_m_s, _fence(fleet), fleet.slots_turn, has_height, _beyond_box(fleet)
    )
    return GuidanceStage(
        own_id,
        slots=SlotPlan(own_id, {m.id: m.slot_enu_m for m in fleet.vehicles}, limits),
        heading=CourseHeading(fleet.slot_speed_m_s) if fleet.slots_turn else None,
        references=_references(fleet, reference, config.vehicle.drag_1_s) if reference else None,
        entry=_entry(fleet, own_id),
        gap_filling=GapFilling(own_id, limits) if fleet.when_one_leaves == "close_up" else None,
    )


def _entry(fleet: FleetConfig, own_id: int) -> FormationEntry:
    separation_m, speed_m_s = fleet.separation_m, fleet.slot_speed_m_s
    within_m = law_within_m(feedback_gains(law_of(fleet.law)), speed_m_s)
    has_height = fleet.law.altitude == "formation"
    return FormationEntry(
        own_id,
        together=FormingTogether(own_id, separation_m, speed_m_s, within_m, has_height),
        joining=Joining(own_id, separation_m, speed_m_s),
        lead_in=LeadIn(speed_m_s, within_m),
    )


def safety_filter_of(fleet: FleetConfig, own_id: int) -> SafetyFilter:
    """The safety filter of a vehicle of this fleet."""
    envelope = output_limits_of(fleet)
    limits = AccelerationLimits.of_envelope(
        tan(envelope.max_tilt_rad), envelope.min_thrust_ratio, envelope.max_thrust_ratio
    )
    return SafetyFilter(
        separation_settings_of(fleet, own_id), bounds_of(fleet), limits, feedback_gains(law_of(fleet.law))
    )


def bounds_of(fleet: FleetConfig) -> Bounds:
    """Airspace and speed limits of a fleet, for each vehicle of it."""
    speeds, braking_m_s2 = fleet.envelope, separation_settings_of(fleet, 0).braking_m_s2
    limit = SpeedLimit(speeds.max_speed_m_s, speeds.max_climb_m_s, speeds.max_descent_m_s)
    return Bounds(fleet.airspace, limit, braking_m_s2, vertical_braking_m_s2(fleet), fleet.takeoff_height_m)


def separation_settings_of(fleet: FleetConfig, own_id: int) -> SeparationSettings:
    """What a vehicle of this fleet keeps from others, and how it brakes before them."""
    braking_m_s2 = PLANNED_SHARE * GRAVITY_M_S2 * tan(output_limits_of(fleet).max_tilt_rad)
    return SeparationSettings(
        own_id, fleet.separation_m, braking_m_s2, fleet.peers.max_age_s, fleet.envelope.max_speed_m_s
    )


def vertical_braking_m_s2(fleet: FleetConfig) -> float:
    """The vertical acceleration with which a vehicle of this fleet plans to brake."""
    envelope = output_limits_of(fleet)
    return PLANNED_SHARE * GRAVITY_M_S2 * min(1.0 - envelope.min_thrust_ratio, envelope.max_thrust_ratio - 1.0)


def _setpoint(
    config: AgentConfig, law: Law, safety_filter: SafetyFilter, stream: SetpointStream, flown_for_s: float
) -> SetpointStage:
    section = config.fleet.law
    gains = section.altitude_hold_gains
    return SetpointStage(
        law=FlownLaw(law, config.vehicle.drag_1_s),
        law_flies_altitude=section.altitude == "formation",
        altitude_hold_gains=Gains(gains.position_1_s2, gains.velocity_1_s),
        safety_filter=safety_filter,
        stream=stream,
        flown_for_s=flown_for_s,
        drag_1_s=config.vehicle.drag_1_s,
    )


def flyable_checks(
    fleet: FleetConfig,
    reference: Reference,
    where: str = "reference",
    slots_enu_m: Mapping[int, Vector3] | None = None,
    drag_1_s: float = USUAL_DRAG_1_S,
) -> Iterator[Problem | None]:
    """`reference_checks`, and where they find nothing, whether the law follows without compressing the formation."""
    needs(reference)
    refused = False
    for problem in reference_checks(fleet, reference, where, slots_enu_m):
        refused = refused or problem is not None
        yield problem
    if not refused:
        slots = slots_enu_m or {member.id: member.slot_enu_m for member in fleet.vehicles}
        yield (yield from following_steps(fleet, law_of(fleet.law), reference, slots, drag_1_s, where))


flyable_problems = without_pauses(flyable_checks)


def check_agent(file: Path, config: AgentConfig) -> None:
    """Raises ConfigError where the law of the fleet cannot follow the reference of the vehicle file."""
    vehicle = config.vehicle
    if vehicle.reference is not None:
        refuse(file, flyable_problems(config.fleet, vehicle.reference, drag_1_s=vehicle.drag_1_s))


def _accepted(
    fleet: FleetConfig,
    described: Described,
    reference: Reference,
    problems: Sequence[Problem],
    slots_enu_m: Mapping[int, Vector3],
    drag_1_s: float,
) -> Steps[tuple[tuple[str, float], ...]]:
    """Values with which it passes all checks, those too that its problems kept from being made; () where none are known."""
    accepts: dict[str, float] = {}
    for _ in range(MOST_SLOWED):
        if not problems or not all(problem.accepts for problem in problems):
            break
        accepts |= accepted_values(reference, problems)
        try:
            reference = commanded(COMMANDED, {"reference": described | accepts})
        except ConfigError:  # beyond the bounds of a key
            return ()
        found = []
        for problem in flyable_checks(fleet, reference, slots_enu_m=slots_enu_m, drag_1_s=drag_1_s):
            if problem is None:
                yield
            else:
                found.append(problem)
        problems = found
    return () if problems else tuple(accepts.items())


def _references(fleet: FleetConfig, first: Reference, drag_1_s: float) -> ReferencePlan:
    speed_m_s, acceleration_m_s2 = most_pace(fleet)
    limits = BlendLimits(
        added_speed_m_s=fleet.hand_over_speed_m_s,
        added_acceleration_m_s2=fleet.hand_over_acceleration_m_s2,
        speed_m_s=speed_m_s,
        acceleration_m_s2=acceleration_m_s2,
        fence=_fence(fleet),
        slots_turn=fleet.slots_turn,
        airspace=_beyond_box(fleet),
    )

    def read(described: Described, slots_enu_m: Mapping[int, Vector3]) -> Steps[Rft | Notice]:
        """RFT of a command, after the checks of the vehicle file, or the refusal."""
        problems: list[Problem] = []
        accepts: tuple[tuple[str, float], ...] = ()
        try:
            reference = commanded(COMMANDED, {"reference": described})
            yield
            for problem in flyable_checks(fleet, reference, slots_enu_m=slots_enu_m, drag_1_s=drag_1_s):
                if problem is None:
                    yield
                else:
                    problems.append(problem)
            if problems:
                accepts = yield from _accepted(fleet, described, reference, problems, slots_enu_m, drag_1_s)
            refuse(COMMANDED, problems)
        except ConfigError as error:
            return Notice(Code.REFERENCE_INVALID, " ".join(str(error).split())[:LONGEST_REASON], accepts)
        return rft_of(reference)

    def refusal_of_slots(described: Described | None, slots_enu_m: Mapping[int, Vector3]) -> Steps[str | None]:
        """Why the law cannot fly these slots with the configured reference or with that of a command."""
        reference = first
        if described is not None:
            reference = commanded(COMMANDED, {"reference": described})
        problem = yield from following_steps(fleet, law_of(fleet.law), reference, slots_enu_m, drag_1_s)
        return None if problem is None else f"{problem.field}: {problem.text}"[:LONGEST_REASON]

    described = None if first.refusal_as_command() else convert(to_builtins(first), Described)
    return ReferencePlan(rft_of(first), described, read, refusal_of_slots, limits)


def _fence(fleet: FleetConfig) -> Box:
    """The box of the fence less the clearance."""
    envelope, c = fleet.envelope, fleet.envelope.clearance_m
    (x, y, z), (far_x, far_y, far_z) = envelope.fence_min_enu_m, envelope.fence_max_enu_m
    return (x + c, y + c, z + c), (far_x - c, far_y - c, far_z - c)


def _beyond_box(fleet: FleetConfig) -> Airspace | None:
    """The airspace where it is more than the box of the fence."""
    airspace = fleet.airspace
    return None if airspace.is_box else airspace


def rft_of(reference: Reference) -> Rft:
    """The RFT that the agent flies: a live one for a target, else a trajectory."""
    if not isinstance(reference, TargetReference):
        return trajectory_of(reference)
    return LiveReference(
        start_enu_m=reference.start_enu_m,
        name=reference.name,
        offset_enu_m=reference.offset_enu_m,
        follows_altitude=reference.follows_altitude,
        max_age_s=reference.max_age_s,
        limits=TargetLimits(reference.max_speed_m_s, reference.max_acceleration_m_s2),
    )


def trajectory_of(reference: Reference) -> ReferenceTrajectory:
    """The configured trajectory; for a target, the one before the first sample of it."""
    return along(reference.curve())


def _neighbour_rule(fleet: FleetConfig, own_id: int) -> NeighbourRule:
    if isinstance(fleet.neighbours, EdgeNeighbours):
        return EdgeRule(own_id, fleet.neighbours.edges)
    return RangeRule(fleet.neighbours.range_m, fleet.neighbours.hysteresis_m)


def profiles_of(fleet: FleetConfig) -> Profiles:
    """The profiles by which a vehicle of this fleet is checked before it flies."""
    return VISION_PROFILES if fleet.external_vision else PROFILES


def tracker_of(fleet: FleetConfig) -> VehicleTracker:
    """The tracker that maps the vehicle's local frame into the fleet frame."""
    bandwidth_1_s = fleet.law.velocity_correction_1_s
    return VehicleTracker(
        None if fleet.origin == "indoor" else fleet.origin.as_tuple(),
        height_from_takeoff=fleet.altitude_source == "takeoff",
        velocity_correction=VelocityCorrection(bandwidth_1_s) if bandwidth_1_s > 0.0 else None,
        vision_origin=SetOrigin(*fleet.external_vision.place.as_tuple()) if fleet.external_vision else None,
    )


def fleet_limits(fleet: FleetConfig) -> FleetLimits:
    """Limits on received states: the speed of `peers`, the acceleration by tilt and thrust, the size of the fence."""
    envelope = fleet.envelope
    level_m_s2 = envelope.max_thrust_ratio * GRAVITY_M_S2 * tan(radians(envelope.max_tilt_deg))
    upright_m_s2 = GRAVITY_M_S2 * max(envelope.max_thrust_ratio - 1.0, 1.0 - envelope.min_thrust_ratio)
    (x, y, z), (far_x, far_y, far_z) = _fence(fleet)
    size_m = (far_x - x, far_y - y, far_z - z)
    wind_is_observed = fleet.law.disturbance_bandwidth_1_s * UNFLOWN_S >= 1.0
    return FleetLimits(fleet.peers.max_speed_m_s, hypot(level_m_s2, upright_m_s2), size_m, wind_is_observed)


def output_limits_of(fleet: FleetConfig) -> OutputLimits:
    """Output limits from the envelope of the fleet file."""
    envelope = fleet.envelope
    return OutputLimits(
        max_tilt_rad=radians(envelope.max_tilt_deg),
        max_tilt_rate_rad_s=radians(envelope.max_tilt_rate_deg_s),
        min_thrust_ratio=envelope.min_thrust_ratio,
        max_thrust_ratio=envelope.max_thrust_ratio,
        max_thrust_rate_1_s=envelope.max_thrust_rate_1_s,
        fence=fleet.airspace.fence,
        max_speed_m_s=envelope.max_speed_m_s,
        max_climb_m_s=envelope.max_climb_m_s,
        max_descent_m_s=envelope.max_descent_m_s,
    )
