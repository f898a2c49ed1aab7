"""Configuration -> Agent. Everything that can be chosen is chosen here, once, and never again in a tick."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from math import radians
from pathlib import Path
from typing import TypeVar

from companion.config.fleet import EdgeNeighbours, Envelope, FleetConfig
from companion.config.law import Law, LawName
from companion.config.reference import (
    Reference,
    ReferenceSection,
    TargetReference,
    check_reference,
    most_pace,
)
from companion.config.vehicle import AgentConfig
from companion.config_file import ConfigError, convert
from companion.core import formation
from companion.core.agent import Agent
from companion.core.battery import BatteryWatch
from companion.core.changes import Changes
from companion.core.closing_up import ClosingUp
from companion.core.command_desk import CommandDesk
from companion.core.control import FormationControl
from companion.core.cooperation import Cooperation
from companion.core.disturbance import DisturbanceObserver
from companion.core.envelope import EnvelopeLimits
from companion.core.fleet_checks import FleetChecks
from companion.core.flown_formation import FlownFormation
from companion.core.formation import FormationLaw, Gains
from companion.core.formation_limits import FormationLimits
from companion.core.hand_over import HandOverLimits
from companion.core.heading import CourseHeading, FixedHeading
from companion.core.health import AgeLimits
from companion.core.joining import Joining
from companion.core.leader_word import LeaderWatch
from companion.core.leadership import Leadership
from companion.core.neighbours import EdgeRule, NeighbourRule, RangeRule
from companion.core.obedience import Obedience
from companion.core.peers import PeerTable
from companion.core.phase import PhaseMachine
from companion.core.preflight import Preflight
from companion.core.pursuit import Box, PursuitLimits
from companion.core.reference import ReferenceTrajectory, along
from companion.core.reference_plan import LiveReference, ReferencePlan, Rft
from companion.core.safeguard import Safeguard
from companion.core.senses import Senses
from companion.core.setpoint_stream import SetpointStream
from companion.core.slot_plan import SlotPlan
from companion.core.steering import Steering
from companion.core.succession import HeldForWantOfALeader, Succession
from companion.core.telling import Identity, ToGround, ToPeers
from companion.core.vehicle_state import VehicleTracker
from companion.types import Described, Role, Vector3

Value = TypeVar("Value")
LAWS: dict[LawName, Callable[[], FormationLaw]] = {
    "cooperative": formation.cooperative,
    "weighted": formation.weighted,
    "average_22": formation.average_22,
    "average_26": formation.average_26,
}


COMMANDED = Path("command")  # stands where errors name a file
LONGEST_REASON = 300  # characters: a command's keys and values may be of any length


def build_agent(config: AgentConfig, session: int) -> Agent:
    """`session` is any number that differs from one start of this vehicle's agent to the next."""
    fleet, member, law, vehicle = config.fleet, config.member, config.fleet.law, config.vehicle
    identity = Identity(member.id, session, fleet.name, fleet.formation_hash(), law.name)
    machine, desk, ages = PhaseMachine(fleet.takeoff_height_m), CommandDesk(session), AgeLimits()
    observer = DisturbanceObserver(vehicle.hover_thrust_norm, vehicle.drag_1_s, law.disturbance_bandwidth_1_s)
    tracker, preflight = tracker_of(fleet), Preflight(observer)
    senses = Senses(tracker, preflight)
    envelope = envelope_limits(fleet.envelope)
    setpoints = SetpointStream(envelope, observer)
    cooperation = _cooperation(fleet, member.id, identity.formation_hash)
    peers, leadership = cooperation.peers, cooperation.leadership
    limits = FormationLimits(fleet.separation_m, fleet.slot_speed_m_s, _fence(fleet), fleet.slots_turn)
    formation = _formation(config, machine, peers, limits)
    closing_up = ClosingUp(member.id, limits) if fleet.when_one_leaves == "close_up" else None
    changes = Changes(member.id, machine, cooperation, formation, closing_up)
    held, battery = HeldForWantOfALeader(fleet.land_after_s), BatteryWatch(fleet.leave_below_percent)
    safeguard = Safeguard(machine, formation, setpoints, held, battery, ages, envelope)
    checks = FleetChecks(
        own_id=member.id,
        slots_have_height=law.altitude == "formation",
        ground_spread_m=fleet.ground_spread_m,
        separation_m=fleet.separation_m,
    )
    obedience = Obedience(desk, machine, cooperation, formation, preflight, safeguard, checks)
    steering = Steering(machine, formation, _control(law), setpoints)
    of_formation = (formation.slots, formation.references, closing_up)
    tellers = (desk, preflight, tracker, leadership, machine, *of_formation, changes, safeguard, obedience)
    events_of = [teller.events for teller in tellers if teller]
    to_peers = ToPeers(identity, machine, formation, changes, setpoints, ages.state_s)
    to_ground = ToGround(identity, machine, senses, peers, formation, setpoints, desk, checks, events_of)
    return Agent(machine, senses, obedience, cooperation, changes, formation, safeguard, steering, to_peers, to_ground)


