"""The interface of the monitor for programs, version 1: what its page uses. JSON; docs/api.md explains it.

Positions are in the fleet frame (ENU, metres), times in seconds. `time_s` is Unix time, in a replay that of the flight.
None stands for a value that is not known.
"""

from __future__ import annotations

from typing import Annotated, Any, Literal

from msgspec import Meta, Struct

from companion.types.code_table import CodeSeverity
from companion.types.status import NetworkState, RecordingState
from companion.types.values import Finite, FleetName, Vector3, VehicleIds, Word

API_VERSION = 1
TOKEN_HEADER = "X-Companion-Token"  # a POST with --control needs it: the token of the printed URL, after #token=
LIVE_PROTOCOL = "companion"  # subprotocol of the WebSocket
TOKEN_PROTOCOL = "companion.token."  # with the token behind it, offered beside LIVE_PROTOCOL: a browser's WebSocket
Severity = CodeSeverity


class NeighbourView(Struct, frozen=True):
    """A neighbour that the law uses, with its weight w_ij (eq. 6) and the age of its newest packet."""

    vehicle_id: int
    weight: float | None
    age_s: float | None


class FlagView(Struct, frozen=True):
    """A health flag. `action` is what the agent does by the failsafe matrix, `advice` what the operator should do."""

    code: str
    severity: Severity
    text: str
    action: str
    advice: str


class NearestView(Struct, frozen=True):
    """The vehicle or traffic with the least room above its required distance, as the separation filter sees it."""

    name: str
    distance_m: float
    required_m: float
    changed_m_s2: float  # change of the commanded acceleration; 0 without an intervention


class TimingView(Struct, frozen=True):
    rate_hz: float
    missed: int
    late_p50_ms: float
    late_p99_ms: float
    late_max_ms: float
    telemetry_to_command_p50_ms: float
    telemetry_to_command_p99_ms: float
    cpu_percent: float
    memory_mb: float


class VehicleView(Struct, frozen=True, kw_only=True):
    """One vehicle as the ground sees it now. `silent`: no report for one second; then all other values are old."""

    fleet: str
    vehicle_id: int
    silent: bool
    age_s: float  # since the last report
    data_age_s: (
        float | None
    )  # age of the position: on board, plus the time since the report; None if there never was a position
    report_rate_hz: float
    phase: str
    role: str
    mode: str
    armed: bool
    landed: str
    position_enu_m: Vector3 | None  # None, as the velocity, while the vehicle has no position
    velocity_enu_m_s: Vector3 | None
    position_error_m: tuple[float, float] | None  # one sigma, horizontal and vertical
    battery_percent: float | None
    law: str
    prc: int
    epoch: int
    leader_id: int | None
    leader_beacon_age_s: float | None
    neighbours: tuple[NeighbourView, ...]
    peers: tuple[int, ...]  # fresh ones
    slot_position_enu_m: Vector3 | None  # present position of its slot: reference plus turned offset
    slot_offset_enu_m: Vector3  # in the formation's own frame
    error_to_slot_m: float | None
    reference_enu_m: Vector3 | None  # leaders only
    formation: str
    reference: str
    holder: str
    flags: tuple[FlagView, ...]
    lacks: tuple[str, ...]
    refuses_return: str | None
    nearest: NearestView | None
    hover_thrust_norm: float
    wind_acceleration_enu_m_s2: Vector3
    timing: TimingView
    network: NetworkState
    recording: RecordingState = RecordingState()
    rejected: int
    last_event: str | None


class FleetView(Struct, frozen=True, kw_only=True):
    """Figures of a whole fleet. Those of the law need its fleet file, and are None without it."""

    name: str
    vehicle_ids: tuple[int, ...]  # vehicles that ever reported
    missing_ids: tuple[int, ...]  # vehicles of the fleet file that never reported; none without the file
    leader_ids: tuple[int, ...]
    smallest_separation_m: float | None
    smallest_separation_pair: tuple[int, int] | None
    smallest_separation_unheard: (
        bool  # the second of the pair does not report here; the distance is as the first sees it
    )
    separation_trend_m_s: float | None  # over the last five seconds; negative: closing
    lambda_min: float | None  # smallest eigenvalue of the interaction matrix G of the present neighbours (eq. 18)
    settling_s: float | None  # predicted, to a tenth of an error
    link_margin_m: (
        float | None
    )  # neighbours by range: how much longer the weakest link that holds the fleet together may get
    link_margin_pair: tuple[int, int] | None
    data_age_worst_s: float | None
    battery_lowest: BatteryView | None
    position_error_worst_m: float | None  # one sigma, horizontal
    wind_acceleration_enu_m_s2: Vector3 | None  # mean of the vehicles in the air; None without one


