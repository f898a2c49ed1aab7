"""How a command ends that is not wanted any more: with a word on Ctrl-C, without one when its reader has seen enough.

`companion ... | head` then does as `yes | head` does.
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
    """Around a whole command. A pipe that broke elsewhere stays an error."""
    try:
        try:
            yield
        except KeyboardInterrupt:  # commands know what it means to them; this one came before or after
            print("interrupted", file=sys.stderr)
            sys.exit(EXIT_INTERRUPTED)
        finally:
            sys.stdout.flush()  # here, and not when Python exits: nobody could catch it there
    except BrokenPipeError:
        closed = [number for number in (STDOUT, STDERR) if _reader_has_gone(number)]
        if not closed:
            raise
        for number in closed:
            os.dup2(os.open(os.devnull, os.O_WRONLY), number)  # for what is still buffered
        sys.exit(EXIT_READER_GONE)


def _reader_has_gone(number: int) -> bool:
    poll = select.poll()
    poll.register(number, 0)  # an error is reported unasked
    return any(events & select.POLLERR for _, events in poll.poll(0))
