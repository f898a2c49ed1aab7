"""Common parts of all links to the autopilot: the callback for bytes, and errors of endpoints that cannot be opened."""

from __future__ import annotations

import errno
from collections.abc import Callable

Received = Callable[[bytes, float], bool]  # (bytes, time of arrival) -> whether they are from the autopilot
AllRead = Callable[[], None]  # after `Received` was called for all that waited, up to a limit

_IN_USE = "{what} is in use; stop the other program (an agent or ground station?) or choose another one"
_ADVICE = {
    errno.EADDRINUSE: _IN_USE,
    errno.EBUSY: _IN_USE,
    errno.EAGAIN: _IN_USE,  # the lock on a serial device
    errno.EADDRNOTAVAIL: "this machine has no such address; use one of its own, or 0.0.0.0 for all of them",
    errno.EACCES: "no permission for {what}; use a port above 1023, or join the device's group (usually dialout)",
    errno.EPERM: "no permission for {what}; join the device's group (usually dialout)",
    errno.ENOENT: "there is no {what}; is it plugged in? expected a device like /dev/ttyACM0, see /dev/serial/by-id",
    errno.ECONNREFUSED: "no program listens at {what}; is the autopilot running?",
    errno.ENOTTY: "{what} is not a serial device; expected one like /dev/ttyACM0, see /dev/serial/by-id",
}


class LinkError(Exception):
    """An endpoint that cannot be opened. `str()` is the reason and the remedy."""


def encoded_host(host: str) -> bytes:
    """The host as `socket` passes it to the operating system. Raises LinkError where no lookup takes it.

    Only a name that is not ASCII needs Python's codec for names, and `socket` itself would load it: half an MB of an agent.
    """
    if "\0" in host:
        raise LinkError("there is a zero byte in the host, expected one like 192.168.1.11")
    try:
        return _ascii_host(host) if host.isascii() else host.encode("idna")
    except ValueError as error:
        raise LinkError("the host is neither an address nor a name, expected one like 192.168.1.11") from error


def _ascii_host(host: str) -> bytes:
    """As the codec for names would encode it. Raises ValueError."""
    labels = host.removesuffix(".").split(".")
    if host and not all(0 < len(label) < 64 for label in labels):
        raise ValueError("label empty or too long")
    return host.encode()


def explain(error: OSError, what: str) -> str:
    """Message for an operating system's error about `what`, with the remedy."""
    advice = _ADVICE.get(error.errno or 0)
    return advice.format(what=what) if advice else f"{what} cannot be opened: {error.strerror or error}"
