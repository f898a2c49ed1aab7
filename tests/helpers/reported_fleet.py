"""Status reports of a fleet in flight, as the ground receives them."""

from __future__ import annotations

from msgspec.structs import replace

from companion.ground.fleet_state import FleetState, VehicleRow, fold, rows
from companion.types.autopilot import LandedState, PositionError
from companion.types.flight import FlightPhase, HealthFlag, Role
from companion.types.formation import FlownSlot, HeldReference
from companion.types.notices import Code, Notice
from companion.types.status import NearestVehicle, SeparationReport, Status
from companion.wire.messages import Percentiles, StatusReport, Timing

TIMING = Timing(50.0, 3000, 0, Percentiles(180.0, 950.0, 4000.0), Percentiles(600.0, 2100.0, 5000.0), 14.0, 49.0)
STATUS = Status(
    vehicle_id=1,
    session=1,
    fleet="platoon",
    formation_hash=5,
    law="weighted",
    phase=FlightPhase.FORMATION,
    mode_name="OFFBOARD",
    armed=True,
    landed=LandedState.IN_AIR,
    position_enu_m=(0.0, 0.0, 2.5),
    velocity_enu_m_s=(1.0, 0.0, 0.0),
    state_age_s=0.02,
    hover_thrust_norm=0.5,
    disturbance_enu_m_s2=(0.3, 0.4, 0.0),
    role=Role.FOLLOWER,
    epoch=0,
    prc=2,
    leader_beacon=None,
    leader_beacon_age_s=None,
    neighbours=(1,),
    slot=FlownSlot((0.0, 0.0, 0.0)),
    reference_enu_m=None,
    flags=(),
    rejected={},
    last_event=Notice(Code.PHASE_CHANGED, "engage -> formation"),
    holder="anna@ground",
    battery_percent=87.0,
    position_error=PositionError(0.4, 0.7),
)


def reported(vehicle_id: int, **changes: object) -> Status:
    """A follower in formation, 1.5 m behind the vehicle before it, without an error."""
    behind_enu_m = (-1.5 * (vehicle_id - 1), 0.0, 0.0)
    status = replace(
        STATUS,
        vehicle_id=vehicle_id,
        position_enu_m=(behind_enu_m[0], 0.0, 2.5),
        slot=FlownSlot(behind_enu_m),
        prc=vehicle_id,
        peers=(1, 2),
    )
    return replace(status, **changes)  # type: ignore[arg-type]


def leader(**changes: object) -> Status:
    """Vehicle 1 leads and flies at its reference."""
    leading = {"role": Role.LEADER, "prc": 1, "reference_enu_m": (0.0, 0.0, 2.5), "reference": HeldReference(3, 3)}
    return reported(1, **leading | changes)


def rows_of(*statuses: Status, silent: tuple[int, ...] = (), now_s: float = 100.04) -> list[VehicleRow]:
    """The rows 40 ms after the reports; those of `silent` vehicles came 4.2 s before."""
    state = FleetState()
    for status in statuses:
        received_s = 95.84 if status.vehicle_id in silent else 100.0
        state = fold(state, StatusReport(status, TIMING), received_s)
    return rows(state, now_s)


def troubled_fleet() -> list[VehicleRow]:
    """Five vehicles: a sound leader, one outside the fence with a late tick, one silent, one on the ground, one avoiding."""
    return rows_of(
        leader(),
        reported(2, flags=(HealthFlag.TICK_LATE, HealthFlag.OUTSIDE_FENCE), position_enu_m=(-1.4, 0.3, 2.5)),
        reported(3),
        reported(
            4,
            phase=FlightPhase.OBSERVE,
            mode_name="AUTO.LOITER",
            armed=False,
            landed=LandedState.ON_GROUND,
            battery_percent=None,
            lacks=(Notice(Code.BATTERY_UNKNOWN, "the autopilot does not report the battery"),),
        ),
        reported(
            250,
            position_enu_m=(-1300.0, -1234.5, 123.4),
            separation=SeparationReport(NearestVehicle("3", 1.23, 1.2), 0.5),
            slot=FlownSlot((-1.0, 2.0, 0.0), formation=12, moves_for_s=2.0),
            rejected={"PEER_LATE 2": 12345},
        ),
        silent=(3,),
    )


def large_fleet() -> list[VehicleRow]:
    """Fifty vehicles; 17 has a low battery, 33 is silent."""
    flagged = reported(17, flags=(HealthFlag.BATTERY_LOW,), battery_percent=21.0)
    others = (reported(i) for i in range(2, 51) if i != 17)
    return rows_of(leader(), flagged, *others, silent=(33,))
