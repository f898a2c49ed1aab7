"""Zenoh key expressions: formation/FLEET/KIND/VEHICLE."""

from __future__ import annotations

ROOT = "formation"


def peer_key(fleet: str, vehicle_id: int) -> str:
    """Key of a vehicle's PeerPacket, published at every tick."""
    return f"{ROOT}/{fleet}/peer/{vehicle_id}"


def status_key(fleet: str, vehicle_id: int) -> str:
    """Key of a vehicle's Status, published a few times per second."""
    return f"{ROOT}/{fleet}/status/{vehicle_id}"


def command_key(fleet: str, vehicle_id: int) -> str:
    """Key on which a vehicle receives Commands."""
    return f"{ROOT}/{fleet}/command/{vehicle_id}"


def abort_key(fleet: str, vehicle_id: int) -> str:
    """Key on which a vehicle receives the Command ABORT, so that a flood of other commands cannot displace it."""
    return f"{ROOT}/{fleet}/abort/{vehicle_id}"


def reply_key(fleet: str, vehicle_id: int) -> str:
    """Key under which a vehicle publishes its CommandReplies."""
    return f"{ROOT}/{fleet}/reply/{vehicle_id}"


def target_key(fleet: str, name: str) -> str:
    """Key under which a target publishes its TargetSample, about ten times per second."""
    return f"{ROOT}/{fleet}/target/{name}"


def every_target(fleet: str) -> str:
    """Key expression of all targets of a fleet."""
    return target_key(fleet, "*")


def traffic_key(fleet: str, name: str) -> str:
    """Key under which a vehicle outside the fleet is published, as a TrafficSample."""
    return f"{ROOT}/{fleet}/traffic/{name}"


def every_traffic(fleet: str) -> str:
    """Key expression of all traffic of a fleet."""
    return traffic_key(fleet, "*")


def every_peer(fleet: str) -> str:
    """Key expression of all peer packets of a fleet."""
    return f"{ROOT}/{fleet}/peer/*"


def every_status(fleet: str) -> str:
    """Key expression of all status reports of a fleet; `fleet` may be * for all fleets."""
    return f"{ROOT}/{fleet}/status/*"


def every_reply(fleet: str) -> str:
    """Key expression of all command replies of a fleet; `fleet` may be * for all fleets."""
    return f"{ROOT}/{fleet}/reply/*"
