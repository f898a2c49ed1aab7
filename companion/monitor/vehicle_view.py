"""One vehicle for the live page: its newest report, and its health flags with what the operator should do. Pure."""

from __future__ import annotations

from functools import lru_cache
from itertools import zip_longest

from companion.config.fleet import FleetConfig, FleetSettings
from companion.geometry.vectors import rounded
from companion.ground.fleet_state import SILENT_AFTER_S, ReportedVehicle, formation_text, reference_text
from companion.monitor.api import FlagView, NearestView, NeighbourView, Severity, TimingView, VehicleView
from companion.tools.explanations import action_words
from companion.types.code_table import code_entries
from companion.types.flight import FLAG_TEXTS, STREAMING, HealthFlag
from companion.types.status import NearestVehicle, NeighbourReport
from companion.types.values import Vector3
from companion.wire.messages import Timing

MM = 3  # decimals of metres: half the bytes of a snapshot would be digits below a millimetre
ON_GROUND = "does nothing while disarmed"  # the action: the failsafes are of a flight
NEVER_S = 1e5  # an agent without a position reports an age beyond this


def is_old(vehicle: VehicleView) -> bool:
    """Whether its position is none that holds now."""
    return vehicle.data_age_s is None or vehicle.data_age_s > SILENT_AFTER_S


def fresh_position_enu_m(vehicle: VehicleView) -> Vector3 | None:
    """Its position where that holds now."""
    return None if is_old(vehicle) else vehicle.position_enu_m


def vehicle_view(vehicle: ReportedVehicle, report_rate_hz: float, fleet: FleetConfig | None) -> VehicleView:
    """`fleet` is None without the fleet file."""
    status = vehicle.status
    agent, autopilot, motion, safety = status.agent, status.autopilot, status.motion, status.safety
    lead, formation, control = status.leadership, status.formation, status.control
    nearest, error, beacon = safety.separation.nearest, motion.position_error, lead.leader_beacon
    streaming = status.phase in STREAMING
    return VehicleView(
        fleet=agent.fleet,
        vehicle_id=agent.vehicle_id,
        silent=vehicle.silent,
        age_s=round(vehicle.age_s, 3),
        data_age_s=round(vehicle.data_age_s, 3) if vehicle.data_age_s < NEVER_S else None,
        report_rate_hz=round(report_rate_hz, 1),
        phase=status.phase,
        role=lead.role,
        mode=autopilot.mode_name,
        armed=autopilot.armed,
        landed=autopilot.landed.name.lower(),
        position_enu_m=rounded(motion.position_enu_m, MM) if motion.is_known else None,
        velocity_enu_m_s=rounded(motion.velocity_enu_m_s, MM) if motion.is_known else None,
        position_error_m=(round(error.horizontal_m, MM), round(error.vertical_m, MM)) if error else None,
        battery_percent=_known(autopilot.battery_percent, 1),
        law=agent.law,
        prc=lead.prc,
        epoch=lead.epoch,
        leader_id=beacon.leader_id if beacon else None,
        leader_beacon_age_s=lead.leader_beacon_age_s,
        neighbours=_neighbours(status.neighbourhood),
        peers=status.neighbourhood.peers,
        slot_position_enu_m=rounded(vehicle.slot_position_enu_m, MM) if vehicle.slot_position_enu_m else None,
        slot_offset_enu_m=rounded(formation.slot.position_enu_m, MM),
        error_to_slot_m=_known(vehicle.error_to_slot_m, MM),
        reference_enu_m=rounded(formation.reference_enu_m, MM) if formation.reference_enu_m else None,
        formation=formation_text(status),
        reference=reference_text(status),
        holder=status.command.holder,
        flags=tuple([flag_view(flag, autopilot.armed, streaming, fleet) for flag in vehicle.flags]),
        lacks=tuple(map(str, safety.lacks)),
        refuses_return=str(safety.refuses_return) if safety.refuses_return else None,
        nearest=_nearest(nearest, safety.separation.changed_m_s2) if nearest else None,
        hover_thrust_norm=round(control.hover_thrust_norm, 4),
        wind_acceleration_enu_m_s2=rounded(control.disturbance_enu_m_s2, MM),
        timing=_timing(vehicle.report.timing),
        network=status.network,
        recording=status.recording,
        rejected=vehicle.rejected,
        last_event=str(status.last_event) if status.last_event else None,
    )


def _known(value: float | None, digits: int) -> float | None:
    return None if value is None else round(value, digits)


def _nearest(nearest: NearestVehicle, changed_m_s2: float) -> NearestView:
    distance_m, required_m = round(nearest.distance_m, MM), round(nearest.required_m, MM)
    return NearestView(nearest.name, distance_m, required_m, round(changed_m_s2, MM))


def _neighbours(reported: NeighbourReport) -> tuple[NeighbourView, ...]:
    """Without weights where the law tells none."""
    ids, known = reported.neighbours, len(reported.neighbours)
    rows = zip_longest(ids, reported.weights[:known], reported.neighbour_ages_s[:known])
    return tuple(NeighbourView(i, _known(weight, 4), _known(age_s, 3)) for i, weight, age_s in rows)


def _timing(timing: Timing) -> TimingView:
    late, to_command = timing.late_us, timing.telemetry_to_command_us
    return TimingView(
        rate_hz=round(timing.rate_hz, 1),
        missed=timing.missed,
        late_p50_ms=round(late.p50 / 1e3, 3),
        late_p99_ms=round(late.p99 / 1e3, 3),
        late_max_ms=round(late.max / 1e3, 3),
        telemetry_to_command_p50_ms=round(to_command.p50 / 1e3, 3),
        telemetry_to_command_p99_ms=round(to_command.p99 / 1e3, 3),
        cpu_percent=round(timing.cpu_percent, 1),
        memory_mb=round(timing.rss_mb, 1),
    )


def severity_of(flag: HealthFlag, armed: bool, streaming: bool) -> Severity:
    """On the ground a flag only keeps a vehicle from flying."""
    entry = code_entries()[flag]
    counts = armed and (streaming or not entry.in_formation_only)
    return entry.severity if counts else "warning"


@lru_cache(maxsize=1024)
def flag_view(flag: HealthFlag, armed: bool, streaming: bool, fleet: FleetSettings | None) -> FlagView:
    """A flag of a vehicle of this fleet. `streaming`: its agent sends setpoints."""
    return FlagView(
        code=flag,
        severity=severity_of(flag, armed, streaming),
        text=FLAG_TEXTS[flag],
        action=action_words(flag, fleet) if armed else ON_GROUND,
        advice=advice_of(flag),
    )


def advice_of(code: str) -> str:
    """What the operator should do; "" where nothing is known of the code."""
    entry = code_entries().get(code)
    return entry.remedy if entry else ""
