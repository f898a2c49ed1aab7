"""Reports that a new formation or reference can be computed from."""

from __future__ import annotations

from collections.abc import Iterable

from companion.config.file import ConfigError
from companion.ground.requests import command_line
from companion.types.status import Status
from companion.types.values import MAX_COORDINATE_M


def check_reports(action: str, statuses: Iterable[Status]) -> None:
    """Refuses positions that no vehicle can have: their squares overflow. Raises ConfigError."""
    for status in statuses:
        positions = {"position_enu_m": status.position_enu_m, "slot": status.slot.position_enu_m}
        for name, position_enu_m in (positions | {"reference_enu_m": status.reference_enu_m or (0.0,)}).items():
            if (largest_m := max(map(abs, position_enu_m))) > MAX_COORDINATE_M:
                raise ConfigError(
                    command_line(action),
                    f"{name} of vehicle {status.vehicle_id}",
                    f"is {largest_m:g} m from the origin by its report; expected at most {MAX_COORDINATE_M:g} m",
                )
