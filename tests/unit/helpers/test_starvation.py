"""The plugin that runs a starved real-time test once more: as a plain session and with xdist."""

from __future__ import annotations

import xml.etree.ElementTree as ElementTree
from pathlib import Path

import pytest

from common import ROOT

CONFTEST = """\
import starvation
import pytest

starvation.STARVED_S = {limit_s}
starvation.STOLEN_WITHIN_S = 0.05
starvation.STAT = __import__("pathlib").Path(__file__).parent / "stat"

def write(user, stolen):
    '''At once, as the kernel does: another thread reads it.'''
    new = starvation.STAT.with_suffix(".new")
    new.write_text(f"cpu  {{user}} 0 0 100 0 0 0 {{stolen}} 0 0\\n")
    new.rename(starvation.STAT)

write(100, 0)

@pytest.fixture
def stolen():
    user, stolen = [int(starvation.STAT.read_text().split()[i]) for i in (1, 8)]
    write(user + 100 - {stolen}, stolen + {stolen})
    yield
    __import__("time").sleep(0.2)

@pytest.fixture
def late(tmp_path):
    (tmp_path / "agent_1.log").write_text("vehicle 1: LOOP_LATE: 3 cycles of the loop started late, at most 20000 ms\\n")

@pytest.fixture
def runs(request):
    '''How often this test has run, this time included.'''
    file = request.config.rootpath / f"{{request.node.name}}.runs"
    count = int(file.read_text()) + 1 if file.exists() else 1
    file.write_text(str(count))
    return count
"""
WORKER = ["-p", "xdist", "-n", "1"]
plain_and_xdist = pytest.mark.parametrize("workers", [[], WORKER], ids=["plain", "xdist"])


def run(
    pytester: pytest.Pytester, code: str, *options: str, limit_s: float = 10.0, stolen: int = 40
) -> pytest.RunResult:
    pytester.makeconftest(CONFTEST.format(limit_s=limit_s, stolen=stolen))
    pytester.makepyfile(test_it=f"import pytest\npytestmark = pytest.mark.real_time\n{code}")
    helpers = str(ROOT / "tests" / "helpers")
    pytester.makeini(f"[pytest]\npythonpath = {helpers}\n")
    pytester.plugins = ["starvation"]
    return pytester.runpytest_subprocess("-v", "--junitxml=junit.xml", *options, timeout=200)


