"""Zenoh key expressions: formation/FLEET/KIND/VEHICLE. With ANY in place of a part it is the expression of all of them.

A subscriber receives the key as it was sent, which may itself be an expression: `**` reaches every subscriber of every kind.
So a received key is input like any other, and `parts_of` is the only way to read one.
"""

from __future__ import annotations

import re

ROOT = "formation"
ANY = "*"


def peer_key(fleet: str, vehicle_id: int | str) -> str:
    """Key of a vehicle's PeerPacket, published at every tick."""
    return f"{ROOT}/{fleet}/peer/{vehicle_id}"


def distant_key(fleet: str, vehicle_id: int) -> str:
    """Key of every tenth PeerPacket of a vehicle in a large fleet, for those that are far away."""
    return f"{ROOT}/{fleet}/distant/{vehicle_id}"


def status_key(fleet: str, vehicle_id: int | str) -> str:
    """Key of a vehicle's Status, published a few times per second."""
    return f"{ROOT}/{fleet}/status/{vehicle_id}"


def command_key(fleet: str, vehicle_id: int, operator: str) -> str:
    """Key under which an operator publishes Commands to a vehicle. The name belongs to the operator's certificate."""
    return f"{ROOT}/{fleet}/command/{vehicle_id}/{operator}"


def abort_key(fleet: str, vehicle_id: int, operator: str) -> str:
    """Key of the Command ABORT, so that a flood of other commands cannot displace it."""
    return f"{ROOT}/{fleet}/abort/{vehicle_id}/{operator}"


def check_key(fleet: str, vehicle_id: int, operator: str) -> str:
    """Key under which an operator publishes Commands that a vehicle only answers. Who does not know it executes none."""
    return f"{ROOT}/{fleet}/check/{vehicle_id}/{operator}"


def admission_key(fleet: str, ground: str) -> str:
    """Key under which a ground publishes a new admission list, which the fleet's authority has signed."""
    return f"{ROOT}/{fleet}/admitted/{ground}"


def reply_key(fleet: str, vehicle_id: int | str) -> str:
    """Key under which a vehicle publishes its CommandReplies."""
    return f"{ROOT}/{fleet}/reply/{vehicle_id}"


def target_key(fleet: str, name: str) -> str:
    """Key under which a target publishes its TargetSample, about ten times per second."""
    return f"{ROOT}/{fleet}/target/{name}"


def traffic_key(fleet: str, source: str, name: str) -> str:
    """Key under which a source publishes a vehicle outside the fleet, as a TrafficSample."""
    return f"{ROOT}/{fleet}/traffic/{source}/{name}"


def pose_key(fleet: str, source: str, vehicle_id: int) -> str:
    """Key under which a motion-capture system publishes the pose of a vehicle, as a BodyPose."""
    return f"{ROOT}/{fleet}/pose/{source}/{vehicle_id}"


def pairing_key(fleet: str, sender_id: int | str, receiver_id: int) -> str:
    """Key under which a vehicle gives another one the key of its datagrams. Only that one may receive it."""
    return f"{ROOT}/{fleet}/pairing/{sender_id}/{receiver_id}"


LONGEST_KEY = 256  # characters; no key of a fleet is longer
PART = re.compile(r"[A-Za-z0-9_.@+-]{1,64}")  # of a received key: no wildcard, nothing that a terminal executes


def parts_of(key: str, kind: str, count: int) -> tuple[str, ...] | None:
    """The fleet, and the `count` parts behind the kind; None where a received key is none of this kind. Never raises."""
    if len(key) > LONGEST_KEY:
        return None
    root, *parts = key.split("/")
    if root != ROOT or len(parts) != 2 + count or parts[1] != kind or not all(map(PART.fullmatch, parts)):
        return None
    return (parts[0], *parts[2:])


def target_of(key: str) -> str | None:
    """Name of the target that publishes under this received key; None for another key."""
    parts = parts_of(key, "target", 1)
    return parts[1] if parts else None


def traffic_of(key: str) -> tuple[str, str] | None:
    """Source and name of the traffic under this received key; None for another key."""
    parts = parts_of(key, "traffic", 2)
    return (parts[1], parts[2]) if parts else None


def pose_source_of(key: str) -> str | None:
    """Name of the source that publishes a pose under this received key; None for another key."""
    parts = parts_of(key, "pose", 2)
    return parts[1] if parts else None


def pairing_sender_of(key: str) -> int | None:
    """Id of the vehicle that sends the key of its datagrams under this received key; None for another key."""
    parts = parts_of(key, "pairing", 2)
    return int(parts[1]) if parts and re.fullmatch("[1-9][0-9]{0,2}", parts[1]) else None


def reply_fleet_of(key: str) -> str | None:
    """Fleet of the vehicle that replies under this received key; None for another key."""
    parts = parts_of(key, "reply", 1)
    return parts[0] if parts else None
