"""Zenoh key expressions: formation/FLEET/KIND/VEHICLE."""

from __future__ import annotations

ROOT = "formation"


def peer_key(fleet: str, vehicle_id: int) -> str:
    """Where a vehicle publishes its PeerPacket at every tick."""
    return f"{ROOT}/{fleet}/peer/{vehicle_id}"


def status_key(fleet: str, vehicle_id: int) -> str:
    """Where a vehicle publishes its Status a few times a second."""
    return f"{ROOT}/{fleet}/status/{vehicle_id}"


def command_key(fleet: str, vehicle_id: int) -> str:
    """Where a vehicle answers queries that carry a Command."""
    return f"{ROOT}/{fleet}/command/{vehicle_id}"


def target_key(fleet: str, name: str) -> str:
    """Where whatever is to be followed publishes a TargetSample, ten times a second or so."""
    return f"{ROOT}/{fleet}/target/{name}"


def every_target(fleet: str) -> str:
    return target_key(fleet, "*")


def every_peer(fleet: str) -> str:
    return f"{ROOT}/{fleet}/peer/*"


def every_status(fleet: str) -> str:
    """`fleet` may be * to watch all fleets."""
    return f"{ROOT}/{fleet}/status/*"
