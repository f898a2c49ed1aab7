"""Run a command that receives SIGTERM when its parent ends: `python -m sitl.flight.bound PARENT_PID COMMAND`.

A parent that is killed with SIGKILL cannot stop its children; on Linux the kernel then sends them SIGTERM. The setting
survives exec, so the command needs no change. On other systems the command is only run.
"""

from __future__ import annotations

import ctypes
import os
import signal
import sys

PR_SET_PDEATHSIG = 1  # linux/prctl.h


def main() -> None:
    """Replace this process by the command. Raises SystemExit."""
    parent_pid, command = int(sys.argv[1]), sys.argv[2:]
    if sys.platform == "linux":
        ctypes.CDLL(None, use_errno=True).prctl(PR_SET_PDEATHSIG, signal.SIGTERM, 0, 0, 0)
    if os.getppid() != parent_pid:  # it ended before prctl
        raise SystemExit(1)
    try:
        os.execvp(command[0], command)
    except OSError as error:
        raise SystemExit(f"{command[0]}: {error.strerror}") from error


if __name__ == "__main__":
    main()
