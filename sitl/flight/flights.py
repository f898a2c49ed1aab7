"""From a scenario file to a folder of results, under one law or several: check, flights, figures.

How a flight is flown is an argument (`run_flights`); `run_virtual` is `sitl run`, sitl/flight/fly.py has that of `sitl fly`.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Mapping, Sequence
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass, fields
from functools import partial
from pathlib import Path
from typing import Any

from msgspec import Struct

from companion.analysis.interaction import Coupling, couple
from companion.analysis.margins import least_delay_margin_s, string_gains
from companion.analysis.response import (
    AUTOPILOT_STEP_S,
    SPARE_S,
    LinearModel,
    VehicleKind,
    flown_graphs,
    flown_model,
    links_borne_s,
    reached_from,
)
from companion.config.degrees import degree_notices
from companion.config.file import ConfigError
from companion.config.fleet import FormationMember
from companion.config.law import LawName, law_of
from companion.config.planned_flight import graph_in_slots, neighbour_graph
from companion.config.reference import TargetReference
from companion.core.reference.blend import ReferenceTrajectory
from companion.tools.analysis_report import BADLY_DAMPED, GROWS, SMALL_DELAY_MARGIN_S
from companion.types.autopilot import AutopilotKind
from companion.types.commands import CommandName
from companion.types.errors import EXIT_DONE, EXIT_FAILED, UnusableError
from companion.types.flight import Role
from companion.types.notices import Code, Notice
from sitl.flight.files import ids_of, truth_path, write_scenario
from sitl.flight.scenario import Scenario, load_scenario, reference_of, with_law
from sitl.flight.virtual_flight import fly_in_virtual_time
from sitl.flight.watch import FlightWatch
from sitl.report.compare import compare, in_a_table, write_comparison
from sitl.report.folder import open_folder
from sitl.report.metrics import (
    FormationFigures,
    FormationFlight,
    Tracking,
    Tracks,
    TrackSource,
    formation_figures,
    neighbouring_pairs,
    pair_name,
    smallest_distance_m,
    tracking,
)
from sitl.report.progress import FlightProgress
from sitl.report.summary import RunSummary, TickFigures, VehicleSummary, in_words, write_json
from sitl.stopping import StopRequest
from sitl.vehicle.config import StandIn


@dataclass(frozen=True, slots=True, kw_only=True)
class FlightOptions:
    """Options of `sitl run`, `sitl fly` and `sitl fleet`.

    `others` are the laws to compare with, None without --compare. `anyway` flies an unstable formation, too. `record`: agents
    in virtual time leave recordings; those of real processes always do. Real processes choose `port_offset` themselves where it
    is None; `external` is the file of their external autopilots, or the type of real ones to be started, whose programs are
    `binary` where they are not found.
    """

    scenario: Path
    overrides: Sequence[str] = ()
    others: Sequence[LawName] | None = None
    out: Path | None = None
    quiet: bool = False
    anyway: bool = False
    record: bool = False
    port_offset: int | None = None
    external: Path | None = None
    binary: Sequence[Path] = ()


class DivergesError(UnusableError):
    """The formation cannot converge. str() is one line."""


def check_convergence(scenario: Scenario) -> list[Notice]:
    """Warnings about the formation under the scenario's law. Raises DivergesError for one that cannot converge.

    Of several kinds of vehicle each is checked as a fleet of its own; what is said is of the one with the least to spare.
    """
    fleet, law = scenario.fleet, law_of(scenario.fleet.law)
    height_m = fleet.takeoff_height_m
    graph = neighbour_graph(
        fleet.neighbours, {i: (x, y, z + height_m) for i, (x, y, z) in scenario.starts_enu_m.items()}
    )
    leaders = [member.id for member in fleet.vehicles if member.role is Role.LEADER]
    if unreached := sorted(set(graph) - reached_from(graph, leaders)):
        ids = ", ".join(map(str, unreached))
        text = f"no path leads from a leader to vehicle {ids}; add an edge, more range, or a leader among them"
        raise _diverges(Notice(Code.NO_PATH_TO_LEADER, text))
    link_s = scenario.links.peer_delay_s + 0.5 * scenario.links.peer_jitter_s
    slots = {member.id: member.slot_enu_m for member in fleet.vehicles}
    graphs = flown_graphs(graph, graph_in_slots(fleet), leaders)

    def of_kind(kind: VehicleKind) -> tuple[float, float, Coupling, VehicleKind]:
        models = [_model(scenario, kind, borne_s) for borne_s in links_borne_s(link_s)]
        couplings = [couple(each, leaders, law, slots, kind.drag_1_s) for each in graphs]
        return least_delay_margin_s(couplings, models), models[0].delay_s + SPARE_S, couplings[0], kind

    kinds = kinds_of(scenario)
    margin_s, least_s, coupling, kind = min(map(of_kind, kinds), key=lambda found: found[0] - found[1])
    if margin_s <= least_s:
        alike = f" in a fleet of vehicles like {kinds[kind]}" if len(kinds) > 1 else ""
        text = (
            f"{fleet.law.name} is unstable from a loop delay of {margin_s:.3f} s on with links of"
            f" {max(links_borne_s(link_s)):g} s{alike}, and must be stable with {least_s:.3f} s;"
            " change the gains or the law"
        )
        raise _diverges(Notice(Code.FORMATION_UNSTABLE, text))
    return [*degree_notices(fleet.origin, scenario), *_warnings(coupling, margin_s, _model(scenario, kind, link_s))]


def kinds_of(scenario: Scenario) -> dict[VehicleKind, int]:
    """The kinds of vehicles in it, each with the lowest id."""
    kinds: dict[VehicleKind, int] = {}
    for vehicle_id in ids_of(scenario):
        stand_in = scenario.stand_in_of(vehicle_id)
        airframe = stand_in.airframe
        kind = VehicleKind(stand_in.autopilot, airframe.drag_n_per_m_s / airframe.mass_kg)
        kinds.setdefault(kind, vehicle_id)
    return kinds


def _model(scenario: Scenario, kind: VehicleKind, link_s: float) -> LinearModel:
    """The model of a fleet of such vehicles with this link."""
    on_board_s = AUTOPILOT_STEP_S + scenario.links.telemetry_delay_s + scenario.links.setpoint_delay_s
    return flown_model(kind.autopilot, link_s, kind.drag_1_s, on_board_s)


def _diverges(notice: Notice) -> DivergesError:
    return DivergesError(f"{notice}; `companion analyze` shows more, and --anyway flies it")


def _warnings(coupling: Coupling, margin_s: float, model: LinearModel) -> list[Notice]:
    warnings = []
    if (damping := coupling.damping) < BADLY_DAMPED:
        warnings.append(Notice(Code.BADLY_DAMPED, f"swings before it settles, damping {damping:.2f} of 1"))
    if margin_s < SMALL_DELAY_MARGIN_S:
        text = f"unstable from a loop delay of {margin_s:.3f} s on; this flight has {model.delay_s:.3f} s"
        warnings.append(Notice(Code.SMALL_DELAY_MARGIN, text))
    gain = string_gains(coupling, model)
    if gain and gain.to_last > GROWS:
        warnings.append(Notice(Code.ERRORS_GROW, f"swings grow up to {gain.to_last:.2f} times to the rear"))
    return warnings


@dataclass(frozen=True, slots=True)
class FlightOrder:
    """One flight to be flown: its scenario with a name, the folder for its results, and the request to stop it.

    `turn` is its place among several, as in "2 of 4".
    """

    scenario: Scenario
    name: str
    folder: Path
    stop: StopRequest
    turn: str | None = None

    @property
    def title(self) -> str:
        """What stands over its progress."""
        return f"{self.name}, {self.scenario.fleet.law.name}" + (f" ({self.turn})" if self.turn else "")


@dataclass(frozen=True, slots=True)
class FlightResult:
    """One flight: its figures, and what they are drawn from (None where no formation was flown)."""

    summary: RunSummary
    flight: FormationFlight | None


class FlightEnd(Struct, frozen=True, kw_only=True):
    """How a flight ended: the failure in one line, the time flown, the source of its tracks, and, where
    real autopilots have flown in the place of stand-ins, their types by vehicle id.
    """

    failure: str | None
    flight_s: float
    real_time_factor: float | None = None
    source: TrackSource = "true"
    real_autopilots: Mapping[int, AutopilotKind] | None = None


def result_of(scenario: Scenario, name: str, watch: FlightWatch, tracks: Tracks | None, end: FlightEnd) -> FlightResult:
    """The figures of a flight. `tracks` is None where none are known."""
    flight = _flight(scenario, watch, tracks, end.source) if tracks else None
    smallest_m = smallest_distance_m(tracks) if tracks else None
    return FlightResult(summarize(scenario, name, watch, end, flight, smallest_m), flight)


def write_results(order: FlightOrder, watch: FlightWatch, tracks: Tracks | None, end: FlightEnd) -> FlightResult:
    """summary.json and, where a formation was flown, its figures. `tracks` is None where none are known."""
    scenario, name, folder = order.scenario, order.name, order.folder
    result = result_of(scenario, name, watch, tracks, end)
    write_json(folder / "summary.json", result.summary)
    if flight := result.flight:
        from sitl.report.plan_view import save_plan_view  # matplotlib is slow to import
        from sitl.report.plots import save_figure_5, save_figure_6

        save_figure_5(folder / "figure_5.png", flight, name)
        save_figure_6(folder / "figure_6.png", flight, name)
        save_plan_view(folder / "from_above.png", flight, watch, name, scenario.fleet.airspace)
    return result


# The figures of a formation that a summary has as well.
FIGURES = [field.name for field in fields(FormationFigures) if field.name in RunSummary.__struct_fields__]
DIGITS = {"duration_s": 3, "settle_s": 2}  # lengths have four


def summarize(
    scenario: Scenario,
    name: str,
    watch: FlightWatch,
    end: FlightEnd,
    flight: FormationFlight | None = None,
    smallest_m: float | None = None,
) -> RunSummary:
    """`flight` is None where no formation was flown; `smallest_m` is the smallest distance of two vehicles on their tracks."""
    fleet, stand_in = scenario.fleet, scenario.stand_in
    by_stand_ins = end.source == "true" and end.real_autopilots is None
    figures = formation_figures(flight.tracks, flight.slots, flight.reference, flight.formation) if flight else None
    tracked = (
        tracking(flight.tracks, flight.slots, flight.reference, flight.formation, watch.leads()) if flight else None
    )
    shown = {figure: _rounded(getattr(figures, figure, None), DIGITS.get(figure, 4)) for figure in FIGURES}
    if watch.under_way_s:  # errors to slots that still move do not settle
        shown["settle_s"] = None
    own = {i: scenario.stand_in_of(i) for i in ids_of(scenario)} if by_stand_ins else {}
    autopilots = end.real_autopilots or {i: one.autopilot for i, one in own.items()}
    sensors = {i: sensors_in_words(one) for i, one in own.items()}
    slots_enu_m = {member.id: member.slot_enu_m for member in fleet.vehicles}
    return RunSummary(
        scenario=name,
        law=fleet.law.name,
        law_parameters=fleet.law.parameters,
        tracks=end.source,
        sensors=" and ".join(sorted(set(sensors.values()))) or None,
        seed=stand_in.seed if by_stand_ins else None,
        failure=end.failure,
        flight_s=round(end.flight_s, 1),
        real_time_factor=_rounded(end.real_time_factor, 3),
        pairs=[pair_name(pair) for pair in neighbouring_pairs(slots_enu_m)],
        **shown,
        under_way_s=watch.under_way_s,
        overload=watch.overload(),
        smallest_distance_m=_rounded(smallest_m),
        vehicles=[
            _vehicle(
                member, watch, figures, tracked, autopilot=autopilots.get(member.id), sensors=sensors.get(member.id)
            )
            for member in sorted(fleet.vehicles, key=lambda member: member.id)
        ],
        commands=watch.commands,
        events=watch.events,
    )


def sensors_in_words(stand_in: StandIn) -> str:
    """The name, where they have one."""
    return stand_in.sensors if isinstance(stand_in.sensors, str) else "as given"


def _vehicle(
    member: FormationMember,
    watch: FlightWatch,
    figures: FormationFigures | None,
    tracked: Tracking | None,
    *,
    autopilot: AutopilotKind | None,
    sensors: str | None,
) -> VehicleSummary:
    vehicle_id = member.id
    timing, status = watch.timing.get(vehicle_id), watch.status(vehicle_id)
    return VehicleSummary(
        id=vehicle_id,
        role=member.role,
        autopilot=autopilot,
        sensors=sensors,
        tick=TickFigures(rate_hz=timing.rate_hz, ticks=timing.ticks, missed=timing.missed, late_us=timing.late_us)
        if timing
        else None,
        telemetry_to_command_us=timing.telemetry_to_command_us if timing else None,
        cpu_percent=timing.cpu_percent if timing else None,
        rss_mb=timing.rss_mb if timing else None,
        final_error_m=_rounded(figures.final_error_of_vehicle_m[vehicle_id] if figures else None),
        tracking_error_m=_rounded(tracked.to_reference_m[vehicle_id] if tracked else None),
        behind_leader_m=_rounded(tracked.to_leader_m[vehicle_id] if tracked else None),
        largest_step_deg=_rounded(watch.largest_step_deg.get(vehicle_id), 2),
        filter_acted_s=_rounded(watch.filter_acted_s.get(vehicle_id), 1),
        rejected=status.rejected if status else {},
    )


def _rounded(value: Any, digits: int = 4) -> Any:
    """A number, or every number of a mapping; None and a truth value stay."""
    if isinstance(value, Mapping):
        return {name: round(number, digits) for name, number in value.items()}
    return value if value is None or isinstance(value, bool) else round(value, digits)


def reference_flown(scenario: Scenario, watch: FlightWatch) -> ReferenceTrajectory:
    """The configured reference, or the reported one where commands or a target change it."""
    changes = any(step.command is CommandName.REFERENCE for step in scenario.timeline)
    varies = changes or isinstance(scenario.reference, TargetReference)
    return watch.reported_reference() if varies and len(watch.reference) > 1 else reference_of(scenario)


def _flight(scenario: Scenario, watch: FlightWatch, tracks: Tracks, source: TrackSource) -> FormationFlight | None:
    if watch.formation is None:
        return None
    pairs = neighbouring_pairs({member.id: member.slot_enu_m for member in scenario.fleet.vehicles})
    reference = reference_flown(scenario, watch)
    return FormationFlight(scenario.fleet.law.name, tracks, watch.slots(), pairs, reference, watch.formation, source)


FlyOnce = Callable[[FlightOrder], FlightResult]
Prepare = Callable[[Scenario], AbstractContextManager[FlyOnce]]


def run_flights(options: FlightOptions, prepare: Prepare) -> int:
    """Fly as the options require; returns the exit code. Raises what sitl/cli/main.py reports.

    `prepare` reserves what the flights need, before anything is written or flown; it may raise ConfigError or
    PortInUseError.
    """
    with StopRequest("stopped at once; the vehicles were not landed") as stop:
        scenario = load_scenario(options.scenario, options.overrides)
        scenarios = [with_law(scenario, law) for law in _laws(scenario, options)]
        warnings = _convergence_warnings(scenarios, options.anyway)
        name = options.scenario.stem
        stem = f"{name}-{scenario.fleet.law.name}"
        with prepare(scenario) as fly_once, open_folder(options.out, stem) as folder:
            _show(warnings, options.quiet)
            if (changed := _changed(options.overrides)) and not options.quiet:
                print(changed, flush=True)
            if options.others is None:
                return _fly_one(FlightOrder(scenario, name, folder, stop), fly_once)
            return _fly_laws(scenarios, name, folder, fly_once, stop)


def _laws(scenario: Scenario, options: FlightOptions) -> list[LawName]:
    """The scenario's own law, then the others. Raises ConfigError."""
    own = scenario.fleet.law.name
    if options.others is not None and all(step.command is not CommandName.FORM for step in scenario.timeline):
        raise ConfigError(
            options.scenario, "timeline", "has no step with command: form, so --compare has nothing to compare"
        )
    return [own, *(law for law in options.others or () if law != own)]