class BatteryView(Struct, frozen=True):
    """The battery with the lowest charge. `left_min`: until it is empty, by its last minute; None while unknown."""

    vehicle_id: int
    percent: float
    left_min: float | None


class AlarmView(Struct, frozen=True, kw_only=True):
    """A condition that needs attention. It stays after its end until it is acknowledged.

    `since_s` is the begin of the newest occurrence, `first_s` that of the first one, `times` how many there were.
    """

    id: int
    fleet: str
    vehicle_id: int | None
    code: str
    severity: Severity
    text: str
    advice: str
    since_s: float
    until_s: float | None
    acknowledged: bool
    first_s: float
    times: int = 1


class EventView(Struct, frozen=True, kw_only=True):
    """Something that happened: an event of a vehicle, a phase change, a command, an answer.

    `leader`: the vehicle leads from now on. `formation`: it flies another one. A command and its answers have the same
    `command`, whatever that is; `outcome` of an answer is as in `companion fleet --json`, of an alarm `ended` or "".
    """

    id: int
    time_s: float
    fleet: str
    vehicle_id: int | None
    kind: Literal["event", "phase", "leader", "formation", "command", "answer", "alarm"]
    code: str
    text: str
    operator: str = ""  # who gave the command
    command: str = ""
    outcome: str = ""


class ReplayView(Struct, frozen=True):
    """Where a replay is. `speed` 0: paused."""

    begin_s: float
    end_s: float
    now_s: float
    speed: float


class Snapshot(Struct, frozen=True, kw_only=True, tag_field="type", tag="snapshot"):
    """Sent ten times a second over the WebSocket `/api/v1/live`; `GET /api/v1/snapshot` gives one.

    A client that is too slow misses some: `number` then rises by more than one, and events are in `GET /api/v1/history`.
    """

    version: int = API_VERSION
    number: int  # rises by one
    time_s: float
    commands: str  # with --control: the fleet that is commanded, with the token, also before it reports; else empty
    operator: str
    connected: tuple[str, ...]  # endpoints of vehicles that this server is connected to
    unreachable: tuple[str, ...]
    vehicles: tuple[VehicleView, ...]
    fleets: tuple[FleetView, ...]
    alarms: tuple[AlarmView, ...]
    events: tuple[EventView, ...] = ()  # over the WebSocket: those since the last snapshot
    replay: ReplayView | None = None


class Seek(Struct, frozen=True, tag_field="type", tag="seek", forbid_unknown_fields=True):
    """Client message over the WebSocket in a replay: go to this time."""

    time_s: Finite


class Speed(Struct, frozen=True, tag_field="type", tag="speed", forbid_unknown_fields=True):
    """Client message over the WebSocket in a replay: seconds of the flight per second; 0 pauses."""

    speed: Annotated[float, Meta(ge=0.0, le=100.0)]


ClientMessage = Seek | Speed


class ObstacleView(Struct, frozen=True):
    """`outline_enu_m`: corners seen from above; of a cylinder its circle by 24 corners. From `floor_m` to `top_m`."""

    outline_enu_m: tuple[tuple[float, float], ...]
    floor_m: float
    top_m: float


class MemberView(Struct, frozen=True):
    vehicle_id: int
    role: str
    may_lead: bool
    slot_enu_m: Vector3


class TilesView(Struct, frozen=True):
    """`attribution` must be shown with the tiles."""

    least_zoom: int
    most_zoom: int
    attribution: str


class FleetFileView(Struct, frozen=True, kw_only=True):
    """`GET /api/v1/fleets/NAME`: what the fleet file defines, for the map."""

    name: str
    law: str
    origin: tuple[float, float, float]  # latitude, longitude (degrees), altitude AMSL (m)
    members: tuple[MemberView, ...]
    edges: tuple[tuple[int, int], ...]  # neighbours by a fixed list
    range_m: float | None  # neighbours by range
    separation_m: float
    fence_outline_enu_m: tuple[tuple[float, float], ...]
    fence_floor_m: float
    fence_ceiling_m: float
    clearance_m: float
    obstacles: tuple[ObstacleView, ...]
    homes_enu_m: dict[int, Vector3]  # where each vehicle was last disarmed on the ground, as this server saw it
    reference_enu_m: tuple[
        Vector3, ...
    ] = ()  # line of the reference that the leader flies, as it reports it; empty while unknown
    tiles: TilesView | None = None  # map tiles of this server; null without --tiles


