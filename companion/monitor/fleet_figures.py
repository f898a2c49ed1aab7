"""Figures of a whole fleet: separation and its trend, convergence of the law, margin of the links, batteries, wind."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable, Mapping, Sequence
from functools import lru_cache
from itertools import combinations
from math import dist, inf

from companion.analysis.interaction import couple, time_to_shrink_s
from companion.analysis.response import reached_from
from companion.config.file import ConfigError
from companion.config.fleet import FleetConfig, RangeNeighbours
from companion.config.law import LawSection, law_of
from companion.geometry.formations import separation_distance_m
from companion.ground.fleet_state import SILENT_AFTER_S
from companion.monitor.api import BatteryView, FleetView, VehicleView
from companion.types.flight import STREAMING, Role
from companion.types.values import Vector3

TREND_S = 5.0
SAMPLE_S = 0.5
FIGURES_EVERY_S = 1.0
SHRUNK_TO = 0.1  # the settling time is until an error has shrunk to this share
BATTERY_WINDOW_S = 60.0
BATTERY_SAMPLE_S = 2.0
BATTERY_LEAST_S = 30.0  # autopilots report whole percents: of a shorter time the slope would be noise
MOST_LEFT_MIN = 180.0  # more is no flight time of a quadrotor: it stands on the ground, or is on mains

Pair = tuple[int, int]
Edges = frozenset[Pair]
Charges = deque[tuple[float, float]]  # time [s], charge [%]


class FleetFigures:
    """The figures of one fleet over time. `file` is None without the fleet file."""

    def __init__(self, name: str, file: FleetConfig | None) -> None:
        self._name = name
        self._file = file
        self._slots_enu_m = tuple([(member.id, member.slot_enu_m) for member in file.vehicles]) if file else ()
        self._separations: deque[tuple[float, float]] = deque(maxlen=int(TREND_S / SAMPLE_S) + 1)
        self._batteries = Batteries()
        self._figured_s = -inf
        self._convergence: tuple[float | None, float | None] = (None, None)
        self._link: tuple[float, Pair] | None = None

    def view(self, now_s: float, vehicles: Sequence[VehicleView]) -> FleetView:
        """Of these vehicles, all of this fleet."""
        fresh = [v for v in vehicles if not v.silent and v.data_age_s is not None and v.data_age_s <= SILENT_AFTER_S]
        positions = _positions_enu_m(fresh)
        among_them, unheard = smallest_separation(positions), nearest_unheard(fresh)
        smallest = min((found for found in (among_them, unheard) if found), default=None)
        if smallest and (not self._separations or now_s - self._separations[-1][0] >= SAMPLE_S - 1e-6):
            self._separations.append((now_s, smallest[0]))
        if now_s - self._figured_s >= FIGURES_EVERY_S - 1e-6:
            self._figured_s = now_s
            self._figure(fresh)
        leaders = tuple(v.vehicle_id for v in vehicles if v.role == Role.LEADER and not v.silent)
        return FleetView(
            name=self._name,
            vehicle_ids=tuple(v.vehicle_id for v in vehicles),
            missing_ids=self._missing(vehicles),
            leader_ids=leaders,
            smallest_separation_m=round(smallest[0], 3) if smallest else None,
            smallest_separation_pair=smallest[1] if smallest else None,
            smallest_separation_unheard=unheard is not None and smallest is unheard,
            separation_trend_m_s=self._trend_m_s(now_s),
            lambda_min=self._convergence[0],
            settling_s=self._convergence[1],
            link_margin_m=round(self._link[0], 3) if self._link else None,
            link_margin_pair=self._link[1] if self._link else None,
            data_age_worst_s=max(
                (v.data_age_s for v in vehicles if not v.silent and v.data_age_s is not None), default=None
            ),
            battery_lowest=self._batteries.lowest(now_s, vehicles),
            position_error_worst_m=max((v.position_error_m[0] for v in fresh if v.position_error_m), default=None),
            wind_acceleration_enu_m_s2=mean_wind_enu_m_s2(fresh),
        )

    def _missing(self, vehicles: Sequence[VehicleView]) -> tuple[int, ...]:
        if self._file is None:
            return ()
        return tuple(sorted({member.id for member in self._file.vehicles} - {v.vehicle_id for v in vehicles}))

    def _figure(self, vehicles: Sequence[VehicleView]) -> None:
        """Those of the law and of the links, which need the fleet file."""
        if self._file is None:
            return
        flying = {v.vehicle_id: v for v in vehicles if v.phase in STREAMING}
        edges = edges_of(flying)
        leaders = frozenset(i for i, v in flying.items() if v.role == Role.LEADER)
        self._convergence = convergence(frozenset(flying), edges, leaders, self._file.law, self._slots_enu_m)
        self._link = None
        if isinstance(self._file.neighbours, RangeNeighbours):
            reach_m = self._file.neighbours.range_m + self._file.neighbours.hysteresis_m
            self._link = weakest_link(_positions_enu_m(flying.values()), edges, reach_m)

    def _trend_m_s(self, now_s: float) -> float | None:
        """The slope of the line through the last five seconds; None before there are two of them."""
        samples = [(t, d) for t, d in self._separations if now_s - t <= TREND_S + SAMPLE_S]
        if len(samples) < 2 or samples[-1][0] - samples[0][0] < TREND_S / 2.5:
            return None
        mean_t = sum(t for t, _ in samples) / len(samples)
        mean_d = sum(d for _, d in samples) / len(samples)
        spread = sum([(t - mean_t) * (t - mean_t) for t, _ in samples])
        return round(sum([(t - mean_t) * (d - mean_d) for t, d in samples]) / spread, 3)


class Batteries:
    """The charges of the vehicles of one fleet over the last minute."""

    def __init__(self) -> None:
        self._samples: dict[int, Charges] = {}

    def lowest(self, now_s: float, vehicles: Sequence[VehicleView]) -> BatteryView | None:
        """Of the vehicles that report a charge; None without one. To be called again and again, with `now_s` rising."""
        charges = {v.vehicle_id: v.battery_percent for v in vehicles if not v.silent and v.battery_percent is not None}
        self._samples = {i: self._samples.get(i) or Charges() for i in charges}
        for vehicle_id, percent in charges.items():
            samples = self._samples[vehicle_id]
            if samples and now_s < samples[-1][0]:  # a replay has gone back
                samples.clear()
            if not samples or now_s - samples[-1][0] >= BATTERY_SAMPLE_S:
                samples.append((now_s, percent))
            while samples[0][0] < now_s - BATTERY_WINDOW_S or percent > samples[0][1]:  # charged, or another battery
                samples.popleft()
                if not samples:
                    samples.append((now_s, percent))
        if not charges:
            return None
        lowest = min(charges, key=lambda i: (charges[i], i))
        return BatteryView(lowest, charges[lowest], left_min(self._samples[lowest], charges[lowest]))


def left_min(samples: Charges, percent: float) -> float | None:
    """By the straight line through the samples."""
    if samples[-1][0] - samples[0][0] < BATTERY_LEAST_S:
        return None
    mean_s = sum(t for t, _ in samples) / len(samples)
    mean_percent = sum(charge for _, charge in samples) / len(samples)
    spread = sum((t - mean_s) ** 2 for t, _ in samples)
    percent_s = sum((t - mean_s) * (charge - mean_percent) for t, charge in samples) / spread
    if percent_s >= 0.0 or (minutes := percent / -percent_s / 60.0) > MOST_LEFT_MIN:
        return None
    return round(minutes, 1)


def mean_wind_enu_m_s2(vehicles: Iterable[VehicleView]) -> Vector3 | None:
    """What the agents estimate while they send setpoints; None where none does."""
    winds = [v.wind_acceleration_enu_m_s2 for v in vehicles if v.phase in STREAMING]
    if not winds:
        return None
    x, y, z = (round(sum(axis) / len(winds), 3) for axis in zip(*winds, strict=True))
    return x, y, z


def _positions_enu_m(vehicles: Iterable[VehicleView]) -> dict[int, Vector3]:
    return {vehicle.vehicle_id: place for vehicle in vehicles if (place := vehicle.position_enu_m) is not None}


def smallest_separation(positions_enu_m: Mapping[int, Vector3]) -> tuple[float, Pair] | None:
    """In the metric of `separation_m`, with the pair; None with fewer than two vehicles."""
    pairs = combinations(positions_enu_m.items(), 2)
    distances = ((separation_distance_m(a, b), (i, j)) for (i, a), (j, b) in pairs)
    return min(distances, default=None)


def nearest_unheard(vehicles: Sequence[VehicleView]) -> tuple[float, Pair] | None:
    """The nearest vehicle that does not report here, as the one nearest to it sees it: where it was last, or may be by now."""
    heard = {v.vehicle_id for v in vehicles}
    seen = [(v.nearest.distance_m, v.vehicle_id, v.nearest.name) for v in vehicles if v.nearest]
    unheard = [(d, (i, int(name))) for d, i, name in seen if name.isdecimal() and int(name) not in heard]
    return min(unheard, default=None)


def edges_of(vehicles: Mapping[int, VehicleView]) -> Edges:
    """Pairs of these vehicles of which at least one uses the other as neighbour."""
    return frozenset(
        (min(i, n.vehicle_id), max(i, n.vehicle_id))
        for i, vehicle in vehicles.items()
        for n in vehicle.neighbours
        if n.vehicle_id in vehicles and n.vehicle_id != i
    )


@lru_cache(maxsize=64)
def convergence(
    vehicle_ids: frozenset[int],
    edges: Edges,
    leaders: frozenset[int],
    settings: LawSection,
    slots_enu_m: tuple[tuple[int, Vector3], ...] = (),
) -> tuple[float | None, float | None]:
    """(smallest eigenvalue of G, predicted time to a tenth of an error in s).

    (None, None) without a vehicle in formation, or where the law fails. (0, None) where a vehicle has no path to a leader.
    """
    if not vehicle_ids:
        return None, None
    graph: dict[int, list[int]] = {i: [] for i in vehicle_ids}
    for i, j in edges:
        graph[i].append(j)
        graph[j].append(i)
    if reached_from(graph, leaders) != vehicle_ids:
        return 0.0, None
    try:
        coupling = couple(graph, leaders, law_of(settings), dict(slots_enu_m))
    except ConfigError:
        return None, None
    settling_s = time_to_shrink_s(coupling.rate_1_s, 1.0, SHRUNK_TO)
    return round(float(coupling.spectrum[0]), 4), round(settling_s, 2) if settling_s < inf else None


def weakest_link(positions_enu_m: Mapping[int, Vector3], edges: Edges, reach_m: float) -> tuple[float, Pair] | None:
    """How much farther apart the weakest link that holds the fleet together may get, m, with its pair.

    Of the links only the shortest ones that connect all vehicles count (a minimum spanning tree): to lose a longer one changes
    no path to a leader. None without a link.
    """
    longest: tuple[float, Pair] | None = None
    part = {i: i for i in positions_enu_m}

    def root(i: int) -> int:
        while part[i] != i:
            i = part[i]
        return i

    for length_m, (i, j) in sorted((dist(positions_enu_m[i], positions_enu_m[j]), (i, j)) for i, j in edges):
        if (a := root(i)) != (b := root(j)):
            part[a] = b
            longest = (length_m, (i, j))
    return (reach_m - longest[0], longest[1]) if longest else None