def _convergence_warnings(scenarios: list[Scenario], anyway: bool) -> list[str]:
    """About the formation under each law, one line each. Raises DivergesError, but not with `anyway`."""
    warnings = []
    for scenario in scenarios:
        law = scenario.fleet.law.name
        try:
            warnings += [_before_flight(law, notice) for notice in check_convergence(scenario)]
        except DivergesError as error:
            if not anyway:
                raise
            warnings.append(f"{WARNING}{law}: {error}")
    return warnings


def _show(warnings: list[str], quiet: bool) -> None:
    """What is wrong is never kept quiet, only what is expected."""
    shown = [line for line in warnings if line.startswith(WARNING)] if quiet else warnings
    print("".join(f"{line}\n" for line in shown), end="", flush=True, file=sys.stderr if quiet else sys.stdout)


def _changed(overrides: Sequence[str]) -> str:
    """What of the scenario is set otherwise, but the law, which the result names; empty where nothing is."""
    others = [one for one in overrides if not one.startswith("fleet.law.name=")]
    return f"changed: {', '.join(others)}" if others else ""


WARNING = "warning, "
EXPECTED = (Code.BADLY_DAMPED, Code.ERRORS_GROW)  # how a flight looks that settles and lands all the same


def _before_flight(law: LawName, notice: Notice) -> str:
    if notice.code in EXPECTED:
        return f"expected of {law}: {notice.text} ({notice.code})"
    return f"{WARNING}{law}: {notice}"


