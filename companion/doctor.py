"""`companion doctor`: is this vehicle fit to fly in formation, and what is to be set? One link, one audit, one line each."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Callable, Coroutine, Iterable
from contextlib import closing
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import msgspec

from companion.assembly import envelope_limits, tracker_of
from companion.config.vehicle import AgentConfig, load_agent
from companion.core.audit import Facts, Finding, Place, audit, parameter_names, worst
from companion.core.survey import WINDOW_S, Survey
from companion.doctor_report import Change, Diagnosis, closing_words, heading, lines
from companion.link.bench import LISTEN_PERIOD_S, Bench, attended
from companion.link.parameters import ParameterError, Parameters
from companion.types import RequestOrigin, VehicleState

FIT, UNFIT = 0, 1  # exit codes
SETTLE_S = 1.0  # until the streams have the rates that were asked for
ASK_ORIGIN_PERIOD_S = 1.0


@dataclass(frozen=True, slots=True)
class Options:
    """What the command line says."""

    file: Path
    wait_s: float
    fix: bool
    as_json: bool


def run_doctor(options: Options) -> int:
    """The exit code. Raises ConfigError and AutopilotSilentError."""
    return asyncio.run(_run(options, load_agent(options.file)))


async def _run(options: Options, config: AgentConfig) -> int:
    with closing(Patient(options.file, config)) as patient:
        diagnosis = await attended(patient, options.wait_s, partial(_examine, patient, options))
    if options.as_json:
        print(msgspec.json.format(msgspec.json.encode(diagnosis), indent=2).decode())
    return FIT if diagnosis.fit else UNFIT


async def _examine(patient: Patient, options: Options) -> Diagnosis:
    """Audit, show, and where it is asked for fix, and audit and show again."""
    say: Callable[[str], None] = _nothing if options.as_json else print
    diagnosis = await patient.diagnose()
    say(heading(diagnosis))
    _each(say, lines(diagnosis.findings))
    fixable = [finding for finding in diagnosis.findings if finding.fix is not None]
    if options.fix and fixable:
        changes = tuple([await patient.fix(finding) for finding in fixable])
        _each(say, ["", *map(str, changes), ""])
        diagnosis = replace(await patient.diagnose(), changes=changes)
        _each(say, lines(diagnosis.findings))
    _each(say, ["", closing_words(diagnosis)])
    return diagnosis


def _each(say: Callable[[str], None], words: Iterable[str]) -> None:
    for line in words:
        say(line)


def _nothing(_line: str) -> None:
    """For JSON, which is one object and nothing beside it."""


class Patient:
    """One vehicle on the bench, and what is known of it."""

    def __init__(self, file: Path, config: AgentConfig) -> None:
        """Opens the link. Raises ConfigError."""
        self._config = config
        self._survey = Survey()
        self._tracker = tracker_of(config.fleet)
        self._limits = envelope_limits(config.fleet.envelope)
        self.bench = Bench(file, config)
        self._link = self.bench.link
        self._parameters: Parameters | None = None  # once it answers
        self._ask_origin_s = float("-inf")

    def jobs(self) -> tuple[Coroutine[None, None, None], ...]:
        """What goes on meanwhile, until cancelled: the link, the agent's own streams, and what comes of them."""
        return (self._link.receive(), self._link.keep_streams(), self._listen())

    async def _listen(self) -> None:
        while True:
            await asyncio.sleep(LISTEN_PERIOD_S)
            telemetry = self._link.drain()
            self._tracker.fold(telemetry)
            self._survey.hear(time.monotonic(), telemetry)
            if self._link.heard and time.monotonic() > self._ask_origin_s:
                self._link.request([RequestOrigin()])
                self._ask_origin_s = time.monotonic() + ASK_ORIGIN_PERIOD_S

    async def answers(self, wait_s: float) -> bool:
        """Its HEARTBEAT comes within this time. Then its streams get the rates that were asked for."""
        system = await self.bench.system(wait_s)
        if system is None:
            return False
        self._parameters = Parameters(system)
        await asyncio.sleep(SETTLE_S)
        return True

    async def diagnose(self) -> Diagnosis:
        """Listen for a whole window, read the parameters, audit."""
        self._survey = Survey()
        await asyncio.sleep(WINDOW_S + 2 * LISTEN_PERIOD_S)
        vehicle, survey, config = self._tracker.state, self._survey, self._config
        assert vehicle.autopilot is not None  # it answers
        assert self._parameters is not None
        facts = Facts(
            autopilot=vehicle.autopilot,
            parameters=await self._parameters.read_all(parameter_names(vehicle.autopilot)),
            hover_thrust_norm=config.vehicle.hover_thrust_norm,
            rates_hz=survey.rates_hz,
            checks_lack=None if vehicle.armed else survey.checks_lack,
            place=self._place(vehicle),
            position_enu_m=vehicle.position_enu_m,
            battery_percent=-1.0 if survey.battery_percent is None else survey.battery_percent,
            mode_name=vehicle.mode_name,
            armed=vehicle.armed,
        )
        findings = audit(facts)
        return Diagnosis(config.vehicle.id, facts.autopilot, config.vehicle.mavlink, worst(findings), findings)

    async def fix(self, finding: Finding) -> Change:
        """Set what the finding says is safe; nothing while the vehicle is armed."""
        assert finding.fix is not None
        assert self._parameters is not None
        failure = "armed; land and disarm first" if self._tracker.state.armed else ""
        if not failure:
            try:
                await self._parameters.set(finding.subject, finding.fix)
            except ParameterError as error:
                failure = str(error)
        return Change(finding.subject, finding.found, finding.fix, failure)

    def _place(self, vehicle: VehicleState) -> Place:
        if vehicle.position_time_s > float("-inf"):
            return Place.INSIDE if self._limits.inside_fence(vehicle.position_enu_m) else Place.OUTSIDE
        return Place.UNKNOWN if vehicle.frame_known else Place.NO_ORIGIN

    def close(self) -> None:
        if self._parameters:
            self._parameters.close()
        self.bench.close()
