"""The filter of a batch against that of the core. tests/lockstep compares whole flights."""

from math import inf

import numpy as np
import pytest

from companion.analysis.interaction import FloatArray
from companion.assembly import bounds_of, separation_settings_of
from companion.core.filter.motion import Ahead, Other
from companion.core.filter.vehicles import Barrier, Separation, eased
from companion.geometry.curves import approach_speed
from companion.geometry.formations import HEIGHT_WEIGHT
from companion.types.formation import FlownSlot
from companion.types.values import Vector3
from lockstep_fleet import platoon
from sitl.batch.columns import columns_of
from sitl.batch.filter import BatchBounds, BatchFilter, ChangedVehicles
from sitl.batch.flight import BatchStart, fly_batch, starts_at_rest
from sitl.batch.nearby import BatchSeparation, Heard, Moving, Pairs, approach_speeds, position_error_of
from sitl.batch.packets import ReceivedPackets
from sitl.flight.scenario import Scenario

COUNT = 3000
ALL = slice(0, COUNT)
NOISY = ("stand_in.sensors=px4_sih", "fleet.separation_m=0.7")
SPREAD_M, SPREAD_M_S, SPREAD_M_S2 = (1.5, 1.5, 1.0), (1.5, 1.5, 0.7), (1.5, 1.5, 1.0)


