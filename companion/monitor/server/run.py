"""`companion monitor`: starts the server of the live page, prints its URL and serves until Ctrl-C."""

from __future__ import annotations

import asyncio
import contextlib
import errno
import logging
import re
import secrets
import signal
import socket
import sys
from collections.abc import Coroutine
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from aiohttp import web
from aiohttp.http_exceptions import HttpProcessingError

from companion.monitor.control.commander import Commander
from companion.monitor.error import MonitorError
from companion.monitor.server.access import is_loopback
from companion.monitor.server.site import Site
from companion.monitor.station import Station

TOKEN_BYTES = 24
CLOSE_WITHIN_S = 0.5
LISTEN = re.compile(r"(?:(\[[0-9A-Fa-f:.]+\]|[A-Za-z0-9._-]+):)?(\d{1,5})")
LISTEN_WORDS = "ADDRESS:PORT, like 127.0.0.1:8600; port 0 chooses a free one"
_log = logging.getLogger(__name__)
_log.addFilter(lambda record: not (record.exc_info and isinstance(record.exc_info[1], HttpProcessingError)))
"""For aiohttp. Who sends what is no HTTP gets the reason as an answer; the operator's terminal needs none of it."""


@dataclass(frozen=True, slots=True)
class Address:
    host: str
    port: int

    def __str__(self) -> str:
        return f"{self.host}:{self.port}"


def listen_address(text: str) -> Address:
    """Raises ValueError with what was expected."""
    found = LISTEN.fullmatch(text)
    if not found or int(found[2]) > 65535:
        raise ValueError(f"{text!r}: expected {LISTEN_WORDS}")
    return Address(found[1] or "127.0.0.1", int(found[2]))


def serve(station: Station, commander: Commander | None, address: Address, tiles: Path | None = None) -> None:
    """Until Ctrl-C or SIGTERM. Raises MonitorError."""
    asyncio.run(_serve(station, commander, address, tiles))


async def _serve(station: Station, commander: Commander | None, address: Address, tiles: Path | None) -> None:
    token = secrets.token_urlsafe(TOKEN_BYTES) if commander else ""
    site = Site(station, commander, token, tiles)
    listening = _listening(address)
    runner = web.AppRunner(
        site.app(address.host), handle_signals=False, access_log=None, logger=_log, shutdown_timeout=CLOSE_WITHIN_S
    )
    await runner.setup()
    accepting = await site.connections.accept(runner, listening)
    try:
        port = listening.getsockname()[1]
        print(f"{url(address.host, port)}{'#token=' + token if token else ''}", flush=True)
        for line in warnings(address.host, commander is not None):
            print(line, file=sys.stderr, flush=True)
        await _until_stopped(station.run())
    finally:
        accepting.close()
        await site.clients.close()
        await runner.cleanup()


async def _until_stopped(job: Coroutine[Any, Any, None]) -> None:
    """Run the job until SIGINT or SIGTERM. An error in it is raised."""
    stop, loop = asyncio.Event(), asyncio.get_running_loop()
    for number in (signal.SIGINT, signal.SIGTERM):
        loop.add_signal_handler(number, stop.set)
    running, waiting = asyncio.create_task(job), asyncio.create_task(stop.wait())
    await asyncio.wait([running, waiting], return_when=asyncio.FIRST_COMPLETED)
    for task in (running, waiting):
        task.cancel()
    with contextlib.suppress(asyncio.CancelledError):
        await running


def _listening(address: Address) -> socket.socket:
    """A bound socket. Raises MonitorError."""
    host = address.host.strip("[]")
    try:
        family, kind, protocol, _, where = socket.getaddrinfo(host, address.port, type=socket.SOCK_STREAM)[0]
        listening = socket.socket(family, kind, protocol)
        try:
            listening.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            listening.bind(where)
        except OSError:
            listening.close()
            raise
    except OSError as error:
        raise MonitorError(f"--listen {address}: {_reason(error)}") from error
    return listening


def _reason(error: OSError) -> str:
    if isinstance(error, socket.gaierror):
        return "unknown host; expected an address of this machine, like 127.0.0.1"
    match error.errno:
        case errno.EADDRINUSE:
            return "the port is in use; choose another one, or port 0 for any free one"
        case errno.EADDRNOTAVAIL:
            return "this machine has no such address; expected one of its own, like 127.0.0.1, or 0.0.0.0 for all"
        case errno.EACCES:
            return "not permitted; choose a port above 1023"
    return error.strerror or str(error)


def url(host: str, port: int) -> str:
    """For a browser on this machine; of 0.0.0.0 and :: by its name in the network."""
    shown = socket.gethostname() if host in ("0.0.0.0", "[::]") else host
    return f"http://{shown}:{port}/"


def warnings(host: str, may_control: bool) -> list[str]:
    """One line where others reach the server."""
    if is_loopback(host):
        return []
    what = (
        "see this fleet, and command it with the token, which they can read on the way"
        if may_control
        else "see this fleet"
    )
    return [f"warning: all who reach {host} over the network can {what} (HTTP without encryption)"]
