"""The decision of a tick, flat and rounded: what is plotted of a flight. No part of it is fed to an agent again."""

from __future__ import annotations

from math import degrees, inf

from companion.core.agent import Decision
from companion.core.consensus.law import FormationLaw, used_weights
from companion.geometry.vectors import rounded
from companion.recording.records import DecisionRecord
from companion.types.flight import Role
from companion.wire.rounding import ACCELERATION, LENGTH, VELOCITY


def decision_record(decision: Decision, law: FormationLaw) -> DecisionRecord:
    """The record of a decision under this law.

    The own state has as many decimals as in the peer packet: the same text again costs a recording nothing.
    """
    vehicle, consensus, guidance, setpoint = (
        decision.perception.vehicle,
        decision.consensus,
        decision.guidance,
        decision.setpoint,
    )
    target, separation, reference, now_s = setpoint.target, setpoint.separation, guidance.reference, decision.now_s
    nearest, battery_percent = separation.nearest, decision.perception.fitness.battery_percent
    role, leader = consensus.role, consensus.leader_beacon
    ids, located = consensus.neighbour_ids, vehicle.position_time_s > -inf
    return DecisionRecord(
        now_s=round(now_s, 6),
        phase=decision.flight.phase.value,
        role=role.value,
        leader_id=leader.leader_id if leader else None,
        epoch=consensus.epoch,
        prc=consensus.prc,
        position_enu_m=rounded(vehicle.position_enu_m, LENGTH) if located else None,
        velocity_enu_m_s=rounded(vehicle.velocity_enu_m_s, VELOCITY) if located else None,
        slot_offset_enu_m=rounded(guidance.slot.position_enu_m, 3),
        reference_enu_m=rounded(reference.position_enu_m, 3) if reference and role is Role.LEADER else None,
        neighbours=ids,
        weights=tuple([round(w, 4) for w in used_weights(law, role is Role.LEADER, consensus.neighbour_prcs)]),
        peer_ages_s=tuple([round(now_s - consensus.newest[i].measured_s, 3) for i in ids]),
        acceleration_enu_m_s2=rounded(setpoint.acceleration_enu_m_s2, ACCELERATION),
        roll_deg=round(degrees(target.roll_rad), 1) if target else None,
        pitch_deg=round(degrees(target.pitch_rad), 1) if target else None,
        yaw_deg=round(degrees(target.yaw_rad), 1) if target else None,
        thrust_norm=round(target.thrust_norm, 3) if target else None,
        nearest=nearest.name if nearest else "",
        nearest_m=round(nearest.distance_m, 2) if nearest else None,
        required_m=round(nearest.required_m, 2) if nearest else None,
        filter_changed_m_s2=round(separation.changed_m_s2, 3),
        wind_acceleration_enu_m_s2=rounded(setpoint.disturbance_enu_m_s2, 2),
        hover_thrust_norm=round(setpoint.hover_thrust_norm, 3),
        battery_percent=battery_percent,
        flags=tuple(sorted(decision.safety.flags)),
    )
