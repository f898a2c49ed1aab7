"""Goals of the law `cooperative` as claims with verdicts, from the flights of the study."""

from __future__ import annotations

from collections.abc import Sequence
from math import inf, radians, tan
from statistics import median
from typing import NamedTuple

from companion.analysis.prediction import SETTLED_WITHIN_M
from companion.config.fleet import Envelope
from companion.config.law import feedback_law_of
from companion.types.values import GRAVITY_M_S2
from sitl.report.claim import Claim, ClaimVerdict
from sitl.study.cases import Figures
from sitl.study.pairs import Pair
from sitl.study.plan import GOAL_SHAPES
from sitl.study.settings import AVERAGE_22, COOPERATIVE, MAIN, WEIGHTED, Setting
from sitl.study.study import Study

SOONER_THAN_AVERAGE, SOONER_THAN_WEIGHTED = 20.0, 10.0
KEYS = ("average_22", "weighted", "cooperative")  # names of MAIN in `measured`


class Settling(NamedTuple):
    """A settle time. `value_s` is a lower bound where the flight has not settled."""

    value_s: float
    settled: bool

    def __str__(self) -> str:
        return f"{'' if self.settled else 'over '}{self.value_s:.1f} s"


class Laws(NamedTuple):
    """Settle times of the three laws of MAIN."""

    average: Settling
    weighted: Settling
    ours: Settling

    def __str__(self) -> str:
        if not self.ours.settled:
            return f"cooperative does not settle ({self.times})"
        ratios = (f"{'' if t.settled else 'over '}{t.value_s / self.ours.value_s:.0f} times" for t in self[:2])
        return f"{', '.join(ratios)} ({self.times})"

    @property
    def times(self) -> str:
        return f"{self.average}, {self.weighted}, {self.ours}"

    @property
    def reach_the_goal(self) -> bool:
        return (
            self.ours.settled
            and self.average.value_s >= SOONER_THAN_AVERAGE * self.ours.value_s
            and self.weighted.value_s >= SOONER_THAN_WEIGHTED * self.ours.value_s
        )

    @property
    def with_result(self) -> str:
        return f"{self}, {'which meets the goal' if self.reach_the_goal else 'which misses the goal'}"

    def measured(self, air: str) -> dict[str, float]:
        return {k: v for law, t in zip(KEYS, self, strict=True) for k, v in _measured(f"{air}_{law}", t).items()}


def goal_claims(study: Study) -> list[Claim]:
    """Three claims for each shape of the goals: settle time, distances, and bad links."""
    claims = []
    for shape in GOAL_SHAPES:
        quiet = [f for f in study.quiet if f.shape == shape.name]
        noisy = [pair for pair in study.noisy if pair.step.shape == shape.name]
        disturbed = [pair for pair in study.disturbed if pair.step.shape == shape.name]
        claims += [
            _sooner(shape.name, quiet, noisy, [f for f in study.with_drag if f.shape == shape.name]),
            _distances(shape.name, quiet, noisy),
            _bad_links(shape.name, noisy, disturbed),
        ]
    return claims


def _sooner(shape: str, quiet: Sequence[Figures], noisy: Sequence[Pair], with_drag: Sequence[Figures]) -> Claim:
    calm, dragged = _laws(quiet), _laws(with_drag)
    transient = Laws(*(_transient(noisy, setting) for setting in MAIN))
    banded = _laws([pair.step for pair in noisy])
    rest_m = [_rest_m(noisy, setting) for setting in MAIN]
    secondary = [dragged, banded] if _step_exceeds_band(noisy) else [dragged]
    return Claim(
        id=f"{shape}-sooner",
        where="beyond the paper",
        claim=f"{shape} settles at least {SOONER_THAN_AVERAGE:.0f} times faster under cooperative than under eq. 22, and "
        f"{SOONER_THAN_WEIGHTED:.0f} times faster than under the paper's law",
        paper=f"{SOONER_THAN_AVERAGE:.0f} times, {SOONER_THAN_WEIGHTED:.0f} times",
        ideal=str(calm),
        full=str(transient),
        verdict=_verdict(
            calm.reach_the_goal and transient.reach_the_goal, all(times.reach_the_goal for times in secondary)
        ),
        remark=f"Times of eq. 22, weighted, cooperative. Without noise: settled to {quiet[0].within_m:g} m. With noise, median "
        f"of {_count(noisy)} seeds: time after which the flight with the step stays within {SETTLED_WITHIN_M:g} m of the same "
        f"flight at rest. Both have the same noise, so the difference is the effect of the step alone. "
        f"{_why_not_the_band(noisy, rest_m)} {_into_the_band(noisy, banded)} All flights are without drag, as eq. 2. With the "
        f"drag of the default airframe and without noise: {dragged.with_result}.",
        measured=calm.measured("quiet")
        | transient.measured("noisy_transient")
        | banded.measured("noisy_band")
        | dragged.measured("with_drag")
        | {f"noisy_{law}_at_rest_m": value for law, value in zip(KEYS, rest_m, strict=True)}
        | {"noisy_band_m": noisy[0].step.within_m, "step_m": noisy[0].step.step_m},
    )


