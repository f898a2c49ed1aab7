"""Zenoh's access control of one participant: what each other one may send to it and receive from it.

A rule names the common name of a certificate, so a key always comes from the participant that it belongs to. Whatever no rule
permits is denied: queries, liveliness tokens, and names that are not admitted.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

from companion.security.names import ParticipantName, ParticipantRole
from companion.wire.keys import (
    abort_key,
    admission_key,
    command_key,
    distant_key,
    every_abort,
    every_admission,
    every_command,
    every_pairing,
    every_peer,
    every_reply,
    every_status,
    every_target,
    every_traffic,
    pairing_key,
    peer_key,
    reply_key,
    status_key,
    target_key,
    traffic_key,
)

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
        received, wanted = published(other, own, fleet)
        sent, asked = published(own, other, fleet)
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


def published(sender: ParticipantName, receiver: ParticipantName, fleet: str) -> tuple[Keys, Keys]:
    """Keys that the sender publishes to the receiver, and the key expressions with which the receiver subscribes to them."""
    if sender.role is ParticipantRole.VEHICLE:
        i = int(sender.id)
        if receiver.role is ParticipantRole.VEHICLE:
            to = int(receiver.id)
            states = (peer_key(fleet, i), distant_key(fleet, i))
            return (*states, pairing_key(fleet, i, to)), (*states, every_pairing(fleet, to))
        if receiver.role in READERS:
            keys = (peer_key(fleet, i), status_key(fleet, i), reply_key(fleet, i))
            return keys, (every_peer(fleet), every_status(fleet), every_reply(fleet))
    elif receiver.role is ParticipantRole.VEHICLE:
        i = int(receiver.id)
        if sender.role is ParticipantRole.GROUND:
            name = str(sender)
            keys = (command_key(fleet, i, name), abort_key(fleet, i, name), admission_key(fleet, name))
            return keys, (every_command(fleet, i), every_abort(fleet, i), every_admission(fleet))
        if sender.role is ParticipantRole.TARGET:
            return (target_key(fleet, sender.id),), (every_target(fleet),)
        if sender.role is ParticipantRole.TRAFFIC:
            return (traffic_key(fleet, sender.id, "*"),), (every_traffic(fleet),)
    return NOTHING


def _rule(name: str, message: str, flow: str, keys: Keys) -> dict[str, Any]:
    return {"id": name, "permission": "allow", "flows": [flow], "messages": [message], "key_exprs": list(keys)}
