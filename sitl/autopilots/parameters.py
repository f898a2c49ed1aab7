"""The data of an autopilot type, and the parameters of one vehicle with MAVLink's two encodings of them.

`data.yaml` in the folder of a type holds what was measured, recorded or looked up; the modules beside it hold its behaviour.
"""

from __future__ import annotations

import struct
from collections.abc import Iterable, Mapping
from functools import cached_property
from math import isfinite
from pathlib import Path
from zlib import crc32

import msgspec
import yaml
from pymavlink.dialects.v20 import ardupilotmega

from companion.config.file import StrictLoader
from companion.mavlink.codec import MavlinkMessage, mavlink
from sitl.autopilots.external_vision import VisionData
from sitl.vehicle.control import Loops

REAL32: int = mavlink.MAV_PARAM_TYPE_REAL32
INT32: int = mavlink.MAV_PARAM_TYPE_INT32
INTEGERS = ((mavlink.MAV_PARAM_TYPE_INT8, 2**7), (mavlink.MAV_PARAM_TYPE_INT16, 2**15), (INT32, 2**31))
HASH_CHECK = "_HASH_CHECK"  # the name under which PX4 sends a checksum of all parameters
NO_INDEX = 65535


class SensorBits(msgspec.Struct, frozen=True):
    """Bits of SYS_STATUS but for the arming checks in `healthy`."""

    present: int
    enabled: int
    healthy: int


class AutopilotData(msgspec.Struct, frozen=True, dict=True, kw_only=True, forbid_unknown_fields=True):
    """The data of one autopilot type. Messages stand by their MAVLink names; rates are in Hz."""

    mav_autopilot: int
    version: tuple[int, int, int]
    uid: int
    capabilities: tuple[str, ...]
    hover_thrust_norm: float
    armable_after_s: float
    braking_m_s2: float
    loops: Loops
    setpoints_lost: dict[int, str | None] = {}  # flight mode by the value of the parameter; None stops the motors
    ground_station_lost: dict[int, str | None]
    set_up: dict[str, float]
    disarmed: SensorBits
    armed: SensorBits
    on_request: tuple[str, ...]
    onboard_rates_hz: dict[str, float]
    ground_rates_hz: dict[str, float]
    silent: tuple[str, ...] = ()
    id_parameter: str
    parameters: dict[str, int | float]
    types: dict[str, str] = {}
    external_vision: VisionData

    @cached_property
    def message_ids(self) -> frozenset[int]:
        """Messages with data that it can send."""
        return frozenset(message_ids((*self.onboard_rates_hz, *self.on_request)))


def load_data(folder: Path) -> AutopilotData:
    """The data of the autopilot type with this folder."""
    text = (folder / "data.yaml").read_text(encoding="utf-8")
    return msgspec.convert(yaml.load(text, Loader=StrictLoader), AutopilotData)


def message_ids(names: Iterable[str]) -> list[int]:
    """Ids of messages by name, also of those that only ArduPilot's dialect has."""
    keys = [f"MAVLINK_MSG_ID_{name}" for name in names]
    return [int(getattr(mavlink if hasattr(mavlink, key) else ardupilotmega, key)) for key in keys]


def rates_by_id(rates_hz: Mapping[str, float]) -> dict[int, float]:
    return dict(zip(message_ids(rates_hz), rates_hz.values(), strict=True))


class StandInParameters:
    """Values by name; a parameter is an integer where its default is one. All are sent as floats, by value."""

    def __init__(self, data: AutopilotData, system_id: int, overrides: Mapping[str, float]) -> None:
        """Raises KeyError for a parameter that does not exist."""
        self._data = data
        self.values: dict[str, float | int] = {**data.parameters, data.id_parameter: system_id}
        for name, value in overrides.items():
            self.set(name, value)

    def __getitem__(self, name: str) -> float:
        return self.values[name]

    def set(self, name: str, value: float) -> None:
        self.values[name] = int(value) if isinstance(self.values[name], int) else float(value)

    def set_from_wire(self, name: str, value: float, kind: int) -> bool:
        """PARAM_SET with its type; returns whether the value was accepted."""
        if name not in self.values:
            return False
        number = self._from_wire(name, value, kind)
        if number is None or not isfinite(number):
            return False
        self.set(name, number)
        return True

    def messages(self) -> list[MavlinkMessage]:
        """PARAM_VALUE of all, in order."""
        return [self.message(name) for name in sorted(self.values)]

    def message(self, name: str) -> MavlinkMessage:
        names = sorted(self.values)
        return mavlink.MAVLink_param_value_message(
            name.encode(), self._to_wire(name), self._kind(name), len(names), names.index(name)
        )

    def read(self, name: str) -> MavlinkMessage | None:
        """PARAM_VALUE of one parameter; None for an unknown name."""
        return self.message(name) if name in self.values else None

    def name_at(self, index: int) -> str | None:
        names = sorted(self.values)
        return names[index] if 0 <= index < len(names) else None

    def _from_wire(self, _name: str, value: float, _kind: int) -> float | None:
        """The number in the float field of PARAM_SET, whatever type a client states; None if it is not acceptable."""
        return value

    def _to_wire(self, name: str) -> float:
        """The float field of PARAM_VALUE."""
        return float(self.values[name])

    def _kind(self, name: str) -> int:
        """MAV_PARAM_TYPE."""
        default = self._data.parameters[name]
        if not isinstance(default, int):
            return REAL32
        if wide := self._data.types.get(name):
            return int(getattr(mavlink, f"MAV_PARAM_TYPE_{wide}"))
        return next(kind for kind, limit in INTEGERS if abs(default) < limit)


class BytewiseParameters(StandInParameters):
    """PX4's: integers are sent bytewise in the float field; a checksum lets a client skip the download."""

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