def _fly_one(order: FlightOrder, fly_once: FlyOnce) -> int:
    result = fly_once(order)
    print(f"{in_words(result.summary)}\nresults in {order.folder}")
    return order.stop.exit_code if order.stop.number else _exit_code(result.summary)


def _fly_laws(scenarios: list[Scenario], name: str, folder: Path, fly_once: FlyOnce, stop: StopRequest) -> int:
    """One flight per law, then the table and the figure.

    A law that fails in formation is part of the comparison; a flight without a formation ends it.
    """
    results: list[FlightResult] = []
    for number, scenario in enumerate(scenarios, start=1):
        turn = f"{number} of {len(scenarios)}"
        result = fly_once(FlightOrder(scenario, name, folder / scenario.fleet.law.name, stop, turn))
        results.append(result)
        print(in_words(result.summary) + "\n", flush=True)
        if stop.number or result.flight is None:
            print(f"results so far in {folder}")
            return stop.exit_code if stop.number else EXIT_FAILED
    comparison = compare([result.summary for result in results])
    write_comparison(folder, comparison, [result.flight for result in results if result.flight])
    print(f"{in_a_table(comparison)}\nresults in {folder}")
    return max(_exit_code(result.summary) for result in results)


def _exit_code(summary: RunSummary) -> int:
    return EXIT_FAILED if summary.failure else EXIT_DONE


def run_virtual(options: FlightOptions) -> int:
    """Fly as the options require; returns the exit code."""
    return run_flights(options, lambda _scenario: nullcontext(partial(_run_once, options)))


def _run_once(options: FlightOptions, order: FlightOrder) -> FlightResult:
    scenario, folder = order.scenario, order.folder
    folder.mkdir(parents=True, exist_ok=True)
    write_scenario(scenario, folder)
    progress = FlightProgress(order.title, options.quiet, began_s=0.0)
    with progress:
        flown = fly_in_virtual_time(scenario, progress, order.stop, folder if options.record else None)
    for stand_in in flown.stand_ins:
        stand_in.write_track(truth_path(folder, stand_in.vehicle_id))
    factor = flown.flight_s / flown.wall_s
    end = FlightEnd(failure=flown.failure, flight_s=flown.flight_s, real_time_factor=factor)
    return write_results(order, flown.watch, flown.tracks(), end)
