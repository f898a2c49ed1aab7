"""Snapshots of the monitor, as its interface gives them."""

from __future__ import annotations

from msgspec.structs import replace

from companion.monitor.api import AlarmView, FlagView, FleetView, NearestView, Snapshot, TimingView, VehicleView
from companion.types.status import NetworkState
from companion.types.values import ZERO3

VEHICLE = VehicleView(
    fleet="platoon",
    vehicle_id=1,
    silent=False,
    age_s=0.04,
    data_age_s=0.06,
    report_rate_hz=10.0,
    phase="formation",
    role="leader",
    mode="OFFBOARD",
    armed=True,
    landed="IN_AIR",
    position_enu_m=(1.0, 2.0, 2.5),
    velocity_enu_m_s=(3.0, 4.0, 0.0),
    position_error_m=(0.4, 0.7),
    battery_percent=87.0,
    law="weighted",
    prc=1,
    epoch=0,
    leader_id=1,
    leader_beacon_age_s=0.1,
    neighbours=(),
    peers=(2, 3),
    slot_position_enu_m=ZERO3,
    slot_offset_enu_m=ZERO3,
    error_to_slot_m=0.13,
    reference_enu_m=ZERO3,
    formation="1",
    reference="3",
    holder="anna@ground",
    flags=(FlagView("TICK_LATE", "warning", "late", "warn", "end other programs"),),
    lacks=(),
    refuses_return=None,
    nearest=NearestView("2", 1.5, 1.2, 0.0),
    hover_thrust_norm=0.5,
    wind_acceleration_enu_m_s2=ZERO3,
    timing=TimingView(50.0, 3, 0.2, 0.9, 4.0, 0.6, 2.1, 14.0, 49.0),
    network=NetworkState(),
    rejected=7,
    last_event=None,
)
FLEET = FleetView(
    name="platoon",
    vehicle_ids=(1, 2),
    missing_ids=(),
    leader_ids=(1,),
    smallest_separation_m=1.5,
    smallest_separation_pair=(1, 2),
    smallest_separation_unheard=False,
    separation_trend_m_s=-0.1,
    lambda_min=None,
    settling_s=None,
    link_margin_m=None,
    link_margin_pair=None,
    data_age_worst_s=0.06,
)
ALARM = AlarmView(
    id=1,
    fleet="platoon",
    vehicle_id=2,
    code="SILENT",
    severity="critical",
    text="",
    advice="",
    since_s=0.0,
    until_s=None,
    acknowledged=False,
    first_s=0.0,
)


def vehicle(vehicle_id: int, **changes: object) -> VehicleView:
    return replace(VEHICLE, vehicle_id=vehicle_id, **changes)  # type: ignore[arg-type]


def snapshot(*vehicles: VehicleView, **changes: object) -> Snapshot:
    plain = Snapshot(
        number=1,
        time_s=1_700_000_000.0,
        may_control=False,
        operator="anna@ground",
        connected=(),
        unreachable=("tcp/127.0.0.1:7448",),
        vehicles=vehicles,
        fleets=(FLEET,),
        alarms=(ALARM,),
    )
    return replace(plain, **changes)  # type: ignore[arg-type]
