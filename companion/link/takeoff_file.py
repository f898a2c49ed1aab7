"""What an agent keeps of a take-off on its own disk, so that one that starts again in the air knows the height of the ground.

The file is in the state folder of the systemd unit. It is written while the vehicle is armed, beside the control loop, and is
removed when the vehicle is disarmed. It is believed only where vehicle, fleet file and the start of the autopilot are those of
now, and where it is so young that this is still the same flight; else one line says why not.
"""

from __future__ import annotations

import asyncio
import logging
import time
from collections.abc import Callable, Mapping
from math import inf
from pathlib import Path
from typing import Annotated

import msgspec
from msgspec import Meta, Struct

from companion.config.atomic import write_file
from companion.config.file import read_regular
from companion.config.validation import in_plain_words
from companion.config.vehicle import AgentConfig
from companion.core.estimation.vehicle import VehicleTracker
from companion.link.tick import monotonic_s
from companion.types.autopilot import GroundSample
from companion.types.values import FleetName, VehicleId

LOOK_S = 1.0  # a vehicle is armed for longer before it climbs
KEPT_EVERY_S = 10.0
OLDEST_S = 120.0  # a computer starts in less; a landing and another take-off elsewhere take longer
EARLIER_S = 2.0  # the clock may have been set back by less
STARTS_AGREE_S = 2.0
CLOCK_ERROR = 0.03  # PX4's clock runs 1 to 2 % slow
MOST_BYTES = 4096
UnixTime = Annotated[float, Meta(ge=0.0, le=1e10)]

_log = logging.getLogger(__name__)


class KeptTakeoff(Struct, frozen=True, forbid_unknown_fields=True):
    """The content of the file. `booted_unix_s`: when the autopilot started; `seen_unix_s`: when this was written."""

    vehicle_id: VehicleId
    fleet: FleetName
    formation_hash: int
    ground_up_m: Annotated[float, Meta(ge=-100_000.0, le=100_000.0)]
    booted_unix_s: UnixTime
    seen_unix_s: UnixTime


def takeoff_path(vehicle_id: int, environment: Mapping[str, str]) -> Path | None:
    """Where it is kept; None outside a systemd unit, where nothing is kept."""
    state, _, _ = environment.get("STATE_DIRECTORY", "").partition(":")
    return Path(state) / f"takeoff_{vehicle_id}.json" if state else None


class TakeoffFile:
    """The file of one vehicle. `ahead_s` gives Unix time less the monotonic clock of the agent, in s."""

    def __init__(
        self,
        path: Path,
        config: AgentConfig,
        tracker: VehicleTracker,
        ahead_s: Callable[[], float] = lambda: time.time() - monotonic_s(),
    ) -> None:
        self._path = path
        self._own = (config.vehicle.id, config.fleet.name, config.fleet.formation_hash())
        self._tracker = tracker
        self._ahead_s = ahead_s
        self._written: GroundSample | None = None
        self._is_removed = self._has_failed = False

    def read(self, now_s: float) -> GroundSample | None:
        """What an agent kept of this flight before; None where there is nothing to believe, with a line of the log."""
        try:
            content, _ = read_regular(self._path, MOST_BYTES)
            kept = msgspec.json.decode(content, type=KeptTakeoff)
        except FileNotFoundError:
            return None
        except (OSError, msgspec.DecodeError, UnicodeDecodeError, RecursionError) as error:
            text = error.strerror if isinstance(error, OSError) else in_plain_words(error)
            _log.warning("%s: is not what an agent keeps of a take-off: %s; ignored", self._path, text)
            return None
        ahead_s = self._ahead_s()
        age_s = now_s + ahead_s - kept.seen_unix_s
        if why := self._disbelieved(kept, age_s):
            _log.warning("%s: %s; ignored", self._path, why)
            return None
        # An autopilot that has started since then is another start, however short the time before was.
        within_s = min(STARTS_AGREE_S + CLOCK_ERROR * abs(age_s), kept.seen_unix_s - kept.booted_unix_s)
        return GroundSample(now_s, kept.ground_up_m, kept.booted_unix_s - ahead_s, within_s)

    def _disbelieved(self, kept: KeptTakeoff, age_s: float) -> str:
        """Why it is not of this flight; "" where it may be."""
        vehicle_id, fleet, formation_hash = self._own
        if (kept.vehicle_id, kept.fleet) != (vehicle_id, fleet):
            return f'is of vehicle {kept.vehicle_id} of fleet "{kept.fleet}"; expected {vehicle_id} of "{fleet}"'
        if kept.formation_hash != formation_hash:
            return "was written with another fleet file"
        if not -EARLIER_S <= age_s <= OLDEST_S:
            return f"was written {age_s:.0f} s ago by the clock; expected at most {OLDEST_S:g} s"
        return ""

    async def run(self) -> None:
        """Until cancelled: keep what there is to keep. Files are written in a thread."""
        while True:
            await asyncio.sleep(LOOK_S)
            if work := self.due():
                await asyncio.to_thread(work)

    def due(self) -> Callable[[], None] | None:
        """What is to be done on the disk now; None where nothing is."""
        ground, state = self._tracker.takeoff, self._tracker.state
        if ground is None:
            on_ground = state.heartbeat_time_s > -inf and not state.armed
            if not on_ground or self._is_removed:
                return None
            self._written, self._is_removed = None, True
            return lambda: self._attempt(self._remove)
        last = self._written
        if last and last.ground_up_m == ground.ground_up_m and ground.received_s - last.received_s < KEPT_EVERY_S:
            return None
        self._written, self._is_removed = ground, False
        content = msgspec.json.encode(self._kept(ground))
        return lambda: self._attempt(lambda: write_file(self._path, content))

    def _kept(self, ground: GroundSample) -> KeptTakeoff:
        ahead_s = self._ahead_s()
        booted_s, seen_s = ground.booted_s + ahead_s, ground.received_s + ahead_s
        return KeptTakeoff(*self._own, round(ground.ground_up_m, 4), round(booted_s, 3), round(seen_s, 3))

    def _remove(self) -> None:
        self._path.unlink(missing_ok=True)

    def _attempt(self, work: Callable[[], None]) -> None:
        """The flight does not depend on it; one line where it begins to fail."""
        try:
            work()
        except OSError as error:
            if not self._has_failed:
                text = f"{error.strerror}; after a start in the air this vehicle must land"
                _log.warning("%s: the take-off cannot be kept: %s", self._path, text)
            self._has_failed = True
        else:
            self._has_failed = False
