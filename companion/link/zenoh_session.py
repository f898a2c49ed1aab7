"""Opens the one Zenoh session of a process: peer mode, explicit endpoints, nothing found by multicast."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator, Sequence
from typing import Any

import zenoh

# A silent link is given up after this. The formation does not wait for it, it acts on the age of its data; shorter
# than the stalls of TCP on a lossy radio (about a second) a lease would only add reconnections to the loss.
LEASE_MS = 2000

SETTINGS: dict[str, Any] = {
    "mode": "peer",
    "scouting/multicast/enabled": False,
    "scouting/delay": 0,  # the default holds back the opening of a session for half a second
    "transport/shared_memory/enabled": False,  # a hardened systemd unit may not create it, and opening would then fail
    "transport/link/tx/lease": LEASE_MS,
    "transport/link/tx/keep_alive": 4,
    "transport/link/rx/max_message_size": 65536,  # the default is a gigabyte; the longest of ours are a few kilobytes
    "listen/timeout_ms": 0,
    "listen/exit_on_failure": True,
    "connect/timeout_ms": -1,  # a peer that is not there yet is tried for ever, in the background
    "connect/exit_on_failure": False,
    # With the defaults (1 s growing to 4 s) a vehicle that starts late was heard 3.7 s after its start.
    "connect/retry": {"period_init_ms": 100, "period_max_ms": 500, "period_increase_factor": 1.5},
}


class EndpointError(Exception):
    """A Zenoh endpoint that cannot be used. str() says what is wrong with it and what to do, without its name."""

    def __init__(self, kind: str, endpoint: str, problem: str) -> None:
        super().__init__(problem)
        self.kind = kind  # "listen" or "connect"
        self.endpoint = endpoint


def open_session(listen: Sequence[str], connect: Sequence[str]) -> zenoh.Session:
    """A session that listens and connects on exactly these endpoints. Close it on every path. Raises EndpointError."""
    for kind, endpoints in (("listen", listen), ("connect", connect)):
        for endpoint in endpoints:
            _check(kind, endpoint)
    zenoh.init_log_from_env_or("off")  # what goes wrong is said here, in one line
    config = zenoh.Config()
    for path, value in SETTINGS.items():
        config.insert_json5(path, json.dumps(value))
    config.insert_json5("listen/endpoints", json.dumps(list(listen)))
    config.insert_json5("connect/endpoints", json.dumps(list(connect)))
    try:
        return zenoh.open(config)
    except zenoh.ZError as error:
        raise _explain(str(error), listen, connect) from error


def drain(channel: Any, limit: int) -> Iterator[Any]:
    """What waits in a subscriber's or queryable's channel, without blocking; no more, however fast more comes."""
    for _ in range(limit):
        if (item := channel.try_recv()) is None:
            return
        yield item


def _check(kind: str, endpoint: str) -> None:
    """Refuse here what Zenoh would try for ever in silence."""
    address = re.fullmatch(r"[a-z]+/(?:\[[^\]]+\]|[^/:\s]+):(\d{1,5})(?:[?#].*)?", endpoint)
    if not address or not 0 < int(address[1]) <= 65535:
        raise EndpointError(kind, endpoint, "expected PROTOCOL/HOST:PORT, like tcp/192.168.1.11:7447")


def _explain(message: str, listen: Sequence[str], connect: Sequence[str]) -> EndpointError:
    """Zenoh names the address it failed at, and places in its own sources that help nobody here."""
    kind, endpoint = "listen", ", ".join(listen)
    for candidate_kind, candidates in (("connect", connect), ("listen", listen)):
        for candidate in candidates:
            if candidate.partition("/")[2].partition("?")[0].partition("#")[0] in message:
                kind, endpoint = candidate_kind, candidate
    if "Address already in use" in message:
        return EndpointError(kind, endpoint, "the port is in use; stop what listens there or choose another port")
    if "Cannot assign requested address" in message:
        return EndpointError(kind, endpoint, "this machine has no such address; use one of its own, or 0.0.0.0")
    unsupported = re.search(r"not supported for (\S+) protocol", message)
    if unsupported:
        for candidate_kind, candidates in (("listen", listen), ("connect", connect)):
            for candidate in candidates:
                if candidate.startswith(unsupported[1] + "/"):
                    kind, endpoint = candidate_kind, candidate
        return EndpointError(kind, endpoint, f'Zenoh knows no protocol "{unsupported[1]}"; use tcp, udp, tls or quic')
    reason = re.sub(r"\s+at /\S+", "", " ".join(message.split())).rstrip(".")
    return EndpointError(kind, endpoint, f"Zenoh cannot use it: {reason}")
