"""The end of a command by Ctrl-C, with a line, and by a closed pipe, without one.

`companion ... | head` ends as `yes | head` does.
"""

from __future__ import annotations

import os
import select
import sys
from collections.abc import Iterator
from contextlib import contextmanager

EXIT_INTERRUPTED = 130
EXIT_READER_GONE = 141  # as shells count: 128 and SIGPIPE's number
STDOUT, STDERR = 1, 2


@contextmanager
def ending_quietly() -> Iterator[None]:
    """Around a whole command. A broken pipe that is not standard output or error stays an error."""
    try:
        try:
            yield
        except KeyboardInterrupt:  # a command handles it itself; this one came before or after
            print("interrupted", file=sys.stderr)
            sys.exit(EXIT_INTERRUPTED)
        finally:
            sys.stdout.flush()  # here: at the exit of Python the error could not be caught
    except BrokenPipeError:
        closed = [number for number in (STDOUT, STDERR) if _reader_has_gone(number)]
        if not closed:
            raise
        for number in closed:
            os.dup2(os.open(os.devnull, os.O_WRONLY), number)  # for what is still buffered
        sys.exit(EXIT_READER_GONE)


def _reader_has_gone(number: int) -> bool:
    poll = select.poll()
    poll.register(number, 0)  # errors are always reported
    return any(events & select.POLLERR for _, events in poll.poll(0))
