"""Figures 7 and 8, the paper's experiment: the platoon with perfect sensors, and many times with sensor noise in its place."""

from __future__ import annotations

from collections.abc import Mapping

from companion.config import LawName
from sitl.paper.book import PERFECT, Book, Entry, verdict_of
from sitl.paper.claims import Claim
from sitl.paper.flights import Model, Subject
from sitl.paper.measures import response_s
from sitl.paper.platoon_claims import AVERAGES, NAMES, PAIRS, flown_platoon, largest_m


def experiment_claims(book: Book) -> list[Claim]:
    return [_followers_respond_faster(book), _highest_peak_is_lower(book)]


def behind_first_s(entry: Entry) -> list[float]:
    """How much later than UAV 1 the others have done half of their way."""
    leader_s, *others_s = (response_s(entry.flight, i) for i in sorted(entry.flight.tracks))
    return [other_s - leader_s for other_s in others_s]


def _followers_respond_faster(book: Book) -> Claim:
    """Against eq. 22 and eq. 26 with perfect sensors, and seed by seed against eq. 22 with noise."""
    late_s = {(law, m): behind_first_s(flown_platoon(book, law, m)) for law in (*AVERAGES, "weighted") for m in PERFECT}
    faster = [
        all(w < a for w, a in zip(late_s["weighted", model], late_s[law, model], strict=True))
        for law in AVERAGES
        for model in PERFECT
    ]
    noisy = _noisy_pairs(book)
    noisy_faster = sum(
        all(w < a for w, a in zip(behind_first_s(weighted), behind_first_s(average), strict=True))
        for weighted, average in noisy
    )

    def said(model: Model) -> str:
        weighted_s, average_s = ("/".join(f"{s:.2f}" for s in late_s[law, model]) for law in ("weighted", "average_22"))
        return f"{weighted_s} s against {average_s} s (eq. 22)"

    return Claim(
        id="fig-7-response",
        where="figure 7",
        claim="UAV 2, 3 and 4 respond faster to UAV 1 under the weighted law",
        paper="faster",
        ideal=said(Model.IDEAL),
        full=said(Model.FULL),
        verdict=verdict_of(all(faster) and noisy_faster == len(noisy), all(faster) or noisy_faster > len(noisy) / 2),
        remark="How much later than UAV 1 each of UAV 2/3/4 has done half of its way. With sensor noise it was so in "
        f"{noisy_faster} of {len(noisy)} pairs of flights.",
        measured={"noisy_pairs": float(len(noisy)), "noisy_pairs_faster": float(noisy_faster)}
        | {
            f"behind_uav_1_s_uav_{i}_{law}_{model}": s
            for (law, model), each in late_s.items()
            for i, s in enumerate(each, start=2)
        },
    )


def highest_deviation_m(entry: Entry) -> float:
    """The largest of all deviations of neighbouring pairs from their wanted distance, apart or together."""
    figures = entry.figures
    return max(
        max(
            figures.max_distance_m[p] - figures.wanted_distance_m[p],
            figures.wanted_distance_m[p] - figures.min_distance_m[p],
        )
        for p in PAIRS
    )


def _highest_peak_is_lower(book: Book) -> Claim:
    """The longest distance of any pair, as the paper's text compares peaks."""

    def excess_m(entry: Entry) -> float:
        return max(largest_m(entry, pair) - entry.figures.wanted_distance_m[pair] for pair in PAIRS)

    laws: tuple[LawName, ...] = (*AVERAGES, "weighted")
    peak_m = {(law, m): excess_m(flown_platoon(book, law, m)) for law in laws for m in PERFECT}
    both_ways_m = {(law, m): highest_deviation_m(flown_platoon(book, law, m)) for law in laws for m in PERFECT}
    lower = [peak_m["weighted", m] < peak_m[law, m] for law in AVERAGES for m in PERFECT]
    lower_both_ways = all(both_ways_m["weighted", m] < both_ways_m[law, m] for law in AVERAGES for m in PERFECT)
    noisy = _noisy_pairs(book)
    noisy_lower = sum(excess_m(weighted) < excess_m(average) for weighted, average in noisy)

    def said(model: Model) -> str:
        others = " and ".join(f"{peak_m[law, model]:.2f} m ({NAMES[law]})" for law in AVERAGES)
        return f"{peak_m['weighted', model]:.2f} m against {others}"

    caveat = "" if lower_both_ways else _too_close(both_ways_m)
    return Claim(
        id="fig-8-peak",
        where="figure 8",
        claim="the highest peak of the inter-distances is lower under the weighted law",
        paper="smaller",
        ideal=said(Model.IDEAL),
        full=said(Model.FULL),
        verdict=verdict_of(
            all(lower) and noisy_lower == len(noisy) and lower_both_ways, all(lower) or noisy_lower > len(noisy) / 2
        ),
        remark=f"Above the wanted 1.5 m, of any neighbouring pair. With sensor noise it was lower than under eq. 22 in "
        f"{noisy_lower} of {len(noisy)} pairs of flights.{caveat}",
        measured={"noisy_pairs": float(len(noisy)), "noisy_pairs_lower": float(noisy_lower)}
        | {f"peak_m_{law}_{model}": m for (law, model), m in peak_m.items()}
        | {f"deviation_either_side_m_{law}_{model}": m for (law, model), m in both_ways_m.items()},
    )


def _too_close(both_ways_m: Mapping[tuple[LawName, Model], float]) -> str:
    weighted_m, average_m = (both_ways_m[law, Model.FULL] for law in ("weighted", "average_22"))
    return (
        " Vehicles that come too close count for nothing in this: as a deviation to either side the weighted law's largest is "
        f"{weighted_m:.2f} m against {average_m:.2f} m (eq. 22) with the full model."
    )


def _noisy_pairs(book: Book) -> list[tuple[Entry, Entry]]:
    """(weighted, eq. 22) with the same noise."""
    weighted, average = (book.all(Subject.PLATOON, law, Model.NOISY) for law in ("weighted", "average_22"))
    return list(zip(weighted, average, strict=True))
