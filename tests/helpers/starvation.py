"""Pytest plugin: a real-time test that failed while its processes were starved runs once more after all the others.

A test marked `real_time` is starved if an agent, a stand-in or the test process measured a lateness of at least
`lateness.STARVED_S` while the test or one of its module or session fixtures ran. Its first failure is reported as STARVED,
which is no failure yet. After all other tests, of all xdist workers, it runs once more, alone, with new fixtures; that
outcome counts. A starved test that could not run again is a failure. Without measured starvation a failure counts at once.
A second failure while the hypervisor gave at least `lateness.STOLEN_SHARE` of the processors to other machines is NOT JUDGED:
such a machine cannot fly in real time, and the code has no part in it. It is reported with what was stolen, and is no failure.
"""

from __future__ import annotations

import fcntl
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from itertools import zip_longest
from pathlib import Path
from typing import Any

import pytest
from _pytest.runner import runtestprotocol

import lateness
from lateness import Late, OwnLateness, ReportedLateness

STARVED = "starved"
NOT_JUDGED = "not judged"
SHOWN_SOURCES = 3


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
        elif failure and item in self._again and stolen >= lateness.STOLEN_SHARE:
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
        self._late += [late for late in measured if late.late_s >= lateness.STARVED_S]
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
    failure.first_failure = (crash.message if crash else str(failure.longrepr)).splitlines()[0]  # type: ignore[attr-defined]
    failure.starved = _in_words(late)  # type: ignore[attr-defined]
    return failure


def _not_judged_report(failure: pytest.TestReport, stolen: float) -> pytest.TestReport:
    """The report of a second failure on a machine that cannot fly in real time."""
    failure.outcome = NOT_JUDGED  # type: ignore[assignment]
    stolen_words = f"the hypervisor gave {stolen:.0%} of the processors to others within {lateness.STOLEN_WITHIN_S:g} s"
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
