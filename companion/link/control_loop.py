"""The control loop around the agent: one tick per position, and the hand-over to the autopilot after a failure."""

from __future__ import annotations

import asyncio
import gc
import logging
import signal
import time
from collections.abc import Callable, Coroutine, Sequence
from functools import partial
from math import inf
from typing import TYPE_CHECKING, Any

from msgspec.structs import replace

from companion.core.agent import Agent
from companion.core.report import Decision
from companion.core.safety.safeguard import FailureResponse
from companion.link.law_timer import LawTimer
from companion.link.log import AgentEventLog, RejectionLog, field_of
from companion.link.systemd import Notifier, status_line
from companion.link.tick import BACK_UP_S, PERIOD_S, LateLoopLog, TickMeter, TickTrigger, monotonic_s
from companion.recording.records import TimingRecord
from companion.types.autopilot import PositionSample, Telemetry
from companion.types.errors import EXIT_DEFECT, EndingError
from companion.types.notices import Code, Notice
from companion.types.peers import ReceivedPeerPacket
from companion.types.status import RecordingState
from companion.types.tick import Inbox, Outbox
from companion.wire.messages import StatusReport
from companion.wire.rounding import round_outbox, round_target

if TYPE_CHECKING:
    from companion.link.autopilot_link import AutopilotLink
    from companion.link.fleet.zenoh_link import ZenohLink
    from companion.recording.recorder import Recorder


COLLECT_PERIOD_S = 5.0

Job = Callable[[], Coroutine[Any, Any, None]]

_log = logging.getLogger(__name__)


class AgentFailedError(EndingError):
    """A defect ended the agent. `str()` is one line: what failed, and what was done."""

    exit_code = EXIT_DEFECT


