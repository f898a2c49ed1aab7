"""`python -m sitl.bound PARENT_PID COMMAND ...`: run a command that is told to end when its parent is gone.

A parent that is killed with SIGKILL cannot stop its children; on Linux the kernel then sends them SIGTERM. What is set
here lasts through exec, so the command needs to know nothing of it. Elsewhere the command is only run.
"""

from __future__ import annotations

import ctypes
import os
import signal
import sys

PR_SET_PDEATHSIG = 1  # linux/prctl.h


def main() -> None:
    """Become the command. Returns never, or raises SystemExit."""
    parent_pid, command = int(sys.argv[1]), sys.argv[2:]
    if sys.platform == "linux":
        ctypes.CDLL(None, use_errno=True).prctl(PR_SET_PDEATHSIG, signal.SIGTERM, 0, 0, 0)
    if os.getppid() != parent_pid:  # it went before the kernel knew that we care
        raise SystemExit(1)
    try:
        os.execvp(command[0], command)
    except OSError as error:
        raise SystemExit(f"{command[0]}: {error.strerror}") from error


if __name__ == "__main__":
    main()
