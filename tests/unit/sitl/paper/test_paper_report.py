"""The report of `sitl paper`: counts, contents and escaping, and measures computed from tracks."""

import re
from math import inf
from pathlib import Path

import msgspec
import numpy as np
import pytest
from msgspec.structs import replace

from companion.analysis.interaction import FloatArray
from companion.core.reference.blend import point
from companion.types.flight import Role
from sitl.paper.command import duration_text
from sitl.paper.figures import SAVED
from sitl.paper.flights import (
    Book,
    FlightSubject,
    Model,
    NotFlownError,
    alone_s,
    behind_leader_m,
    broken_s,
    edges_m,
    paper_plans,
    response_s,
    topology_at,
    total_s,
)
from sitl.paper.graphs import printed_matrix
from sitl.paper.platoon_claims import platoon_claims
from sitl.paper.report import SIGNS, LawRow, PaperReport, as_html, sentence, verdict_counts, versions, write_report
from sitl.paper.words import join_words, seconds, verdict_of, words
from sitl.report.claim import Claim, ClaimVerdict, Erratum
from sitl.report.metrics import Formation, FormationFlight, Track, stand_at
from sitl.report.summary import TopologyChange


def claim(claim_id: str, verdict: ClaimVerdict, remark: str = "", full: str = "1.81 m") -> Claim:
    return Claim(
        id=claim_id,
        where="figure 6",
        claim="d12 < 1.75 m & d23 < 1.75 m",
        paper="1.75 m",
        ideal="1.754 m",
        full=full,
        verdict=verdict,
        remark=remark,
        measured={"largest_d12_m": 1.754, "never_s": inf},
    )


def report(*claims: Claim) -> PaperReport:
    return PaperReport(
        claims=list(claims),
        errata=[Erratum(place="eq. 8", printed="tan(phi) - phi", right="tan(phi)", shown="<b>38 deg</b>")],
        laws=[
            LawRow(law="weighted", source="equations", largest_m=(1.754, 1.775, 1.661), settle_s=26.2),
            LawRow(law="average_22", source="agents, full quadrotor", largest_m=(1.86, 1.772, 1.618), settle_s=None),
        ],
        versions=versions(),
        full=False,
        flights=31,
        took_s=99.6,
    )


# ---------------------------------------------------------------- the page


def test_the_summary_counts_every_verdict() -> None:
    claims = [claim("a", ClaimVerdict.HOLDS), claim("b", ClaimVerdict.HOLDS), claim("c", ClaimVerdict.FAILS)]
    assert verdict_counts(claims) == "3 claims: 2 hold, 0 hold with a condition and 1 does not hold"
    assert verdict_counts(claims[:1]) == "1 claim: 1 holds, 0 hold with a condition and 0 do not hold"


def test_every_verdict_has_its_own_sign_and_text() -> None:
    assert len(set(SIGNS.values())) == len(ClaimVerdict)
    for verdict in ClaimVerdict:
        page = as_html(report(claim("a", verdict)))
        row = page[page.index('<tr id="claim-a"') :]
        row = row[: row.index("</tr>")]
        assert SIGNS[verdict] in row
        assert verdict.value in row
        assert not any(SIGNS[other] in row for other in ClaimVerdict if other is not verdict)


def test_texts_of_claims_are_escaped() -> None:
    page = as_html(report(claim("a", ClaimVerdict.HOLDS, remark="<script>alert(1)</script>")))
    assert "d12 &lt; 1.75 m &amp; d23 &lt; 1.75 m" in page
    assert "<script" not in page
    assert "&lt;b&gt;38 deg" in page


def test_the_page_needs_no_network_and_names_every_figure() -> None:
    page = as_html(report(claim("a", ClaimVerdict.HOLDS)))
    assert not re.search(r"""(src|href)=["']?(https?:)?//""", page)
    assert "url(" not in page
    assert set(SAVED) == set(words().figures)
    for file in SAVED:
        assert f'src="{file}"' in page
        assert f'href="#{file}"' in page
        assert f'id="{file}"' in page