def _why_not_the_band(noisy: Sequence[Pair], rest_m: Sequence[float]) -> str:
    """Text: why the verdict is on the transient, with the figures of the band and of the step."""
    band_m, step_m = noisy[0].step.within_m, noisy[0].step.step_m
    most_m = GRAVITY_M_S2 * tan(radians(Envelope().max_tilt_deg)) / feedback_law_of(COOPERATIVE.law).gains.position_1_s2
    errors = ", ".join(f"{value:.2f}" for value in rest_m)
    return (
        f"The verdict is on this time, not on a band: noise alone causes errors of up to {errors} m at rest, so the band that "
        f"all laws settle into is {band_m:.2f} m, {_percent(band_m / step_m)} of the step. A step of more than {most_m:.1f} m "
        "would reach the tilt limit of the leader."
    )


def _step_exceeds_band(pairs: Sequence[Pair]) -> bool:
    """Whether the step leads out of the band, so that the time into the band is meaningful."""
    return all(pair.step.within_m < abs(pair.step.step_m) for pair in pairs)


def _into_the_band(noisy: Sequence[Pair], banded: Laws) -> str:
    if _step_exceeds_band(noisy):
        return f"Times into that band: {banded.with_result}."
    return f"All flights start inside that band; times after which they stay in it: {banded.times}."


def _distances(shape: str, quiet: Sequence[Figures], noisy: Sequence[Pair]) -> Claim:
    steps, rests = [pair.step for pair in noisy], [pair.rest for pair in noisy]
    misses = [*_misses("without noise", quiet), *_misses("with noise", steps)]
    return Claim(
        id=f"{shape}-distances",
        where="beyond the paper",
        claim=f"{shape}: under cooperative the largest neighbour distance is smaller, and the smallest larger, than under "
        "both other laws",
        paper="smaller, larger",
        ideal=_extremes(quiet),
        full=_extremes(steps),
        verdict=_verdict(not misses),
        remark="Largest / smallest distance of neighbours with a desired distance of 1.5 m: eq. 22, weighted, cooperative; "
        f"with noise the median of the seeds. With noise alone, without a step: {_extremes(rests)}."
        + (f" Missed {'; '.join(misses)}." if misses else ""),
        measured={
            f"{air}_{law}_{end}_m": value
            for air, flights in (("quiet", quiet), ("noisy", steps), ("noisy_at_rest", rests))
            for law, setting in zip(KEYS, MAIN, strict=True)
            for end, value in zip(("largest", "smallest"), _extreme_m(flights, setting), strict=True)
        },
    )


def _bad_links(shape: str, noisy: Sequence[Pair], disturbed: Sequence[Pair]) -> Claim:
    ours, papers = _transient(disturbed, COOPERATIVE), _transient(noisy, WEIGHTED)
    ours_steps, papers_steps = [pair.step for pair in disturbed], [pair.step for pair in noisy]
    ours_in_band, papers_in_band = _settling(ours_steps, COOPERATIVE), _settling(papers_steps, WEIGHTED)
    ours_m, papers_m = _extreme_m(ours_steps, COOPERATIVE), _extreme_m(papers_steps, WEIGHTED)
    better = ours_m[0] < papers_m[0] and ours_m[1] > papers_m[1]
    links = disturbed[0].step
    return Claim(
        id=f"{shape}-bad-links",
        where="beyond the paper",
        claim=f"{shape}: cooperative with {_percent(links.peer_loss)} packet loss and {1000 * links.peer_delay_s:.0f} ms delay "
        "is better than the paper's law with undisturbed links",
        paper="faster, and better distances",
        ideal="-",
        full=f"{ours}, {ours_m[0]:.2f}/{ours_m[1]:.2f} m against {papers}, {papers_m[0]:.2f}/{papers_m[1]:.2f} m",
        verdict=_verdict(
            better and _is_sooner(ours, papers),
            not _step_exceeds_band(disturbed) or _is_sooner(ours_in_band, papers_in_band),
        ),
        remark=f"Default noise for both. Times after which a flight with the step stays within {SETTLED_WITHIN_M:g} m of the "
        f"same flight at rest. Times into the band of {links.within_m:.2f} m that all laws settle into: {ours_in_band} and "
        f"{papers_in_band}. Noise alone causes errors of up to {_rest_m(disturbed, COOPERATIVE):.2f} m and "
        f"{_rest_m(noisy, WEIGHTED):.2f} m at rest.",
        measured=_measured("cooperative_disturbed_transient", ours)
        | _measured("weighted_undisturbed_transient", papers)
        | _measured("cooperative_disturbed_band", ours_in_band)
        | _measured("weighted_undisturbed_band", papers_in_band)
        | {
            "cooperative_disturbed_largest_m": ours_m[0],
            "cooperative_disturbed_smallest_m": ours_m[1],
            "weighted_undisturbed_largest_m": papers_m[0],
            "weighted_undisturbed_smallest_m": papers_m[1],
            "cooperative_disturbed_at_rest_m": _rest_m(disturbed, COOPERATIVE),
        },
    )


