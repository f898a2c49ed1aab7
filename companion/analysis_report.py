"""An Analysis in words: the figures as tables, and what will go wrong and what to change."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from companion.analysis import PREDICT_S, Analysis, LawAnalysis

BADLY_DAMPED = 0.3
CLOSE_M = 0.8
GROWS = 1.2  # string gain to the last vehicle; 1 is perfect, and up to here nobody sees the difference
SMALL_DELAY_MARGIN_S = 0.15  # three times the usual delay of the loop


def report(analysis: Analysis) -> str:
    """The whole text that `companion analyze` prints."""
    lines = [
        f"{analysis.file}: {len(analysis.vehicles)} vehicles, led by {_ids(analysis.leaders)}, law {analysis.law}",
        "",
    ]
    lines += ["who hears whom at the start:"]
    lines += [f"  {i}: {_ids(neighbours) or 'nobody'}" for i, neighbours in analysis.graph.items()]
    if analysis.laws:
        lines += ["", *_law_table(analysis), "", *_leader_table(analysis), "", *_matrix(analysis)]
    lines += ["", "verdict:", *(f"  - {line}" for line in verdict(analysis))]
    return "\n".join(lines)


def verdict(analysis: Analysis) -> list[str]:
    """What will go wrong and what to change, one sentence each; a single one where nothing will."""
    warnings = list(_warnings(analysis))
    if len(analysis.vehicles) == 1 and not analysis.unreached:
        return [
            f"vehicle {_ids(analysis.vehicles)} is alone and follows its reference; there is no formation",
            *warnings,
        ]
    return warnings or [f"the formation converges under {analysis.law}, and nothing stands out"]


def _warnings(analysis: Analysis) -> Iterator[str]:
    if analysis.unreached:
        yield (
            f"cannot converge: no path leads from a leader to vehicle {_ids(analysis.unreached)}; add an edge, more range, "
            "or a leader among them (Lemma 1)"
        )
        return
    law = analysis.laws[analysis.law]
    yield from _slow_or_unstable(law)
    yield from _grows(analysis, law)
    yield from _too_far_or_too_close(law)
    yield from _better_leader(analysis)


def _slow_or_unstable(law: LawAnalysis) -> Iterator[str]:
    if law.damping_min < BADLY_DAMPED:
        yield (
            f"badly damped (smallest damping {law.damping_min:.2f}, 1 is critical): errors swing before they settle; "
            "more gain on velocity helps, and so does a larger lambda_min"
        )
    if law.delay_margin_with_lag_s == 0.0:
        yield (
            "unstable with the attitude lag alone: errors swing up for ever; more gain on velocity against that on position, "
            "or less feedforward"
        )
    elif law.delay_margin_with_lag_s < SMALL_DELAY_MARGIN_S:
        yield (
            f"small delay margin: a loop delay of {law.delay_margin_with_lag_s:.2f} s makes it unstable, and about 0.05 s is "
            "usual; less gain on velocity and on position helps"
        )
    if law.predicted_settle_s is None:
        yield f"not within 10 cm after {PREDICT_S:g} s, by the linear model with attitude lag and delay"


def _grows(analysis: Analysis, law: LawAnalysis) -> Iterator[str]:
    if law.string_gain_per_hop is None or law.string_gain_to_last is None or law.string_gain_to_last <= GROWS:
        return
    least = min(analysis.laws, key=lambda name: analysis.laws[name].string_gain_to_last or 0.0)
    other = "" if least == analysis.law else f"; {least} has {analysis.laws[least].string_gain_to_last:.2f} to the last"
    yield (
        f"errors grow along the chain: the leader's swing gets up to {law.string_gain_per_hop:.2f} times larger in a hop and "
        f"{law.string_gain_to_last:.2f} times until the last vehicle; more gain on velocity against that on position, "
        f"feedforward, or fewer hops from the leader help{other}"
    )


def _too_far_or_too_close(law: LawAnalysis) -> Iterator[str]:
    if law.stays_in_range is False:
        pair, distance_m = max(law.predicted_max_distance_m.items(), key=lambda item: item[1])
        yield (
            f"neighbours lose each other on the way: {pair} gets {distance_m:.2f} m apart, beyond the range; start closer, "
            "move the reference slower, or give the edges explicitly"
        )
    if law.predicted_min_distance_m:
        pair, distance_m = min(law.predicted_min_distance_m.items(), key=lambda item: item[1])
        if distance_m < CLOSE_M:
            yield f"vehicles come close: {pair} gets within {distance_m:.2f} m; more spacing, or better damping"


def _better_leader(analysis: Analysis) -> Iterator[str]:
    best = max(analysis.lambda_min_by_leader, key=lambda i: analysis.lambda_min_by_leader[i], default=None)
    if best is not None and best not in analysis.leaders and len(analysis.leaders) == 1:
        now, then = analysis.lambda_min_by_leader[analysis.leaders[0]], analysis.lambda_min_by_leader[best]
        if then > 1.1 * now:
            yield f"vehicle {best} would lead better: lambda_min {then:.4f} instead of {now:.4f}"


def _law_table(analysis: Analysis) -> list[str]:
    rows: list[tuple[str, list[str]]] = []
    laws = list(analysis.laws.values())
    rows.append(("lambda_min", [f"{law.lambda_min:.4f}" for law in laws]))
    rows.append(("convergence rate [1/s]", [f"{law.rate_1_s:.4f}" for law in laws]))
    rows.append(("time to 10 cm by the rate [s]", [_number(law.time_to_10_cm_s, 1) for law in laws]))
    rows.append(("smallest damping", [f"{law.damping_min:.3f}" for law in laws]))
    rows.append(("delay margin, no lag [s]", [f"{law.delay_margin_s:.2f}" for law in laws]))
    rows.append(("delay margin with attitude lag [s]", [f"{law.delay_margin_with_lag_s:.2f}" for law in laws]))
    rows.append(("string gain per hop", [_gain(law.string_gain_per_hop) for law in laws]))
    rows.append(("string gain, leader to last", [_gain(law.string_gain_to_last) for law in laws]))
    rows.append(("transient peak, this start", [f"{law.transient_peak:.2f}" for law in laws]))
    rows.append(("transient peak, worst start", [_gain(law.worst_transient_peak) for law in laws]))
    rows.append(("predicted: settled to 10 cm [s]", [_number(law.predicted_settle_s, 1) for law in laws]))
    rows.append(
        ("predicted: largest distance [m]", [_extreme(law.predicted_max_distance_m, largest=True) for law in laws])
    )
    rows.append(
        ("predicted: smallest distance [m]", [_extreme(law.predicted_min_distance_m, largest=False) for law in laws])
    )
    head = f"{'':36}" + "".join(f"{name:>18}" for name in analysis.laws)
    if any(law.margin_to_range_m is not None for law in laws):
        rows.append(("predicted: margin to range [m]", [_gain(law.margin_to_range_m) for law in laws]))
    gains = ", ".join(
        f"{gain:.2f} times {name}" for name, gain in analysis.gain_on_average.items() if name != analysis.law
    )
    table = [head, *(f"{title:36}" + "".join(f"{cell:>18}" for cell in cells) for title, cells in rows)]
    return [*table, f"lambda_min of {analysis.law} is {gains}"]


def _leader_table(analysis: Analysis) -> list[str]:
    cells = [f"{i}: {value:.4f}" for i, value in analysis.lambda_min_by_leader.items()]
    return [f"lambda_min under {analysis.law} if one vehicle led alone:", "  " + "   ".join(cells)]


def _matrix(analysis: Analysis) -> list[str]:
    law: LawAnalysis = analysis.laws[analysis.law]
    rows = np.array2string(np.array(law.G), precision=3, suppress_small=True, max_line_width=160).splitlines()
    values = "  ".join(f"{value:.4f}" for value in law.eigenvalues)
    return [f"interaction matrix G under {analysis.law}:", *(f"  {row}" for row in rows), f"eigenvalues: {values}"]


def _extreme(distances_m: dict[str, float], *, largest: bool) -> str:
    if not distances_m:
        return "-"
    choose = max if largest else min
    pair, value = choose(distances_m.items(), key=lambda item: item[1])
    return f"{value:.2f} ({pair})"


def _gain(value: float | None) -> str:
    return "-" if value is None else f"{value:.2f}"


def _number(value: float | None, digits: int) -> str:
    return f"over {PREDICT_S:g}" if value is None else f"{value:.{digits}f}"


def _ids(ids: list[int]) -> str:
    return ", ".join(str(i) for i in ids)
