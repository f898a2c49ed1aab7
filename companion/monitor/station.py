"""The ground station behind the server: reads its source, keeps the picture, publishes snapshots."""

from __future__ import annotations

import asyncio
import logging
from collections.abc import Callable, Iterator, Mapping, Sequence

import msgspec

from companion.config.fleet import FleetConfig
from companion.ground.fleet_state import ReportedVehicle
from companion.monitor.api import AlarmView, ClientMessage, FleetFileView, FlightView, History, Seek, Snapshot, Speed
from companion.monitor.events import NOTHING_GIVEN, Given, Happening, Kind
from companion.monitor.snapshot import Picture
from companion.monitor.sources import BEFORE_JUMP_S, Moment, ReplaySource, Source, TimedReport

PERIOD_S = 0.05
STEPS_PER_SNAPSHOT = 2
CONNECTIONS_EVERY_S = 3.0
RETRACED_S = 300.0  # before the time that a replay jumps to: of alarms, events and history
RETRACE_STEP_S = 0.5
FLIGHT_EVENTS_KEPT = 20_000
BEGUN_S = 1.0  # after the begin of a flight all of its vehicles have reported
FAR_BEHIND_S = 1.0  # after a pause of this process steps are left out, not made up for

_log = logging.getLogger(__name__)
_encoder = msgspec.json.Encoder()


Listener = Callable[[Sequence[TimedReport], float], None]
View = Callable[[Sequence[ReportedVehicle], float], None]