def test_a_figure_is_followed_by_its_claims() -> None:
    page = as_html(report(claim("fig-8-peak", ClaimVerdict.CONDITION)))
    figure_8 = page[page.index('id="figure_8.png"') : page.index('id="figure_9.png"')]
    assert "Claim: d12 &lt; 1.75 m" in figure_8
    assert ClaimVerdict.CONDITION.value in figure_8


def test_failed_claims_are_listed_at_the_top() -> None:
    page = as_html(report(claim("a", ClaimVerdict.FAILS, remark="d23 passes it"), claim("b", ClaimVerdict.HOLDS)))
    top = page[: page.index('id="claims"')]
    assert "d23 passes it" in top
    assert '<a href="#claim-a">' in top
    assert '<a href="#claim-b">' not in top
    assert "What does not hold" not in as_html(report(claim("b", ClaimVerdict.HOLDS)))


def test_a_law_that_never_settles_is_marked() -> None:
    page = as_html(report())
    assert "26.2" in page
    assert "never" in page


def test_the_folder_holds_the_page_and_all_numbers(tmp_path: Path) -> None:
    written = report(claim("a", ClaimVerdict.FAILS))
    write_report(tmp_path, written)
    assert (tmp_path / "index.html").read_text(encoding="utf-8") == as_html(written)
    content = msgspec.json.decode((tmp_path / "claims.json").read_bytes())
    assert content["schema"] == 1
    assert content["claims"][0]["verdict"] == "does not hold"
    assert content["claims"][0]["measured"] == {"largest_d12_m": 1.754, "never_s": None}
    assert content["errata"][0]["place"] == "eq. 8"
    assert content["took_s"] == 99.6
    assert "numpy" in content["versions"]


# ---------------------------------------------------------------- texts and measures


def test_texts_of_figures() -> None:
    assert seconds(21.54) == "21.5 s"
    assert seconds(inf) == "never"
    assert join_words([]) == ""
    assert join_words(["a"]) == "a"
    assert join_words(["a", "b", "c"]) == "a, b and c"
    assert [sentence(text) for text in ("", "so it is", "It is.", "d23 is")] == ["", "So it is.", "It is.", "d23 is."]
    assert verdict_of(True) is ClaimVerdict.HOLDS
    assert verdict_of(False, True) is ClaimVerdict.CONDITION
    assert verdict_of(False) is ClaimVerdict.FAILS


# ---------------------------------------------------------------- figures


TIMES_S = np.arange(0.0, 20.0, 0.02)


def moving(*x_m: FloatArray) -> FormationFlight:
    """Vehicles 1, 2, ... along x; the formation lasts from 5 s to 15 s, the goal is x = 2 m."""
    tracks = {
        i: Track(TIMES_S, np.stack([x, np.zeros_like(x), np.ones_like(x)], axis=1)) for i, x in enumerate(x_m, start=1)
    }
    slots = {i: (1.0 - i, 0.0, 0.0) for i in tracks}
    return FormationFlight("weighted", tracks, stand_at(slots), [], point((2.0, 0.0, 1.0)), Formation(5.0, 15.0, 5.0))


def test_edges_out_of_range_and_a_leader_alone() -> None:
    away = np.where((TIMES_S >= 7.0) & (TIMES_S < 9.0), 4.0, 0.0)
    flight = moving(away, np.full_like(TIMES_S, -1.0), np.full_like(TIMES_S, 1.5))
    (broken,) = broken_s(flight, (1, 2), 3.0)
    assert broken == pytest.approx((2.0, 4.0), abs=0.03)
    assert broken_s(flight, (2, 3), 3.0) == []
    assert alone_s(flight, 1, 3.0) == []  # 2.5 m from vehicle 3 all the while
    assert total_s(alone_s(flight, 1, 2.4)) == pytest.approx(2.0, abs=0.03)
    assert edges_m(flight.tracks, 8.0, 3.0) == [(1, 3), (2, 3)]


