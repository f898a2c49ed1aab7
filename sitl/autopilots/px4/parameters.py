"""Parameters of the stand-in PX4. Integers are sent bytewise in the float field, as PX4 does."""

from __future__ import annotations

import struct
from collections.abc import Mapping
from zlib import crc32

from companion.mavlink.codec import MavlinkMessage, mavlink
from sitl.autopilots.parameters import REAL32, StandInParameters

INT32: int = mavlink.MAV_PARAM_TYPE_INT32
HASH_CHECK = "_HASH_CHECK"  # the name under which PX4 sends a checksum of all parameters
NO_INDEX = 65535

DEFAULTS: dict[str, float | int] = {
    "BAT1_CAPACITY": -1.0,
    "BAT1_N_CELLS": 4,
    "BAT1_V_CHARGED": 4.05,
    "BAT1_V_EMPTY": 3.6,
    "BAT_CRIT_THR": 0.07,
    "BAT_EMERGEN_THR": 0.05,
    "BAT_LOW_THR": 0.15,
    "CAL_ACC0_ID": 1310988,
    "CAL_GYRO0_ID": 1310988,
    "CAL_MAG0_ID": 197388,
    "CBRK_FLIGHTTERM": 121212,
    "CBRK_IO_SAFETY": 22027,
    "CBRK_SUPPLY_CHK": 894281,
    "CBRK_USB_CHK": 197848,
    "COM_ARM_WO_GPS": 1,
    "COM_DISARM_LAND": 2.0,
    "COM_DISARM_PRFLT": 10.0,
    "COM_DL_LOSS_T": 10,
    "COM_FAIL_ACT_T": 5.0,
    "COM_LOW_BAT_ACT": 0,
    "COM_OBL_RC_ACT": 0,
    "COM_OF_LOSS_T": 1.0,
    "COM_RCL_EXCEPT": 0,
    "COM_RC_IN_MODE": 4,
    "COM_RC_LOSS_T": 0.5,
    "COM_RC_OVERRIDE": 1,
    "EKF2_ACC_NOISE": 0.35,
    "EKF2_GPS_P_NOISE": 0.5,
    "EKF2_GPS_V_NOISE": 0.3,
    "EKF2_GYR_NOISE": 0.015,
    "EKF2_HGT_REF": 1,
    "GF_ACTION": 2,
    "GF_MAX_HOR_DIST": 0.0,
    "GF_MAX_VER_DIST": 0.0,
    "MAV_COMP_ID": 1,
    "MAV_SYS_ID": 1,
    "MAV_TYPE": 2,
    "MIS_TAKEOFF_ALT": 2.5,
    "MPC_LAND_SPEED": 0.7,
    "MPC_THR_HOVER": 0.5,
    "MPC_TILTMAX_AIR": 45.0,
    "MPC_TKO_SPEED": 1.5,
    "MPC_XY_CRUISE": 5.0,
    "MPC_XY_VEL_MAX": 12.0,
    "MPC_Z_VEL_MAX_DN": 1.5,
    "MPC_Z_VEL_MAX_UP": 3.0,
    "MPC_Z_V_AUTO_DN": 1.5,
    "MPC_Z_V_AUTO_UP": 3.0,
    "NAV_ACC_RAD": 2.0,
    "NAV_DLL_ACT": 0,
    "NAV_RCL_ACT": 2,
    "RTL_CONE_ANG": 45,
    "RTL_DESCEND_ALT": 10.0,
    "RTL_LAND_DELAY": 0.0,
    "RTL_MIN_DIST": 10.0,
    "RTL_RETURN_ALT": 30.0,
    "SDLOG_MODE": 0,
    "SYS_AUTOCONFIG": 0,
    "SYS_AUTOSTART": 10040,
    "SYS_HITL": 0,
}


class Px4Parameters(StandInParameters):
    """Integers are sent bytewise; a checksum lets a client skip the download."""

    def __init__(self, system_id: int, overrides: Mapping[str, float]) -> None:
        """Raises KeyError for a parameter that does not exist."""
        super().__init__(DEFAULTS | {"MAV_SYS_ID": system_id}, overrides)

    def messages(self) -> list[MavlinkMessage]:
        """The checksum, then all parameters: a client that has them already may ignore the rest."""
        return [self.hash_message(), *super().messages()]

    def read(self, name: str) -> MavlinkMessage | None:
        return self.hash_message() if name == HASH_CHECK else super().read(name)

    def hash_message(self) -> MavlinkMessage:
        """PARAM_VALUE of _HASH_CHECK: a checksum over names and values, without an index."""
        content = b"".join(name.encode() + self._bytes(name) for name in sorted(self.values))
        wire = struct.unpack("<f", struct.pack("<I", crc32(content)))[0]
        kind = mavlink.MAV_PARAM_TYPE_UINT32
        return mavlink.MAVLink_param_value_message(HASH_CHECK.encode(), wire, kind, len(self.values), NO_INDEX)

    def _from_wire(self, name: str, value: float, kind: int) -> float | None:
        """The number, None if the type is not that of the parameter."""
        if kind != self._kind(name):
            return None
        number: float = struct.unpack("<i", struct.pack("<f", value))[0] if kind == INT32 else value
        return number

    def _to_wire(self, name: str) -> float:
        wire: float = struct.unpack("<f", self._bytes(name))[0]
        return wire

    def _bytes(self, name: str) -> bytes:
        value = self.values[name]
        return struct.pack("<i" if isinstance(value, int) else "<f", value)

    def _kind(self, name: str) -> int:
        return INT32 if isinstance(self.values[name], int) else REAL32
