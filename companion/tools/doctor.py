"""`companion doctor`: whether a vehicle is fit to fly in formation; with --fix it sets safe parameter values."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Coroutine, Iterator, Sequence
from contextlib import closing
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from functools import partial
from math import dist
from pathlib import Path
from typing import Any

from companion.assembly import check_agent, fleet_fence_of, output_limits_of, profiles_of, tracker_of
from companion.config.degrees import METRES, degree_notices
from companion.config.file import ConfigError
from companion.config.vehicle import AgentConfig, load_agent
from companion.core.preflight import WINDOW_S, Survey
from companion.core.safety.audit import AuditFinding, Facts, FoundHome, PositionCheck, Verdict, audit, worst
from companion.link.bench import LISTEN_PERIOD_S, Bench, ParameterError, Parameters
from companion.mavlink.autopilot_types import DIALECTS
from companion.tools.output import found_lines, json_text, line_printer
from companion.types.autopilot import AutopilotKind, RequestOrigin, VehicleState

SOON_DAYS = 30
FIT, UNFIT = 0, 1  # exit codes
SETTLE_S = 1.0  # until the streams have the requested rates
ASK_ORIGIN_PERIOD_S = 1.0
SHOWN = {Verdict.OK: "ok", Verdict.WARNING: "warning", Verdict.REFUSAL: "REFUSAL"}


@dataclass(frozen=True, slots=True)
class Change:
    """A parameter that --fix set, or the reason why it did not."""

    name: str
    found: str
    value: float
    failure: str = ""

    def __str__(self) -> str:
        outcome = f"not set: {self.failure}" if self.failure else "set and read back"
        return f"{self.name}: {self.found} -> {self.value:g}: {outcome}"


@dataclass(frozen=True, slots=True)
class Diagnosis:
    """Result of the doctor for one vehicle, as `--json` prints it."""

    vehicle: int
    autopilot: AutopilotKind
    mavlink: str
    verdict: Verdict
    findings: tuple[AuditFinding, ...]
    changes: tuple[Change, ...] = ()

    @property
    def fit(self) -> bool:
        """Whether there is no refusal and every parameter could be set."""
        return self.verdict is not Verdict.REFUSAL and not any(change.failure for change in self.changes)


def heading(diagnosis: Diagnosis) -> str:
    """The first line of the report."""
    return f"vehicle {diagnosis.vehicle}, {DIALECTS[diagnosis.autopilot].NAME} at {diagnosis.mavlink}"


def lines(findings: Sequence[AuditFinding]) -> Iterator[str]:
    """One line per finding, in columns; the code follows where the finding is not OK."""
    rows = []
    for finding in findings:
        wanted = f"wanted: {finding.wanted}" + (f"; {finding.remedy}" if finding.remedy else "")
        wanted += f" [{finding.code}]" if finding.code else ""
        rows.append((SHOWN[finding.verdict], finding.subject, finding.found, wanted))
    return found_lines(rows, verdict_width=8)


def summary(diagnosis: Diagnosis) -> str:
    """The last line: fit or not, number of findings, and what --fix would set."""
    refusals = sum(finding.verdict is Verdict.REFUSAL for finding in diagnosis.findings)
    warnings = sum(finding.verdict is Verdict.WARNING for finding in diagnosis.findings)
    fixable = [f"{finding.subject} to {finding.fix:g}" for finding in diagnosis.findings if finding.fix is not None]
    text = "not fit to fly in formation" if refusals else "fit to fly in formation"
    text += f": {_count(refusals, 'refusal')}, {_count(warnings, 'warning')}"
    if fixable and not diagnosis.changes:
        text += f"; --fix would set {', '.join(fixable)}"
    return text


def _count(number: int, noun: str) -> str:
    return f"{number} {noun}" + ("" if number == 1 else "s")


def network_line(vehicle_file: Path, config: AgentConfig) -> str:
    """Identity, no security, or none needed. An identity that cannot be used is named, as the agent would refuse it."""
    if config.vehicle.identity is None:
        if config.fleet.security == "none":
            return "warning  network: UNSECURED: strangers in it can command this vehicle (security: none in the fleet file)"
        return "ok       network: reached from this computer only"
    from companion.link.fleet.identity import vehicle_identity  # without an identity its library is not loaded

    try:
        identity = vehicle_identity(vehicle_file, config)
    except ConfigError as error:
        return f"REFUSAL  network: {error}"
    days = (identity.expires_at - datetime.now(UTC)).days
    soon = f"; companion provision renew, {days} days are left" if days < SOON_DAYS else ""
    words = f"identity {identity.common_name}, valid until {identity.expires_at:%Y-%m-%d}"
    return f"{'warning' if soon else 'ok':<8} network: {words}, admission list {identity.admitted.number}{soon}"


def _positions_in_degrees(config: AgentConfig) -> Iterator[AuditFinding]:
    """A warning about each of the two files with a position that looks like latitude and longitude."""
    for subject, content in (("fleet file", config.fleet), ("vehicle file", config.vehicle)):
        for notice in degree_notices(config.fleet.origin, content):
            yield AuditFinding(
                subject, Verdict.WARNING, notice.code, notice.text.removesuffix(f"; expected {METRES}"), METRES
            )


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
        diagnosis = await session.run(options.wait_s, partial(_examine, session, options))
    if options.as_json:
        print(json_text(diagnosis))
    return FIT if diagnosis.fit else UNFIT


async def _examine(session: DoctorSession, options: DoctorOptions) -> Diagnosis:
    """Audit and print; with --fix set parameters, then audit and print again."""
    show = line_printer(options.as_json)
    diagnosis = await session.diagnose()
    show([heading(diagnosis), network_line(options.file, session.config), *lines(diagnosis.findings)])
    fixable = [finding for finding in diagnosis.findings if finding.fix is not None]
    if options.fix and fixable:
        changes = tuple([await session.fix(finding) for finding in fixable])
        show(["", *map(str, changes), ""])
        diagnosis = replace(await session.diagnose(), changes=changes)
        show(lines(diagnosis.findings))
    show(["", summary(diagnosis)])
    return diagnosis


class DoctorSession(Bench):
    """Link to one vehicle, and the facts for its audit."""

    def __init__(self, file: Path, config: AgentConfig) -> None:
        """Opens the link. Raises ConfigError."""
        super().__init__(file, config)
        self.config = config
        self._survey = Survey()
        self.tracker = tracker_of(config.fleet)
        self._limits = output_limits_of(config.fleet)
        self.parameters: Parameters | None = None  # once it answers
        self._ask_origin_s = float("-inf")

    def jobs(self) -> tuple[Coroutine[None, None, None], ...]:
        """Background jobs until cancelled: the link, the agent's message rates, and the telemetry."""
        return (self.link.receive(), self.link.keep_streams(), self.link.keep_time(), self._listen())

    async def _listen(self) -> None:
        while True:
            await asyncio.sleep(LISTEN_PERIOD_S)
            telemetry = self.link.drain()
            self.tracker.fold(telemetry)
            self._survey.update(time.monotonic(), telemetry)
            if self.link.is_connected and time.monotonic() > self._ask_origin_s:
                self.link.request([RequestOrigin()])
                self._ask_origin_s = time.monotonic() + ASK_ORIGIN_PERIOD_S

    async def connected(self, system: Any) -> None:
        """Waits until the streams have the requested rates."""
        self.parameters = Parameters(system)
        await asyncio.sleep(SETTLE_S)

    async def diagnose(self) -> Diagnosis:
        """Listen for one window, read the parameters, audit."""
        self._survey = Survey()
        await asyncio.sleep(WINDOW_S + 2 * LISTEN_PERIOD_S)
        vehicle, survey, config = self.tracker.state, self._survey, self.config
        assert vehicle.autopilot is not None  # it answers
        assert self.parameters is not None
        profile = profiles_of(config.fleet)[vehicle.autopilot]
        rules, needs_altitude = profile.parameters, profile.takes_off_by_altitude
        awaits_poses = config.fleet.external_vision is not None and vehicle.altitude_amsl_m is None
        parameters = await self.parameters.read_all(rule.name for rule in rules)
        round_trip_s = self.link.round_trip_s
        facts = Facts(
            rules=rules,
            parameters=parameters,
            hover_thrust_norm=config.vehicle.hover_thrust_norm,
            rates_hz=survey.rates_hz,
            missing=survey.missing,
            messages=profile.messages,
            interleaves=vehicle.interleaves,
            round_trip_s=self.parameters.shortest_read_s if round_trip_s is None else round_trip_s,
            awaits_poses=awaits_poses,
            failing_checks=None if vehicle.armed or awaits_poses else survey.failing_checks,
            position_check=None if awaits_poses else self._position_check(vehicle),
            position_enu_m=vehicle.position_enu_m,
            lacks_altitude=needs_altitude
            and vehicle.frame_known
            and vehicle.altitude_amsl_m is None
            and not awaits_poses,
            home=None if awaits_poses else self._found_home(vehicle),
            battery_percent=-1.0 if survey.battery_percent is None else survey.battery_percent,
            mode_name=vehicle.mode_name,
            armed=vehicle.armed,
            accepts_uncontrolled_descent=config.vehicle.accept_uncontrolled_descent,
            fence=replace(fleet_fence_of(config.fleet), home_enu_m=vehicle.home_enu_m),
        )
        findings = (*audit(facts), *_positions_in_degrees(config))
        return Diagnosis(config.vehicle.id, vehicle.autopilot, config.vehicle.mavlink, worst(findings), findings)

    async def fix(self, finding: AuditFinding) -> Change:
        """Set the safe value of a finding; not while the vehicle is armed."""
        assert finding.fix is not None
        assert self.parameters is not None
        failure = "armed; land and disarm first" if self.tracker.state.armed else ""
        if not failure:
            try:
                await self.parameters.set(finding.subject, finding.fix)
            except ParameterError as error:
                failure = str(error)
        return Change(finding.subject, finding.found, finding.fix, failure)

    def _position_check(self, vehicle: VehicleState) -> PositionCheck:
        if vehicle.position_time_s > float("-inf"):
            return (
                PositionCheck.INSIDE if self._limits.fence.contains(vehicle.position_enu_m) else PositionCheck.OUTSIDE
            )
        return PositionCheck.UNKNOWN if vehicle.frame_known else PositionCheck.NO_ORIGIN

    def _found_home(self, vehicle: VehicleState) -> FoundHome | None:
        if vehicle.armed or vehicle.position_time_s == float("-inf"):
            return None
        home = vehicle.home_enu_m
        apart_m = None if home is None else dist(home, vehicle.position_enu_m[:2])
        return FoundHome(apart_m, self.config.fleet.separation_m, vehicle.returns_elsewhere)

    def close(self) -> None:
        if self.parameters:
            self.parameters.close()
        super().close()
