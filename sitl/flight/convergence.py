"""Check before a flight: a path from a leader to every vehicle, and stability, by the criteria of `companion analyze`."""

from __future__ import annotations

from companion.assembly import law_of
from companion.config.planned_flight import neighbour_graph
from companion.core.consensus.law import FormationLaw
from companion.stability.delay_margin import delay_margin_with_lag_s
from companion.stability.interaction import Graph, couple, mode_eigenvalues, mode_figures, reached_from
from companion.stability.prediction import LinearModel
from companion.stability.string_stability import string_gains
from companion.tools.analysis_report import BADLY_DAMPED, GROWS, SMALL_DELAY_MARGIN_S
from companion.types.flight import Role
from companion.types.notices import Code, Notice
from sitl.errors import UnusableError
from sitl.flight.scenario import Scenario

MODEL = LinearModel()


class DivergesError(UnusableError):
    """The formation cannot converge. str() is one line."""


def check_convergence(scenario: Scenario) -> list[Notice]:
    """Warnings about the formation under the scenario's law. Raises DivergesError for one that cannot converge."""
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
    margin_s = delay_margin_with_lag_s(couple(graph, leaders, law), MODEL)
    if margin_s <= MODEL.delay_s:
        text = (
            f"{fleet.law.name} is unstable from a loop delay of {margin_s:.3f} s on, and {MODEL.delay_s:g} s is usual;"
            " change the gains or the law"
        )
        raise _diverges(Notice(Code.FORMATION_UNSTABLE, text))
    return _warnings(graph, leaders, law, margin_s)


def _diverges(notice: Notice) -> DivergesError:
    return DivergesError(f"{notice}; `companion analyze` shows more, and --anyway flies it")


def _warnings(graph: Graph, leaders: list[int], law: FormationLaw, margin_s: float) -> list[Notice]:
    coupling, warnings = couple(graph, leaders, law), []
    damping = min(mode_figures(law.gains, float(value)).damping for value in mode_eigenvalues(coupling))
    if damping < BADLY_DAMPED:
        warnings.append(Notice(Code.BADLY_DAMPED, f"smallest damping {damping:.2f}, 1 is critical"))
    if margin_s < SMALL_DELAY_MARGIN_S:
        warnings.append(Notice(Code.SMALL_DELAY_MARGIN, f"unstable from a loop delay of {margin_s:.3f} s on"))
    gain = string_gains(coupling, MODEL)
    if gain and gain.to_last > GROWS:
        text = f"an oscillation of the leader is up to {gain.to_last:.2f} times as large at the last vehicle"
        warnings.append(Notice(Code.ERRORS_GROW, text))
    return warnings
