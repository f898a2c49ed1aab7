"""The page: valid, without a network, with title and units in every figure."""

from __future__ import annotations

import dataclasses
import re
from datetime import timedelta, timezone
from html.parser import HTMLParser

import numpy as np
import pytest
from msgspec.structs import replace

from companion.recording.records import DecisionRecord
from companion.report.autopilot_logs import read_logs
from companion.report.findings import FindingKind, Severity, finding, rows_of
from companion.report.page import page_of, prose
from companion.report.plotting import COLUMNS, STYLES, thin_out, vehicle_look
from companion.report.summary import judge
from companion.report.track_figures import view
from companion.types.commands import CommandName
from companion.types.flight import HealthFlag
from companion.types.notices import Code, Notice
from made_flights import Faults, flagged, flight_of, near_vehicle_1, records_of
from recordings import write_ulog

ZONE = timezone(timedelta(hours=2))
VOID = {"meta", "br", "img", "path", "use", "rect", "line", "circle"}
FIGURES = {
    "tracks",
    "altitude",
    "phases",
    "distances",
    "errors",
    "interventions",
    "leaders",
    "prc",
    "topology",
    "peer-ages",
    "weights",
    "flags",
    "battery",
    "position-errors",
    "wind",
    "autopilot-1",
    "timing",
    "lateness",
}
DIMENSIONLESS = {"phases", "leaders", "flags"}  # their values are names; the time has its unit


class Page(HTMLParser):
    """Checks that elements are nested, and collects ids, attributes and the texts of the figures."""

    def __init__(self) -> None:
        super().__init__(convert_charrefs=True)
        self.open: list[str] = []
        self.ids: list[str] = []
        self.references: list[str] = []
        self.figures: dict[str, str] = {}
        self.headings: list[str] = []
        self._figure = ""

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        if tag not in VOID:
            self.open.append(tag)
        values = dict(attrs)
        if identity := values.get("id"):
            self.ids.append(identity)
        self.references += [value or "" for name, value in attrs if name in ("href", "src", "xlink:href", "srcset")]
        if tag == "figure":
            self._figure = (values.get("id") or "").removeprefix("figure-")
            self.figures[self._figure] = ""
        if self._figure:
            self.figures[self._figure] += " " + (values.get("aria-label") or values.get("alt") or "")

    def handle_startendtag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.handle_starttag(tag, attrs)
        if tag not in VOID:
            self.open.pop()

    def handle_endtag(self, tag: str) -> None:
        if tag in VOID:
            return
        assert self.open, f"</{tag}> closes nothing"
        assert self.open.pop() == tag
        if tag == "figure":
            self._figure = ""

    def handle_data(self, data: str) -> None:
        if self._figure:
            self.figures[self._figure] += data
        if self.open and self.open[-1] in ("h2", "h3"):
            self.headings.append(data)


@pytest.fixture(scope="module")
def html(tmp_path_factory: pytest.TempPathFactory) -> str:
    """A flight in which everything occurs that has a figure. Texts try to break out of the page."""
    attack = '<script>alert(1)</script> & "quotes"'
    starts = records_of(
        3,
        30.0,
        {
            1: Faults(refused={CommandName.ARM: Code.WRONG_PHASE}),
            2: Faults(decision=near_vehicle_1, events=((15.0, Notice(Code.PHASE_CHANGED, attack)),)),
            3: flagged(HealthFlag.LEADER_AWAITED, 12.0, 13.0),
        },
    )
    flight = flight_of(starts)
    log = write_ulog(tmp_path_factory.mktemp("log") / "vehicle-1_log-3.ulg", starts[0])
    return page_of(judge(flight, read_logs([log], flight)), ZONE)


@pytest.fixture(scope="module")
def page(html: str) -> Page:
    parsed = Page()
    parsed.feed(html)
    parsed.close()
    return parsed


def test_all_elements_are_closed_and_ids_are_unique(page: Page) -> None:
    assert page.open == []
    assert len(page.ids) == len(set(page.ids))


def test_nothing_is_requested_from_a_network(html: str, page: Page) -> None:
    assert re.findall(r"https?:|//cdn|@import|url\((?!#)", html) == []
    assert [one for one in page.references if not one.startswith(("#", "data:"))] == []
    assert {one[1:] for one in page.references if one.startswith("#")} <= set(page.ids)


def test_every_figure_is_there_with_title_units_and_legend(page: Page) -> None:
    assert set(page.figures) == FIGURES
    for name, text in page.figures.items():
        assert text.strip(), name
        if "data:image" not in text:
            units = set(re.findall(r"\[([^\]]{1,6})\]", text))
            assert units - {"s"} or name in DIMENSIONLESS, name


def test_texts_of_vehicles_cannot_break_out_of_the_page(html: str) -> None:
    assert "<script" not in html
    assert "&lt;script&gt;alert(1)" in html


def test_the_findings_lead_the_page_with_local_times(html: str, page: Page) -> None:
    assert page.headings[:2] == ["Findings", "Vehicles"]
    assert "1 critical finding and 2 warnings" in html
    assert "UTC+02:00" in html
    assert "18:00:20" in html  # BEGIN_UNIX_S is 16:00 UTC; the encounter begins at 20 s


