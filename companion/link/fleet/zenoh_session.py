"""The Zenoh session of a process: peer mode, explicit endpoints, no multicast scouting; with identities its access control.

A rule of the access control names the common name of a certificate, so a key always comes from the participant that it belongs
to. Whatever no rule permits is denied: queries, liveliness tokens, and names that are not admitted.
"""

from __future__ import annotations

import json
import logging
import os
import re
from collections.abc import Callable, Iterable, Sequence
from typing import TYPE_CHECKING, Any, TypeVar

import zenoh

from companion.link.fleet.sockets import (
    MOST_CONNECTIONS,
    allow_connections,
    hold_silent_connections,
    keep_from_lingering,
)
from companion.security.names import ParticipantName, ParticipantRole, parse_common_name
from companion.types.errors import UnusableError
from companion.wire.keys import (
    ANY,
    abort_key,
    admission_key,
    check_key,
    command_key,
    distant_key,
    pairing_key,
    peer_key,
    pose_key,
    reply_key,
    status_key,
    target_key,
    traffic_key,
)

if TYPE_CHECKING:
    from companion.security.identity import Identity


_log = logging.getLogger(__name__)
Taken = TypeVar("Taken")

# A silent link is closed after this time. The formation does not depend on it, as it uses the age of the data. A lease below
# the stalls of TCP on a lossy radio (about a second) would only add reconnections to the loss.
LEASE_MS = 2000
HANDSHAKE_MS = 2000
# A TLS handshake that is begun and never goes on costs 12 kB and a file. When Zenoh gives it up, after 10 s by default, it
# accepts no connection for 0.1 s: 600 such handshakes kept a restarted agent out for 13 s. So none is given up in a flight.
TLS_HANDSHAKE_MS = 3_600_000
# Size of a connection's buffers; a longer message is sent in parts. The default of 64 kB takes 0.3 MB more for every peer. Two
# of these hold the packets of 2 s. A stall of less does not fill them, and a longer one ends the connection anyway (LEASE_MS).
BATCH_BYTES = 16384
# Threads of Zenoh in this process. By default every message wakes the thread that opened its connection, which wakes one of
# two threads that receive, which wakes the other.
THREADS = "(rx: (worker_threads: 1), acc: (handover: rx), net: (handover: rx))"

ENDPOINT = re.compile(r"[a-z]+/(?:\[[^\]]+\]|[^/:\s]+):(\d{1,5})(?:[?#].*)?")
PROTECTED, PROTECTED_WORDS = ("tls", "quic"), "tls/HOST:PORT or quic/HOST:PORT"

SETTINGS: dict[str, Any] = {
    "mode": "peer",
    "scouting/multicast/enabled": False,
    "scouting/gossip/enabled": False,  # sessions to configured endpoints only: nothing connects two fleets
    "scouting/delay": 0,  # the default delays the opening of a session by half a second
    "transport/shared_memory/enabled": False,  # a hardened systemd unit may not create it; opening would fail
    "transport/link/tx/lease": LEASE_MS,
    "transport/link/tx/keep_alive": 4,
    # Changes of subscriptions are never dropped. With the default of 5 s each waits in a tick for a participant that reads
    # nothing, once two batches of them do; now that connection is closed.
    "transport/link/tx/queue/congestion_control/block/wait_before_close": 1000,  # us
    "transport/link/tx/batch_size": BATCH_BYTES,
    "transport/link/rx/buffer_size": BATCH_BYTES,
    "transport/link/rx/max_message_size": 65536,  # the default is a gigabyte; the longest messages are a few kilobytes
    # The default waits 10 s for an answer that a lossy link or a partition took.
    "transport/unicast/open_timeout": HANDSHAKE_MS,
    "transport/unicast/accept_timeout": HANDSHAKE_MS,
    # Strangers whose connections have said something wait among these, too, until HANDSHAKE_MS has passed. The default of 100
    # refused participants meanwhile.
    "transport/unicast/accept_pending": MOST_CONNECTIONS,
    "listen/timeout_ms": 0,
    "listen/exit_on_failure": True,
    "connect/timeout_ms": -1,  # a peer that is not running yet is retried without end, in the background
    "connect/exit_on_failure": False,
    # With the defaults (1 s growing to 4 s) a vehicle that started late was connected 3.7 s after its start.
    "connect/retry": {"period_init_ms": 100, "period_max_ms": 500, "period_increase_factor": 1.5},
}


class EndpointError(UnusableError):
    """A Zenoh endpoint that cannot be used. `str()` is the reason and the remedy, without the endpoint."""

    def __init__(self, kind: str, endpoint: str, problem: str) -> None:
        super().__init__(problem)
        self.kind = kind  # "listen" or "connect"
        self.endpoint = endpoint

    def line(self, command: str) -> str:
        return f'{command}: --{self.kind} "{self.endpoint}": {self}'


