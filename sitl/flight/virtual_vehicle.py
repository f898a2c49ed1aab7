"""One vehicle in virtual time: its stand-in, and its agent with the clock and the timer of its ticks."""

from __future__ import annotations

from array import array
from collections.abc import Callable, Sequence
from math import inf
from pathlib import Path

import numpy as np
from msgspec.structs import replace
from numpy.typing import NDArray

from companion.assembly import build_agent
from companion.config.vehicle import AgentConfig
from companion.core.agent import Agent
from companion.core.consensus.law import LawError
from companion.core.safety.safeguard import FailureResponse
from companion.link.pose_relay import PoseRelay
from companion.link.tick import Ticking
from companion.mavlink.autopilot_types import DIALECTS
from companion.recording.recorder import recorder_of
from companion.recording.records import TimingRecord
from companion.recording.writing import WritingAtOnce
from companion.types.autopilot import AutopilotMode, Telemetry
from companion.types.commands import Command, CommandReply
from companion.types.notices import Code, Notice
from companion.types.peers import BodyPose, ReceivedPeerPacket, ReceivedTarget, TargetSample
from companion.types.status import Status
from companion.types.tick import Inbox, Outbox
from companion.wire.messages import Percentiles, StatusReport, Timing
from companion.wire.rounding import round_outbox
from sitl.autopilots.autopilot import DT_S, FlightMode
from sitl.autopilots.types import AUTOPILOT_TYPES
from sitl.flight.files import reached_stand_in, vehicle_file
from sitl.flight.scenario import AgentEnd, Scenario
from sitl.links.direct_link import DirectLink
from sitl.links.network import Network
from sitl.report.metrics import Track
from sitl.vehicle.config import AutopilotFile, Links
from sitl.vehicle.dynamics import State
from sitl.vehicle.truth import TRUTH_HEADER, truth_row

BoolArray = NDArray[np.bool_]
STREAM_ENDED_AFTER_S = 0.1  # without a newer attitude target
KEPT_WITHIN_S = 2.0  # the start of the autopilot that an agent knew from before is that of now
OFF_GROUND_M = 0.1  # higher than this above its start
STATE_KEPT = 10  # numbers of a state: position, velocity, attitude
_NONE = Percentiles(0.0, 0.0, 0.0)
NOT_TIMED = Timing(0.0, 0, 0, _NONE, _NONE, 0.0, 0.0)  # in virtual time no tick is late


