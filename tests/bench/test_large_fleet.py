"""Counters, cases and table of the large fleet. `make bench-large-fleet` has 8 to 64 vehicles."""

from pathlib import Path

import pytest

from sitl.links.free_ports import reserved_ports
from sitl.links.ports import ports_of
from tests.bench.large_fleet import (
    HEAD,
    HEADERS,
    MARKS,
    Case,
    LinkCounters,
    Traffic,
    cases,
    measure,
    row,
    table,
    traffic_in,
)
from tests.bench.page import marks, write_between_marks
from tests.bench.programs.large_fleet import LinkResult

pytestmark = pytest.mark.long

SHOWN = """\
ESTAB 0 0 127.0.0.1:7600 127.0.0.1:5000 users:(("python",pid=12,fd=9)) ts bytes_sent:100 bytes_acked:100 bytes_received:2000 segs_out:3 segs_in:20 data_segs_out:2
ESTAB 0 0 127.0.0.1:7600 127.0.0.1:5001 users:(("python",pid=12,fd=10)) ts bytes_sent:50 bytes_received:1000 segs_out:1 segs_in:10
ESTAB 0 0 127.0.0.1:5000 127.0.0.1:7600 users:(("python",pid=123,fd=9)) ts bytes_sent:2000 bytes_received:100 segs_out:20 segs_in:3
ESTAB 0 0 127.0.0.1:5002 127.0.0.1:7600 users:(("python",pid=12,fd=11)) ts cwnd:10 segs_in:1
"""  # noqa: E501
RESULT = LinkResult(10.0, 20.0, None, 400.0, None, None)


def test_traffic_is_that_of_all_connections_of_the_process_alone() -> None:
    assert traffic_in(SHOWN, 12) == Traffic(150 + 4 * HEADERS, 4, 3000 + 31 * HEADERS, 31)


def test_where_all_are_received_at_full_rate_there_is_one_case() -> None:
    assert [(one.number, one.full) for one in cases([8, 16]) if one.routed] == [(8, 8), (16, 16), (16, 8)]
    assert [one.routed for one in cases([8])] == [False, True]


def test_a_row_is_the_median_of_the_windows() -> None:
    counted = [(0.0, 0, 0.0), (2.0, 2000, 0.2), (4.0, 6000, 0.4), (6.0, 106000, 0.6)]
    samples = [
        LinkCounters(at_s, Traffic(2 * received, 0, received, 0), cpu_s, 0.0) for at_s, received, cpu_s in counted
    ]
    one = row(Case(8, 8, routed=False), samples, 46.0, RESULT)
    assert (one.received_kb_s, one.sent_kb_s, one.cpu) == (2.0, 4.0, pytest.approx(0.1))


def test_the_table_is_written_between_the_marks(tmp_path: Path) -> None:
    samples = [LinkCounters(float(second), Traffic(0, 0, 0, 0), 0.0, 0.0) for second in range(2)]
    rows = [row(Case(8, 8, routed=routed), samples, 46.0, RESULT) for routed in (False, True)]
    begin, end = marks(MARKS)
    page = tmp_path / "page.md"
    page.write_text(f"a\n{begin}\nold\n{end}\nb\n", encoding="utf-8")
    write_between_marks(page, MARKS, table(rows))
    text = page.read_text(encoding="utf-8")
    assert text.startswith(f"a\n{begin}\n{HEAD}\n| 8 | all | own connections | 400 |")
    assert text.endswith(f"\n{end}\nb\n")
    assert {line.count("|") for line in table(rows).splitlines()} == {13}
    with pytest.raises(ValueError, match="expected the lines"):
        write_between_marks(Path(__file__), MARKS, "")


@pytest.mark.parametrize("routed", [False, True])
def test_zenoh_sends_full_rate_only_to_those_that_subscribe(routed: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("tests.bench.large_fleet.SETTLES_S", 0.2)
    monkeypatch.setattr("tests.bench.large_fleet.WINDOW_S", 0.7)
    with reserved_ports({1: None}, None) as offset:
        measured = measure(Case(4, 1, routed), ports_of(1, offset).zenoh)
    packets_per_s = 50.0 + 4 * 5.0
    assert measured.result.packets_per_s == pytest.approx(packets_per_s, rel=0.3)
    assert measured.received_kb_s * 1e3 < 500.0 * packets_per_s  # 200 packets a second would take more
    assert measured.result.switch_worst_ms is not None
