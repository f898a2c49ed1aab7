"""The other vehicles near this one, whatever they are: peers of the fleet and traffic, as motions of one kind."""

from __future__ import annotations

from collections.abc import Mapping
from math import inf

from msgspec import Struct
from msgspec.structs import replace

from companion.core.consensus.peers import PeerState
from companion.core.safety.filter.lag import LAG_S
from companion.core.safety.filter.silence import DESCENT_M_S, KEPT_S, Silence
from companion.geometry.separation import HEIGHT_WEIGHT
from companion.types.autopilot import PositionError
from companion.types.flight import FlightPhase
from companion.types.formation import FlownSlot
from companion.types.peers import ReceivedTraffic
from companion.types.values import ZERO3, Vector3

FORMATION = FlightPhase.FORMATION
NEAR_M, NEAR_S = 8.0, 3.0  # farther than NEAR_M + NEAR_S * relative speed nothing is computed
FORGOTTEN_S = 600.0  # a vehicle that is silent for so long is no obstacle any more: its battery lasts no longer
TRAFFIC_EXTRAPOLATED_S = 5.0  # an aircraft holds its course
TRAFFIC_SILENCE = Silence(TRAFFIC_EXTRAPOLATED_S, TRAFFIC_EXTRAPOLATED_S, TRAFFIC_EXTRAPOLATED_S, lands=False)
NO_ERROR = PositionError(0.0, 0.0)


class Other(Struct, frozen=True, gc=False):
    """Position and velocity `age_s` ago, the acceleration it flies by its commands, and what it is.

    A peer that is not fresh keeps its acceleration: an autopilot without setpoints keeps its attitude at first.
    `silence`: how it may fly where its state is too old, else None.
    `slot` is None for a vehicle that does not cooperate. `side` is the sign of its number compared with the own one.
    """

    key: int | str
    position_enu_m: Vector3
    velocity_enu_m_s: Vector3
    acceleration_enu_m_s2: Vector3
    age_s: float
    silence: Silence | None
    error: PositionError
    height_weight: float
    slot: FlownSlot | None
    side: float


class Others:
    """Selects the vehicles nearby. Holds the lagged accelerations that peers fly by their commands."""

    def __init__(self, own_id: int, silence: Silence) -> None:
        self._own_id = own_id
        self._silence = silence  # of peers
        self._silence_on_ground = replace(silence, lands=False)
        self._lagged_enu_m_s2: dict[int, Vector3] = {}
        self._last_s = -inf

    def step(
        self,
        now_s: float,
        position_enu_m: Vector3,
        velocity_enu_m_s: Vector3,
        cooperates: bool,
        peers: Mapping[int, PeerState],
        fresh: Mapping[int, PeerState],
        traffic: Mapping[str, ReceivedTraffic],
    ) -> list[Other]:
        """`cooperates`: this vehicle flies in formation, so peers expect its share."""
        near = self._peers_nearby(now_s, position_enu_m, velocity_enu_m_s, cooperates, peers, fresh)
        if traffic:
            near += _traffic_nearby(now_s, position_enu_m, velocity_enu_m_s, traffic)
        return near

    def _peers_nearby(
        self,
        now_s: float,
        position_enu_m: Vector3,
        velocity_enu_m_s: Vector3,
        cooperates: bool,
        peers: Mapping[int, PeerState],
        fresh: Mapping[int, PeerState],
    ) -> list[Other]:
        elapsed_s, self._last_s = now_s - self._last_s, now_s
        lag_share = 1.0 - LAG_S / (LAG_S + elapsed_s)
        near, before, begins_s = [], self._lagged_enu_m_s2, self._silence.begins_s
        commanded: dict[int, Vector3] = {}
        for peer_id, peer in peers.items():
            packet, age_s = peer.packet, now_s - peer.measured_s
            there_enu_m, moving_enu_m_s = packet.position_enu_m, packet.velocity_enu_m_s
            acceleration, reaches_m_s = packet.acceleration_enu_m_s2, moving_enu_m_s
            is_fresh = peer_id in fresh
            if not is_fresh:
                (vx, vy, vz), (ax, ay, _) = moving_enu_m_s, acceleration
                reaches_m_s = (abs(vx) + KEPT_S * abs(ax), abs(vy) + KEPT_S * abs(ay), abs(vz) + DESCENT_M_S)
            if age_s > FORGOTTEN_S or not _near(position_enu_m, velocity_enu_m_s, there_enu_m, reaches_m_s, age_s):
                continue
            last = before.get(peer_id)
            if last is not None and is_fresh:
                (lx, ly, lz), (ux, uy, uz) = last, acceleration
                acceleration = (lx + lag_share * (ux - lx), ly + lag_share * (uy - ly), lz + lag_share * (uz - lz))
            commanded[peer_id] = acceleration
            near.append(
                Other(
                    peer_id,
                    there_enu_m,
                    moving_enu_m_s,
                    acceleration,
                    age_s,
                    None if age_s <= begins_s else self._silence if packet.armed else self._silence_on_ground,
                    packet.position_error or NO_ERROR,
                    HEIGHT_WEIGHT if packet.armed else 1.0,  # no downwash reaches a vehicle on the ground
                    packet.slot if cooperates and is_fresh and packet.phase is FORMATION else None,
                    1.0 if self._own_id < peer_id else -1.0,
                )
            )
        self._lagged_enu_m_s2 = commanded
        return near


def _traffic_nearby(
    now_s: float, position_enu_m: Vector3, velocity_enu_m_s: Vector3, traffic: Mapping[str, ReceivedTraffic]
) -> list[Other]:
    near = []
    for name, one in traffic.items():
        sample = one.sample
        age_s = now_s - one.received_s + sample.age_s
        there_enu_m, moving_enu_m_s = sample.position_enu_m, sample.velocity_enu_m_s
        if _near(position_enu_m, velocity_enu_m_s, there_enu_m, moving_enu_m_s, age_s):
            error = PositionError(sample.error_m, sample.error_m)
            silence = TRAFFIC_SILENCE if age_s > TRAFFIC_EXTRAPOLATED_S else None
            near.append(
                Other(name, there_enu_m, moving_enu_m_s, ZERO3, age_s, silence, error, HEIGHT_WEIGHT, None, 1.0)
            )
    return near


def _near(own_m: Vector3, own_m_s: Vector3, other_m: Vector3, other_m_s: Vector3, age_s: float) -> bool:
    """Whether the two might meet within NEAR_S, or come within NEAR_M."""
    (x, y, z), (px, py, pz) = own_m, other_m
    dx, dy, dz = abs(x - px), abs(y - py), abs(z - pz)
    if dx < NEAR_M and dy < NEAR_M and dz < NEAR_M:
        return True
    (wx, wy, wz), (vx, vy, vz) = own_m_s, other_m_s
    reach_m = NEAR_M + NEAR_S * (abs(wx) + abs(wy) + abs(wz)) + (NEAR_S + age_s) * (abs(vx) + abs(vy) + abs(vz))
    return dx < reach_m and dy < reach_m and dz < reach_m
