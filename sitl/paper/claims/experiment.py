"""Claims on figures 7 and 8, the paper's experiment: platoon flights with perfect sensors, and with sensor noise."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from math import inf

from companion.config.fleet import LawName
from sitl.paper.book import PERFECT, Book, Entry, listed, verdict_of
from sitl.paper.claims.platoon import AVERAGES, NAMES, PAIRS, exceptions, flown_platoon, largest_m
from sitl.paper.flights import FlightSubject, Model
from sitl.paper.measures import response_s
from sitl.report.claim import Claim


def experiment_claims(book: Book) -> list[Claim]:
    return [_followers_respond_faster(book), _highest_peak_is_lower(book)]


def behind_first_s(entry: Entry) -> list[float]:
    """Delay of the other vehicles behind UAV 1 at half of their distance."""
    leader_s, *others_s = (response_s(entry.flight, i) for i in sorted(entry.flight.tracks))
    return [other_s - leader_s if leader_s < inf else inf for other_s in others_s]


def _followers_respond_faster(book: Book) -> Claim:
    """Compared with eq. 22 and eq. 26 with perfect sensors, and with eq. 22 seed by seed with noise."""
    late_s = {(law, m): behind_first_s(flown_platoon(book, law, m)) for law in (*AVERAGES, "weighted") for m in PERFECT}
    faster: dict[LawName, bool] = {
        law: all(w < a for model in PERFECT for w, a in zip(late_s["weighted", model], late_s[law, model], strict=True))
        for law in AVERAGES
    }
    noisy = _noisy_pairs(book)
    noisy_faster = sum(
        all(w < a for w, a in zip(behind_first_s(weighted), behind_first_s(average), strict=True))
        for weighted, average in noisy
    )

    def result(model: Model) -> str:
        each = {law: "/".join(f"{s:.2f}" for s in late_s[law, model]) for law in ("weighted", *AVERAGES)}
        others = " and ".join(f"{each[law]} s ({NAMES[law]})" for law in AVERAGES)
        return f"{each['weighted']} s against {others}"

    return Claim(
        id="fig-7-response",
        where="figure 7",
        claim="UAV 2, 3 and 4 respond faster to UAV 1 under the weighted law",
        paper="faster",
        ideal=result(Model.IDEAL),
        full=result(Model.FULL),
        verdict=verdict_of(
            all(faster.values()) and 0 < len(noisy) == noisy_faster,
            any(faster.values()) or noisy_faster > len(noisy) / 2,
        ),
        remark="Delay of UAV 2/3/4 behind UAV 1 at half of the distance. With sensor noise all three were faster than under "
        f"eq. 22 in {noisy_faster} of {len(noisy)} pairs of flights.{exceptions(faster)}",
        measured={"noisy_pairs": float(len(noisy)), "noisy_pairs_faster": float(noisy_faster)}
        | {
            f"behind_uav_1_s_uav_{i}_{law}_{model}": s
            for (law, model), each in late_s.items()
            for i, s in enumerate(each, start=2)
        },
    )


def highest_deviation_m(entry: Entry) -> float:
    """Largest deviation of a neighbour distance from the desired one, above or below."""
    figures = entry.figures
    return max(
        max(
            figures.max_distance_m[p] - figures.wanted_distance_m[p],
            figures.wanted_distance_m[p] - figures.min_distance_m[p],
        )
        for p in PAIRS
    )


def _highest_peak_is_lower(book: Book) -> Claim:
    """Largest neighbour distance, as in the paper's text."""

    def excess_m(entry: Entry) -> float:
        return max(largest_m(entry, pair) - entry.figures.wanted_distance_m[pair] for pair in PAIRS)

    laws: tuple[LawName, ...] = (*AVERAGES, "weighted")
    peak_m = {(law, m): excess_m(flown_platoon(book, law, m)) for law in laws for m in PERFECT}
    both_ways_m = {(law, m): highest_deviation_m(flown_platoon(book, law, m)) for law in laws for m in PERFECT}
    lower = {law: all(peak_m["weighted", m] < peak_m[law, m] for m in PERFECT) for law in AVERAGES}
    not_both_ways = [(law, m) for law in AVERAGES for m in PERFECT if both_ways_m["weighted", m] >= both_ways_m[law, m]]
    noisy = _noisy_pairs(book)
    noisy_lower = sum(excess_m(weighted) < excess_m(average) for weighted, average in noisy)

    def result(model: Model) -> str:
        others = " and ".join(f"{peak_m[law, model]:.2f} m ({NAMES[law]})" for law in AVERAGES)
        return f"{peak_m['weighted', model]:.2f} m against {others}"

    caveat = _too_close(both_ways_m, not_both_ways) if not_both_ways else ""
    return Claim(
        id="fig-8-peak",
        where="figure 8",
        claim="the highest peak of the inter-distances is lower under the weighted law",
        paper="smaller",
        ideal=result(Model.IDEAL),
        full=result(Model.FULL),
        verdict=verdict_of(
            all(lower.values()) and 0 < len(noisy) == noisy_lower and not not_both_ways,
            any(lower.values()) or noisy_lower > len(noisy) / 2,
        ),
        remark=f"Largest excess over 1.5 m of any neighbouring pair. With sensor noise it was lower than under eq. 22 in "
        f"{noisy_lower} of {len(noisy)} pairs of flights.{exceptions(lower)}{caveat}",
        measured={"noisy_pairs": float(len(noisy)), "noisy_pairs_lower": float(noisy_lower)}
        | {f"peak_m_{law}_{model}": m for (law, model), m in peak_m.items()}
        | {f"deviation_either_side_m_{law}_{model}": m for (law, model), m in both_ways_m.items()},
    )


def _too_close(both_ways_m: Mapping[tuple[LawName, Model], float], where: Sequence[tuple[LawName, Model]]) -> str:
    found = (
        f"{both_ways_m['weighted', m]:.2f} m against {both_ways_m[law, m]:.2f} m ({NAMES[law]}, {m})"
        for law, m in where
    )
    return (
        f" Distances that are too small do not count here; the largest deviation in both directions is not lower: "
        f"{listed(found)}."
    )


def _noisy_pairs(book: Book) -> list[tuple[Entry, Entry]]:
    """Pairs of flights (weighted, eq. 22) with the same noise."""
    weighted, average = (book.all(FlightSubject.PLATOON, law, Model.NOISY) for law in ("weighted", "average_22"))
    return list(zip(weighted, average, strict=True))
