"""The agent as one process: sockets and Zenoh on the outside, `Agent.step` in the middle, one task group around."""

from __future__ import annotations

import asyncio
import gc
import logging
import secrets
import selectors
import signal
import time
from collections.abc import Callable, Coroutine, Sequence
from contextlib import ExitStack, closing
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from companion.assembly import build_agent
from companion.config.vehicle import AgentConfig, load_agent
from companion.config_file import ConfigError
from companion.core.agent import Agent
from companion.link.autopilot_link import AutopilotLink, AutopilotSilentError
from companion.link.endpoint import LinkError
from companion.link.ground_link import GroundStationLink
from companion.link.log import RejectionLog, log_to_stderr
from companion.link.signing_key import read_signing_key
from companion.link.systemd import Notifier
from companion.link.tick import TickMeter, TickTrigger
from companion.link.zenoh_link import ZenohLink
from companion.link.zenoh_session import EndpointError
from companion.mavlink.ground_station import GroundStationFilter
from companion.mavlink.manners import AGENTS_STREAMS
from companion.mavlink.translator import Translator
from companion.types import Inbox, Outbox, PositionSample, Telemetry
from companion.wire.ground import StatusReport

Job = Callable[[], Coroutine[Any, Any, None]]

WAIT_FOR_AUTOPILOT_S = 15.0

_log = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True)
class Settings:
    """What the command line says of one run."""

    file: Path
    wait_s: float = WAIT_FOR_AUTOPILOT_S


def run_agent(settings: Settings) -> None:
    """Fly until SIGTERM or SIGINT. Raises ConfigError and AutopilotSilentError."""
    config = load_agent(settings.file)
    log_to_stderr(config.vehicle.id)
    with asyncio.Runner(loop_factory=_loop) as runner:
        runner.run(_run(settings, config))


def _loop() -> asyncio.AbstractEventLoop:
    """epoll rounds a timer up to whole milliseconds and wakes 0.6 to 1.1 ms late; select wakes 0.2 ms late."""
    return asyncio.SelectorEventLoop(selectors.SelectSelector())


async def _run(settings: Settings, config: AgentConfig) -> None:
    vehicle, agent, trigger = config.vehicle, build_agent(config, secrets.randbits(32)), TickTrigger()
    key = read_signing_key(settings.file, vehicle.signing) if vehicle.signing else None
    with ExitStack() as stack:
        try:
            autopilot = AutopilotLink(
                vehicle.id,
                vehicle.mavlink,
                Translator(vehicle.id, vehicle.autopilot, key),
                position_arrived=trigger.position_arrived,
                reject=agent.reject,
            )
            stack.enter_context(closing(autopilot))
            peers = ZenohLink(vehicle.id, config.fleet, vehicle.zenoh, agent.reject)
            stack.enter_context(closing(peers))
        except LinkError as error:
            raise ConfigError(settings.file, "mavlink", f'"{vehicle.mavlink}": {error}') from error
        except EndpointError as error:
            raise ConfigError(settings.file, f"zenoh.{error.kind}", f'"{error.endpoint}": {error}') from error
        notifier = stack.enter_context(closing(Notifier()))
        signed = ", signed" if key else ""
        _log.info("%s of fleet %s, %s%s", config.member.role, config.fleet.name, vehicle.mavlink, signed)
        beside = []
        if vehicle.ground_station:
            ground = stack.enter_context(closing(_ground_station(settings, config, autopilot, agent)))
            beside.append(ground.run)
        loop = ControlLoop(agent, autopilot, peers, trigger, notifier)
        if not await loop.run(settings.wait_s, beside):
            raise AutopilotSilentError(settings.file, vehicle, settings.wait_s, autopilot.why_silent())


def _ground_station(
    settings: Settings, config: AgentConfig, autopilot: AutopilotLink, agent: Agent
) -> GroundStationLink:
    """Joined to the autopilot's link. Raises ConfigError."""
    vehicle = config.vehicle
    try:
        admission = GroundStationFilter(vehicle.id, AGENTS_STREAMS)
        ground = GroundStationLink(vehicle.ground_station, admission, autopilot.offer, agent.reject)
    except LinkError as error:
        raise ConfigError(settings.file, "ground_station", f'"{vehicle.ground_station}": {error}') from error
    autopilot.pass_on_to(ground.pass_on)
    return ground