class States:
    """Random vehicles of the first column of a platoon, each with one other vehicle, which is that of the second column."""

    def __init__(self, scenario: Scenario) -> None:
        self.random = np.random.default_rng(1)
        self.scenario, self.columns = scenario, columns_of([scenario])
        now = np.concatenate([self.vectors(SPREAD_M), self.vectors(SPREAD_M_S)])
        self.moving = Moving(now, now[:3] + 0.2 * now[3:], now[3:] + 0.2 * self.vectors(SPREAD_M_S2))
        spreads = (SPREAD_M, SPREAD_M_S, SPREAD_M_S2, SPREAD_M_S2)
        last = np.concatenate([self.vectors(spread) for spread in spreads])
        last[:3] += self.random.choice([0.0, 3.0], COUNT)
        self.own, self.other = self.columns.column_of[:2].tolist()
        self.pairs = Pairs(
            place=np.arange(COUNT),
            own=np.full(COUNT, self.own),
            other=np.full(COUNT, self.other),
            last=last,
            age_s=self.random.choice([0.0, 0.002, 0.15], COUNT),
            formed=np.ones(COUNT, dtype=np.bool_),
        )

    def vectors(self, spread: Vector3) -> FloatArray:
        return self.random.standard_normal((3, COUNT)) * np.array(spread)[:, None]

    def slots_enu_m(self) -> FloatArray:
        members = sorted(self.scenario.fleet.vehicles, key=lambda member: member.id)
        return self.columns.in_columns(np.array([[member.slot_enu_m for member in members]]))

    def many(self) -> list[Scenario]:
        """So often that there are as many vehicles as states."""
        return [self.scenario] * (COUNT // self.columns.count)

    def separation(self) -> BatchSeparation:
        return BatchSeparation([self.scenario], self.columns, self.slots_enu_m())

    def barriers(self) -> list[Barrier]:
        """Those of the core."""
        slots = [FlownSlot((x, y, z)) for x, y, z in self.slots_enu_m().T.tolist()]
        error, moving, pairs = position_error_of(self.scenario), self.moving, self.pairs
        separation = Separation(separation_settings_of(self.scenario.fleet, 1))
        barriers = []
        for q, w, last, age_s in zip(
            moving.position_enu_m.T, moving.velocity_enu_m_s.T, pairs.last.T, pairs.age_s, strict=True
        ):
            motion, slot = (vector(last[:3]), vector(last[3:6]), vector(last[6:9])), slots[self.other]
            other = Other(
                2, motion, vector(last[9:]), age_s, None, error, HEIGHT_WEIGHT, slot, makes_way=True, side=1.0
            )
            barriers.append(separation.barrier(Ahead(vector(q), vector(w)), error, slots[self.own], other))
        return barriers


def vector(numbers: FloatArray) -> Vector3:
    x, y, z = numbers.tolist()
    return x, y, z


@pytest.mark.parametrize("overrides", [(), NOISY], ids=["ideal", "noisy"])
def test_vehicles_ask_what_they_ask_in_the_core(overrides: tuple[str, ...]) -> None:
    states = States(platoon(*overrides))
    asked = states.separation().asked(states.pairs, states.moving)
    barriers = states.barriers()
    close = asked.least_m_s2 == inf
    assert close.mean() < 0.1
    rows = np.array([barrier.constraint[:4] for barrier in barriers])
    np.testing.assert_allclose(asked.normal.T[~close], rows[~close, :3], atol=1e-9)
    np.testing.assert_allclose(asked.least_m_s2[~close], rows[~close, 3], rtol=1e-9, atol=1e-9)
    margins_m = np.array([(barrier.required_m, barrier.margin_m) for barrier in barriers])
    np.testing.assert_allclose(asked.margins_m.T[~close], margins_m[~close], atol=1e-9)


@pytest.mark.parametrize("overrides", [(), NOISY], ids=["ideal", "noisy"])
def test_only_what_surely_asks_nothing_is_left_out(overrides: tuple[str, ...]) -> None:
    """For no size of the acceleration a pair is left out that would ask for more, or ease it; and many are left out."""
    states = States(platoon(*overrides))
    pairs, moving = states.pairs, states.moving
    received = ReceivedPackets(
        np.zeros((COUNT, 1), dtype=np.int64), np.ones((COUNT, 1), np.bool_), pairs.age_s[:, None]
    )
    flown_m_s2 = np.maximum(np.linalg.norm(pairs.last[6:9], axis=0), np.linalg.norm(pairs.last[9:], axis=0))
    motions = np.concatenate([pairs.last[:6], flown_m_s2[None]])[:, :, None]
    heard = Heard(1000, received, motions, all_formed=True)
    many = states.many()
    separation = BatchSeparation(many, columns_of(many), np.zeros((3, COUNT)))
    barriers = states.barriers()
    least_m_s2 = np.array([barrier.constraint[3] for barrier in barriers])
    for most_m_s2 in (0.0, 2.0, 5.0, 12.0):
        may_ask = separation.may_ask(ALL, heard, moving, np.full(COUNT, most_m_s2))[:, 0]
        assert may_ask[least_m_s2 > -most_m_s2].all()
        assert may_ask[[is_eased(barrier, most_m_s2) for barrier in barriers]].all()
        assert (~may_ask).mean() > 0.12


def is_eased(barrier: Barrier, pull_m_s2: float) -> bool:
    """Whether the core eases an acceleration of this size straight towards the other vehicle."""
    nx, ny, nz = barrier.constraint[:3]
    wanted = (-pull_m_s2 * nx, -pull_m_s2 * ny, -pull_m_s2 * nz)
    return eased(wanted, [barrier]) is not wanted


def test_approach_speeds_are_those_of_the_core() -> None:
    distance_m, braking_m_s2 = np.linspace(-2.0, 3.0, 101), np.full(101, 2.0)
    speeds = np.array(approach_speeds(distance_m, braking_m_s2, 4.0, 1.5)).T
    np.testing.assert_allclose(speeds, [approach_speed(d, 2.0, 4.0, 1.5) for d in distance_m.tolist()], rtol=1e-12)


WALLS = "fleet.envelope={fence_min_enu_m: [-6, -5, -3], fence_max_enu_m: [5, 6, 4], max_speed_m_s: 2, max_climb_m_s: 1}"
OBSTACLE = "fleet.obstacles=[{kind: cylinder, centre_enu_m: [40, 40], radius_m: 1, bottom_m: 0, top_m: 9}]"


def test_bounds_matter_where_the_core_finds_one_violated() -> None:
    states = States(platoon(WALLS, "reference.point_enu_m=[1, 0, 1]"))
    fleet, moving = states.scenario.fleet, states.moving
    moving.position_enu_m[2] += 2.0
    wanted = states.vectors(SPREAD_M_S2)
    bounds = bounds_of(fleet)
    violated = []
    for q, w, u in zip(moving.position_enu_m.T, moving.velocity_enu_m_s.T, wanted.T, strict=True):
        ahead = Ahead(vector(q), vector(w))
        _, constraints = bounds.limit_speed(ahead, vector(u))
        constraints += bounds.constraints(ahead, (0.0, 0.0, 0.0))
        violated.append(any(least - float(u @ (nx, ny, nz)) > 1e-6 for nx, ny, nz, least, _ in constraints))
    many = states.many()
    matter = BatchBounds(many, columns_of(many)).matter(ALL, moving, wanted, 0.5 * wanted)
    assert 0.2 < np.mean(violated) < 0.8
    assert matter[violated].all()
    assert matter.mean() < np.mean(violated) + 0.1  # half of what is wanted violates a few more


def test_an_obstacle_may_always_matter() -> None:
    scenario = platoon(OBSTACLE)
    moving = Moving(np.zeros((6, 4)), np.full((3, 4), 1.0), np.zeros((3, 4)))
    still = np.zeros((3, 4))
    for one, matters in ((platoon(), False), (scenario, True)):
        assert (BatchBounds([one], columns_of([one])).matter(slice(0, 4), moving, still, still) == matters).all()


def test_a_flight_far_from_any_limit_is_the_same_to_the_last_bit(monkeypatch: pytest.MonkeyPatch) -> None:
    scenarios = [platoon("fleet.law.name=cooperative"), platoon("stand_in.sensors=default")]
    filtered = fly_batch(scenarios, 4.0).positions_enu_m
    monkeypatch.setattr(BatchFilter, "step", lambda *_: NOBODY)
    np.testing.assert_array_equal(filtered, fly_batch(scenarios, 4.0).positions_enu_m)


NOBODY = ChangedVehicles(np.zeros(0, dtype=np.int64), np.zeros((3, 0)), np.zeros(0))


def test_formations_in_one_batch_pass_each_other_as_alone() -> None:
    """Vehicles 2 and 3 exchange their places; in the other formation a vehicle starts on top of another."""
    exchanged = platoon(
        "starts_enu_m.2=[-3.0, 0.0, 0.0]", "starts_enu_m.3=[-1.5, 0.0, 0.0]", "fleet.law.name=cooperative"
    )
    on_top = platoon("fleet.law.name=cooperative", "links.peer_loss=0.2", "links.peer_jitter_s=0.03")
    scenarios = [exchanged, on_top]
    start = starts_at_rest(scenarios)
    start.positions_enu_m[1, 2] = start.positions_enu_m[1, 1] + (0.02, 0.01, 0.0)
    together = fly_batch(scenarios, 4.0, start=start)
    for b, scenario in enumerate(scenarios):
        of_one = BatchStart(start.positions_enu_m[b : b + 1], start.velocities_enu_m_s[b : b + 1])
        alone = fly_batch([scenario], 4.0, start=of_one).positions_enu_m[:, 0]
        np.testing.assert_allclose(together.positions_enu_m[:, b], alone, atol=1e-6)
        apart_m = np.linalg.norm(alone[:, 1] - alone[:, 2], axis=1)
        assert apart_m[100:].min() > 0.9