class Station:
    """`publish` gets every snapshot, encoded once, with the events since the one before.

    `listeners` get the new reports at every reading, `views` the vehicles, with the time on their clock. They do not block.
    """

    def __init__(
        self,
        source: Source,
        fleets: Mapping[str, FleetConfig],
        operator: str,
        commands: str = "",
        endpoints_are_guessed: bool = False,
    ) -> None:
        """With `endpoints_are_guessed` those that are not reached are shown while no vehicle reports."""
        self._source = source
        self._guessed = endpoints_are_guessed
        self._picture = Picture(fleets, operator, commands)
        self._fleets = fleets
        self._flight: asyncio.Task[FlightView] | None = None
        self._connected: tuple[str, ...] = ()
        self._unreachable: tuple[str, ...] = ()
        self._published_event = 0
        self._sought_s: float | None = None
        self.fleet_names = tuple(fleets)
        self.listeners: list[Listener] = []
        self.views: list[View] = []
        self.publish: Callable[[bytes], None] = lambda _snapshot: None
        self.newest = self._snapshot(source.moment())

    async def run(self) -> None:
        """Without end: reads every 50 ms, publishes every 100 ms."""
        looking = asyncio.create_task(self._look_at_connections())
        try:
            await self._steps()
        finally:
            looking.cancel()

    async def _steps(self) -> None:
        loop = asyncio.get_running_loop()
        due_s, step = loop.time(), 0
        while True:
            self.read()
            step += 1
            if step % STEPS_PER_SNAPSHOT == 0:
                self.renew()
            due_s = max(due_s + PERIOD_S, loop.time() - FAR_BEHIND_S)
            await asyncio.sleep(max(0.0, due_s - loop.time()))

    def read(self) -> None:
        """Take in what has come since the last call."""
        if self._sought_s is not None and isinstance(self._source, ReplaySource):
            self._jump(self._source, self._sought_s)
        self._sought_s = None
        moment, reports = self._take_in()
        for listen in self.listeners:
            listen(reports, moment.now_s)
        for show in self.views:
            show(self._picture.reported(moment.now_s), moment.now_s)

    def _take_in(self) -> tuple[Moment, list[TimedReport]]:
        moment, reports = self._source.moment(), self._source.drain()
        self._picture.receive(reports, moment.time_s - moment.now_s)
        for happening in self._source.drain_happenings():
            self._picture.events.add(happening)
        return moment, reports

    def _jump(self, source: ReplaySource, time_s: float) -> None:
        """Fold what came before this time, so that alarms have their true begin.

        Blocks: five minutes take 0.2 s with four vehicles, 0.5 s with 16, 1.7 s with 50.
        """
        source.seek(time_s)
        end_s = source.moment().time_s
        begin_s = max(end_s - RETRACED_S, source.replay.begin_s)
        source.seek(begin_s)
        self._picture.jump(begin_s - BEFORE_JUMP_S)
        for _ in self._play(source, begin_s, end_s):
            pass
        source.go_on(end_s)

    def _play(self, source: ReplaySource, begin_s: float, end_s: float) -> Iterator[Snapshot]:
        """At once, step by step."""
        for step in range(int((end_s - begin_s) / RETRACE_STEP_S) + 1):
            source.go_on(begin_s + step * RETRACE_STEP_S)
            self._take_in()
            yield self._snapshot(source.moment())

    def renew(self) -> None:
        """Take and publish the snapshot of this moment."""
        self.newest = self._snapshot(self._source.moment())
        events = self._picture.events
        new = events.after(self._published_event)
        self._published_event = events.last_id
        sent = msgspec.structs.replace(self.newest, events=new) if new else self.newest
        self.publish(_encoder.encode(sent))

    def _snapshot(self, moment: Moment) -> Snapshot:
        replay = self._source.replay if isinstance(self._source, ReplaySource) else None
        unreachable = () if self._guessed and self._picture.has_vehicles else self._unreachable
        return self._picture.snapshot(*moment, self._connected, unreachable, replay)

    async def _look_at_connections(self) -> None:
        """In a thread: to reach an endpoint may take a second."""
        failed = False
        while True:
            try:
                self._connected, self._unreachable = await asyncio.to_thread(self._source.connections)
                failed = False
            except Exception:  # noqa: BLE001 -- Zenoh's; the picture goes on without it
                if not failed:  # logged once, until it works again
                    _log.exception("the connections to the vehicles cannot be looked at")
                failed = True
            await asyncio.sleep(CONNECTIONS_EVERY_S)

    def act(self, message: ClientMessage) -> None:
        """What a client asks of a replay. Without effect on live vehicles."""
        source = self._source
        if not isinstance(source, ReplaySource):
            return
        match message:
            case Seek(time_s):
                self._sought_s = time_s  # at the next reading: a slider that is dragged asks for many
            case Speed(speed):
                source.set_speed(speed)

    def acknowledge(self, alarm_id: int) -> AlarmView | None:
        """None where there is no alarm with this id."""
        return self._picture.alarms.acknowledge(alarm_id)

    def log(
        self, fleet: str, vehicle_id: int | None, kind: Kind, code: str, text: str, given: Given = NOTHING_GIVEN
    ) -> None:
        """An event that this program knows of: a command, an answer."""
        self._picture.events.add(Happening(self._source.moment().time_s, fleet, vehicle_id, kind, code, text, given))

    def history(self) -> History:
        return self._picture.history()

    async def flight(self) -> FlightView | None:
        """None of live vehicles. The first call looks through all of the flight, in a thread, for as long as jumps take."""
        if not isinstance(self._source, ReplaySource):
            return None
        if self._flight is None:
            self._flight = asyncio.create_task(asyncio.to_thread(flight_of, self._source.again(), self._fleets))
        return await asyncio.shield(self._flight)

    def fleet_map(self, name: str) -> FleetFileView | None:
        """None without the fleet file of this fleet."""
        return self._picture.fleet_map(name)


def flight_of(source: ReplaySource, fleets: Mapping[str, FleetConfig]) -> FlightView:
    """By the same steps as the replay itself. `source` is at its begin."""
    station = Station(source, fleets, "")
    station._picture = Picture(fleets, "", events_kept=FLIGHT_EVENTS_KEPT)
    leader_ids: dict[str, tuple[int, ...]] = {}
    for snapshot in station._play(source, source.replay.begin_s, source.replay.end_s + RETRACE_STEP_S):
        if snapshot.time_s <= source.replay.begin_s + BEGUN_S:
            leader_ids = {fleet.name: fleet.leader_ids for fleet in snapshot.fleets}
    return FlightView(station._picture.events.all(), leader_ids)
