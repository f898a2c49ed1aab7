"""The Zenoh session of a process: peer mode, explicit endpoints, no multicast scouting."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator, Mapping, Sequence
from types import MappingProxyType
from typing import Any

import zenoh

# A silent link is closed after this time. The formation does not depend on it, as it uses the age of the data. A lease below
# the stalls of TCP on a lossy radio (about a second) would only add reconnections to the loss.
LEASE_MS = 2000
HANDSHAKE_MS = 2000

SETTINGS: dict[str, Any] = {
    "mode": "peer",
    "scouting/multicast/enabled": False,
    "scouting/delay": 0,  # the default delays the opening of a session by half a second
    "transport/shared_memory/enabled": False,  # a hardened systemd unit may not create it; opening would fail
    "transport/link/tx/lease": LEASE_MS,
    "transport/link/tx/keep_alive": 4,
    "transport/link/rx/max_message_size": 65536,  # the default is a gigabyte; the longest messages are a few kilobytes
    # The default waits 10 s for an answer that a lossy link or a partition took.
    "transport/unicast/open_timeout": HANDSHAKE_MS,
    "transport/unicast/accept_timeout": HANDSHAKE_MS,
    "listen/timeout_ms": 0,
    "listen/exit_on_failure": True,
    "connect/timeout_ms": -1,  # a peer that is not running yet is retried without end, in the background
    "connect/exit_on_failure": False,
    # With the defaults (1 s growing to 4 s) a vehicle that started late was connected 3.7 s after its start.
    "connect/retry": {"period_init_ms": 100, "period_max_ms": 500, "period_increase_factor": 1.5},
}

# An agent connects to the endpoints of its vehicle file only. The ground also finds those that these vehicles tell of.
CONFIGURED_PEERS_ONLY: dict[str, Any] = {"scouting/gossip/autoconnect": {"router": [], "peer": []}}


class EndpointError(Exception):
    """A Zenoh endpoint that cannot be used. `str()` is the reason and the remedy, without the endpoint."""

    def __init__(self, kind: str, endpoint: str, problem: str) -> None:
        super().__init__(problem)
        self.kind = kind  # "listen" or "connect"
        self.endpoint = endpoint


def open_session(
    listen: Sequence[str], connect: Sequence[str], settings: Mapping[str, Any] = MappingProxyType({})
) -> zenoh.Session:
    """A session on these endpoints, with `settings` beside SETTINGS. Close it on every path. Raises EndpointError."""
    for kind, endpoints in (("listen", listen), ("connect", connect)):
        check_endpoints(kind, endpoints)
    zenoh.init_log_from_env_or("off")  # errors are reported here, in one line
    config = zenoh.Config()
    for path, value in {**SETTINGS, **settings}.items():
        config.insert_json5(path, json.dumps(value))
    config.insert_json5("listen/endpoints", json.dumps(list(listen)))
    config.insert_json5("connect/endpoints", json.dumps(list(connect)))
    try:
        return zenoh.open(config)
    except zenoh.ZError as error:
        raise _explain(str(error), listen, connect) from error


def drain(channel: Any, limit: int) -> Iterator[Any]:
    """At most `limit` items waiting in the channel of a subscriber. Never blocks."""
    for _ in range(limit):
        if (item := channel.try_recv()) is None:
            return
        yield item


def check_endpoints(kind: str, endpoints: Sequence[str]) -> None:
    """Refuses endpoints that Zenoh would retry without end and without a message. Raises EndpointError."""
    for endpoint in endpoints:
        _check(kind, endpoint)


def _check(kind: str, endpoint: str) -> None:
    address = re.fullmatch(r"[a-z]+/(?:\[[^\]]+\]|[^/:\s]+):(\d{1,5})(?:[?#].*)?", endpoint)
    if not address or not 0 < int(address[1]) <= 65535:
        raise EndpointError(kind, endpoint, "expected PROTOCOL/HOST:PORT, like tcp/192.168.1.11:7447")


def _explain(message: str, listen: Sequence[str], connect: Sequence[str]) -> EndpointError:
    """The error for a message of Zenoh: the endpoint it names, without locations in Zenoh's sources."""
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
        return EndpointError(kind, endpoint, f'unknown protocol "{unsupported[1]}"; use tcp, udp, tls or quic')
    reason = re.sub(r"\s+at /\S+", "", " ".join(message.split())).rstrip(".")
    return EndpointError(kind, endpoint, f"Zenoh cannot use it: {reason}")