@pytest.fixture(autouse=True)
def found_by_subprocesses(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PYTHONPATH", str(ROOT / "tests" / "helpers"))
    monkeypatch.setenv("PYTEST_DISABLE_PLUGIN_AUTOLOAD", "1")  # each takes long to import


def cases(folder: Path) -> dict[str, ElementTree.Element]:
    return {case.attrib["name"]: case for case in ElementTree.parse(folder / "junit.xml").iter("testcase")}


@pytest.mark.parametrize(
    "workers", [[], WORKER, ["-p", "xdist", "-n", "2"]], ids=["plain", "one worker", "two workers"]
)
def test_a_starved_test_that_passes_when_run_again_is_no_failure(pytester: pytest.Pytester, workers: list[str]) -> None:
    result = run(
        pytester,
        """
def test_starved(late, runs):
    assert runs == 2, "the first run"

def test_other():
    pass
""",
        *workers,
    )
    assert result.ret == 0
    result.assert_outcomes(passed=2)
    result.stdout.fnmatch_lines(
        [
            "*STARVED*",
            "*test_starved*PASSED*" if not workers else "*PASSED*test_starved*",
            "*starved tests*",
            "passed     test_it.py::test_starved",
            "*measured: agent_1 20000 ms late",
            "*first failure: AssertionError: the first run",
        ]
    )
    assert {name: len(case.findall("failure")) for name, case in cases(pytester.path).items()} == {
        "test_starved": 0,
        "test_other": 0,
    }
    (noted,) = cases(pytester.path)["test_starved"].iter("property")
    assert noted.attrib == {"name": "starved", "value": "agent_1 20000 ms late"}


@plain_and_xdist
def test_a_starved_test_that_fails_again_is_a_failure(pytester: pytest.Pytester, workers: list[str]) -> None:
    result = run(pytester, "def test_starved(late, runs): assert runs == 3\ndef test_other(): pass\n", *workers)
    assert result.ret == 1
    result.assert_outcomes(passed=1, failed=1)
    result.stdout.fnmatch_lines(["failed     test_it.py::test_starved"])
    assert (pytester.path / "test_starved.runs").read_text() == "2"
    assert len(cases(pytester.path)["test_starved"].findall("failure")) == 1


@plain_and_xdist
def test_a_starved_test_that_fails_again_while_the_hypervisor_takes_the_processors_is_not_judged(
    pytester: pytest.Pytester, workers: list[str]
) -> None:
    result = run(pytester, "def test_starved(late, stolen, runs): assert runs == 3\ndef test_other(): pass\n", *workers)
    assert result.ret == 0
    result.assert_outcomes(passed=1)
    result.stdout.fnmatch_lines(
        [
            "*NOT JUDGED*",
            "not judged test_it.py::test_starved",
            "*second run: the hypervisor gave 40% of the processors to others within 0.05 s",
        ]
    )


def test_a_little_stolen_time_excuses_no_second_failure(pytester: pytest.Pytester) -> None:
    result = run(pytester, "def test_starved(late, stolen, runs): assert runs == 3\n", stolen=5)
    assert result.ret == 1
    result.assert_outcomes(failed=1)


def test_stolen_time_excuses_no_failure_of_a_test_that_was_in_time(pytester: pytest.Pytester) -> None:
    result = run(pytester, "def test_fails(stolen): assert False\n")
    assert result.ret == 1
    result.assert_outcomes(failed=1)


@plain_and_xdist
def test_a_failure_without_starvation_is_a_failure_at_once(pytester: pytest.Pytester, workers: list[str]) -> None:
    code = "def test_late_before(late): pass\ndef test_fails(runs): assert runs == 2\n"
    result = run(pytester, code, *workers)
    assert result.ret == 1
    result.assert_outcomes(passed=1, failed=1)
    result.stdout.no_fnmatch_line("*starved*")
    assert (pytester.path / "test_fails.runs").read_text() == "1"


@plain_and_xdist
def test_a_starved_module_fixture_is_set_up_again_and_once(pytester: pytest.Pytester, workers: list[str]) -> None:
    result = run(
        pytester,
        """
@pytest.fixture(scope="module")
def flight(tmp_path_factory, request):
    file = request.config.rootpath / "setups"
    count = len(file.read_text()) + 1 if file.exists() else 1
    file.write_text("x" * count)
    (tmp_path_factory.mktemp("flight") / "autopilot_2.log").write_text(
        "LOOP_LATE: 1 cycles of the loop started late, at most 11000 ms\\n" if count == 1 else "")
    if count == 1:
        raise RuntimeError("no formation")

def test_first(flight): pass
def test_second(flight): pass
""",
        *workers,
    )
    assert result.ret == 0
    result.assert_outcomes(passed=2)
    result.stdout.fnmatch_lines(
        ["passed     test_it.py::test_first", "*autopilot_2 11000 ms late", "passed     test_it.py::test_second"]
    )
    assert (pytester.path / "setups").read_text() == "xx"


def test_a_failed_check_of_a_starved_shared_flight_flies_it_again(pytester: pytest.Pytester) -> None:
    result = run(
        pytester,
        """
@pytest.fixture(scope="module")
def flight(tmp_path_factory, request):
    file = request.config.rootpath / "setups"
    count = len(file.read_text()) + 1 if file.exists() else 1
    file.write_text("x" * count)
    (tmp_path_factory.mktemp("flight") / "agent_2.log").write_text(
        "LOOP_LATE: 1 cycles of the loop started late, at most 11000 ms\\n" if count == 1 else "")
    return count

def test_holds(flight): pass
def test_bound(flight): assert flight == 2
""",
    )
    assert result.ret == 0
    result.assert_outcomes(passed=2)
    result.stdout.no_fnmatch_line("*   test_it.py::test_holds*")


def test_an_error_in_teardown_of_a_starved_test_counts_as_its_failure(pytester: pytest.Pytester) -> None:
    code = """
@pytest.fixture
def process(runs):
    yield
    assert runs == 2, "did not end"

def test_starved(late, process): pass
"""
    result = run(pytester, code)
    assert result.ret == 0
    result.assert_outcomes(passed=1)
    result.stdout.fnmatch_lines(["*first failure: AssertionError: did not end"])


def test_a_test_that_is_not_real_time_never_runs_again(pytester: pytest.Pytester) -> None:
    result = run(pytester, "pytestmark = []\ndef test_fails(late): assert False\n")
    assert result.ret == 1
    result.assert_outcomes(failed=1)


def test_a_starved_test_whose_worker_ends_before_the_second_run_is_a_failure(pytester: pytest.Pytester) -> None:
    code = """
import os

def test_starved(late, runs):
    assert runs == 2

def test_ends_its_process():
    os._exit(3)
"""
    result = run(pytester, code, *WORKER, "--max-worker-restart=0")
    assert result.ret != 0
    result.stdout.fnmatch_lines(["*not run again*"])


def test_a_stopped_test_process_is_starved(pytester: pytest.Pytester) -> None:
    code = """
import os, signal, subprocess, time

def test_starved(runs):
    if runs == 1:
        subprocess.Popen(["sh", "-c", f"sleep 0.6; kill -CONT {os.getpid()}"])
        os.kill(os.getpid(), signal.SIGSTOP)
        time.sleep(0.1)
    assert runs == 2
"""
    result = run(pytester, code, limit_s=0.3)
    assert result.ret == 0
    result.stdout.fnmatch_lines(["*measured: test process *"])
