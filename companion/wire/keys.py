"""Zenoh key expressions: formation/FLEET/KIND/VEHICLE. With ANY in place of a part it is the expression of all of them."""

from __future__ import annotations

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


def pairing_key(fleet: str, sender_id: int | str, receiver_id: int) -> str:
    """Key under which a vehicle gives another one the key of its datagrams. Only that one may receive it."""
    return f"{ROOT}/{fleet}/pairing/{sender_id}/{receiver_id}"