class ControlView(Struct, frozen=True):
    """`GET /api/v1/control`: whether the token of this request is that of the server, so that it would take commands."""

    allowed: bool


class CommandRequest(Struct, frozen=True, forbid_unknown_fields=True):
    """`POST /api/v1/commands`, only with --control. `name` is an action of `companion fleet`.

    `vehicle_ids` empty: all of the fleet. `content` has the options of the action: of `formation` shape, spacing_m,
    heading_deg or slots_enu_m; of `reference` those of the reference in a vehicle file; of `leader` leader_ids.
    """

    fleet: FleetName
    name: Word
    vehicle_ids: VehicleIds = ()
    content: dict[str, Any] = {}


class AnswerView(Struct, frozen=True):
    """`kind` is that of `companion fleet --json`: accepted, refused, missing and so on."""

    vehicle_id: int
    kind: str
    code: str
    text: str
    after_ms: float | None


class CommandResult(Struct, frozen=True):
    """`error`: why nothing was sent; with `answers`, which command has ended this one."""

    name: str
    answers: tuple[AnswerView, ...]
    advice: str = ""
    error: str = ""


class PathView(Struct, frozen=True):
    vehicle_id: int
    from_enu_m: Vector3
    to_enu_m: Vector3


class Preview(Struct, frozen=True):
    """`POST /api/v1/preview` with a CommandRequest of `formation` or `reference`: a check of it. Nothing changes.

    `paths` of a formation: from the present slot to the new one. Its `slots_enu_m` are as in the content, in a frame that is
    turned by `heading_rad` against the fleet frame. `track_enu_m` of a reference: where it goes. `answers` are
    those of the vehicles to the check; none where the ground refuses. `instead` has keys of the content with values that
    would be accepted, where they are known. `warning`: what of the content is probably meant otherwise.
    """

    paths: tuple[PathView, ...] = ()
    slots_enu_m: dict[int, Vector3] = {}
    heading_rad: float = 0.0
    track_enu_m: tuple[Vector3, ...] = ()
    smallest_separation_m: float | None = None
    lasts_s: float | None = None
    refused: str = ""
    warning: str = ""
    answers: tuple[AnswerView, ...] = ()
    instead: dict[str, float] = {}


class HistorySample(Struct, frozen=True, array_like=True):
    """Of one vehicle at one time: id, altitude, error to slot, battery, lateness p99, nearest distance."""

    vehicle_id: int
    altitude_m: float | None  # None where the position is older than a second
    error_to_slot_m: float | None
    battery_percent: float | None
    late_p99_ms: float
    nearest_m: float | None


class HistoryPoint(Struct, frozen=True):
    """One fleet at one time."""

    time_s: float
    fleet: str
    smallest_separation_m: float | None
    vehicles: tuple[HistorySample, ...]


class History(Struct, frozen=True):
    """`GET /api/v1/history`: the last ten minutes, two points a second, and all events kept."""

    points: tuple[HistoryPoint, ...]
    events: tuple[EventView, ...]


class FlightView(Struct, frozen=True):
    """`GET /api/v1/flight`, of a replay: what happened in all of it, before and after the present time.

    `leader_ids` has for each fleet who led about a second after its begin.
    """

    events: tuple[EventView, ...]
    leader_ids: dict[str, tuple[int, ...]]


class LogFileView(Struct, frozen=True):
    """A file of a flight on the ground; `GET /api/v1/logs/ID` gives its bytes. `vehicle_id` None: recorded on the ground."""

    id: str
    name: str
    vehicle_id: int | None
    kind: str  # recording, MAVLink (a .tlog), autopilot
    bytes: int
    written_s: float  # last change, by the clock of this computer


class LogsView(Struct, frozen=True):
    """`GET /api/v1/logs`: the files of flights in the folder of --record or --replay, the newest first."""

    has_folder: bool
    files: tuple[LogFileView, ...]
