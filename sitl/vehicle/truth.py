"""True states of a stand-in as rows of a CSV file."""

from __future__ import annotations

import os
from pathlib import Path

from companion.geometry.frames import euler_from_quaternion
from sitl.vehicle.dynamics import ATTITUDE, State

TRUTH_HEADER = "monotonic_s,x_m,y_m,z_m,vx_m_s,vy_m_s,vz_m_s,roll_rad,pitch_rad,yaw_rad,thrust_norm,armed,mode\n"
_ROW = "%.6f" + ",%.5f" * 10 + ",%d,%s\n"
_TAIL_BYTES = 512  # more than two rows


def truth_row(time_s: float, state: State, thrust_norm: float, armed: bool, mode_name: str) -> str:
    """One row; `state` is that of sitl.vehicle.dynamics."""
    w, x, y, z = state[ATTITUDE]
    euler_rad = euler_from_quaternion((w, x, y, z))
    return _ROW % (time_s, *state[:6], *euler_rad, thrust_norm, armed, mode_name)


def armed_at_m(file: Path) -> float | None:
    """Height at which the last row has the vehicle armed, m; None where it is disarmed or nothing was written."""
    with file.open("rb") as rows:
        rows.seek(-min(_TAIL_BYTES, rows.seek(0, os.SEEK_END)), os.SEEK_END)
        complete = rows.read().decode().split("\n")[:-1]
    values = complete[-1].split(",") if complete else []
    columns = dict(zip(TRUTH_HEADER.strip().split(","), values, strict=False))
    return float(columns["z_m"]) if columns.get("armed") == "1" else None