class ControlLoop:
    """Fills the agent's Inbox, lets it decide, sends its Outbox; once per tick, until told to stop."""

    def __init__(
        self, agent: Agent, autopilot: AutopilotLink, peers: ZenohLink, trigger: TickTrigger, notifier: Notifier
    ) -> None:
        self._agent = agent
        self._autopilot = autopilot
        self._peers = peers
        self._trigger = trigger
        self._notifier = notifier
        self._meter = TickMeter(time.monotonic())
        self._rejections = RejectionLog()
        self._stop_asked_s: float | None = None
        self._failure: BaseException | None = None

    async def run(self, wait_s: float, beside: Sequence[Job] = ()) -> bool:
        """Until SIGTERM or SIGINT, with the jobs beside it; False after `wait_s` in which no autopilot was heard."""
        loop = asyncio.get_running_loop()
        loop.set_exception_handler(self._callback_failed)
        for number in (signal.SIGTERM, signal.SIGINT):
            loop.add_signal_handler(number, self._stop, signal.Signals(number).name)
        gc.collect()
        gc.freeze()  # what was made until now stays; the collector need not look at it in a tick
        async with asyncio.TaskGroup() as group:
            links = (self._autopilot.receive, self._autopilot.keep_in_touch, self._autopilot.keep_streams)
            tasks = [group.create_task(job()) for job in (*links, *beside)]
            await self._tick_until_done(give_up_s=time.monotonic() + wait_s)
            for task in tasks:
                task.cancel()
        if self._failure:
            raise self._failure
        self._notifier.stopping()
        _log.info("ends in phase %s", self._agent.phase)
        return self._stop_asked_s is not None

    async def _tick_until_done(self, give_up_s: float) -> None:
        now_s = time.monotonic()
        while not self._is_done(now_s, give_up_s):
            await self._trigger.wait(now_s)
            now_s = time.monotonic()
            self._meter.tick(now_s)
            inbox = self._inbox(now_s)
            outbox = self._agent.step(now_s, inbox)
            self._send(now_s, inbox.telemetry, outbox)
            self._notifier.cycle_completed(now_s, self._autopilot.heard)

    def _inbox(self, now_s: float) -> Inbox:
        peers, commands = self._peers.receive(now_s)
        targets = self._peers.targets(now_s)
        return Inbox(self._autopilot.drain(), peers, commands, self._stop_asked_s is not None, targets)

    def _send(self, now_s: float, telemetry: Sequence[Telemetry], outbox: Outbox) -> None:
        """The setpoint first: a publication costs the caller up to a tenth of a millisecond."""
        if outbox.attitude_target:
            self._autopilot.command(outbox.attitude_target, now_s)
            self._measure_command(telemetry)
        self._autopilot.request(outbox.requests)
        self._peers.reply(outbox.replies)
        if outbox.peer_packet:
            self._peers.publish_peer(outbox.peer_packet)
        self._meter.phase_after_tick(self._agent.phase, now_s)
        if outbox.status:
            self._peers.publish_status(StatusReport(outbox.status, self._meter.timing(now_s)))
            self._rejections.update(outbox.status.rejected, now_s)
        for event in outbox.events:
            _log.info("%s", event)
            self._notifier.status(event)

    def _measure_command(self, telemetry: Sequence[Telemetry]) -> None:
        """From the newest position's arrival to this moment, just after its setpoint was handed to the socket."""
        arrivals_s = [sample.received_s for sample in telemetry if isinstance(sample, PositionSample)]
        if arrivals_s:
            self._meter.command_sent(arrivals_s[-1], time.monotonic())

    def _is_done(self, now_s: float, give_up_s: float) -> bool:
        """Told to stop and no setpoint stream is left to hand over; or there never was an autopilot."""
        if self._failure:
            return True
        if self._stop_asked_s is None:
            return not self._autopilot.heard and now_s > give_up_s
        return self._agent.has_handed_over

    def _stop(self, reason: str) -> None:
        if self._stop_asked_s is None:
            _log.info("%s in phase %s: stopping", reason, self._agent.phase)
            self._stop_asked_s = time.monotonic()

    def _callback_failed(self, loop: asyncio.AbstractEventLoop, context: dict[str, Any]) -> None:
        """A defect in a callback would otherwise only be logged, while the loop goes on without its telemetry."""
        exception = context.get("exception")
        if exception is None:
            loop.default_exception_handler(context)
        else:
            self._failure = exception
