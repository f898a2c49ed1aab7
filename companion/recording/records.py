"""The topics of a recording and their messages. One MCAP file has one start of one agent, or a part of it.

Messages are JSON. `/inbox` and `/outbox` are exact: fed to the same agent again, the inputs give the same outputs. What is
only to be looked at (`/decision`, `/timing`) is rounded. Times without other words are of the vehicle's monotonic clock.
"""

from __future__ import annotations

from msgspec import Struct

from companion import __version__
from companion.types.values import Vector3

FORMAT = "formation-companion"
FORMAT_VERSION = 1
SOFTWARE = f"formation-companion {__version__}"

INBOX, OUTBOX = "/inbox", "/outbox"  # one message for each tick, in this order
DECISION, TIMING = "/decision", "/timing"  # one message for each tick
STATUS = "/status"  # as published to the ground: five a second, and all with an event
EVENT, COMMAND, REPLY = "/event", "/command", "/reply"  # as they occur
GROUND_STATUS, GROUND_COMMAND = "/ground/status", "/ground/command"  # of a recording made on the ground


class Header(Struct, frozen=True, kw_only=True):
    """Metadata of a recording. `unix_s` and `monotonic_s` are the same moment on the two clocks of the vehicle.

    `fleet_file` and `vehicle_file` are the configuration as JSON, for a replay.
    """

    format: str = FORMAT
    version: int = FORMAT_VERSION
    software: str
    fleet: str
    vehicle_id: int  # 0: the ground
    session: int
    part: int  # 1, 2, ... of the files of one start
    unix_s: float
    monotonic_s: float
    fleet_file: str
    vehicle_file: str


class DecisionRecord(Struct, frozen=True, kw_only=True):
    """What was decided in one tick and from what, flat, for plots."""

    now_s: float
    phase: str
    role: str
    leader_id: int | None
    epoch: int
    prc: int
    position_enu_m: Vector3 | None  # None before there is one in the fleet frame, like the velocity
    velocity_enu_m_s: Vector3 | None
    slot_offset_enu_m: Vector3  # turned to the heading of the formation
    reference_enu_m: Vector3 | None  # leaders only
    neighbours: tuple[int, ...]
    weights: tuple[float, ...]  # w_ij of the neighbours, in their order; empty where the law does not use them
    peer_ages_s: tuple[float, ...]  # of the neighbours, in their order
    acceleration_enu_m_s2: Vector3
    roll_deg: float | None  # of the setpoint, which /outbox has exactly; None without one
    pitch_deg: float | None
    yaw_deg: float | None
    thrust_norm: float | None
    nearest: str
    nearest_m: float | None
    required_m: float | None
    filter_changed_m_s2: float
    wind_acceleration_enu_m_s2: Vector3
    hover_thrust_norm: float
    battery_percent: float | None
    flags: tuple[str, ...]


class TimingRecord(Struct, frozen=True):
    """`late_us`: how late the tick began; `decide_us`: until the setpoint was sent; `whole_us`: until the end of the tick."""

    now_s: float
    late_us: int
    decide_us: int
    whole_us: int
    telemetry_to_command_us: int | None
