"""The study past the paper: what is counted of its flights, its plan, its verdicts and its figures."""

from pathlib import Path

import numpy as np
import pytest
from msgspec.structs import replace

from companion.assembly import law_of
from companion.core.formation import cooperative, weighted
from sitl.paper.claims import Verdict
from sitl.shapes import chain
from sitl.study.cases import BAD_LINKS, Case, Figures, closest_m, fly, settled_s
from sitl.study.figures import save_spectra, save_trade_off
from sitl.study.goals import goal_claims
from sitl.study.plan import GOAL_SHAPES
from sitl.study.settings import AVERAGE_22, COOPERATIVE, MAIN, SETTINGS, WEIGHTED, Setting, in_short
from sitl.study.study import Study
from sitl.study.table import in_a_table


def flown(shape: str, setting: Setting, settle_s: float | None, largest_m: float, smallest_m: float) -> Figures:
    return Figures(
        shape=shape,
        vehicles=16,
        setting=setting.label,
        sensors="ideal",
        peer_delay_s=0.0,
        peer_loss=0.0,
        seed=1,
        step_m=1.0,
        drag_n_per_m_s=0.0,
        duration_s=300.0,
        within_m=0.1,
        settle_s=settle_s,
        largest_m=largest_m,
        smallest_m=smallest_m,
        closest_m=smallest_m,
        stretch_m=largest_m - 1.5,
        squeeze_m=1.5 - smallest_m,
        late_error_m=0.05,
    )


def round_of(cooperative_s: float | None, largest_m: float = 1.56, smallest_m: float = 1.45) -> list[Figures]:
    return [
        figures
        for shape in GOAL_SHAPES
        for figures in (
            flown(shape.name, AVERAGE_22, None, 1.86, 1.37),
            flown(shape.name, WEIGHTED, 200.0, 1.98, 0.79),
            flown(shape.name, COOPERATIVE, cooperative_s, largest_m, smallest_m),
        )
    ]


def study(quiet: list[Figures], noisy: list[Figures], disturbed: list[Figures]) -> Study:
    return Study(quiet=quiet, with_drag=quiet, still=quiet, noisy=noisy, disturbed=disturbed, bands_m={})


def verdicts(subject: Study) -> dict[str, Verdict]:
    return {claim.id: claim.verdict for claim in goal_claims(subject)}


def test_the_goals_hold_where_the_figures_say_so() -> None:
    good = round_of(5.0)
    assert set(verdicts(study(good, good, good)).values()) == {Verdict.HOLDS}


@pytest.mark.parametrize("bad", [round_of(21.0), round_of(None)])
def test_too_slow_is_not_sooner(bad: list[Figures]) -> None:
    good = round_of(5.0)
    for subject in (study(bad, good, good), study(good, bad, good)):
        assert verdicts(subject)["chain-16-sooner"] is Verdict.FAILS


@pytest.mark.parametrize("bad", [round_of(5.0, largest_m=1.9), round_of(5.0, smallest_m=1.3)])
def test_distances_must_beat_both(bad: list[Figures]) -> None:
    good = round_of(5.0)
    assert verdicts(study(good, bad, good))["grid-10x10-distances"] is Verdict.FAILS


def test_bad_links_are_judged_against_the_papers_law_undisturbed() -> None:
    good = round_of(5.0)
    assert verdicts(study(good, good, round_of(250.0)))["chain-16-bad-links"] is Verdict.FAILS
    assert verdicts(study(good, good, round_of(5.0, smallest_m=0.7)))["chain-16-bad-links"] is Verdict.FAILS


def test_settled_means_to_stay_inside() -> None:
    times_s = np.arange(0.0, 10.0, 0.5)
    assert settled_s(times_s, np.where(times_s < 3.0, 1.0, 0.05), 0.1) == 3.0
    assert settled_s(times_s, np.where(times_s < 8.6, 1.0, 0.05), 0.1) is None
    assert settled_s(times_s, np.ones_like(times_s), 0.1) is None


def test_the_closest_of_any_two_at_any_time() -> None:
    positions = np.zeros((2, 3, 3))
    positions[0, :, 0] = (0.0, 2.0, 5.0)
    positions[1, :, 0] = (0.0, 4.0, 4.5)
    assert closest_m(positions) == pytest.approx(0.5)


def test_the_settings_are_what_they_are_called() -> None:
    assert law_of(COOPERATIVE.law) == cooperative()
    assert law_of(WEIGHTED.law) == weighted()
    parts = [setting for setting in SETTINGS if setting.is_part]
    ours, papers = cooperative(), weighted()
    assert [law_of(part.law).exponent for part in parts] == [ours.exponent, 1.0, 1.0, 1.0]
    assert [law_of(part.law).gains for part in parts] == [papers.gains, ours.gains, papers.gains, papers.gains]
    assert [law_of(part.law).feedforward for part in parts] == [0.0, 0.0, ours.feedforward, 0.0]
    assert [law_of(part.law).leader_heeds_neighbours for part in parts] == [True, True, True, False]
    assert in_short(WEIGHTED) == "alpha 1, K = (1.39, 1.2), g 0"
    assert len({setting.label for setting in SETTINGS}) == len(SETTINGS)


def test_a_short_flight_of_the_main_laws_with_bad_links() -> None:
    figures = fly([Case(chain(4), setting, "default", BAD_LINKS) for setting in MAIN], 12.0, within_m=0.4)
    average, paper, ours = figures
    assert ours.settle_s is not None
    assert ours.settle_s < min(f.settle_s or 12.0 for f in (average, paper))
    assert ours.largest_m < min(average.largest_m, paper.largest_m)
    assert fly([Case(chain(4), COOPERATIVE, "default", BAD_LINKS)], 12.0, within_m=0.4) == [ours]


def test_the_figures_and_the_table(tmp_path: Path) -> None:
    flights = [flown("chain-16", setting, 5.0, 1.6, 1.4) for setting in SETTINGS]
    flights[0] = replace(flights[0], settle_s=None)
    save_trade_off(tmp_path / "t.png", flights, ["chain-16"])
    save_spectra(tmp_path / "s.png", {"chain": {"weighted": [(4, 0.18), (16, 0.02)]}})
    assert all((tmp_path / name).read_bytes().startswith(b"\x89PNG") for name in ("t.png", "s.png"))
    table = in_a_table(flights, ["chain-16"])
    assert "over 300 s, 1.60/1.40 m" in table
    assert len(table.splitlines()) == 1 + len(SETTINGS)