def _verdict(holds: bool, secondary_hold: bool = True) -> ClaimVerdict:
    """HOLDS where also the secondary figures that the remark names reach the goal, else CONDITION or FAILS."""
    if not holds:
        return ClaimVerdict.FAILS
    return ClaimVerdict.HOLDS if secondary_hold else ClaimVerdict.CONDITION


def _of(flights: Sequence[Figures], setting: Setting) -> list[Figures]:
    """The flights of one setting; where some are longer, only the longest."""
    own = [f for f in flights if f.setting == setting.label]
    return [f for f in own if f.duration_s == max(g.duration_s for g in own)]


def _laws(flights: Sequence[Figures]) -> Laws:
    return Laws(*(_settling(flights, setting) for setting in MAIN))


def _settling(flights: Sequence[Figures], setting: Setting) -> Settling:
    own = _of(flights, setting)
    return _median([f.settle_s for f in own], own[0].duration_s)


def _transient(pairs: Sequence[Pair], setting: Setting) -> Settling:
    own = [pair for pair in pairs if pair.step.setting == setting.label]
    return _median([pair.transient_s for pair in own], own[0].step.duration_s)


def _median(times_s: Sequence[float | None], duration_s: float) -> Settling:
    """Median over the seeds, with `duration_s` for flights that have not settled. More than half must have settled."""
    value_s = median(duration_s if time_s is None else time_s for time_s in times_s)
    return Settling(round(max(value_s, 0.02), 2), sum(time_s is not None for time_s in times_s) * 2 > len(times_s))


def _is_sooner(ours: Settling, others: Settling) -> bool:
    return ours.settled and ours.value_s < others.value_s


def _measured(name: str, settling: Settling) -> dict[str, float]:
    """Entries of `measured`; an infinite time (null in JSON) where it has not settled."""
    return {f"{name}_s": settling.value_s if settling.settled else inf, f"{name}_settled": settling.settled}


def _rest_m(pairs: Sequence[Pair], setting: Setting) -> float:
    """Largest error of any vehicle over all seeds at rest."""
    return max(pair.rest_error_m for pair in pairs if pair.rest.setting == setting.label)


def _extreme_m(flights: Sequence[Figures], setting: Setting) -> tuple[float, float]:
    own = _of(flights, setting)
    return round(median(f.largest_m for f in own), 4), round(median(f.smallest_m for f in own), 4)


def _extremes(flights: Sequence[Figures]) -> str:
    pairs = (_extreme_m(flights, setting) for setting in MAIN)
    return ", ".join(f"{largest:.2f}/{smallest:.2f}" for largest, smallest in pairs) + " m"


def _misses(air: str, flights: Sequence[Figures]) -> list[str]:
    """Texts on the distances in which `cooperative` is not better, to the millimetre."""
    largest_m, smallest_m = _extreme_m(flights, COOPERATIVE)
    found = []
    for name, setting in (("eq. 22", AVERAGE_22), ("weighted", WEIGHTED)):
        other_largest_m, other_smallest_m = _extreme_m(flights, setting)
        if largest_m >= other_largest_m:
            found.append(f"{air}: the largest is {largest_m:.3f} m, under {name} {other_largest_m:.3f} m")
        if smallest_m <= other_smallest_m:
            found.append(f"{air}: the smallest is {smallest_m:.3f} m, under {name} {other_smallest_m:.3f} m")
    return found


def _count(pairs: Sequence[Pair]) -> int:
    return len({pair.step.seed for pair in pairs})


def _percent(share: float) -> str:
    return f"{100.0 * share:.0f} %"
