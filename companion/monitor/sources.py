"""Where reports come from: the vehicles, over Zenoh, or a recorded flight."""

from __future__ import annotations

import time
from bisect import bisect_left, bisect_right
from collections.abc import Callable, Sequence
from math import inf
from typing import NamedTuple, Protocol

from companion.ground.current_fleet import unreachable
from companion.ground.fleet_state import VehicleKey
from companion.ground.session import FleetSession
from companion.monitor.api import ReplayView
from companion.monitor.events import Happening, describe_reply
from companion.types.rejections import rejection_text
from companion.wire.messages import StatusReport

TimedReport = tuple[float, StatusReport]
BEFORE_JUMP_S = 2.0  # after a jump in a replay these reports are read, for rates and changes
REFUSED_EVERY_S = 60.0
NO_FLEET = ""  # stands for the fleet in an event that concerns no known fleet
MOST_AT_ONCE = 20_000  # reports in one call


class Moment(NamedTuple):
    """One time on two clocks: that of the reports, which never jumps in a flight, and Unix time."""

    now_s: float
    time_s: float


class Source(Protocol):
    """Reports of vehicles with their times of arrival. No method blocks but `connections`."""

    def moment(self) -> Moment: ...

    def drain(self) -> list[TimedReport]:
        """The reports since the last call, in order."""

    def drain_happenings(self) -> list[Happening]:
        """What happened besides since the last call: answers to other operators, or what was recorded."""

    def connections(self) -> tuple[tuple[str, ...], tuple[str, ...]]:
        """Endpoints that are reached, and those that are not, with the reason. May take a second."""


class LiveSource:
    """The vehicles that a session is connected to. A lost connection comes back by itself."""

    def __init__(self, session: FleetSession, endpoints: Sequence[str]) -> None:
        self._session = session
        self._endpoints = endpoints
        self._refused: dict[str, float] = {}  # code of refused reports -> when it was last told

    def moment(self) -> Moment:
        return Moment(time.monotonic(), time.time())

    def drain(self) -> list[TimedReport]:
        now_s = time.monotonic()
        return [(now_s, report) for report in self._session.drain()]

    def drain_happenings(self) -> list[Happening]:
        """Answers that a command of this program waits for are left out: they are logged with it."""
        answers = [describe_reply(time.time(), fleet, reply) for fleet, reply in self._session.drain_other_replies()]
        return answers + self._refusals(time.monotonic())

    def _refusals(self, now_s: float) -> list[Happening]:
        """One event per code and REFUSED_EVERY_S: a vehicle with another version of this software is not seen otherwise."""
        happened, rejected = [], self._session.rejected
        for code in list(rejected):
            if now_s - self._refused.get(code, -inf) < REFUSED_EVERY_S:
                continue
            self._refused[code] = now_s
            text = f"{rejected.pop(code)} reports or answers refused: {rejection_text(code)}"
            happened.append(Happening(time.time(), NO_FLEET, None, "event", code, text))
        return happened

    def connections(self) -> tuple[tuple[str, ...], tuple[str, ...]]:
        failed = unreachable(self._endpoints, self._session.linked())
        reached = tuple(endpoint for endpoint in self._endpoints if endpoint not in failed)
        return reached, tuple(f"{endpoint}: {reason}" for endpoint, reason in failed.items())


class ReplaySource:
    """Recorded reports, played again. Times are those of the flight, Unix time; `clock` is the machine's, monotonic."""

    def __init__(
        self,
        reports: Sequence[TimedReport],
        happenings: Sequence[Happening] = (),
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        """Both in rising order of time; at least one report."""
        self._happenings = happenings
        self._happening_times = [happening.time_s for happening in happenings]
        self._next_happening = 0
        self._reports = reports
        self._times = [time_s for time_s, _ in reports]
        self._of_vehicle: dict[VehicleKey, list[int]] = {}  # indices of its reports
        for index, (_, report) in enumerate(reports):
            self._of_vehicle.setdefault((report.status.agent.fleet, report.status.agent.vehicle_id), []).append(index)
        self._clock = clock
        self._speed = 1.0
        self._next = 0  # the first report that has not been played
        self._before_jump: list[TimedReport] = []
        self._from = Moment(clock(), self._times[0])  # machine's clock and time of the flight

    def again(self) -> ReplaySource:
        """The same flight from its begin, paused. It shares what was recorded."""
        return ReplaySource(self._reports, self._happenings, lambda: 0.0)

    @property
    def replay(self) -> ReplayView:
        return ReplayView(self._times[0], self._times[-1], self.moment().time_s, self._speed)

    def moment(self) -> Moment:
        """It stops at the end."""
        flown_s = self._from.time_s + (self._clock() - self._from.now_s) * self._speed
        time_s = min(flown_s, self._times[-1])
        return Moment(time_s, time_s)

    def drain(self) -> list[TimedReport]:
        end = min(bisect_right(self._times, self.moment().time_s), self._next + MOST_AT_ONCE)
        played = list(self._reports[self._next : max(end, self._next)])
        self._next += len(played)
        before, self._before_jump = self._before_jump, []
        return before + played

    def drain_happenings(self) -> list[Happening]:
        end = bisect_right(self._happening_times, self.moment().time_s)
        played = list(self._happenings[self._next_happening : end])
        self._next_happening = max(end, self._next_happening)
        return played

    def connections(self) -> tuple[tuple[str, ...], tuple[str, ...]]:
        return (), ()

    def seek(self, time_s: float) -> None:
        """Go on from this time. The next `drain` begins with the last report of each vehicle before `BEFORE_JUMP_S`."""
        time_s = min(max(time_s, self._times[0]), self._times[-1])
        self._from = Moment(self._clock(), time_s)
        self._next = bisect_left(self._times, time_s - BEFORE_JUMP_S)
        self._next_happening = bisect_left(self._happening_times, time_s - BEFORE_JUMP_S)
        lasts = [indices[bisect_left(indices, self._next) - 1] for indices in self._of_vehicle.values()]
        self._before_jump = [self._reports[index] for index in sorted(lasts) if index < self._next]

    def go_on(self, time_s: float) -> None:
        """Play up to this time at once: the next `drain` has all that comes before it."""
        self._from = Moment(self._clock(), min(max(time_s, self._times[0]), self._times[-1]))

    def set_speed(self, speed: float) -> None:
        """Seconds of the flight per second; 0 pauses."""
        self._from = Moment(self._clock(), self.moment().time_s)
        self._speed = speed
