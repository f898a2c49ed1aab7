"""The poses that a vehicle's Zenoh link hands to an event loop, which runs in a thread of its own."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Iterator
from contextlib import contextmanager
from threading import Event, Thread
from typing import Any

from companion.link.fleet.zenoh_link import ZenohLink
from companion.types.peers import BodyPose

UNIT = (1.0, 0.0, 0.0, 0.0)


class HeardPoses:
    """`poses` with the times of their arrival; what went wrong in the loop is in `errors`."""

    def __init__(self, loop: asyncio.AbstractEventLoop) -> None:
        self.loop, self.poses = loop, list[tuple[BodyPose, float]]()
        self.errors: list[dict[str, Any]] = []
        self.takes_s = 0.0  # each
        loop.set_exception_handler(lambda _loop, context: self.errors.append(context))

    def taken(self) -> list[BodyPose]:
        """Those since the last call."""
        return [self.poses.pop(0)[0] for _ in range(len(self.poses))]

    def settle(self) -> None:
        """Until the loop has run what waited."""
        for _ in range(3):
            asyncio.run_coroutine_threadsafe(asyncio.sleep(0), self.loop).result()

    def take(self, pose: BodyPose, received_s: float) -> None:
        self.poses.append((pose, received_s))
        if self.takes_s:
            time.sleep(self.takes_s)

    @contextmanager
    def blocked(self) -> Iterator[None]:
        """The loop does nothing else meanwhile."""
        begun, ends = Event(), Event()
        self.loop.call_soon_threadsafe(lambda: (begun.set(), ends.wait()))
        begun.wait()
        try:
            yield
        finally:
            ends.set()
            self.settle()


@contextmanager
def hearing_poses(link: ZenohLink) -> Iterator[HeardPoses]:
    loop = asyncio.new_event_loop()
    heard, thread = HeardPoses(loop), Thread(target=loop.run_forever)

    async def hear() -> None:
        link.hear_poses(heard.take)

    thread.start()
    try:
        asyncio.run_coroutine_threadsafe(hear(), loop).result()
        yield heard
    finally:
        loop.call_soon_threadsafe(loop.stop)
        thread.join()
        loop.close()