def _cooperation(fleet: FleetConfig, own_id: int, formation_hash: int) -> Cooperation:
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
        fleet.peers.max_speed_m_s,
        fleet.successors,
    )
    leader, succession = LeaderWatch(fleet.peers.leader_word_max_age_s), Succession(own_id, fleet.successors)
    rule = _neighbour_rule(fleet, own_id)
    return Cooperation(own_id, leadership, len(fleet.vehicles), peers, rule, leader, succession)


def _formation(config: AgentConfig, machine: PhaseMachine, peers: PeerTable, limits: FormationLimits) -> FlownFormation:
    fleet, own_id, reference = config.fleet, config.member.id, config.vehicle.reference
    return FlownFormation(
        own_id,
        machine,
        peers,
        slots=SlotPlan(own_id, {m.id: m.slot_enu_m for m in fleet.vehicles}, limits),
        heading=CourseHeading(fleet.slot_speed_m_s) if fleet.slots_turn else FixedHeading(),
        references=_references(fleet, reference) if reference else None,
        joining=Joining(own_id, fleet.separation_m, fleet.slot_speed_m_s),
    )


def _control(law: Law) -> FormationControl:
    gains = law.altitude_hold_gains
    return FormationControl(
        law=law_of(law),
        law_flies_altitude=law.altitude == "formation",
        altitude_hold_gains=Gains(gains.position_1_s2, gains.velocity_1_s),
    )


def _references(fleet: FleetConfig, first: Reference) -> ReferencePlan:
    speed_m_s, acceleration_m_s2 = most_pace(fleet)
    limits = HandOverLimits(
        added_speed_m_s=fleet.hand_over_speed_m_s,
        added_acceleration_m_s2=fleet.hand_over_acceleration_m_s2,
        speed_m_s=speed_m_s,
        acceleration_m_s2=acceleration_m_s2,
        fence=_fence(fleet),
        slots_turn=fleet.slots_turn,
    )

    def read(described: Described, slots_enu_m: Mapping[int, Vector3]) -> Rft:
        """A command's reference goes through what a file's goes through."""
        try:
            reference = convert(COMMANDED, {"reference": described}, ReferenceSection).reference
            check_reference(COMMANDED, fleet, reference, slots_enu_m=slots_enu_m)
        except ConfigError as error:
            raise ValueError(" ".join(str(error).split())[:LONGEST_REASON]) from error
        return rft_of(reference)

    return ReferencePlan(rft_of(first), read, limits)


def _fence(fleet: FleetConfig) -> Box:
    return fleet.envelope.fence_min_enu_m, fleet.envelope.fence_max_enu_m


def rft_of(reference: Reference) -> Rft:
    """As it is flown."""
    if not isinstance(reference, TargetReference):
        return trajectory_of(reference)
    return LiveReference(
        start_enu_m=reference.start_enu_m,
        name=reference.name,
        offset_enu_m=reference.offset_enu_m,
        follows_altitude=reference.follows_altitude,
        max_age_s=reference.max_age_s,
        limits=PursuitLimits(reference.max_speed_m_s, reference.max_acceleration_m_s2),
    )


def trajectory_of(reference: Reference) -> ReferenceTrajectory:
    """The RFT that a file describes; of one that follows a target, as long as none is heard."""
    return along(reference.curve())


def law_of(law: Law) -> FormationLaw:
    """The law of that name with what a fleet file changes of it."""
    named, changed = LAWS[law.name](), law.gains
    return FormationLaw(
        gains=Gains(
            _first(changed.position_1_s2, named.gains.position_1_s2),
            _first(changed.velocity_1_s, named.gains.velocity_1_s),
        ),
        exponent=_first(law.exponent, named.exponent),
        leader_heeds_neighbours=_first(law.leader_heeds_neighbours, named.leader_heeds_neighbours),
        feedforward=_first(law.feedforward, named.feedforward),
    )


def _first(changed: Value | None, named: Value) -> Value:
    return named if changed is None else changed


def _neighbour_rule(fleet: FleetConfig, own_id: int) -> NeighbourRule:
    if isinstance(fleet.neighbours, EdgeNeighbours):
        return EdgeRule(own_id, fleet.neighbours.edges)
    return RangeRule(fleet.neighbours.range_m, fleet.neighbours.hysteresis_m)


def tracker_of(fleet: FleetConfig) -> VehicleTracker:
    """What maps a vehicle's own frame into this fleet's."""
    return VehicleTracker(
        None if fleet.origin == "indoor" else fleet.origin.as_tuple(),
        height_from_takeoff=fleet.altitude_source == "takeoff",
    )


def envelope_limits(envelope: Envelope) -> EnvelopeLimits:
    """The last gate's limits, as a fleet file has them."""
    return EnvelopeLimits(
        max_tilt_rad=radians(envelope.max_tilt_deg),
        max_tilt_rate_rad_s=radians(envelope.max_tilt_rate_deg_s),
        min_thrust_ratio=envelope.min_thrust_ratio,
        max_thrust_ratio=envelope.max_thrust_ratio,
        max_thrust_rate_1_s=envelope.max_thrust_rate_1_s,
        fence_min_enu_m=envelope.fence_min_enu_m,
        fence_max_enu_m=envelope.fence_max_enu_m,
    )