def test_an_edge_that_stays_broken_is_broken_until_the_end() -> None:
    flight = moving(np.where(TIMES_S >= 7.0, 9.0, 0.0), np.zeros_like(TIMES_S))
    assert broken_s(flight, (1, 2), 3.0)[-1][1] == pytest.approx(10.0)


def test_a_vehicle_has_responded_after_half_of_its_distance() -> None:
    ramp = np.clip((TIMES_S - 6.0) / 4.0, 0.0, 1.0)  # from 6 s to 10 s
    flight = moving(2.0 * ramp, 1.0 * ramp, np.zeros_like(TIMES_S) - 1.0)
    assert response_s(flight, 1) == pytest.approx(3.0, abs=0.03)
    assert response_s(flight, 3) == inf


def test_the_error_of_a_follower_is_relative_to_its_leader() -> None:
    flight = moving(np.full_like(TIMES_S, 2.0), np.full_like(TIMES_S, 0.7))
    assert behind_leader_m(flight, 1, 2, TIMES_S[300:310]) == pytest.approx(np.full(10, 0.3))


def change(time_s: float, vehicle: int, role: Role, prc: int) -> TopologyChange:
    neighbours = (3 - vehicle,)
    return TopologyChange(
        time_s=time_s, vehicle=vehicle, role=role, epoch=0, prc=prc, neighbours=neighbours, in_formation=True
    )


def test_a_topology_holds_the_last_report_of_each_vehicle() -> None:
    changes = [
        change(1.0, 1, Role.LEADER, 1),
        change(1.0, 2, Role.FOLLOWER, 2),
        change(5.0, 2, Role.LEADER, 1),
        change(5.1, 1, Role.FOLLOWER, 2),
    ]
    assert topology_at(changes, 4.9) == {1: changes[0], 2: changes[1]}
    assert topology_at(changes, 9.0) == {1: changes[3], 2: changes[2]}


def test_printed_matrices_are_parsed() -> None:
    assert printed_matrix(["2 -1/2", "-3/4 1"]).tolist() == [[2.0, -0.5], [-0.75, 1.0]]


def test_every_experiment_is_flown_with_both_models() -> None:
    plans = paper_plans(full=False)
    assert len(plans) == len(set(plans))
    for subject in FlightSubject:
        for model in (Model.IDEAL, Model.FULL):
            assert [p for p in plans if (p.subject, p.law, p.model) == (subject, "weighted", model)]
    assert set(plans) < set(paper_plans(full=True))


def test_the_ideal_model_is_a_double_integrator() -> None:
    plan = next(p for p in paper_plans(full=False) if p.model is Model.IDEAL)
    stand_in = plan.scenario().stand_in
    assert stand_in.airframe.attitude == "instant"
    assert stand_in.airframe.motor_lag_s == stand_in.airframe.drag_n_per_m_s == 0.0
    assert stand_in.sensors == "ideal"


@pytest.mark.parametrize(
    ("cores", "text"),
    [(1, "about 2 minutes on 1 quiet core;"), (2, "about 1 minute on 2 quiet cores;"), (64, "about 1 minute on 64")],
)
def test_it_says_beforehand_how_long_it_takes(cores: int, text: str) -> None:
    assert duration_text(full=False, cores=cores).startswith(text)


def test_a_page_that_was_stopped_says_what_is_missing_and_shows_the_rest() -> None:
    page = as_html(replace(report(claim("a", ClaimVerdict.HOLDS)), missing=["lemma-1", "figure_8.png"]))
    assert "Not finished: lemma-1, figure_8.png." in page
    assert 'src="figure_8.png"' not in page and 'src="figure_5.png"' in page


def test_a_group_of_flights_with_one_missing_gives_no_claim() -> None:
    plans = [plan for plan in paper_plans(full=False) if plan.model is Model.NOISY and plan.subject == "platoon"]
    book = Book([], plans)
    with pytest.raises(NotFlownError, match="not all flights of platoon"):
        book.all(plans[0].subject, plans[0].law, Model.NOISY)
    assert platoon_claims(Book([], paper_plans(full=False))) == []
