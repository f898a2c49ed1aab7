"""One vehicle for the live page: its newest report, and its health flags with what the operator should do. Pure."""

from __future__ import annotations

from functools import lru_cache
from itertools import zip_longest

from companion.config.fleet import FleetConfig, FleetSettings
from companion.ground.fleet_state import SILENT_AFTER_S, ReportedVehicle, formation_text, reference_text
from companion.monitor.api import FlagView, NearestView, NeighbourView, Severity, TimingView, VehicleView
from companion.tools.explanations import action_words
from companion.types.code_table import code_entries
from companion.types.flight import FLAG_TEXTS, STREAMING, HealthFlag
from companion.types.status import Status
from companion.types.values import Vector3
from companion.wire.messages import Timing

NEVER_S = 1e5  # an agent without a position reports an age beyond this


def is_old(vehicle: VehicleView) -> bool:
    """Whether its position is none that holds now."""
    return vehicle.data_age_s is None or vehicle.data_age_s > SILENT_AFTER_S


def vehicle_view(vehicle: ReportedVehicle, report_rate_hz: float, fleet: FleetConfig | None) -> VehicleView:
    """`fleet` is None without the fleet file."""
    status = vehicle.status
    nearest, error, beacon = (
        status.safety.separation.nearest,
        status.motion.position_error,
        status.leadership.leader_beacon,
    )
    return VehicleView(
        fleet=status.agent.fleet,
        vehicle_id=status.agent.vehicle_id,
        silent=vehicle.silent,
        age_s=round(vehicle.age_s, 3),
        data_age_s=round(vehicle.data_age_s, 3) if vehicle.data_age_s < NEVER_S else None,
        report_rate_hz=round(report_rate_hz, 1),
        phase=status.phase,
        role=status.leadership.role,
        mode=status.autopilot.mode_name,
        armed=status.autopilot.armed,
        landed=status.autopilot.landed.name.lower(),
        position_enu_m=_in_mm(status.motion.position_enu_m),
        velocity_enu_m_s=_in_mm(status.motion.velocity_enu_m_s),
        position_error_m=(round(error.horizontal_m, 3), round(error.vertical_m, 3)) if error else None,
        battery_percent=None
        if status.autopilot.battery_percent is None
        else round(status.autopilot.battery_percent, 1),
        law=status.agent.law,
        prc=status.leadership.prc,
        epoch=status.leadership.epoch,
        leader_id=beacon.leader_id if beacon else None,
        leader_beacon_age_s=status.leadership.leader_beacon_age_s,
        neighbours=_neighbours(status),
        peers=status.neighbourhood.peers,
        slot_position_enu_m=_in_mm(vehicle.slot_position_enu_m) if vehicle.slot_position_enu_m else None,
        slot_offset_enu_m=_in_mm(status.formation.slot.position_enu_m),
        error_to_slot_m=None if vehicle.error_to_slot_m is None else round(vehicle.error_to_slot_m, 3),
        reference_enu_m=_in_mm(status.formation.reference_enu_m) if status.formation.reference_enu_m else None,
        formation=formation_text(status),
        reference=reference_text(status),
        holder=status.command.holder,
        flags=tuple(
            [flag_view(flag, status.autopilot.armed, status.phase in STREAMING, fleet) for flag in vehicle.flags]
        ),
        lacks=tuple(map(str, status.safety.lacks)),
        refuses_return=str(status.safety.refuses_return) if status.safety.refuses_return else None,
        nearest=(
            NearestView(
                nearest.name,
                round(nearest.distance_m, 3),
                round(nearest.required_m, 3),
                round(status.safety.separation.changed_m_s2, 3),
            )
            if nearest
            else None
        ),
        hover_thrust_norm=round(status.control.hover_thrust_norm, 4),
        wind_acceleration_enu_m_s2=_in_mm(status.control.disturbance_enu_m_s2),
        timing=_timing(vehicle.report.timing),
        network=status.network,
        recording=status.recording,
        rejected=vehicle.rejected,
        last_event=str(status.last_event) if status.last_event else None,
    )


def _in_mm(vector: Vector3) -> Vector3:
    """Rounded: half the bytes of a snapshot are digits below a millimetre."""
    x, y, z = vector
    return (round(x, 3), round(y, 3), round(z, 3))


def _neighbours(status: Status) -> tuple[NeighbourView, ...]:
    """A report of an older agent has neither weights nor ages."""
    known = len(status.neighbourhood.neighbours)
    return tuple(
        NeighbourView(
            vehicle_id, None if weight is None else round(weight, 4), None if age_s is None else round(age_s, 3)
        )
        for vehicle_id, weight, age_s in zip_longest(
            status.neighbourhood.neighbours,
            status.neighbourhood.weights[:known],
            status.neighbourhood.neighbour_ages_s[:known],
        )
    )


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
        action=action_words(flag, fleet),
        advice=advice_of(flag),
    )


def advice_of(code: str) -> str:
    """What the operator should do; "" where nothing is known of the code."""
    entry = code_entries().get(code)
    return entry.remedy if entry else ""
