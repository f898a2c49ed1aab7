"""What a vehicle that lies must not do to the others: make them faster than their limits, or change who leads."""

from __future__ import annotations

from collections.abc import Collection, Sequence

import numpy as np
from msgspec import Struct
from numpy.lib.stride_tricks import sliding_window_view

from companion.config.fleet import Envelope
from companion.types.flight import Role
from sitl.flight.scenario import Scenario
from sitl.flight.virtual_vehicle import VirtualStandIn
from sitl.flight.watch import FlightWatch

LONGER_THAN = 51  # rows of the track in a row: more than a second at 50 Hz
SPEED_MARGIN_M_S = {"ideal": 0.3, "default": 0.4, "px4_sih": 0.7}
"""By which a true velocity may exceed a limit all the time: three sigmas, and what the last check lets pass."""


class Excess(Struct, frozen=True, kw_only=True):
    """The largest speed above a limit (horizontal, climb or descent) that lasted longer than a second; negative below it."""

    over_m_s: float
    time_s: float
    vehicle: int


def fastest(stand_ins: Sequence[VirtualStandIn], envelope: Envelope) -> Excess | None:
    """Of these vehicles, while agents command them; None where none was commanded for so long."""
    worst: Excess | None = None
    for stand_in in stand_ins:
        velocity_enu_m_s = stand_in.velocities_enu_m_s()
        if len(velocity_enu_m_s) < LONGER_THAN:
            continue
        level_m_s, up_m_s = np.hypot(velocity_enu_m_s[:, 0], velocity_enu_m_s[:, 1]), velocity_enu_m_s[:, 2]
        limits = (
            level_m_s - envelope.max_speed_m_s,
            up_m_s - envelope.max_climb_m_s,
            -up_m_s - envelope.max_descent_m_s,
        )
        over_m_s = np.where(stand_in.commanded(), np.max(limits, axis=0), -np.inf)
        lasting_m_s = sliding_window_view(over_m_s, LONGER_THAN).min(axis=1)
        row = int(lasting_m_s.argmax())
        over = float(lasting_m_s[row])
        if over > -np.inf and (worst is None or over > worst.over_m_s):
            time_s = round(float(stand_in.track().time_s[row]), 3)
            worst = Excess(over_m_s=round(over, 3), time_s=time_s, vehicle=stand_in.vehicle_id)
    return worst


class LeadTaken(Struct, frozen=True, kw_only=True):
    """A vehicle that led without a right to, or a leader that was deposed without a command."""

    vehicle: int
    time_s: float
    role: Role


def lead_taken(scenario: Scenario, watch: FlightWatch, liars: Collection[int]) -> LeadTaken | None:
    """The first change of the leader without a right to it.

    The right to have the leaders of the file, those of commands, and a liar that may lead; where a leader lies, its successors.
    """
    fleet = scenario.fleet
    first = {member.id for member in fleet.vehicles if member.role is Role.LEADER}
    named = {leader for step in scenario.timeline for leader in step.leaders or ()}
    may_lead = {member.id for member in fleet.vehicles if member.can_lead}
    free = {i for i in liars if i in may_lead}
    rightful = first | named | free | (set(fleet.successors) if free else set())
    for change in watch.topology:
        taken = change.role is Role.LEADER and change.vehicle not in rightful
        deposed = change.role is Role.FOLLOWER and change.vehicle in first and not named and not free
        if change.vehicle not in liars and (taken or deposed):
            return LeadTaken(vehicle=change.vehicle, time_s=change.time_s, role=change.role)
    return None
