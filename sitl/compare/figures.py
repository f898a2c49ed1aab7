"""The figures of one flight, from true positions: the same definitions for a batch and for real agents.

docs/statistics.md defines them for the reader.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from math import isfinite

import numpy as np
from msgspec import Struct
from msgspec.structs import replace

from companion.analysis.interaction import FloatArray
from companion.analysis.prediction import settle_time_s
from companion.config.law import LawSection, law_of
from companion.types.flight import FlightPhase, Role
from companion.types.formation import FlownSlot, LeaderBeacon
from companion.types.peers import LeaderReport, Motion, PeerPacket, Sender
from companion.wire.messages import encode_peer
from sitl.compare.hops import gain_per_hop, longest_path
from sitl.flight.files import ids_of
from sitl.flight.scenario import Scenario
from sitl.report.metrics import FINAL_S, MOVES_M

PACKETS_HZ = 50.0


@dataclass(frozen=True, slots=True)
class FlownFormation:
    """True tracks of n vehicles, in rising order of their ids, from the begin of the law.

    `positions_enu_m` (T, n, 3), `reference_enu_m` (T, 3), `slots_enu_m` (n, 3), `commanded_m_s2` (T, n). `connected` (T,) is
    whether every vehicle had a path to a leader, None where that is not known.
    """

    times_s: FloatArray
    positions_enu_m: FloatArray
    reference_enu_m: FloatArray
    slots_enu_m: FloatArray
    commanded_m_s2: FloatArray
    connected: FloatArray | None


class Figures(Struct, frozen=True, kw_only=True):
    """Figures of one flight. None: it has not this figure; for `settle_s` that it never settled.

    settle_s: time from which every vehicle stays within 10 cm of its slot
    overshoot_m: the farthest that a vehicle flew past its slot, seen from its start; not for a moving reference
    smallest_distance_m: of any two vehicles
    gain_per_hop: factor by which deviations grow from hop to hop of the longest path
    rms_m: root mean square distance to the slot about the RFT, of all vehicles over the second half of the flight
    final_error_m: the same over the last 2 s, of the vehicle with the largest
    effort_m_s2: root mean square of the commanded acceleration, of all vehicles
    bytes_per_s: bytes of state packets that one vehicle publishes per second
    connected_share: share of the time in which every vehicle had a path to a leader, where neighbours change with range
    failure: why the flight ended before its time; then it has no figure
    remark: why its law flew vehicle by vehicle in the batch
    """

    settle_s: float | None
    overshoot_m: float | None
    smallest_distance_m: float | None
    gain_per_hop: float | None
    rms_m: float | None
    final_error_m: float | None
    effort_m_s2: float | None
    bytes_per_s: float | None
    connected_share: float | None
    failure: str | None
    remark: str | None


NOTHING = Figures(**dict.fromkeys(Figures.__struct_fields__))
DIGITS = {"settle_s": 2, "bytes_per_s": 0}  # others have four


def figures_of(flown: FlownFormation, scenario: Scenario, hop_gains: bool) -> Figures:
    """`hop_gains`: whether deviations are those of the law, not of noise."""
    if np.isnan(flown.positions_enu_m[-1]).any():
        return failed("its positions end before the flight")
    displaced_m = flown.positions_enu_m - flown.slots_enu_m
    errors_m = np.linalg.norm(displaced_m - flown.reference_enu_m[:, None, :], axis=2)
    final = np.sqrt(np.mean(np.square(errors_m[flown.times_s >= flown.times_s[-1] - FINAL_S - 1e-9]), axis=0))
    moves = bool(np.any(np.ptp(flown.reference_enu_m, axis=0) > MOVES_M))
    found = {
        "settle_s": settle_time_s(flown.times_s, errors_m.max(axis=1)),
        "overshoot_m": None if moves else _overshoot_m(displaced_m - flown.reference_enu_m[-1]),
        "smallest_distance_m": closest_m(flown.positions_enu_m),
        "gain_per_hop": _gain(displaced_m, scenario) if hop_gains else None,
        "rms_m": _rms(errors_m[len(errors_m) // 2 :]),
        "final_error_m": float(final.max()),
        "effort_m_s2": _rms(flown.commanded_m_s2),
        "bytes_per_s": PACKETS_HZ * packet_bytes(scenario.fleet.law),
        "connected_share": None if flown.connected is None else float(np.mean(flown.connected)),
    }
    rounded = {name: _rounded(value, DIGITS.get(name, 4)) for name, value in found.items()}
    return Figures(**rounded, failure=None, remark=None)


def failed(why: str) -> Figures:
    """Of a flight that ended before its time."""
    return replace(NOTHING, failure=why)


def _overshoot_m(off_m: FloatArray) -> float:
    """`off_m` (T, n, 3): position minus the place where the vehicle belongs."""
    begin_m = np.linalg.norm(off_m[0], axis=1)
    towards = -off_m[0] / np.maximum(begin_m, MOVES_M)[:, None]
    return max(0.0, float(np.einsum("tik,ik->ti", off_m, towards).max()))


def closest_m(positions_enu_m: FloatArray) -> float | None:
    """Smallest distance of any two vehicles over all times; positions are (T, n, 3). None for a single vehicle."""
    n = positions_enu_m.shape[1]
    smallest = np.inf
    for k in range(1, n):  # one offset at a time: (T, n, n) would not fit in memory
        apart = positions_enu_m[:, k:] - positions_enu_m[:, :-k]
        smallest = min(smallest, float(np.einsum("tij,tij->ti", apart, apart).min()))
    return float(np.sqrt(smallest)) if n > 1 else None


def _gain(displaced_m: FloatArray, scenario: Scenario) -> float | None:
    ids = ids_of(scenario)
    return gain_per_hop([displaced_m[:, ids.index(i)] for i in longest_path(scenario)])


def _rms(values: FloatArray) -> float:
    return float(np.sqrt(np.mean(np.square(values))))


@lru_cache(maxsize=64)
def packet_bytes(law: LawSection) -> int:
    """Bytes of one state packet of a vehicle in formation, with what the law publishes."""
    x = 123.456  # numbers have a fixed size
    vector, beacon = (x, x, x), LeaderBeacon(1, 1, 10_000, 1)
    return len(
        encode_peer(
            PeerPacket(
                sender=Sender(2, 1 << 40, 10_000, 1 << 40),
                phase=FlightPhase.FORMATION,
                role=Role.FOLLOWER,
                motion=Motion(vector, vector, vector, 0.01, x),
                leader=LeaderReport(2, beacon),
                slot=FlownSlot(vector, vector, vector, 1, 1, x),
                home_enu_m=(x, x),
                law_values=(vector,) * law_of(law).publishes,
            )
        )
    )


def _rounded(value: float | None, digits: int) -> float | None:
    return round(value, digits) if value is not None and isfinite(value) else None
