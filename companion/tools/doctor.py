"""`companion doctor`: checks whether a vehicle is fit to fly in formation, and sets safe parameter values."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Callable, Coroutine, Iterable
from contextlib import closing
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import msgspec

from companion.assembly import check_agent, output_limits_of, tracker_of
from companion.config.vehicle import AgentConfig, load_agent
from companion.core.estimation.survey import WINDOW_S, Survey
from companion.core.safety.audit import Facts, Finding, PositionCheck, audit, parameter_names, worst
from companion.link.bench import LISTEN_PERIOD_S, Bench, run_on_bench
from companion.link.parameters import ParameterError, Parameters
from companion.tools.doctor_report import Change, Diagnosis, heading, lines, summary
from companion.tools.network_report import network_line
from companion.types.autopilot import VehicleState
from companion.types.requests import RequestOrigin

FIT, UNFIT = 0, 1  # exit codes
SETTLE_S = 1.0  # until the streams have the requested rates
ASK_ORIGIN_PERIOD_S = 1.0


@dataclass(frozen=True, slots=True)
class DoctorOptions:
    """Options of the command line."""

    file: Path
    wait_s: float
    fix: bool
    as_json: bool


def run_doctor(options: DoctorOptions) -> int:
    """The exit code. Raises ConfigError and AutopilotSilentError."""
    config = load_agent(options.file)
    check_agent(options.file, config)
    return asyncio.run(_run(options, config))


async def _run(options: DoctorOptions, config: AgentConfig) -> int:
    with closing(DoctorSession(options.file, config)) as session:
        diagnosis = await run_on_bench(session, options.wait_s, partial(_examine, session, options))
    if options.as_json:
        print(msgspec.json.format(msgspec.json.encode(diagnosis), indent=2).decode())
    return FIT if diagnosis.fit else UNFIT


async def _examine(session: DoctorSession, options: DoctorOptions) -> Diagnosis:
    """Audit and print; with --fix set parameters, then audit and print again."""
    show: Callable[[str], None] = _nothing if options.as_json else print
    diagnosis = await session.diagnose()
    show(heading(diagnosis))
    show(network_line(options.file, session.config))
    _each(show, lines(diagnosis.findings))
    fixable = [finding for finding in diagnosis.findings if finding.fix is not None]
    if options.fix and fixable:
        changes = tuple([await session.fix(finding) for finding in fixable])
        _each(show, ["", *map(str, changes), ""])
        diagnosis = replace(await session.diagnose(), changes=changes)
        _each(show, lines(diagnosis.findings))
    _each(show, ["", summary(diagnosis)])
    return diagnosis


def _each(show: Callable[[str], None], texts: Iterable[str]) -> None:
    for line in texts:
        show(line)


def _nothing(_line: str) -> None:
    """Print nothing: with --json the output is one object."""


class DoctorSession:
    """Link to one vehicle, and the facts for its audit."""

    def __init__(self, file: Path, config: AgentConfig) -> None:
        """Opens the link. Raises ConfigError."""
        self.config = config
        self._survey = Survey()
        self._tracker = tracker_of(config.fleet)
        self._limits = output_limits_of(config.fleet)
        self.bench = Bench(file, config)
        self._link = self.bench.link
        self._parameters: Parameters | None = None  # once it answers
        self._ask_origin_s = float("-inf")

    def jobs(self) -> tuple[Coroutine[None, None, None], ...]:
        """Background jobs until cancelled: the link, the agent's message rates, and the telemetry."""
        return (self._link.receive(), self._link.keep_streams(), self._listen())

    async def _listen(self) -> None:
        while True:
            await asyncio.sleep(LISTEN_PERIOD_S)
            telemetry = self._link.drain()
            self._tracker.fold(telemetry)
            self._survey.update(time.monotonic(), telemetry)
            if self._link.is_connected and time.monotonic() > self._ask_origin_s:
                self._link.request([RequestOrigin()])
                self._ask_origin_s = time.monotonic() + ASK_ORIGIN_PERIOD_S

    async def connect(self, wait_s: float) -> bool:
        """Whether a HEARTBEAT arrives within this time. Then waits until the streams have the requested rates."""
        system = await self.bench.system(wait_s)
        if system is None:
            return False
        self._parameters = Parameters(system)
        await asyncio.sleep(SETTLE_S)
        return True

    async def diagnose(self) -> Diagnosis:
        """Listen for one window, read the parameters, audit."""
        self._survey = Survey()
        await asyncio.sleep(WINDOW_S + 2 * LISTEN_PERIOD_S)
        vehicle, survey, config = self._tracker.state, self._survey, self.config
        assert vehicle.autopilot is not None  # it answers
        assert self._parameters is not None
        facts = Facts(
            autopilot=vehicle.autopilot,
            parameters=await self._parameters.read_all(parameter_names(vehicle.autopilot)),
            hover_thrust_norm=config.vehicle.hover_thrust_norm,
            rates_hz=survey.rates_hz,
            failing_checks=None if vehicle.armed else survey.failing_checks,
            position_check=self._position_check(vehicle),
            position_enu_m=vehicle.position_enu_m,
            battery_percent=-1.0 if survey.battery_percent is None else survey.battery_percent,
            mode_name=vehicle.mode_name,
            armed=vehicle.armed,
            accepts_uncontrolled_descent=config.vehicle.accept_uncontrolled_descent,
        )
        findings = audit(facts)
        return Diagnosis(config.vehicle.id, facts.autopilot, config.vehicle.mavlink, worst(findings), findings)

    async def fix(self, finding: Finding) -> Change:
        """Set the safe value of a finding; not while the vehicle is armed."""
        assert finding.fix is not None
        assert self._parameters is not None
        failure = "armed; land and disarm first" if self._tracker.state.armed else ""
        if not failure:
            try:
                await self._parameters.set(finding.subject, finding.fix)
            except ParameterError as error:
                failure = str(error)
        return Change(finding.subject, finding.found, finding.fix, failure)

    def _position_check(self, vehicle: VehicleState) -> PositionCheck:
        if vehicle.position_time_s > float("-inf"):
            return (
                PositionCheck.INSIDE if self._limits.fence.contains(vehicle.position_enu_m) else PositionCheck.OUTSIDE
            )
        return PositionCheck.UNKNOWN if vehicle.frame_known else PositionCheck.NO_ORIGIN

    def close(self) -> None:
        if self._parameters:
            self._parameters.close()
        self.bench.close()
