"""How the setting of `cooperative` is chosen: candidates, the flights that they are compared in, and the criterion.

Every candidate flies every shape under every condition. Its two figures are the worst of all its flights:

- settling: the time to 10 cm of all vehicles, as a multiple of the time of a leader alone under the same condition;
- room: the smallest distance of neighbours less that under eq. 22 in the same flight. Noise, which no setting of the weights
  changes, is in both.

Of the candidates with at most LOST_ROOM_M less room than eq. 22 those count that settle at most AS_SOON times as late as the
soonest. Chosen is the one with the smallest feed-forward, because 1 - g of a wrong acceleration is forgotten with each tick; of
several the soonest, to a tenth, and then the one with the largest ratio, which averages the most.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import product
from math import inf

from msgspec import Struct

from companion.analysis.prediction import SETTLED_WITHIN_M
from companion.config.law import LawSection, feedback_law_of
from sitl.batch.flight import fly_batch
from sitl.study.cases import BAD_LINKS, GOOD_LINKS, STEP_M, Case, Figures, Sensing, fly, settled_s
from sitl.study.settings import AVERAGE_22, Setting
from sitl.study.shapes import Shape, chain
from sitl.vehicle.config import Airframe, Links
from sitl.workers import Workers, all_results

RATIOS = (0.3, 0.1, 0.03, 0.01)
FED_FORWARD = (0.9, 0.95, 0.97, 0.98, 0.99)
LOST_ROOM_M = 0.04
AS_SOON = 1.25
LEADER_ALONE = Setting("leader alone", LawSection(name="cooperative", parameters={"leader_uses_neighbours": False}))
FLOWN_S = 60.0
AT_ONCE = 8  # formations in one batch


@dataclass(frozen=True, slots=True)
class Condition:
    """What a flight of the comparison differs in. Under noise there is no settling time: only the distances count."""

    label: str
    links: Links = GOOD_LINKS
    sensors: Sensing = "ideal"
    step_m: float = STEP_M
    drag_n_per_m_s: float = 0.0

    def case(self, shape: Shape, setting: Setting) -> Case:
        return Case(shape, setting, self.sensors, self.links, step_m=self.step_m, drag_n_per_m_s=self.drag_n_per_m_s)


CONDITIONS = (
    Condition("undisturbed"),
    Condition("100 ms delay, 10 % loss", links=BAD_LINKS),
    Condition("drag", drag_n_per_m_s=Airframe().drag_n_per_m_s),
    Condition("attitude 80 ms later", links=Links(setpoint_delay_s=0.08)),
    Condition("step to the tilt limit", step_m=4.0),
    Condition("default noise", sensors="default"),
    Condition("noise of PX4's SIH", sensors="px4_sih"),
)


def candidate(ratio: float, feedforward: float) -> Setting:
    """`cooperative` with weights that fall by this ratio per hop."""
    law = LawSection(
        name="cooperative", parameters={"exponent": 0.0, "weight_ratio": ratio, "feedforward": feedforward}
    )
    return Setting(f"rho {ratio:g}, g {feedforward:g}", law)


CANDIDATES: tuple[Setting, ...] = (
    *(candidate(ratio, feedforward) for ratio, feedforward in product(RATIOS, FED_FORWARD)),
    Setting(
        "alpha 8, g 0.9",
        LawSection(name="cooperative", parameters={"exponent": 8.0, "weight_ratio": 1.0, "feedforward": 0.9}),
    ),
)


class Compared(Struct, frozen=True, kw_only=True):
    """A flight of the comparison; `leader_s` is the settling time of a leader alone under its condition."""

    condition: str
    figures: Figures
    leader_s: float | None


class Score(Struct, frozen=True, kw_only=True):
    """The worst of the flights of one setting. `settling` None: it did not settle in every flight."""

    setting: str
    settling: float | None
    room_m: float
    smallest_m: float


def compare(workers: Workers, shapes: Sequence[Shape], progress: Callable[[float], None]) -> list[Compared]:
    """Fly all candidates and eq. 22 in these workers, and a leader alone here."""
    settings = (AVERAGE_22, *CANDIDATES)
    groups = [settings[k : k + AT_ONCE] for k in range(0, len(settings), AT_ONCE)]
    jobs = [
        (condition, [condition.case(shape, setting) for setting in group])
        for condition, shape, group in product(CONDITIONS, shapes, groups)
    ]
    weights = [float(len(cases) * len(cases[0].shape.slots_enu_m)) for _, cases in jobs]
    flown = all_results(workers, _fly, jobs, progress, weights)
    leader_s = {condition.label: leader_alone_s(condition) for condition in CONDITIONS}
    return [
        Compared(condition=condition.label, figures=figures, leader_s=leader_s[condition.label])
        for (condition, _), many in zip(jobs, flown, strict=True)
        for figures in many
    ]


def _fly(job: tuple[Condition, list[Case]]) -> list[Figures]:
    return fly(job[1], FLOWN_S)


def leader_alone_s(condition: Condition) -> float | None:
    """The settling time of a leader that does not use its one follower."""
    flight = fly_batch([condition.case(chain(2), LEADER_ALONE).scenario()], FLOWN_S)
    return settled_s(flight.times_s, flight.errors_m()[:, 0, 0], SETTLED_WITHIN_M)


def scores(flights: Sequence[Compared]) -> list[Score]:
    """Of every setting but eq. 22, in the order of CANDIDATES."""
    average_m = {(f.condition, f.figures.shape): f.figures.smallest_m for f in flights if _is(f, AVERAGE_22)}
    return [_score(setting, [f for f in flights if _is(f, setting)], average_m) for setting in CANDIDATES]


def _is(flight: Compared, setting: Setting) -> bool:
    return flight.figures.setting == setting.label


def _score(setting: Setting, flights: Sequence[Compared], average_m: dict[tuple[str, str], float]) -> Score:
    quiet = [f for f in flights if f.figures.sensors == "ideal"]
    settling = max(_settling(f) for f in quiet)
    return Score(
        setting=setting.label,
        settling=None if settling == inf else round(settling, 3),
        room_m=round(min(f.figures.smallest_m - average_m[f.condition, f.figures.shape] for f in flights), 4),
        smallest_m=min(f.figures.smallest_m for f in flights),
    )


def _settling(flight: Compared) -> float:
    if flight.figures.settle_s is None or not flight.leader_s:
        return inf
    return flight.figures.settle_s / flight.leader_s


def chosen(found: Sequence[Score]) -> Score | None:
    """By the criterion above; None where no candidate settles with enough room."""
    fit = [score for score in found if score.settling is not None and score.room_m >= -LOST_ROOM_M]
    if not fit:
        return None
    soonest = min(_known(score) for score in fit)
    laws = {setting.label: feedback_law_of(setting.law) for setting in CANDIDATES}
    as_soon = [score for score in fit if _known(score) <= soonest * AS_SOON]
    return min(as_soon, key=lambda s: (laws[s.setting].feedforward, round(_known(s), 1), -laws[s.setting].weight_ratio))


def _known(score: Score) -> float:
    return inf if score.settling is None else score.settling


def selection_text(found: Sequence[Score]) -> str:
    """A table of the candidates; > marks the chosen one."""
    best = chosen(found)
    rows = [f"  {'candidates for cooperative, worst of all flights':<52}{'settling':>9}{'less than eq. 22':>18}"]
    for score in found:
        settling = "never" if score.settling is None else f"{score.settling:.1f}"
        rows.append(f"{'>' if score == best else ' '} {score.setting:<52}{settling:>9}{-score.room_m:>16.2f} m")
    return "\n".join(
        [*rows, "  settling: in settling times of a leader alone; less: smallest distance, in the same flight"]
    )
