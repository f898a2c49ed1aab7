"""Which Zenoh endpoints cannot be reached, and why: shown where vehicles do not report."""

from __future__ import annotations

import re
import socket
from collections.abc import Collection, Sequence
from concurrent.futures import ThreadPoolExecutor

CONNECT_WITHIN_S = 1.0
OVER_TCP = ("tcp", "tls")


def unreachable(endpoints: Sequence[str], linked: Collection[str]) -> dict[str, str]:
    """The reason by endpoint; `linked` has the remote addresses of the session's links.

    An endpoint over TCP is tried with a connection of its own; any other is unreachable where it has no link.
    """
    with ThreadPoolExecutor(max_workers=16) as workers:
        reasons = workers.map(lambda endpoint: "" if endpoint in linked else _reason(endpoint), endpoints)
        return {endpoint: reason for endpoint, reason in zip(endpoints, reasons, strict=True) if reason}


def _reason(endpoint: str) -> str:
    """ "" where the endpoint answers."""
    protocol, _, address = endpoint.partition("/")
    host, port = _host_and_port(address)
    try:
        if protocol in OVER_TCP:
            socket.create_connection((host, port), CONNECT_WITHIN_S).close()
            return ""
        addresses = socket.getaddrinfo(host, port, type=socket.SOCK_DGRAM)
    except TimeoutError:
        return f"no answer within {CONNECT_WITHIN_S:g} s; check the address and the network"
    except ConnectionRefusedError:
        return "connection refused; no agent listens there"
    except socket.gaierror:
        return f"unknown host {host}"
    except OSError as error:
        return error.strerror or str(error)
    return f"no link over {protocol} to {addresses[0][4][0]}; check that an agent listens there"


def _host_and_port(address: str) -> tuple[str, int]:
    """Of "HOST:PORT" or "[HOST]:PORT", with Zenoh's metadata behind it."""
    host, _, port = re.split("[?#]", address)[0].rpartition(":")
    return host.strip("[]"), int(port)
