"""Claims on figure 4: four vehicles gather with a range of 3 m, under three laws. And all claims on flights."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from math import dist, inf

from companion.config.fleet import RangeNeighbours
from companion.config.law import LawName
from sitl.paper.flights import (
    NOISY_LAWS,
    PERFECT,
    Book,
    FlightSubject,
    FlownPlan,
    Interval,
    Model,
    alone_s,
    apart_s,
    beginning,
    broken_s,
    claims_of,
    edges_m,
    fewest_in_range,
    results,
    total_s,
)
from sitl.paper.platoon_claims import AVERAGES, FIRST_M, FITS_M, NAMES, experiment_claims, largest_m, platoon_claims
from sitl.paper.ring_claims import ring_claims
from sitl.paper.words import claim_of, join_words, seconds, verdict_of
from sitl.report.claim import Claim
from sitl.report.metrics import pair_name

LEADER = 1
GATHERED_WITHIN_M = 0.5  # a third of the square's side: with sensor noise no vehicle stays within 10 cm
FEW_S = 3.0  # the largest value of "a few seconds", and the shortest time for which the leader must then be alone
TOLERANCE_S = 0.1  # times with a smaller difference count as equal
LAWS: tuple[LawName, ...] = ("weighted", *AVERAGES)


def aggregation_claims(book: Book) -> list[Claim]:
    return claims_of(book, (_average_fails, _weighted_succeeds, _weighted_keeps_together, _one_average_law))


def range_m(entry: FlownPlan) -> float:
    neighbours = entry.scenario.fleet.neighbours
    if not isinstance(neighbours, RangeNeighbours):
        raise TypeError("the aggregation's neighbours are those in range")
    return neighbours.range_m


def has_gathered(entry: FlownPlan) -> bool:
    """Whether the flight was completed with all vehicles at their slots."""
    return entry.formation is not None and entry.failure is None and entry.figures.final_error_m < GATHERED_WITHIN_M


def left_for_good_s(entry: FlownPlan) -> float:
    """Time at which the leader lost its last follower for the rest of the flight; inf where it did not."""
    intervals = alone_s(entry.flight, LEADER, range_m(entry))
    if intervals and intervals[-1][1] >= _duration_s(entry) - 0.02:
        return intervals[-1][0]
    return inf


def falls_apart(entry: FlownPlan) -> bool:
    """Whether the leader is alone within FEW_S, and stays alone for at least FEW_S, as the paper states of the average law."""
    left_s = left_for_good_s(entry)
    return left_s <= FEW_S and _duration_s(entry) - left_s >= FEW_S


def outcome(entry: FlownPlan) -> str:
    if falls_apart(entry):
        return "fails"
    return "succeeds" if has_gathered(entry) else "neither fails early nor gathers"


def _duration_s(entry: FlownPlan) -> float:
    formation = entry.flight.formation
    return formation.end_s - formation.start_s


def broken_edges(entry: FlownPlan, seconds_s: float = inf) -> str:
    """ "1-2 from 0.08 s to 2.90 s", for every edge of the start that broke within `seconds_s`; empty where none did."""
    spans = _out_of_range(entry, seconds_s)
    return join_words(
        f"{pair} from {found[0][0]:.2f} s to {found[-1][1]:.2f} s" for pair, found in spans.items() if found
    )


def _out_of_range(entry: FlownPlan, seconds_s: float) -> dict[str, list[Interval]]:
    """Intervals out of range, for every edge of the start."""
    first, reach_m = beginning(entry.flight, seconds_s), range_m(entry)
    edges = edges_m(first.tracks, first.formation.start_s, reach_m)
    return {pair_name(pair): broken_s(first, pair, reach_m) for pair in edges}


@dataclass(frozen=True, slots=True)
class Connectivity:
    """Connectivity of one flight over a common time; `connected_at_end` is of the end of the whole flight."""

    broken: str  # text of broken_edges
    out_of_sight_s: float  # sum of the times that edges of the start were out of range
    leader_alone_s: float  # time that the leader had no other vehicle in range
    in_parts_s: float  # time that the graph was not connected
    connected_at_end: bool  # whether the graph is connected at the end

    def better_than(self, other: Connectivity) -> bool:
        """Whether no figure is worse and at least one is better."""
        times_s = ("out_of_sight_s", "leader_alone_s", "in_parts_s")
        gains_s = [getattr(other, name) - getattr(self, name) for name in times_s]
        if min(gains_s) < -TOLERANCE_S or self.connected_at_end < other.connected_at_end:
            return False
        return max(gains_s) > TOLERANCE_S or self.connected_at_end > other.connected_at_end

    def measured(self) -> dict[str, float]:
        return {name: float(value) for name, value in asdict(self).items() if name != "broken"}

    def text(self) -> str:
        """ "1-2 from 0.08 s to 2.90 s, leader alone for 2.0 s, disconnected at the end", as far as it applies."""
        alone = f", leader alone for {self.leader_alone_s:.1f} s" if self.leader_alone_s else ""
        return f"{self.broken or 'none'}{alone}{'' if self.connected_at_end else ', disconnected at the end'}"


def connectivity(entry: FlownPlan, seconds_s: float = inf) -> Connectivity:
    reach_m, first = range_m(entry), beginning(entry.flight, seconds_s)
    parts = apart_s(entry.flight, reach_m)
    return Connectivity(
        broken=broken_edges(entry, seconds_s),
        out_of_sight_s=sum(total_s(spans) for spans in _out_of_range(entry, seconds_s).values()),
        leader_alone_s=total_s(alone_s(first, LEADER, reach_m)),
        in_parts_s=total_s(apart_s(first, reach_m)),
        connected_at_end=not parts or parts[-1][1] < _duration_s(entry) - 0.02,
    )


def stays_whole(entry: FlownPlan) -> bool:
    """Whether the flight was completed with a connected graph."""
    return entry.formation is not None and entry.failure is None and connectivity(entry).connected_at_end


def _average_fails(book: Book) -> Claim:
    """The verdict is on eq. 26, the law that the paper names. It holds with a condition where eq. 22 does not fail as well."""
    flown = book.perfect(FlightSubject.AGGREGATION, AVERAGES)
    left_s = {key: left_for_good_s(entry) for key, entry in flown.items()}
    fails = {law: all(falls_apart(flown[law, model]) for model in PERFECT) for law in AVERAGES}

    def result(model: Model) -> str:
        entry = flown["average_26", model]
        apart_m = entry.figures.final_distance_m
        where = f"at the end {apart_m['1-2']:.1f} m from vehicle 2 and {apart_m['1-3']:.1f} m from vehicle 3"
        alone = left_s["average_26", model]
        return f"leader {'never finally alone' if alone == inf else f'alone from {alone:.2f} s on'}; {where}"

    ideal_22, full_22 = (outcome(flown["average_22", model]) for model in PERFECT)
    others = f"{ideal_22} with both models" if ideal_22 == full_22 else f"{ideal_22} (ideal) or {full_22} (full)"
    flown_s = min(_duration_s(flown["average_26", model]) for model in PERFECT)
    return claim_of(
        "fig-4-average",
        verdict_of(all(fails.values()), fails["average_26"]),
        {f"leader_alone_from_s_{law}_{model}": s for (law, model), s in left_s.items()}
        | {f"gathered_average_22_{m}": has_gathered(flown["average_22", m]) for m in PERFECT}
        | {"flown_s": flown_s},
        few_s=FEW_S,
        others=others,
        **results(result),
    )


def _weighted_succeeds(book: Book) -> Claim:
    entries = {model: book.one(FlightSubject.AGGREGATION, "weighted", model) for model in PERFECT}
    succeeds = all(has_gathered(entry) for entry in entries.values())
    noisy = book.all(FlightSubject.AGGREGATION, "weighted", Model.NOISY)
    noisy_gathered = sum(has_gathered(entry) for entry in noisy)
    ideal = entries[Model.IDEAL]
    starts = ideal.scenario.starts_enu_m
    spare_mm = 1000 * (range_m(ideal) - dist(starts[1], starts[2]))

    def result(model: Model) -> str:
        entry = entries[model]
        kept = len(edges_m(entry.flight.tracks, entry.flight.formation.end_s, range_m(entry)))
        settled = f"settled to 10 cm after {seconds(entry.settle_s)}" if has_gathered(entry) else "does not gather"
        return f"{settled}; {kept} of {len(entry.figures.max_distance_m)} pairs in range at the end"

    return claim_of(
        "fig-4-weighted",
        verdict_of(succeeds and 0 < len(noisy) == noisy_gathered, succeeds),
        {f"settle_s_{model}": entry.settle_s for model, entry in entries.items()}
        | {"noisy_flights": len(noisy), "noisy_flights_gathered": noisy_gathered}
        | {f"leader_alone_s_{model}": total_s(alone_s(e.flight, LEADER, range_m(e))) for model, e in entries.items()}
        | {"spare_range_mm": spare_mm, "formation_s": ideal.figures.duration_s},
        **results(result),
    )


def _weighted_keeps_together(book: Book) -> Claim:
    """The paper's conclusion from figure 4: connectivity, compared law by law over the time common to all flights.

    To hold, it must also be true with noise: in most flights, and in more flights than under eq. 22.
    """
    entries = book.perfect(FlightSubject.AGGREGATION, LAWS)
    window_s = min(_duration_s(entry) for entry in entries.values())
    kept = {key: connectivity(entry, window_s) for key, entry in entries.items()}
    better = {law: all(kept["weighted", m].better_than(kept[law, m]) for m in PERFECT) for law in AVERAGES}
    noisy = {law: book.all(FlightSubject.AGGREGATION, law, Model.NOISY) for law in NOISY_LAWS}
    whole = {law: sum(stays_whole(entry) for entry in flights) for law, flights in noisy.items()}
    with_noise = whole["weighted"] > max(whole["average_22"], len(noisy["weighted"]) / 2)

    def result(model: Model) -> str:
        return "; ".join(f"{kept[law, model].text()} ({NAMES[law]})" for law in LAWS)

    return claim_of(
        "fig-4-robust",
        verdict_of(all(better.values()) and with_noise, any(better.values())),
        {f"{name}_{law}_{m}": value for (law, m), found in kept.items() for name, value in found.measured().items()}
        | {f"noisy_flights_{law}": len(flights) for law, flights in noisy.items()}
        | {f"noisy_flights_connected_{law}": count for law, count in whole.items()}
        | {"compared_over_s": window_s},
        comparison=_comparison_text(better, kept),
        with_noise=join_words(
            f"{whole[law]} of {len(noisy[law])} flights ({NAMES[law]})" for law in ("weighted", "average_22")
        ),
        fewest=join_words(f"{_fewest_text(entries[law, Model.FULL])} ({NAMES[law]})" for law in LAWS),
        **results(result),
    )


def _comparison_text(better: dict[LawName, bool], kept: dict[tuple[LawName, Model], Connectivity]) -> str:
    than = [NAMES[law] for law in AVERAGES if better[law]]
    text = f"With perfect sensors and both models better than {join_words(than) if than else 'neither average law'}"
    if than and len(than) < len(AVERAGES):
        text += f", not better than {join_words(NAMES[law] for law in AVERAGES if not better[law])}"

    def stays_in_one(law: LawName) -> bool:
        return all(kept[law, m].in_parts_s == 0.0 and kept[law, m].connected_at_end for m in PERFECT)

    edges_alone = [NAMES[law] for law in AVERAGES if stays_in_one(law) and stays_in_one("weighted")]
    if edges_alone:
        text += f"; compared with {join_words(edges_alone)} only in the time of edges out of range: both graphs stay connected"
    return text + "."


def _fewest_text(entry: FlownPlan) -> str:
    found = fewest_in_range(entry.flight, LEADER, range_m(entry))
    return f"vehicle{'s' if len(found) > 1 else ''} {join_words(str(i) for i in found)}" if found else "none"


def _one_average_law(book: Book) -> Claim:
    """Figures 4 and 6 compare with the same law according to the paper; the claim holds if one law fits both figures."""
    outcomes = {key: outcome(entry) for key, entry in book.perfect(FlightSubject.AGGREGATION, AVERAGES).items()}
    peaks_m = {key: largest_m(entry, "1-2") for key, entry in book.perfect(FlightSubject.PLATOON, AVERAGES).items()}
    figure_4 = [law for law in AVERAGES if outcomes[law, Model.IDEAL] == "fails"]
    figure_6 = [law for law in AVERAGES if abs(peaks_m[law, Model.IDEAL] - FIRST_M) <= FITS_M]

    def result(model: Model) -> str:
        return "; ".join(f"{NAMES[law]}: {outcomes[law, model]}, {peaks_m[law, model]:.2f} m" for law in AVERAGES)

    fit_4, fit_6 = (join_words(NAMES[law] for law in laws) if laws else "neither law" for laws in (figure_4, figure_6))
    return claim_of(
        "average-law",
        verdict_of("average_26" in figure_4 and "average_26" in figure_6),
        {f"largest_d12_m_{law}_{model}": m for (law, model), m in peaks_m.items()}
        | {f"fails_{law}_{model}": float(outcome_text == "fails") for (law, model), outcome_text in outcomes.items()},
        fit_4=fit_4,
        fit_6=fit_6,
        fits_m=FITS_M,
        **results(result),
    )


def flight_claims(book: Book) -> list[Claim]:
    """In the order of the figures."""
    return [*aggregation_claims(book), *platoon_claims(book), *experiment_claims(book), *ring_claims(book)]
