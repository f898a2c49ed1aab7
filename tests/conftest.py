"""What every test needs: programs that can be interrupted."""

import signal

# A shell that starts the tests in the background has them ignore SIGINT, and every program they start would ignore it, too.
signal.signal(signal.SIGINT, signal.default_int_handler)