def open_session(listen: Sequence[str], connect: Sequence[str], identity: Identity | None = None) -> zenoh.Session:
    """A session on these endpoints. Close it on every path. Raises EndpointError.

    With an identity only over TLS or QUIC, with the participants that its fleet has admitted.
    """
    for kind, endpoints in (("listen", listen), ("connect", connect)):
        check_endpoints(kind, endpoints)
        _check_protection(kind, endpoints, identity)
    os.environ.setdefault("ZENOH_RUNTIME", THREADS)  # there is no other way; Zenoh reads it at the first session
    zenoh.init_log_from_env_or("off")  # errors are reported here, in one line
    keep_from_lingering()
    config = zenoh.Config()
    for path, value in {**SETTINGS, **(_security_settings(identity) if identity else {})}.items():
        config.insert_json5(path, json.dumps(value))
    config.insert_json5("listen/endpoints", json.dumps([_patient(endpoint) for endpoint in listen]))
    config.insert_json5("connect/endpoints", json.dumps(list(connect)))
    try:
        session = zenoh.open(config)
    except zenoh.ZError as error:
        raise _explain(str(error), listen, connect) from error
    if listen:
        hold_silent_connections([int(address[1]) for one in listen if (address := ENDPOINT.fullmatch(one))])
        allow_connections()
    return session


def _patient(listen: str) -> str:
    """The endpoint with TLS_HANDSHAKE_MS, for which Zenoh has no other place."""
    if not listen.startswith("tls/"):
        return listen
    return f"{listen}{';' if '#' in listen else '#'}tls_handshake_timeout_ms={TLS_HANDSHAKE_MS}"


def _security_settings(identity: Identity) -> dict[str, Any]:
    """Zenoh's settings for mutual TLS, over TCP or QUIC, and its access control."""
    key, certificate = str(identity.key_file), str(identity.certificate_file)
    return {
        "transport/link/tls": {
            "root_ca_certificate": str(identity.authority_file),
            "listen_private_key": key,
            "listen_certificate": certificate,
            "connect_private_key": key,
            "connect_certificate": certificate,
            "enable_mtls": True,
            # Endpoints are addresses; a certificate names a participant. The access control compares its common name.
            "verify_name_on_connect": False,
            "close_link_on_expiration": True,
        },
        "access_control": access_control(
            parse_common_name(identity.common_name),
            identity.fleet,
            [parse_common_name(one.name) for one in identity.admitted.participants],
        ),
    }


def _check_protection(kind: str, endpoints: Sequence[str], identity: Identity | None) -> None:
    for endpoint in endpoints:
        protected = endpoint.partition("/")[0] in PROTECTED
        if identity and not protected:
            raise EndpointError(kind, endpoint, f"not protected; with an identity expected {PROTECTED_WORDS}")
        if protected and not identity:
            raise EndpointError(
                kind, endpoint, "needs an identity; companion provision --help explains how to make one"
            )


def publisher(session: zenoh.Session, key: str, priority: zenoh.Priority, express: bool = True) -> zenoh.Publisher:
    """What it publishes is dropped where the network is congested. `express`: sent at once, not together with what follows."""
    drop = zenoh.CongestionControl.DROP
    return session.declare_publisher(key, congestion_control=drop, priority=priority, express=express)


def subscriber(session: zenoh.Session, key: str, kept: int, **options: Any) -> Any:
    """Its channel keeps so many messages, the newest, until they are drained."""
    return session.declare_subscriber(key, zenoh.handlers.RingChannel(kept), **options)


def drain(channel: Any, limit: int) -> list[Any]:
    """At most `limit` items waiting in the channel of a subscriber. Never blocks."""
    items: list[Any] = []
    while len(items) < limit and (item := channel.try_recv()) is not None:
        items.append(item)
    return items


def each(items: Iterable[Any], take: Callable[[Any], Taken | None], refuse: Callable[[], None]) -> list[Taken]:
    """What `take` makes of the items, without None. One on which it fails is refused: no message ends its receiver."""
    taken: list[Taken] = []
    for item in items:
        try:
            one = take(item)
        except Exception as error:  # noqa: BLE001 -- a defect in a decoder costs the message and not the vehicle
            _log.error("a received message is not used: %s: %.200s", type(error).__name__, error)
            refuse()
            continue
        if one is not None:
            taken.append(one)
    return taken


def check_endpoints(kind: str, endpoints: Sequence[str]) -> None:
    """Refuses endpoints that Zenoh would retry without end and without a message. Raises EndpointError."""
    for endpoint in endpoints:
        address = ENDPOINT.fullmatch(endpoint)
        if not address or not 0 < int(address[1]) <= 65535:
            raise EndpointError(kind, endpoint, "expected PROTOCOL/HOST:PORT, like tcp/192.168.1.11:7447")