class VirtualStandIn:
    """One vehicle: autopilot, link to its agent, and true track at 50 Hz."""

    def __init__(self, file: AutopilotFile, links: Links, phase_s: float) -> None:
        self.vehicle_id = file.id
        behaviour = AUTOPILOT_TYPES[file.stand_in.autopilot]
        self.autopilot = behaviour.vehicle(file, DT_S)
        self.ground_m = file.start_enu_m[2]
        self.link = DirectLink(self.autopilot, behaviour.onboard_link(self.autopilot), links, phase_s)
        self._track = array("d")  # time, state, thrust: flat, because a study keeps many of them
        self._targets = array("d")  # with each row: roll, pitch, yaw and thrust that its agent sent last
        self._modes: list[tuple[bool, str]] = []
        self._commanded = bytearray()  # with each row: whether the autopilot flies attitudes that its agent sends
        self._mode: FlightMode | None = None  # of the last row, its name, and whether attitudes are flown in it
        self._mode_name, self._takes_attitudes = "", False

    def step(self, now_s: float) -> None:
        """Advance by one step to this time."""
        link, autopilot = self.link, self.autopilot
        if link.to_autopilot:
            link.deliver(now_s)
        autopilot.step()
        if now_s >= link.schedule.next_s or autopilot.texts or autopilot.origin_changes:
            link.send_telemetry(now_s)

    def record(self, now_s: float) -> None:
        """Add a row to the track."""
        autopilot, quad = self.autopilot, self.autopilot.quad
        if autopilot.mode is not self._mode:
            self._mode, self._mode_name = autopilot.mode, autopilot.mode.name
            mode, _ = DIALECTS[autopilot.kind].mode_of(autopilot.mode.custom_mode)
            self._takes_attitudes = mode is AutopilotMode.OFFBOARD
        self._track.extend((now_s, *quad.state[:STATE_KEPT], quad.thrust_norm))
        self._modes.append((autopilot.armed, self._mode_name))
        target = self.link.target
        self._targets.extend((target.roll_rad, target.pitch_rad, target.yaw_rad, target.thrust_norm))
        streams = now_s - self.link.setpoint_s < STREAM_ENDED_AFTER_S
        self._commanded.append(self._takes_attitudes and streams and autopilot.armed)

    def commanded(self) -> BoolArray:
        """Whether an agent commanded the attitude (k,), at the times of the track."""
        return np.array(self._commanded, dtype=np.bool_)

    def setpoints(self) -> NDArray[np.float64]:
        """Roll, pitch, yaw [rad] and thrust (k, 4) that its agent commanded, at the times of the track; NaN without any."""
        return np.where(self.commanded()[:, None], np.array(self._targets).reshape(-1, 4), np.nan)

    def velocities_enu_m_s(self) -> NDArray[np.float64]:
        """True velocities (k, 3), at the times of the track."""
        return np.array(self._track).reshape(-1, STATE_KEPT + 2)[:, 4:7]

    def flies(self) -> BoolArray:
        """Whether it was armed and off the ground (k,), at the times of the track."""
        armed = np.array([armed for armed, _ in self._modes], dtype=np.bool_)
        return armed & (self.track().position_enu_m[:, 2] - self.ground_m > OFF_GROUND_M)

    def track(self) -> Track:
        table = np.array(self._track).reshape(-1, STATE_KEPT + 2)
        return Track(table[:, 0], table[:, 1:4])

    def write_track(self, path: Path) -> None:
        """Write a CSV file like `sitl autopilot --truth`, in virtual time."""
        width = STATE_KEPT + 2
        with path.open("w", encoding="ascii") as file:
            file.write(TRUTH_HEADER)
            for row, (armed, mode_name) in enumerate(self._modes):
                time_s, *numbers = self._track[row * width : (row + 1) * width]
                state: State = tuple(numbers[:STATE_KEPT])
                file.write(truth_row(time_s, state, numbers[STATE_KEPT], armed, mode_name))


class VirtualTimer:
    """Clock and timer of one agent's ticks in virtual time; `Ticking` never has two timers."""

    def __init__(self) -> None:
        self.now_s = 0.0
        self.at_s = inf
        self._callback: Callable[[], None] = lambda: None

    def time(self) -> float:
        """Virtual time since the start, seconds."""
        return self.now_s

    def call_at(self, when: float, callback: Callable[[], None], /) -> VirtualTimer:
        """Call once at this time."""
        self.at_s, self._callback = when, callback
        return self

    def cancel(self) -> None:
        """It does not call."""
        self.at_s = inf

    def fire(self) -> None:
        """Call now."""
        self.cancel()
        self._callback()


