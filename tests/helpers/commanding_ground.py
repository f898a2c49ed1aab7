"""A ground station that commands a fleet of real processes and keeps the reports."""

import time
from collections.abc import Callable

from companion.ground.session import FleetSession
from companion.types.commands import CommandName
from companion.types.flight import FlightPhase
from companion.types.status import Status


class Ground:
    """A ground station: commands to the fleet, and the newest status of every vehicle."""

    def __init__(self, session: FleetSession) -> None:
        self._session = session
        self.newest: dict[int, Status] = {}
        self.events: set[str] = set()
        self.received: list[tuple[float, Status]] = []

    def listen(self, seconds: float, enough: Callable[[], bool] = lambda: False) -> None:
        """Receive reports for this time, or until `enough`."""
        end_s = time.monotonic() + seconds
        while time.monotonic() < end_s and not enough():
            for report in self._session.drain():
                self.newest[report.status.vehicle_id] = report.status
                self.received.append((time.monotonic(), report.status))
                self.events.add(f"{report.status.vehicle_id}: {report.status.last_event}")
            time.sleep(0.02)

    def fly_to_formation(self, ids: tuple[int, ...]) -> None:
        for name, phase in (
            (CommandName.PREPARE, FlightPhase.READY),
            (CommandName.ARM, FlightPhase.ARMED),
            (CommandName.TAKEOFF, FlightPhase.HOLD),
            (CommandName.FORM, FlightPhase.FORMATION),
        ):
            self.order(name, phase, ids)

    def phases(self, ids: tuple[int, ...]) -> set[FlightPhase | None]:
        return {self.newest[i].phase if i in self.newest else None for i in ids}

    def order(self, name: CommandName, phase: FlightPhase, ids: tuple[int, ...], within_s: float = 40.0) -> None:
        """Repeat a command until every vehicle is in the phase that it leads to."""
        end_s = time.monotonic() + within_s
        while self.phases(ids) != {phase}:
            assert time.monotonic() < end_s, (name, self.newest)
            self._session.command([i for i in ids if self.phases((i,)) != {phase}], name, 0.5)
            self.listen(0.5, lambda: self.phases(ids) == {phase})
