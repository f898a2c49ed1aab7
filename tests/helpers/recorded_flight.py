"""Recorders for flights in virtual time: all reports of the vehicles, and all setpoints that their agents send."""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeVar

from companion.types.autopilot import AttitudeTarget
from companion.types.status import Status
from companion.wire.messages import StatusReport
from sitl.flight.files import ids_of
from sitl.flight.lockstep import Lockstep
from sitl.flight.scenario import Scenario
from sitl.flight.watch import FlightWatch

Recorded = TypeVar("Recorded")


class Recorder(FlightWatch):
    """A FlightWatch that keeps every report with its time of receipt."""

    def __init__(self, scenario: Scenario) -> None:
        super().__init__(ids_of(scenario), [1], 0.0)
        self.reports: list[tuple[float, Status]] = []

    def receive(self, report: StatusReport, now_s: float) -> None:
        super().receive(report, now_s)
        self.reports.append((now_s, report.status))


def record_targets(lockstep: Lockstep) -> dict[int, list[tuple[float, AttitudeTarget]]]:
    """Setpoints by vehicle id with their times; the lists grow during the flight."""
    return record_at_setpoints(lockstep, lambda _vehicle_id, target: target)


def record_at_setpoints(
    lockstep: Lockstep, value_of: Callable[[int, AttitudeTarget], Recorded]
) -> dict[int, list[tuple[float, Recorded]]]:
    """`value_of(vehicle_id, setpoint)` at every setpoint, by vehicle id, with its time."""
    recorded: dict[int, list[tuple[float, Recorded]]] = {}
    for vehicle_id, vehicle in lockstep._vehicles.items():
        rows, follow = recorded.setdefault(vehicle_id, []), vehicle.link.command

        def command(target, now_s, vehicle_id=vehicle_id, rows=rows, follow=follow):  # type: ignore[no-untyped-def]
            rows.append((now_s, value_of(vehicle_id, target)))
            follow(target, now_s)

        vehicle.link.command = command  # type: ignore[method-assign]
    return recorded
