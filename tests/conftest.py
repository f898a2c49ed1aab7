"""What every test needs: programs that can be interrupted, and linear algebra that does not fight for the cores."""

import os
import signal

# Read when numpy is first loaded. Tests work on small matrices, for which more threads only get into each other's way.
os.environ.setdefault("OMP_NUM_THREADS", "1")

# A shell that starts the tests in the background has them ignore SIGINT, and every program they start would ignore it, too.
signal.signal(signal.SIGINT, signal.default_int_handler)
