"""How a vehicle is protected in the network of its fleet: one line of `companion doctor`."""

from __future__ import annotations

from datetime import UTC, datetime
from pathlib import Path

from companion.config.file import ConfigError
from companion.config.vehicle import AgentConfig

SOON_DAYS = 30


def network_line(vehicle_file: Path, config: AgentConfig) -> str:
    """Identity, no security, or none needed. An identity that cannot be used is named, as the agent would refuse it."""
    if config.vehicle.identity is None:
        if config.fleet.security == "none":
            return "warning  network: UNSECURED: strangers in it can command this vehicle (security: none in the fleet file)"
        return "ok       network: reached from this computer only"
    from companion.link.fleet.own_identity import vehicle_identity  # without an identity its library is not loaded

    try:
        identity = vehicle_identity(vehicle_file, config)
    except ConfigError as error:
        return f"REFUSAL  network: {error}"
    days = (identity.expires_at - datetime.now(UTC)).days
    soon = f"; companion provision renew, {days} days are left" if days < SOON_DAYS else ""
    words = f"identity {identity.common_name}, valid until {identity.expires_at:%Y-%m-%d}"
    return f"{'warning' if soon else 'ok':<8} network: {words}, admission list {identity.admitted.number}{soon}"