class VirtualAgent:
    """An agent with its links: fills the Inbox, runs a tick, sends the Outbox, as the agent's process does and when it does."""

    def __init__(
        self,
        scenario: Scenario,
        stand_in: VirtualStandIn,
        network: Network,
        reports: list[StatusReport],
        recordings: Path | None = None,
    ) -> None:
        self.vehicle_id = stand_in.vehicle_id
        self.link = stand_in.link
        self.network = network
        self._reports = reports
        self._scenario = scenario
        ends = (end for end in scenario.agent_ends if end.vehicle == self.vehicle_id)
        self._ends = sorted(ends, key=lambda end: end.at_s)  # those that are not over yet
        self._starts = 1
        self._kept: tuple[Telemetry, ...] = ()  # for the next tick, beside what comes from the autopilot
        self._pose_s = 0.0  # when a pose arrived last
        self._recordings = recordings
        self._timer = VirtualTimer()
        self._prepared: Inbox | None = None  # what the first part of the next tick saw, once it has run
        self._commands: tuple[Command, ...] = ()
        self._checks: tuple[Command, ...] = ()
        self._targets: tuple[tuple[str, TargetSample], ...] = ()
        self._start()
        self._reply: CommandReply | None = None  # the last
        self._distant_ids: tuple[int, ...] = ()
        self.status: Status | None = None  # the newest
        self.session = 0  # of the agent, from its status; 0 before the first

    def give(self, command: Command) -> None:
        self._commands += (command,)

    def ask(self, check: Command) -> None:
        """A command that is only to be answered."""
        self._checks += (check,)

    def take_target(self, name: str, target: TargetSample) -> None:
        """A sample of a moving target, for the next tick."""
        self._targets += ((name, target),)

    def take_pose(self, pose: BodyPose, now_s: float) -> None:
        """A motion-capture pose of this vehicle that arrives now."""
        if self._relay is not None and self._process_runs(now_s) and not self._failed:
            self._pose_s = now_s
            self._relay.receive(pose, now_s)

    def pose(self, pose: BodyPose, measured_s: float, covariance: Sequence[float], resets: int) -> None:
        """The pose that has just arrived, for the autopilot."""
        self.link.pose(self._pose_s, pose, measured_s, covariance, resets)

    def keep(self, sample: Telemetry) -> None:
        """A sample for the next tick that does not come from the autopilot."""
        self._kept += (sample,)

    def reply_to(self, number: int) -> CommandReply | None:
        """The reply to the command with this number, None without one."""
        return self._reply if self._reply and self._reply.number == number else None

    @property
    def next_s(self) -> float:
        """When the next position or the timer of the ticks is due."""
        return self.link.position_s if self.link.position_s < self._timer.at_s else self._timer.at_s

    def go_on(self, now_s: float) -> None:
        """What is due at `next_s`: a tick, or the first part of one."""
        self._timer.now_s = now_s
        runs = self._process_runs(now_s)
        if self.link.position_s <= now_s:
            self.link.take_position()
            if runs:
                self._ticking.position_arrived(now_s)
            else:
                self._lose_input(now_s)
        elif not runs:
            self._timer.call_at(self._ends[0].until_s, lambda: None)
        elif self._timer.at_s <= now_s:  # not that of a process that has just started
            self._timer.fire()

    def _prepare(self) -> None:
        now_s = self._timer.now_s
        if self._failed:
            return
        packets, commands, checks = self.network.receive(self.vehicle_id, now_s), self._commands, self._checks
        targets = tuple([ReceivedTarget(now_s, name, target) for name, target in self._targets])
        self._prepared = Inbox(
            peers=packets, commands=commands, targets=targets, prepared_s=now_s, early=len(packets), checks=checks
        )
        self._commands, self._checks, self._targets = (), (), ()
        self.agent.prepare(now_s, packets, commands, checks)

    def _tick(self) -> None:
        now_s = self._timer.now_s
        if self._failed:
            self._hand_over(now_s)
            return
        late: tuple[ReceivedPeerPacket, ...] = ()
        if self._prepared is None:
            self._prepare()
        else:
            late = self.network.receive(self.vehicle_id, now_s)
        seen, self._prepared = self._prepared, None
        assert seen is not None
        telemetry, self._kept = self._kept + self.link.drain(now_s), ()
        inbox = replace(seen, telemetry=telemetry, peers=seen.peers + late)
        self._response.receive(telemetry)
        try:
            decision = self.agent.decide(now_s, inbox)
        except LawError as error:
            self._fail(now_s, inbox, error)
            return
        outbox = self.agent.report(decision)
        self._response.sent(decision.flight, outbox.attitude_target, decision.setpoint.hover_thrust_norm)
        self._response.publishes(outbox.peer_packet)
        self._send(now_s, outbox)
        if self._recorder:
            sent = round_outbox(outbox)
            report = StatusReport(sent.status, NOT_TIMED) if sent.status else None
            self._recorder.tick(now_s, inbox, decision, sent, report, TimingRecord(now_s, 0, 0, 0, None))

    def _fail(self, now_s: float, inbox: Inbox, error: LawError) -> None:
        """The process hands over, and ends. Defects of the agent itself end the flight with a traceback."""
        self._failed, notice = True, Notice(Code.AGENT_FAILED, str(error))
        if self._recorder:
            self._recorder.failure(now_s, notice, (now_s, inbox))
        if self.status:
            self.status = replace(self.status, last_event=notice)
            self._reports.append(StatusReport(self.status, NOT_TIMED))
        self._hand_over(now_s)

    def _hand_over(self, now_s: float) -> None:
        self._response.receive(self.link.drain(now_s))
        response = self._response.step(now_s)
        if response.target:
            self.link.command(response.target, now_s)
        for request in response.requests:
            self.link.request(request, now_s)
        if response.ended:
            self._ends = [AgentEnd(vehicle=self.vehicle_id, at_s=now_s)]
        elif packet := self._response.packet(now_s):
            self.network.send(packet, now_s)

    def _lose_input(self, now_s: float) -> None:
        """Nothing waits for the next process."""
        self.link.drain(now_s)
        self.network.receive(self.vehicle_id, now_s)
        self._commands, self._checks, self._targets = (), (), ()

    def close(self) -> None:
        """End the recording."""
        if self._recorder:
            self._recorder.close()

    def _process_runs(self, now_s: float) -> bool:
        """Whether the agent's process runs. A new one that is due is started, with its own session.

        It knows what the one before has kept of the take-off, and nothing else.
        """
        if self._ends and now_s >= self._ends[0].until_s:
            self._ends.pop(0)
            self._starts += 1
            self.close()
            takeoff = self.agent.perception.takeoff
            self._kept = (replace(takeoff, within_s=KEPT_WITHIN_S),) if takeoff else ()
            self._start()
        return not self._ends or now_s < self._ends[0].at_s

    def _start(self) -> None:
        """A new process of the agent."""
        config = _config(self._scenario, self.vehicle_id)
        self.agent: Agent = build_agent(config, self._starts)
        self._ticking, self._prepared = Ticking(self._timer, self._tick, self._prepare), None
        self._response, self._failed = FailureResponse(), False
        vision = config.fleet.external_vision
        self._relay = PoseRelay(vision, self.agent, self) if vision else None
        self._recorder = (
            recorder_of(config, self._starts, self._recordings, 0.0, 0.0, WritingAtOnce()) if self._recordings else None
        )

    def _send(self, now_s: float, outbox: Outbox) -> None:
        if outbox.attitude_target:
            self.link.command(outbox.attitude_target, now_s)
        for request in outbox.requests:
            self.link.request(request, now_s)
        for reply in outbox.replies:
            self._reply = reply
        if outbox.peer_packet:
            self.network.send(outbox.peer_packet, now_s)
        if outbox.distant_ids != self._distant_ids:
            self._distant_ids = outbox.distant_ids
            self.network.set_low_rate_peers(self.vehicle_id, outbox.distant_ids, now_s)
        if outbox.status:
            self.status, self.session = outbox.status, outbox.status.agent.session
            self._reports.append(StatusReport(outbox.status, NOT_TIMED))


def _config(scenario: Scenario, vehicle_id: int) -> AgentConfig:
    member = next(member for member in scenario.fleet.vehicles if member.id == vehicle_id)
    file = vehicle_file(scenario, reached_stand_in(scenario, vehicle_id, port_offset=0), port_offset=0)
    return AgentConfig(file, scenario.fleet, member)
