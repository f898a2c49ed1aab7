"""Where a stand-in truly is, as rows of its CSV file."""

from __future__ import annotations

from typing import TextIO

from companion.frames import euler_from_quaternion
from sitl.dynamics import ATTITUDE, State
from sitl.px4 import Px4

TRUTH_HEADER = "monotonic_s,x_m,y_m,z_m,vx_m_s,vy_m_s,vz_m_s,roll_rad,pitch_rad,yaw_rad,thrust_norm,armed,mode\n"
_ROW = "%.6f" + ",%.5f" * 10 + ",%d,%s\n"


def truth_row(time_s: float, state: State, thrust_norm: float, armed: bool, mode_name: str) -> str:
    """One line; `state` is that of sitl.dynamics."""
    w, x, y, z = state[ATTITUDE]
    euler_rad = euler_from_quaternion((w, x, y, z))
    return _ROW % (time_s, *state[:6], *euler_rad, thrust_norm, armed, mode_name)


class TruthLog:
    """True states as CSV at 50 Hz, stamped with the machine's monotonic clock, which all its processes share."""

    def __init__(self, file: TextIO) -> None:
        self._file = file
        file.write(TRUTH_HEADER)

    def write(self, px4: Px4, monotonic_s: float) -> None:
        self._file.write(truth_row(monotonic_s, px4.quad.state, px4.quad.thrust_norm, px4.armed, px4.mode.name))

    def flush(self) -> None:
        self._file.flush()