def _explain(message: str, listen: Sequence[str], connect: Sequence[str]) -> EndpointError:
    """The error for a message of Zenoh: the endpoint it names, without locations in Zenoh's sources."""
    endpoints = [*(("connect", one) for one in connect), *(("listen", one) for one in listen)]

    def error_of(text: str, is_named: Callable[[str], bool]) -> EndpointError:
        """About the last endpoint that is named; about all where Zenoh listens if none is."""
        named = [(kind, one) for kind, one in endpoints if is_named(one)]
        return EndpointError(*(named[-1] if named else ("listen", ", ".join(listen))), text)

    def has_address(endpoint: str) -> bool:
        return re.split("[?#]", endpoint.partition("/")[2])[0] in message

    if "Address already in use" in message:
        return error_of("the port is in use; stop what listens there or choose another port", has_address)
    if "Cannot assign requested address" in message:
        return error_of("this machine has no such address; use one of its own, or 0.0.0.0", has_address)
    if unsupported := re.search(r"not supported for (\S+) protocol", message):
        text = f'unknown protocol "{unsupported[1]}"; use tcp, udp, tls or quic'
        return error_of(text, lambda endpoint: endpoint.startswith(f"{unsupported[1]}/"))
    reason = re.sub(r"\s+at /\S+", "", " ".join(message.split())).rstrip(".")
    return error_of(f"Zenoh cannot use it: {reason}", has_address)


Keys = tuple[str, ...]
PUT, SUBSCRIBE = "put", "declare_subscriber"
READERS = frozenset({ParticipantRole.GROUND, ParticipantRole.MONITOR})
NOTHING: tuple[Keys, Keys] = ((), ())


def access_control(own: ParticipantName, fleet: str, admitted: Iterable[ParticipantName]) -> dict[str, Any]:
    """The value of Zenoh's `access_control` for `own`, with one subject for each other participant that it deals with."""
    rules: list[dict[str, Any]] = []
    subjects: list[dict[str, Any]] = []
    policies: list[dict[str, Any]] = []
    for other in admitted:
        if other == own:
            continue
        # A sample flows against the direction of the subscription that asks for it.
        received, wanted = keys_between(other, own, fleet)
        sent, asked = keys_between(own, other, fleet)
        made = [
            _rule(f"{other}: {name}", message, flow, keys)
            for name, message, flow, keys in (
                ("received", PUT, "ingress", received),
                ("wanted", SUBSCRIBE, "egress", wanted),
                ("sent", PUT, "egress", sent),
                ("asked for", SUBSCRIBE, "ingress", asked),
            )
            if keys
        ]
        if made:
            rules += made
            subjects.append({"id": str(other), "cert_common_names": [str(other)]})
            policies.append({"rules": [rule["id"] for rule in made], "subjects": [str(other)]})
    return {"enabled": True, "default_permission": "deny", "rules": rules, "subjects": subjects, "policies": policies}


def keys_between(sender: ParticipantName, receiver: ParticipantName, fleet: str) -> tuple[Keys, Keys]:
    """Keys that the sender publishes to the receiver, and the key expressions with which the receiver subscribes to them."""
    if sender.role is ParticipantRole.VEHICLE:
        i = int(sender.id)
        if receiver.role is ParticipantRole.VEHICLE:
            to = int(receiver.id)
            states = (peer_key(fleet, i), distant_key(fleet, i))
            return (*states, pairing_key(fleet, i, to)), (*states, pairing_key(fleet, ANY, to))
        if receiver.role in READERS:
            keys = (peer_key(fleet, i), status_key(fleet, i), reply_key(fleet, i))
            return keys, (peer_key(fleet, ANY), status_key(fleet, ANY), reply_key(fleet, ANY))
    elif receiver.role is ParticipantRole.VEHICLE:
        i = int(receiver.id)
        if sender.role is ParticipantRole.GROUND:
            return _of_ground(fleet, i, str(sender)), _of_ground(fleet, i, ANY)
        if sender.role is ParticipantRole.TARGET:
            return (target_key(fleet, sender.id),), (target_key(fleet, ANY),)
        if sender.role is ParticipantRole.TRAFFIC:
            return (traffic_key(fleet, sender.id, ANY),), (traffic_key(fleet, ANY, ANY),)
        if sender.role is ParticipantRole.MOCAP:
            return (pose_key(fleet, sender.id, i),), (pose_key(fleet, ANY, i),)
    return NOTHING


def _of_ground(fleet: str, vehicle_id: int, name: str) -> Keys:
    """What a ground of this name publishes to a vehicle."""
    keys = (
        command_key(fleet, vehicle_id, name),
        check_key(fleet, vehicle_id, name),
        abort_key(fleet, vehicle_id, name),
    )
    return *keys, admission_key(fleet, name)


def _rule(name: str, message: str, flow: str, keys: Keys) -> dict[str, Any]:
    return {"id": name, "permission": "allow", "flows": [flow], "messages": [message], "key_exprs": list(keys)}
