"""For every test: programs that can be interrupted, one thread for linear algebra, and the mark of real-time tests."""

import gc
import os
import signal
from pathlib import Path

import pytest
from hypothesis import settings
from xdist.remote import Producer
from xdist.scheduler import LoadScopeScheduling

pytest_plugins = ["pytester", "starvation", "fault_table", "drawn_figures"]

REAL_TIME = {"protocol", "fleet", "faults", "page"}  # folders beside this file

# Read when numpy is first loaded. Tests work on small matrices, for which more threads only get into each other's way.
os.environ.setdefault("OMP_NUM_THREADS", "1")

# The same examples in every run. On a machine with other load the time of one example shows nothing.
settings.register_profile("quick", deadline=None, derandomize=True, max_examples=30)
settings.register_profile("thorough", deadline=None, derandomize=True, max_examples=100)  # make test-long
settings.register_profile(
    "new", deadline=None, max_examples=500, print_blob=True
)  # make test-new-inputs: other ones each time
settings.load_profile("quick")

# A shell that starts the tests in the background has them ignore SIGINT, and every program they start would ignore it, too.
signal.signal(signal.SIGINT, signal.default_int_handler)


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    here = Path(__file__).parent
    for item in items:
        if item.path.relative_to(here).parts[0] in REAL_TIME:
            item.add_marker("real_time")
    _begin_with_the_longest(items)


def pytest_collection_finish() -> None:
    """As agents and stand-ins do before they fly.

    A full collection of all that pytest holds takes 70 ms. No packet passes a tap meanwhile, and all vehicles of a fleet send
    their last setpoints before a silence.
    """
    gc.collect()
    gc.freeze()


# Of the files with one or two vehicles. Begun last, it keeps one worker when the others have ended.
LONGEST = "test_logs.py"


def _begin_with_the_longest(items: list[pytest.Item]) -> None:
    """Among the files of its folder."""
    places = [index for index, item in enumerate(items) if item.path.parent.name == "protocol"]
    in_order = sorted((items[index] for index in places), key=lambda item: item.path.name != LONGEST)
    for index, item in zip(places, in_order, strict=True):
        items[index] = item


PAIRS = ("test_fly_external.py", "test_fly_stops.py", "test_return_home.py")  # their fleets have two vehicles


class OneFleetOneSequence(LoadScopeScheduling):
    """Scheduler for `--dist loadscope`: a worker takes a folder of fleets, or a file of one or two vehicles, at a time."""

    def _split_scope(self, nodeid: str) -> str:
        file = nodeid.partition("::")[0]
        folder, _, name = file.rpartition("/")
        return folder if folder.endswith(("fleet", "faults")) and name not in PAIRS else file


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_make_scheduler(config: pytest.Config, log: Producer) -> LoadScopeScheduling | None:
    return OneFleetOneSequence(config, log) if config.getvalue("dist") == "loadscope" else None