class ControlLoop:
    """Once per tick: fills the Inbox, lets the agent decide, sends the setpoint, then publishes the reports and records.

    An exception in any of this ends the loop by a hand-over: level setpoints and the autopilot's hold.
    """

    def __init__(
        self,
        agent: Agent,
        autopilot: AutopilotLink,
        peers: ZenohLink,
        trigger: TickTrigger,
        notifier: Notifier,
        recorder: Recorder | None = None,
        law: LawTimer | None = None,
    ) -> None:
        self._agent = agent
        self._autopilot = autopilot
        self._peers = peers
        self._trigger = trigger
        self.notifier = notifier
        self._recorder = recorder
        self._law = law
        self.meter = TickMeter(time.monotonic())
        self.late = LateLoopLog()
        self.rejections = RejectionLog()
        self.events = AgentEventLog()
        self.response = FailureResponse()
        self._stop_asked_s: float | None = None
        self._failure: BaseException | None = None
        self._last_report: StatusReport | None = None
        self._due_s = inf  # when the next tick begins at the latest
        self._ticked_s = inf  # when the last one began
        self._prepared: Inbox | None = None  # what the first part of the next tick saw, once it has run
        self._begun: tuple[float, Inbox] | None = None  # time and input of a part of a tick that has not ended
        self._collected_s = -inf

    # ------------------------------------------------------------ one tick

    def prepare(self, now_s: float) -> None:
        """The first part of the next tick, before its position is due. Raises as `tick` does."""
        peers, commands = self._peers.receive(now_s)
        targets, checks = self._peers.targets(now_s), self._peers.checks()
        seen = Inbox(peers=peers, commands=commands, targets=targets, prepared_s=now_s, early=len(peers), checks=checks)
        self._begun = (now_s, seen)
        self._agent.prepare(now_s, peers, commands, checks)
        self._prepared, self._begun = seen, None

    def tick(self, now_s: float) -> None:
        """One tick, with its first part where that has not run. Raises whatever a stage, an encoder or a link raises.

        `fail` must follow then.
        """
        began_s, due_s = time.monotonic(), self._due_s
        late: tuple[ReceivedPeerPacket, ...] = ()
        if self._prepared is None:
            self.prepare(now_s)
        else:
            late = self._peers.receive_late(now_s)
        inbox = self._inbox(now_s, late)
        self._begun = (now_s, inbox)
        self.response.receive(inbox.telemetry)
        decision = self._agent.decide(now_s, inbox)
        latency_us = self._send(now_s, inbox.telemetry, decision)
        sent_s = time.monotonic()
        self.late.cycle(due_s, now_s)
        self.meter.tick(now_s)
        outbox = round_outbox(self._agent.report(decision))
        report = self._publish(now_s, outbox)
        self.notifier.complete_cycle(now_s, self._autopilot.is_connected and self._peers.is_open)
        late_s, self._ticked_s = max(0.0, now_s - self._ticked_s - PERIOD_S), now_s
        if self._recorder:
            decide_us, whole_us = _us(sent_s - began_s), _us(time.monotonic() - began_s)
            timing = TimingRecord(now_s, _us(late_s), decide_us, whole_us, latency_us)
            if notice := self._recorder.tick(now_s, inbox, decision, outbox, report, timing):
                self.events.log(notice, now_s)
        self._begun = None

    def _inbox(self, now_s: float, late: tuple[ReceivedPeerPacket, ...]) -> Inbox:
        """What `prepare` saw, and what has arrived since that must not wait for the next tick."""
        seen, self._prepared = self._prepared, None
        assert seen is not None
        late_s, self._due_s = round(max(0.0, now_s - self._due_s), 6), now_s + BACK_UP_S
        return Inbox(
            telemetry=self._autopilot.drain(),
            peers=seen.peers + late,
            commands=seen.commands,
            stopping=self._stop_asked_s is not None,
            targets=seen.targets,
            late_s=late_s,
            traffic=self._peers.traffic(now_s),
            prepared_s=seen.prepared_s,
            early=seen.early,
            law_s=self._law.read_s() if self._law else 0.0,
            checks=seen.checks,
        )

    def _send(self, now_s: float, telemetry: Sequence[Telemetry], decision: Decision) -> int | None:
        """Send the setpoint and the requests, before packets, status and log lines are built.

        Returns the time from the newest position to its setpoint, us.
        """
        latency_us, wanted = None, decision.setpoint.target
        target = round_target(wanted) if wanted else None
        self.response.sent(decision.flight, target, decision.setpoint.hover_thrust_norm)
        if target:
            self._autopilot.command(target, now_s)
            latency_us = self._measure_command(telemetry)
        self._autopilot.request(decision.requests)
        return latency_us

    def _publish(self, now_s: float, outbox: Outbox) -> StatusReport | None:
        """Returns the report where one is published."""
        self._peers.reply(outbox.replies)
        self.response.publishes(outbox.peer_packet)
        if outbox.peer_packet:
            self._peers.publish_peer(outbox.peer_packet)
        self._peers.set_low_rate_peers(outbox.distant_ids)
        self.meter.phase_after_tick(self._agent.phase, now_s)
        report = None
        if outbox.status:
            recording = self._recorder.state if self._recorder else RecordingState()
            status = replace(outbox.status, network=self._peers.network, recording=recording)
            report = self._last_report = StatusReport(status, self.meter.timing(now_s))
            self._peers.publish_status(report)
            self.notifier.status(status_line(outbox.status))
            self.rejections.update(outbox.status.rejected, now_s)
        for event in outbox.events:
            self.events.log(event, now_s)
        return report

    def _measure_command(self, telemetry: Sequence[Telemetry]) -> int | None:
        """Latency from the arrival of the newest position to now, when its setpoint has been sent, us."""
        arrivals_s = [sample.received_s for sample in telemetry if isinstance(sample, PositionSample)]
        if not arrivals_s:
            return None
        sent_s = time.monotonic()
        self.meter.add_command(arrivals_s[-1], sent_s)
        return _us(sent_s - arrivals_s[-1])

    # ------------------------------------------------------------ after a failure

    def fail(self, error: BaseException, now_s: float) -> bool:
        """Record the failure and send the first level setpoint and hold request. Returns whether the hand-over has ended."""
        self._failure = error
        ended = self.hand_over(now_s)
        notice = Notice(Code.AGENT_FAILED, f"{type(error).__name__}: {error}")
        _log.critical("%s in phase %s", notice, self._agent.phase, exc_info=error, extra=field_of(notice.code))
        _attempt(lambda: self.notifier.status(str(notice)))
        if self._recorder:
            self._recorder.failure(now_s, notice, self._begun)
        if self._last_report:
            report = replace(self._last_report, status=replace(self._last_report.status, last_event=notice))
            _attempt(lambda: self._peers.publish_status(report))
        return ended

    def hand_over(self, now_s: float) -> bool:
        """One step of the hand-over after a failure. Returns whether it has ended. Never raises.

        Each action is attempted for itself: a link that cannot send setpoints may still send the request.
        """
        _attempt(lambda: self.response.receive(self._autopilot.drain()))
        response = self.response.step(now_s)
        if response.target:
            target = response.target
            _attempt(lambda: self._autopilot.command(target, now_s))
        if response.requests:
            _attempt(lambda: self._autopilot.request(response.requests))
        if not response.ended:
            _attempt(lambda: self._publish_released(now_s))
        return response.ended

    def _publish_released(self, now_s: float) -> None:
        """A packet in phase release, so that the peers know that the vehicle brakes."""
        if packet := self.response.packet(now_s):
            self._peers.publish_peer(packet)

    # ------------------------------------------------------------ the loop

    async def run(self, wait_s: float, jobs: Sequence[Job]) -> bool:
        """Run until SIGTERM or SIGINT, with the jobs of the links beside it. Raises AgentFailedError.

        False if no autopilot was received within `wait_s`.
        """
        loop = asyncio.get_running_loop()
        loop.set_exception_handler(self._callback_failed)
        for number in (signal.SIGTERM, signal.SIGINT):
            loop.add_signal_handler(number, self._stop, signal.Signals(number).name)
        gc.collect()
        gc.freeze()  # objects made until now stay; the collector skips them in a tick
        async with asyncio.TaskGroup() as group:
            tasks = [group.create_task(self._guard(job)) for job in jobs]
            await self._trigger.run(partial(self._tick_now, time.monotonic() + wait_s), self._prepare_now)
            if self._failure:
                await self._end_after_failure(self._failure)
            for task in tasks:
                task.cancel()
        if self._failure:
            raise AgentFailedError(f"ends after a defect: {type(self._failure).__name__}: {self._failure}")
        self.notifier.stopping()
        _log.info("ends in phase %s", self._agent.phase)
        return self._stop_asked_s is not None

    def _tick_now(self, give_up_s: float) -> None:
        now_s = monotonic_s()
        try:
            self.tick(now_s)
        except Exception as error:  # noqa: BLE001 -- whatever failed, the vehicle is handed over
            self._fail_soon(error)
        self._collect_garbage(now_s)
        if self._is_done(now_s, give_up_s):
            self._trigger.end()

    def _prepare_now(self) -> None:
        try:
            self.prepare(monotonic_s())
        except Exception as error:  # noqa: BLE001 -- whatever failed, the vehicle is handed over
            self._fail_soon(error)

    def _collect_garbage(self, now_s: float) -> None:
        """Keep the memory constant, in some 15 us every COLLECT_PERIOD_S.

        CPython keeps up to 2000 freed tuples of each length for reuse, and frees them only in a full collection. The few
        objects of a tick never cause one, so that the memory would grow for an hour.
        """
        if now_s - self._collected_s >= COLLECT_PERIOD_S:
            gc.collect()
            self._collected_s = now_s

    async def _end_after_failure(self, error: BaseException) -> None:
        ended = self.fail(error, time.monotonic())
        while not ended:
            await asyncio.sleep(PERIOD_S)
            ended = self.hand_over(time.monotonic())

    async def _guard(self, job: Job) -> None:
        """A job whose failure ends the loop by a hand-over, while the links still work."""
        try:
            await job()
        except Exception as error:  # noqa: BLE001 -- whatever failed, the vehicle is handed over
            self._fail_soon(error)

    def _is_done(self, now_s: float, give_up_s: float) -> bool:
        """After a request to stop and the hand-over of the stream, after a failure, or without any autopilot."""
        if self._failure:
            return True
        if self._stop_asked_s is None:
            return not self._autopilot.is_connected and now_s > give_up_s
        return self._agent.has_handed_over

    def _stop(self, reason: str) -> None:
        if self._stop_asked_s is None:
            _log.info("%s in phase %s: stopping", reason, self._agent.phase)
            self._stop_asked_s = time.monotonic()

    def _callback_failed(self, loop: asyncio.AbstractEventLoop, context: dict[str, Any]) -> None:
        """End the loop at an exception in a callback; asyncio would only log it and lose telemetry."""
        exception = context.get("exception")
        if isinstance(exception, Exception):
            self._fail_soon(exception)
        else:
            loop.default_exception_handler(context)

    def _fail_soon(self, error: Exception) -> None:
        """End the loop at once. Of several failures the first is reported."""
        self._failure = self._failure or error
        self._trigger.end()


def _us(seconds: float) -> int:
    """To ten microseconds."""
    return round(seconds * 1e5) * 10


def _attempt(action: Callable[[], object]) -> None:
    """After a failure the next one must not prevent the other actions."""
    try:
        action()
    except Exception as error:  # noqa: BLE001 -- the other actions follow
        _log.error("also failed: %s: %s", type(error).__name__, error)
