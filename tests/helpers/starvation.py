"""Pytest plugin: a real-time test that failed while its processes were starved runs once more after all the others.

Lateness is measured in the processes under test and in the test process: docs/architecture/index.md.
"""

from __future__ import annotations

import fcntl
import os
import re
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from itertools import zip_longest
from pathlib import Path
from typing import Any

import pytest
from _pytest.runner import runtestprotocol

STAT = Path("/proc/stat")
# Share of all processors that the hypervisor gives to other machines, within STOLEN_WITHIN_S. Idle machines show none.
STOLEN_SHARE = 0.1
STOLEN_WITHIN_S = 1.0
# One period of the control loop. On an idle machine no cycle starts more than 2 ms late.
# Cycles that start more than 20 ms late are logged (companion/link/tick.py).
STARVED_S = 0.02
PROBE_PERIOD_S = 0.01
REPORTED = re.compile(r"LOOP_LATE: \d+ cycles of the loop started late, at most (\d+) ms")


@dataclass(frozen=True)
class Late:
    """One measured lateness: who measured it and when it was collected, by the monotonic clock."""

    source: str
    late_s: float
    collected_s: float

    def __str__(self) -> str:
        return f"{self.source} {self.late_s * 1000:.0f} ms late"


class ReportedLateness:
    """Lateness that agents and stand-ins report in their logs: all `*.log` files below `folder`."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._read_bytes: dict[Path, int] = {}

    def collect(self) -> list[Late]:
        """What was reported since the last call."""
        now_s = time.monotonic()
        return [late for file in self._folder.rglob("*.log") for late in self._new(file, now_s)]

    def _new(self, file: Path, now_s: float) -> list[Late]:
        try:
            with file.open("rb") as log:
                begin = self._read_bytes.get(file, 0)
                log.seek(begin if begin <= log.seek(0, os.SEEK_END) else 0)
                lines, newline, unfinished = log.read().rpartition(b"\n")
                self._read_bytes[file] = log.tell() - len(unfinished)
        except OSError:  # removed meanwhile, or a folder
            return []
        found = REPORTED.findall((lines + newline).decode(errors="replace"))
        return [Late(file.stem, int(ms) / 1000.0, now_s) for ms in found]


class StolenTime:
    """Processor time that the hypervisor took from this machine: `steal` of /proc/stat. None of it is the work of the tests."""

    def __init__(self) -> None:
        self._sampled_s = time.monotonic()
        self._stolen, self._total = _processor_times()
        self._worst = 0.0

    def sample(self) -> None:
        """Call often; takes a sample every STOLEN_WITHIN_S."""
        now_s = time.monotonic()
        if now_s - self._sampled_s < STOLEN_WITHIN_S:
            return
        stolen, total = _processor_times()
        if total > self._total:
            self._worst = max(self._worst, (stolen - self._stolen) / (total - self._total))
        self._sampled_s, self._stolen, self._total = now_s, stolen, total

    def collect(self) -> float:
        """The largest share within STOLEN_WITHIN_S since the last call, 0 to 1."""
        worst, self._worst = self._worst, 0.0
        return worst


def _processor_times() -> tuple[int, int]:
    """Stolen and total time of all processors, in ticks of the kernel; zeros where the kernel reports none."""
    try:
        times = [int(number) for number in STAT.read_text().split("\n", 1)[0].split()[1:9]]
    except OSError:
        return 0, 0
    return times[7], sum(times)


class OwnLateness(threading.Thread):
    """Lateness of a thread of the test process that wakes every PROBE_PERIOD_S, and what the hypervisor took meanwhile.

    The time in which the process itself ran is not counted. For tests whose processes report no lateness, or do not run yet.
    """

    def __init__(self) -> None:
        super().__init__(daemon=True, name="lateness")
        self._ended = threading.Event()
        self._lock = threading.Lock()
        self._worst_s = 0.0
        self._stolen = StolenTime()

    def run(self) -> None:
        while not self._ended.is_set():
            began_s, ran_s = time.monotonic(), time.process_time()
            self._ended.wait(PROBE_PERIOD_S)
            late_s = time.monotonic() - began_s - PROBE_PERIOD_S - (time.process_time() - ran_s)
            with self._lock:
                self._worst_s = max(self._worst_s, late_s)
                self._stolen.sample()

    def collect(self) -> list[Late]:
        """The worst since the last call."""
        with self._lock:
            worst_s, self._worst_s = self._worst_s, 0.0
        return [Late("test process", worst_s, time.monotonic())]

    def collect_stolen(self) -> float:
        """The largest share of the processors that was stolen since the last call."""
        with self._lock:
            return self._stolen.collect()

    def end(self) -> None:
        self._ended.set()
        self.join()


STARVED = "starved"
NOT_JUDGED = "not judged"
SHOWN_SOURCES, SHOWN_CHARACTERS = 3, 400


def pytest_configure(config: pytest.Config) -> None:
    config.addinivalue_line("markers", "real_time: flies real processes; runs once more if they were starved")
    config.pluginmanager.register(StarvedTests(config), "starved_tests")


class StarvedTests:
    """The starved tests of one pytest process: a plain session, an xdist worker or the xdist controller."""

    def __init__(self, config: pytest.Config) -> None:
        self._config = config
        self._is_worker = hasattr(config, "workerinput")
        self._own: OwnLateness | None = None
        self._reported: ReportedLateness | None = None
        self._late: list[Late] = []
        self._stolen: list[tuple[float, float]] = []  # share of the processors, and when it was collected
        self._fixture_began_s: dict[object, float] = {}  # of module and session fixtures, their last setup
        self._deferred: list[pytest.Item] = []
        self._again: set[pytest.Item] = set()
        self._first_failures: dict[str, Any] = {}  # by test id, in the order in which they were reported
        self._outcomes: dict[str, str] = {}  # of the second runs
        self._stolen_from: dict[str, str] = {}  # of those that were not judged: what was stolen

    # ---------------------------------------------------------------- running

    @pytest.hookimpl(wrapper=True)
    def pytest_fixture_setup(self, fixturedef: Any) -> Iterator[None]:
        if fixturedef.scope != "function" and fixturedef.baseid:
            self._fixture_began_s[fixturedef] = time.monotonic()
        return (yield)

    @pytest.hookimpl(tryfirst=True)
    def pytest_runtest_protocol(self, item: pytest.Item, nextitem: pytest.Item | None) -> bool | None:
        if item.get_closest_marker("real_time") is None:
            return None
        hook = item.ihook
        hook.pytest_runtest_logstart(nodeid=item.nodeid, location=item.location)
        self._measure()
        began_s = time.monotonic()
        reports = runtestprotocol(item, log=False, nextitem=nextitem)
        self._measure()
        failure = next((report for report in reports if report.failed), None)
        since_s = self._since_s(item, began_s)
        late = [late for late in self._late if late.collected_s >= since_s]
        stolen = max((share for share, collected_s in self._stolen if collected_s >= since_s), default=0.0)
        if failure and late and item not in self._again:
            self._deferred.append(item)
            reports = [_starved_report(failure, late)]
            item.user_properties.append((STARVED, _in_words(late)))  # goes into the reports of the second run
        elif failure and item in self._again and stolen >= STOLEN_SHARE:
            reports = [_not_judged_report(failure, stolen)]
        for report in reports:
            hook.pytest_runtest_logreport(report=report)
        hook.pytest_runtest_logfinish(nodeid=item.nodeid, location=item.location)
        return True

    @pytest.hookimpl(wrapper=True, tryfirst=True)
    def pytest_runtestloop(self, session: pytest.Session) -> Iterator[None]:
        if self._config.pluginmanager.hasplugin("dsession"):  # xdist's controller: its workers run the tests
            result = yield
        else:
            with _shared_lock(self._lock_file()) as wait_for_others:
                result = yield
                if self._deferred:
                    wait_for_others()
                    self._run_deferred(session)
        if self._own:
            self._own.end()
        if not self._is_worker:
            self._fail_what_did_not_run_again()
        return result

    def _run_deferred(self, session: pytest.Session) -> None:
        self._again.update(self._deferred)
        for item, following in zip_longest(self._deferred, self._deferred[1:]):
            for worker in self._config.pluginmanager.get_plugins():
                if hasattr(worker, "item_index"):  # xdist's, which reports results by it
                    worker.item_index = session.items.index(item)
            self._config.hook.pytest_runtest_protocol(item=item, nextitem=following)

    def _lock_file(self) -> Path:
        folder: Path = self._config._tmp_path_factory.getbasetemp()  # type: ignore[attr-defined]
        return (folder.parent if self._is_worker else folder) / "real_time_tests.lock"

    # ---------------------------------------------------------------- lateness

    def _measure(self) -> None:
        if self._own is None or self._reported is None:
            self._own = OwnLateness()
            self._own.start()
            self._reported = ReportedLateness(self._config._tmp_path_factory.getbasetemp())  # type: ignore[attr-defined]
        measured = self._reported.collect() + self._own.collect()
        self._late += [late for late in measured if late.late_s >= STARVED_S]
        self._stolen.append((self._own.collect_stolen(), time.monotonic()))

    def _since_s(self, item: pytest.Item, began_s: float) -> float:
        """When the test, or a fixture that it shares with others, began."""
        fixtures = [fixture for named in item._fixtureinfo.name2fixturedefs.values() for fixture in named]  # type: ignore[attr-defined]
        return min([began_s, *(self._fixture_began_s.get(fixture, began_s) for fixture in fixtures)])

    # ---------------------------------------------------------------- reporting

    @pytest.hookimpl(tryfirst=True)
    def pytest_report_teststatus(self, report: Any) -> tuple[str, str, tuple[str, dict[str, bool]]] | None:
        if report.outcome in (STARVED, NOT_JUDGED):
            return report.outcome, "S", (report.outcome.upper(), {"yellow": True})
        return None

    def pytest_runtest_logreport(self, report: Any) -> None:
        test = report.nodeid
        if report.outcome == STARVED:
            self._first_failures[test] = report
        elif test in self._first_failures and (report.when == "call" or not report.passed):
            self._outcomes[test] = "failed" if self._outcomes.get(test) == "failed" else report.outcome
        if report.outcome == NOT_JUDGED:
            self._stolen_from[test] = report.stolen

    def _fail_what_did_not_run_again(self) -> None:
        for test, first in self._first_failures.items():
            if test not in self._outcomes:
                text = f"starved ({first.starved}) and not run again: its process ended first"
                report = pytest.TestReport(test, first.location, {}, "failed", text, "call")
                self._config.hook.pytest_runtest_logreport(report=report)

    def pytest_terminal_summary(self, terminalreporter: Any) -> None:
        if self._is_worker or not self._first_failures:
            return
        terminalreporter.section("starved tests: failed while late, run once more after the others")
        for test, first in self._first_failures.items():
            outcome = self._outcomes.get(test, "not run again")
            terminalreporter.write_line(f"{outcome:<10} {test}")
            terminalreporter.write_line(f"         measured: {first.starved}")
            terminalreporter.write_line(f"         first failure: {first.first_failure}")
            if test in self._stolen_from:
                terminalreporter.write_line(f"         second run: {self._stolen_from[test]}")


def _starved_report(failure: pytest.TestReport, late: list[Late]) -> pytest.TestReport:
    """The report of a failed phase, as one that does not count. Its texts pass from an xdist worker to the controller."""
    failure.outcome = STARVED  # type: ignore[assignment]
    crash = getattr(failure.longrepr, "reprcrash", None)
    first_line = (crash.message if crash else str(failure.longrepr)).splitlines()[0]
    failure.first_failure = first_line[:SHOWN_CHARACTERS]  # type: ignore[attr-defined]
    failure.starved = _in_words(late)  # type: ignore[attr-defined]
    return failure


def _not_judged_report(failure: pytest.TestReport, stolen: float) -> pytest.TestReport:
    """The report of a second failure on a machine that cannot fly in real time."""
    failure.outcome = NOT_JUDGED  # type: ignore[assignment]
    stolen_words = f"the hypervisor gave {stolen:.0%} of the processors to others within {STOLEN_WITHIN_S:g} s"
    failure.stolen = stolen_words  # type: ignore[attr-defined]
    return failure


def _in_words(late: list[Late]) -> str:
    """The worst lateness of each source, the worst sources first."""
    worst = {each.source: each for each in sorted(late, key=lambda each: each.late_s)}
    shown = sorted(worst.values(), key=lambda each: -each.late_s)
    more = f" and {len(shown) - SHOWN_SOURCES} more" if len(shown) > SHOWN_SOURCES else ""
    return ", ".join(map(str, shown[:SHOWN_SOURCES])) + more


@contextmanager
def _shared_lock(file: Path) -> Iterator[Callable[[], None]]:
    """Held by every process while it runs its tests. The function yielded waits until no other process holds it.

    The kernel releases it when a process dies.
    """
    with file.open("w") as opened:
        fcntl.flock(opened, fcntl.LOCK_SH)

        def wait_for_others() -> None:
            fcntl.flock(opened, fcntl.LOCK_UN)  # two that wait for each other would wait for ever
            fcntl.flock(opened, fcntl.LOCK_EX)

        yield wait_for_others
