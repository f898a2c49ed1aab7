"""Report of `companion analyze`: figures as tables, and findings with their remedies."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from math import inf
from textwrap import wrap

import numpy as np

from companion.analysis.response import ATTITUDE_LOOPS, LATE_LINK_S, TICK_S
from companion.geometry.formations import ROUNDING_M
from companion.tools.analysis import ERROR_TURNS_S, PREDICT_S, VELOCITY_ERROR_M_S, Analysis, LawAnalysis
from companion.tools.second_edges import GROWS as GROWS_AT_ALL
from companion.tools.subject import STEP_M
from companion.types.autopilot import AutopilotKind
from companion.types.notices import Code, Notice

BADLY_DAMPED = 0.3
GROWS = 1.2  # string gain to the last vehicle; 1 is perfect, and up to this value the difference is not visible
DEEP = 0.5  # time for a motion to reach the last vehicle, in settling times of a leader alone
SMALL_DELAY_MARGIN_S = 0.15  # three times the usual loop delay
WHOLE_UP_TO = 20  # vehicles; a larger matrix does not fit a screen
A_LINE = 8  # vehicles per line
COLUMNS = 100
ONE_KIND = (
    "{} kinds of vehicles by autopilot and drag: all figures are of a fleet of vehicles like {}, the kind with the least"
    " delay to spare; nothing is computed of the mixture"
)
NO_ADVICE = "no advice on gains: the law has no parameters position_gain_1_s2 and velocity_gain_1_s"

LAG_S = 1.0 / ATTITUDE_LOOPS[AutopilotKind.PX4].tilt_gain_1_s
LEGEND = f"""\
  lambda_min: the smallest eigenvalue of G; the larger, the faster errors decay
  damping: 1 is critical, 0 is an undamped oscillation
  no lag: without attitude lag and link; all else is with the attitude loop as measured, {LAG_S:.2f} s of PX4
  delay margin: the delay on board above which the formation is unstable, with the links of the scenario,
    or with any up to {LATE_LINK_S:g} s where it has none
  string gain: factor by which an oscillation grows on its way from the leader, at the frequency
    where it grows most; `gain per hop` of `sitl compare` is of the largest deviations after a step
  alpha, rho, gamma: exponent, weight_ratio and feedforward of the law; gamma is the share of the
    neighbours' acceleration that is fed forward
  shift: where a vehicle rests while its velocity disagrees with its position; corrected: with
    velocity_correction_1_s, for an error that turns once in {ERROR_TURNS_S:g} s. Not of a law with memory,
    which can take the shift out, as integral action does
  transient peak: the largest error of any vehicle over the largest at the start
  kept: as the separation filter leaves it; all other rows are of the law alone
  no law sooner: so long a leader alone takes under this law, and its motion over all hops, with mean
    delay, wait and loss. It differs by law, as leaders do: behind such a leader no law of followers is
    sooner"""


def report(analysis: Analysis) -> str:
    """The text that `companion analyze` prints."""
    lines = [
        f"{analysis.file}: {_vehicles(analysis)}, led by {_ids(analysis.leaders)}, law {analysis.law}",
        *([f"with {', '.join(analysis.settings)}"] if analysis.settings else []),
        *(wrap(ONE_KIND.format(analysis.kinds, analysis.like_vehicle), COLUMNS) if analysis.kinds > 1 else []),
        "",
    ]
    lines += ["neighbours at the start:"]
    lines += [f"  {i}: {_ids(neighbours) or 'none'}" for i, neighbours in analysis.graph.items()]
    if analysis.laws:
        lines += [
            "",
            *_law_table(analysis),
            "",
            *_leader_table(analysis),
            *_second_edges(analysis),
            "",
            *_matrix(analysis),
        ]
    if analysis.not_read:
        lines += [
            "",
            f"not read and not checked: {', '.join(analysis.not_read)}; `sitl run` checks and uses them",
        ]
    lines += ["", "verdict:"]
    for finding in verdict(analysis):
        lines += wrap(f"- {finding}", COLUMNS, initial_indent="  ", subsequent_indent="    ", break_long_words=False)
    return "\n".join(lines)


def _vehicles(analysis: Analysis) -> str:
    return "1 vehicle" if len(analysis.vehicles) == 1 else f"{len(analysis.vehicles)} vehicles"


def verdict(analysis: Analysis) -> list[Notice]:
    """Findings with their remedies; a single FORMATION_CONVERGES where there are none."""
    warnings = list(_warnings(analysis))
    if len(analysis.vehicles) == 1 and not analysis.unreached:
        text = f"vehicle {_ids(analysis.vehicles)} is alone and follows its reference; there is no formation"
        return [Notice(Code.SINGLE_VEHICLE, text), *warnings]
    converges = Notice(Code.FORMATION_CONVERGES, f"the formation converges under {analysis.law}, without findings")
    return warnings or [converges]


def _warnings(analysis: Analysis) -> Iterator[Notice]:
    yield from analysis.looks_wrong
    if analysis.unreached:
        yield Notice(
            Code.NO_PATH_TO_LEADER,
            f"cannot converge: no path leads from a leader to vehicle {_ids(analysis.unreached)}; add an edge, more range, "
            "or a leader among them (Lemma 1)",
        )
        return
    law = analysis.laws[analysis.law]
    if not law.stable:
        yield Notice(Code.FORMATION_UNSTABLE, _unstable(analysis, law))
        return
    yield from _slow_or_badly_damped(analysis, law)
    yield from _grows(analysis, law)
    yield from _too_deep(analysis, law)
    yield from _too_far_or_too_close(analysis, law)
    yield from _better_leader(analysis)


def _unstable(analysis: Analysis, law: LawAnalysis) -> str:
    others = [
        name
        for name, other in analysis.laws.items()
        if other.stable and other.delay_margin_with_lag_s >= SMALL_DELAY_MARGIN_S
    ]
    other = f"; {' and '.join(others)} would be stable, with the gains above" if others else ""
    links, helps = f"links of {analysis.latest_link_s:g} s", _for_the_margin(law)
    if law.delay_margin_with_lag_s > 0.0:
        return (
            f"unstable with the delays of its flight, and so it cannot converge: with {links} errors grow without limit from a"
            f" loop delay of {law.delay_margin_with_lag_s:.3f} s on, and it must be stable with {analysis.least_margin_s:.3f}"
            f" s; {helps}{other}"
        )
    return (
        f"unstable with the attitude lag alone, and so it cannot converge: with {links} errors grow without limit even without"
        f" delay; {helps}{other}"
    )


def _for_the_margin(law: LawAnalysis) -> str:
    """Which gains to change for a larger delay margin: more damping or a slower loop."""
    if law.more_velocity_gain_helps is None:
        return NO_ADVICE
    if law.more_velocity_gain_helps:
        return "more gain on velocity or less on position helps"
    return "less gain on both velocity and position helps"


def _for_damping(law: LawAnalysis) -> list[str]:
    """Changes of the gains that increase the damping.

    Less gain on position always does. More gain on velocity is advised only where the delay margin permits it.
    """
    if law.more_velocity_gain_helps is None:
        return []
    spare = law.feedforward == 0.0 and law.delay_margin_with_lag_s >= SMALL_DELAY_MARGIN_S
    if spare or law.more_velocity_gain_helps:
        return ["more gain on velocity", "less on position"]
    return ["less gain on position"]


def _slow_or_badly_damped(analysis: Analysis, law: LawAnalysis) -> Iterator[Notice]:
    if law.damping_min < BADLY_DAMPED:
        changes = _for_damping(law)
        yield Notice(
            Code.BADLY_DAMPED,
            f"badly damped (smallest damping {law.damping_min:.2f}, 1 is critical): errors oscillate before they settle; "
            + (f"{' or '.join(changes)} helps, and so does a larger lambda_min" if changes else NO_ADVICE),
        )
    if law.delay_margin_with_lag_s < SMALL_DELAY_MARGIN_S:
        yield Notice(
            Code.SMALL_DELAY_MARGIN,
            f"small delay margin: with links of {analysis.latest_link_s:g} s a loop delay of {law.delay_margin_with_lag_s:.3f}"
            f" s makes it unstable, and it must be stable with {analysis.least_margin_s:.3f} s; {_for_the_margin(law)}",
        )
    if law.predicted_settle_s is None:
        text = f"not within 10 cm after {PREDICT_S:g} s, by the linear model with attitude lag and delays"
        yield Notice(Code.SETTLES_SLOWLY, text)


def _grows(analysis: Analysis, law: LawAnalysis) -> Iterator[Notice]:
    if law.string_gain_per_hop is None or law.string_gain_to_last is None or law.string_gain_to_last <= GROWS:
        return
    to_last = {
        name: other.string_gain_to_last
        for name, other in analysis.laws.items()
        if other.string_gain_to_last is not None and _settles_as_soon(other, law)
    }
    least = min(to_last, key=lambda name: to_last[name])
    other = "" if least == analysis.law else f"; {least} has {to_last[least]:.2f} to the last"
    remedies = [*_for_damping(law), *(["feedforward"] if law.feedforward == 0.0 else [])]
    yield Notice(
        Code.ERRORS_GROW,
        f"errors grow from hop to hop: the leader's motion is amplified up to {law.string_gain_per_hop:.2f} times in one hop "
        f"(at {law.string_gain_per_hop_rad_s:.2f} rad/s) and {law.string_gain_to_last:.2f} times to the last vehicle (at "
        f"{law.string_gain_to_last_rad_s:.2f} rad/s); {', '.join(remedies)}, or fewer hops from the leader help{other}",
    )


def _settles_as_soon(other: LawAnalysis, law: LawAnalysis) -> bool:
    """Whether this law is no slower than the one flown: a slow law amplifies less, but is no remedy."""
    return (other.predicted_settle_s or inf) <= (law.predicted_settle_s or inf)


def _too_deep(analysis: Analysis, law: LawAnalysis) -> Iterator[Notice]:
    late_s = analysis.hops * TICK_S
    if law.leader_step_settle_s is None or late_s < DEEP * law.leader_step_settle_s:
        return
    yield Notice(
        Code.FLEET_TOO_DEEP,
        f"deep for its delay: {analysis.hops} hops pass a motion of the leader on, {late_s:.1f} s later to the last vehicle,"
        f" and {late_s + analysis.hops * LATE_LINK_S:.1f} s with links of {1000 * LATE_LINK_S:g} ms; a leader alone settles in"
        f" {law.leader_step_settle_s:.1f} s from {STEP_M:g} m, and from {DEEP:g} times that on a fleet is deep; more edges, a "
        "leader in the middle or a second leader help",
    )


def _too_far_or_too_close(analysis: Analysis, law: LawAnalysis) -> Iterator[Notice]:
    if law.margin_to_range_m is not None and law.margin_to_range_m < 0.0 and law.predicted_max_distance_m:
        pair, distance_m = max(law.predicted_max_distance_m.items(), key=lambda item: item[1])
        yield Notice(
            Code.NEIGHBOURS_OUT_OF_RANGE,
            f"neighbours lose each other: {pair} is {distance_m:.2f} m apart, {-law.margin_to_range_m:.2f} m beyond the "
            "range, and the prediction after that does not hold; start closer, move the reference slower, or give the edges "
            "explicitly",
        )
    closest_m = law.law_alone_distance_m
    if closest_m is not None and closest_m < analysis.separation_m - ROUNDING_M:
        text = (
            f"vehicles come close: with the law alone {law.smallest_distance_of} would come within {closest_m:.2f} m of each"
            f" other, separation_m is {analysis.separation_m:g}; the separation filter keeps them apart, and they settle at"
            " another time than predicted; use more spacing or better damping"
        )
        yield Notice(Code.NEIGHBOURS_TOO_CLOSE, text)


def _better_leader(analysis: Analysis) -> Iterator[Notice]:
    best = max(analysis.lambda_min_by_leader, key=lambda i: analysis.lambda_min_by_leader[i], default=None)
    if best is not None and best not in analysis.leaders and len(analysis.leaders) == 1:
        now, then = analysis.lambda_min_by_leader[analysis.leaders[0]], analysis.lambda_min_by_leader[best]
        if then > 1.1 * now:
            text = f"vehicle {best} would be the better leader: lambda_min {then:.4f} instead of {now:.4f}"
            yield Notice(Code.BETTER_LEADER, text)


def _law_table(analysis: Analysis) -> list[str]:
    laws = list(analysis.laws.values())
    rows: list[tuple[str, list[str]]] = []

    def add(title: str, cell: Callable[[LawAnalysis], str], *, of_stable: bool = False) -> None:
        rows.append((title, [cell(law) if law.stable or not of_stable else "unstable" for law in laws]))

    add("gains over 1 m, over 1 m/s", lambda law: f"{law.gain_position_1_s2:g}, {law.gain_velocity_1_s:g}")
    add("alpha and rho of the weights, gamma", _weighting)
    add("lambda_min", lambda law: f"{law.lambda_min:.4f}")
    add("convergence rate, no lag [1/s]", lambda law: f"{law.rate_1_s:.4f}")
    add("time to 10 cm by this rate [s]", lambda law: _number(law.time_to_10_cm_s, 1), of_stable=True)
    add("smallest damping, no lag", lambda law: f"{law.damping_min:.3f}")
    add("delay margin, no lag [s]", lambda law: f"{law.delay_margin_s:.3f}")
    add("delay margin [s]", lambda law: f"{law.delay_margin_with_lag_s:.3f}")
    add("string gain per hop", lambda law: _gain(law.string_gain_per_hop), of_stable=True)
    add("  at [rad/s]", lambda law: _gain(law.string_gain_per_hop_rad_s), of_stable=True)
    add("string gain, leader to last", lambda law: _gain(law.string_gain_to_last), of_stable=True)
    add("  at [rad/s]", lambda law: _gain(law.string_gain_to_last_rad_s), of_stable=True)
    add(f"shift by {VELOCITY_ERROR_M_S:g} m/s velocity error [m]", lambda law: _shift(law.velocity_error_shift_m))
    add("  corrected", lambda law: _shift(law.velocity_error_shift_corrected_m))
    add("transient peak, worst start", lambda law: _gain(law.worst_transient_peak), of_stable=True)
    add("transient peak, this start", lambda law: _gain(law.transient_peak), of_stable=True)
    add("settled to 10 cm [s]", lambda law: _number(law.predicted_settle_s, 1), of_stable=True)
    add("  a leader alone [s]", lambda law: _number(law.leader_settle_s, 1), of_stable=True)
    add("  behind it no law sooner than [s]", lambda law: _number(law.limit_s, 1), of_stable=True)
    add("largest distance of neighbours [m]", lambda law: _extreme(law.predicted_max_distance_m, max), of_stable=True)
    add("smallest distance of neighbours [m]", lambda law: _extreme(law.predicted_min_distance_m, min), of_stable=True)
    add("smallest distance of all, kept [m]", _smallest, of_stable=True)
    if any(law.margin_to_range_m is not None for law in laws):
        add("margin to the range [m]", lambda law: _gain(law.margin_to_range_m), of_stable=True)
    head = f"{'':38}" + "".join(f"{name:>15}" for name in analysis.laws)
    table = [head, *(f"{title:38}" + "".join(f"{cell:>15}" for cell in cells) for title, cells in rows)]
    gains = ", ".join(
        f"{gain:.2f} times that of {name}" for name, gain in analysis.gain_on_average.items() if name != analysis.law
    )
    remarks = [f"{name}: {remark}" for name, law in analysis.laws.items() for remark in law.remarks]
    return [*table, *remarks, *LEGEND.splitlines(), *_start(analysis), "", f"lambda_min of {analysis.law} is {gains}"]


def _weighting(law: LawAnalysis) -> str:
    values = (law.exponent, law.weight_ratio, law.feedforward)
    return ", ".join("-" if value is None else f"{value:g}" for value in values)


def _start(analysis: Analysis) -> list[str]:
    moves = "; the reference is at rest at its start, though it moves in flight" if analysis.reference_moves else ""
    text = (
        f"this start, and the rows below it: predicted over {PREDICT_S:g} s from rest as it flies, with links of "
        f"{analysis.link_s:g} s, the farthest vehicle {analysis.start_error_m:.2f} m from its slot{moves}"
    )
    return wrap(text, COLUMNS, initial_indent="  ", subsequent_indent="    ")


def _leader_table(analysis: Analysis) -> list[str]:
    cells = [f"{i:>3}: {value:.4f}" for i, value in analysis.lambda_min_by_leader.items()]
    return [f"lambda_min under {analysis.law} with one vehicle as the only leader:", *_in_lines(cells)]


def _second_edges(analysis: Analysis) -> list[str]:
    found = analysis.second_edges
    if found is None:
        return []
    enough = "" if found.per_hop_with <= GROWS_AT_ALL else "; no such edges bring the gain per hop to 1.00"
    text = (
        f"with neighbours two hops ahead as well the string gain, leader to last, is {found.to_last_with:.2f} instead of "
        f"{found.to_last:.2f}, and {found.per_hop_with:.2f} instead of {found.per_hop:.2f} per hop{enough}; add to "
        "neighbours.edges:"
    )
    pairs = ", ".join(f"[{a}, {b}]" for a, b in found.edges)
    return ["", *wrap(text, COLUMNS), *wrap(pairs, COLUMNS, initial_indent="  ", subsequent_indent="  ")]


def _matrix(analysis: Analysis) -> list[str]:
    law: LawAnalysis = analysis.laws[analysis.law]
    if len(analysis.vehicles) > WHOLE_UP_TO:
        return [f"the interaction matrix G and its {len(law.eigenvalues)} eigenvalues: see --json"]
    rounded = np.round(np.array(law.G), 3) + 0.0  # no -0.
    rows = np.array2string(rounded, precision=3, suppress_small=True, max_line_width=200).splitlines()
    values = _in_lines([f"{value:.4f}" for value in law.eigenvalues])
    return [f"interaction matrix G under {analysis.law}:", *(f"  {row}" for row in rows), "its eigenvalues:", *values]


def _in_lines(cells: list[str]) -> list[str]:
    return ["  " + "   ".join(cells[first : first + A_LINE]) for first in range(0, len(cells), A_LINE)]


def _extreme(distances_m: dict[str, float] | None, choose: Callable[..., tuple[str, float]]) -> str:
    if not distances_m:
        return "-"
    pair, value = choose(distances_m.items(), key=lambda item: item[1])
    return f"{value:.2f} ({pair})"


def _smallest(law: LawAnalysis) -> str:
    distance_m = law.predicted_smallest_distance_m
    return "-" if distance_m is None else f"{distance_m:.2f} ({law.smallest_distance_of})"


def _gain(value: float | None) -> str:
    return "-" if value is None else f"{value:.2f}"


def _shift(value_m: float | None) -> str:
    return "-" if value_m is None else f"{value_m:.3f}"


def _number(value: float | None, digits: int) -> str:
    return f"over {PREDICT_S:g}" if value is None else f"{value:.{digits}f}"


def _ids(ids: list[int]) -> str:
    return ", ".join(str(i) for i in ids)
