"""What every test needs: programs that can be interrupted, and linear algebra that does not fight for the cores."""

import os
import signal

import pytest

# Read when numpy is first loaded. Tests work on small matrices, for which more threads only get into each other's way.
os.environ.setdefault("OMP_NUM_THREADS", "1")

# A shell that starts the tests in the background has them ignore SIGINT, and every program they start would ignore it, too.
signal.signal(signal.SIGINT, signal.default_int_handler)

# Processes fly in real time, and mostly wait: whole fleets and single vehicles share the cores. Each of the two has one turn at
# a time, so that no test takes another's ports.
TURNS = {"protocol": "vehicles", "fleet": "fleets", "faults": "fleets"}


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    for item in items:
        if turn := TURNS.get(item.path.parent.name):
            item.add_marker(pytest.mark.xdist_group(turn))
