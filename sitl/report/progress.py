"""The live view of a flight: a headline and one line per vehicle."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from types import TracebackType
from typing import Self, TextIO

from companion.ground.fleet_state import VehicleRow
from companion.types.flight import WITHOUT_LEADER, FlightPhase
from sitl.report.screen import Screen

VIEW_EVERY_S = 5.0
LONGEST_AGE_S = 1e5  # above: no data has come yet
NEEDS_A_LEADER = (FlightPhase.HOLD, FlightPhase.ENGAGE, FlightPhase.FORMATION, FlightPhase.RELEASE)


class FlightProgress:
    """Shows one flight. Its times are arguments, because it may fly in virtual time. `quiet` shows nothing."""

    def __init__(self, name: str, quiet: bool, began_s: float, out: TextIO | None = None) -> None:
        self._name = name
        self._screen = Screen(quiet, out or sys.stdout, VIEW_EVERY_S, transient=False)
        self._screen.make_due()
        self._began_s = began_s
        self._step, self._step_began_s, self._step_lasts_s = "starting", self._began_s, 0.0
        self._remark = ""

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, value: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._screen.close()

    def begin_step(self, step: str, since_s: float, lasts_s: float = 0.0) -> None:
        """`lasts_s` is 0 if the duration is unknown."""
        self._screen.make_due()  # shown at once, however short the step before was
        self._step, self._step_began_s, self._step_lasts_s = step, since_s, lasts_s

    def remark(self, text: str) -> None:
        """A line below the headline until the next remark; "" removes it."""
        self._remark = text

    def is_due(self) -> bool:
        """Whether it is time to refresh."""
        return self._screen.is_due()

    def show(self, rows: Sequence[VehicleRow], now_s: float) -> None:
        """Refresh the view."""
        remark = [f"  {self._remark}"] if self._remark else []
        self._screen.show([self._headline(now_s), *remark, *(vehicle_line(row) for row in rows)])

    def _headline(self, now_s: float) -> str:
        total = f" of {self._step_lasts_s:g}" if self._step_lasts_s else ""
        step_s = max(0.0, now_s - self._step_began_s)
        return f"{self._name}   {self._step}   {step_s:.1f}{total} s   (flight {now_s - self._began_s:.0f} s)"


def vehicle_line(row: VehicleRow) -> str:
    """A vehicle's id, role, phase, altitude, error to its slot, PrC and age of its data."""
    error = "   -  " if row.error_to_slot_m is None else f"{row.error_to_slot_m:4.2f} m"
    age = f"{row.data_age_s * 1000:3.0f} ms old" if row.data_age_s < LONGEST_AGE_S else "  -"
    data = f"SILENT for {row.age_s:.1f} s" if row.silent else f"data {age}"
    flags = [flag for flag in row.flags if flag not in WITHOUT_LEADER or row.phase in NEEDS_A_LEADER]
    alarm = f"   ! {', '.join(flags)}" if flags else ""
    return (
        f"  UAV {row.vehicle_id:<3d} {row.role:<8}  {row.phase:<9}  altitude {row.altitude_m:5.2f} m"
        f"   error {error}   PrC {row.prc}   {data}{alarm}"
    )