def test_a_flight_in_virtual_time_has_no_date() -> None:
    """Its clock begins at 0, which a date would show as 1970."""
    text = page_of(judge(dataclasses.replace(flight_of(records_of(1, 24.0)), begin_unix_s=0.0)), ZONE)
    assert "1970" not in text
    assert "Without a date (virtual time, or a clock that was never set)" in text
    assert re.findall(r"local|\d\d:\d\d:\d\d", text) == []  # nor times of day


def test_the_contents_name_every_section_and_figure(html: str, page: Page) -> None:
    contents = re.findall(r'href="#([^"]+)">', html.split("<nav", 1)[1].split("</nav>")[0])
    assert [one.removeprefix("figure-") for one in contents if one.startswith("figure-")] == list(page.figures)
    sections = ["findings", "vehicles", "flight", "formation", "law-and-leader", "health", "autopilots", "timing"]
    assert [one for one in contents if not one.startswith("figure-")] == [
        *sections,
        "commands",
        "events",
        "configuration",
    ]


def test_the_page_of_a_vehicle_alone_has_no_figure_of_pairs() -> None:
    parsed = Page()
    parsed.feed(page_of(judge(flight_of(records_of(1, 24.0))), ZONE))
    assert not {"distances", "flags", "weights", "topology", "autopilot-1"} & set(parsed.figures)
    assert {"tracks", "errors", "timing"} <= set(parsed.figures)


def test_weights_that_a_law_does_not_tell_have_no_figure() -> None:
    def untold(_time_s: float, record: DecisionRecord) -> DecisionRecord:
        return replace(record, weights=())

    parsed = Page()
    parsed.feed(page_of(judge(flight_of(records_of(3, 24.0, dict.fromkeys((1, 2, 3), Faults(decision=untold))))), ZONE))
    assert "weights" not in parsed.figures
    assert "tracks" in parsed.figures


def test_a_track_begins_at_the_first_position() -> None:
    def located_from_4_s(time_s: float, record: DecisionRecord) -> DecisionRecord:
        if time_s >= 4.0:
            return replace(record, position_enu_m=(50.0, 60.0, 0.0), reference_enu_m=None)
        return replace(record, position_enu_m=None, velocity_enu_m_s=None)

    def never_located(_time_s: float, record: DecisionRecord) -> DecisionRecord:
        return replace(record, position_enu_m=None, velocity_enu_m_s=None)

    flight = flight_of(records_of(2, 24.0, {1: Faults(decision=located_from_4_s), 2: Faults(decision=never_located)}))
    assert "tracks" in page_of(judge(flight), ZONE)
    assert view(flight) == ((49.0, 51.0), (59.0, 61.0))


def test_what_is_drawn_keeps_every_peak() -> None:
    time_s = np.arange(30_000) * 0.02
    values = np.zeros(30_000)
    values[[7, 15_001, 29_990]] = (5.0, -3.0, 9.0)
    values[20_000:20_100] = np.nan
    drawn_s, drawn = thin_out(time_s, values)
    assert drawn.size <= 3 * COLUMNS
    assert (np.nanmax(drawn), np.nanmin(drawn)) == (9.0, -3.0)
    assert np.isnan(drawn).any()
    assert np.all(np.diff(drawn_s) > 0.0)


def test_28_vehicles_look_different() -> None:
    looks = {(vehicle_look(n)["color"], STYLES.index(vehicle_look(n)["linestyle"])) for n in range(1, 29)}
    assert len(looks) == 28


def test_the_same_finding_of_several_vehicles_is_one_row() -> None:
    def refused(vehicle_id: int, time_s: float, text: str = "no") -> object:
        return finding(Code.WRONG_PHASE, vehicle_id, time_s, text, kind=FindingKind.REFUSED, severity=Severity.WARNING)

    rows = rows_of([refused(3, 1.0), refused(1, 1.02), refused(2, 1.0, "other"), refused(1, 9.0)])  # type: ignore[list-item]
    assert [row.vehicle_ids for row in rows] == [(1, 3), (2,), (1,)]


def test_a_finding_that_comes_often_is_one_row_with_its_longest_time() -> None:
    found = [
        finding(Code.POSITION_STALE, 1 + n % 2, 10.0 * n, f"for {n} s", lasts_s=float(n), severity=Severity.WARNING)
        for n in range(5)
    ]
    (row,) = rows_of(found)
    assert (row.times, row.vehicle_ids, row.finding.text) == (5, (1, 2), "for 4 s")
    assert [row.times for row in rows_of(found[:3])] == [1, 1, 1]


def test_critical_findings_stay_apart() -> None:
    found = [finding(Code.SEPARATION_VIOLATED, 1, 10.0 * n, f"pair {n}") for n in range(5)]
    assert len(rows_of(found)) == 5


def test_code_in_an_explanation_is_marked_and_escaped() -> None:
    assert str(prose("set `a<b` now")) == "set <code>a&lt;b</code> now"
