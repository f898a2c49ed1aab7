"""Laws of a batch: asked about many vehicles in arrays, about one where they cannot, and given up where they fail."""

import re
from pathlib import Path

import numpy as np
import pytest
from msgspec.structs import replace

from lockstep_fleet import platoon
from sitl.batch.flight import BatchFlight, fly_batch
from sitl.batch.laws import FEW
from sitl.batch.metrics import batch_figures
from sitl.flight.scenario import Scenario

MANY = 2 * FEW  # formations of one seed: so many vehicles tick together
FLOWN_S = 3.0

# Feedback of the mean of the neighbours, of its integral, and of what they publish.
PLAIN = """\
from companion.laws import Gain, Law

class Mine(Law, frozen=True):
    memory = 1
    publishes = 1
    gain: Gain = 1.4

    def off(self, own, neighbours, reference):
        seen = [*neighbours, reference] if reference is not None else neighbours or [own]
        return tuple(
            own.position_enu_m[k] - sum(one.position_enu_m[k] for one in seen) / len(seen) for k in range(3)
        )

    def acceleration(self, own, neighbours, reference):
        wanted = []
        for axis, off in enumerate(self.off(own, neighbours, reference)):
            others = sum(one.values[0][axis] for one in neighbours) / max(1, len(neighbours))
            left = own.velocity_enu_m_s[axis] - 0.3 * others
            wanted.append(-self.gain * off - 1.5 * left - 0.1 * own.memory[0][axis])
        return tuple(wanted)

    def remember(self, own, neighbours, reference):
        off = self.off(own, neighbours, reference)
        return (tuple(m + own.step_s * o for m, o in zip(own.memory[0], off)),)

    def publish(self, own, neighbours, reference):
        return (own.velocity_enu_m_s,)
"""
COMPARES = PLAIN.replace("        wanted = []\n", "        wanted = [] if own.position_enu_m[0] < 1e6 else None\n")
# Right of one vehicle, and wrong of many at once without an error.
MIXES = PLAIN.replace(
    "        return tuple(wanted)",
    "        import numpy\n        return tuple(x * (1.0 + 0.1 * numpy.linalg.norm(own.velocity_enu_m_s)) for x in wanted)",
)
OF_SECOND = "0.0 / (own.slot_enu_m[0] + 1.5)"
FAILS = PLAIN.replace("return tuple(wanted)", f"return (wanted[0] + {OF_SECOND}, *wanted[1:])")
TOO_LARGE = "1e308 * own.slot_enu_m[0] * own.slot_enu_m[0]"
NOT_FINITE = PLAIN.replace("return tuple(wanted)", f"return (wanted[0] + {TOO_LARGE}, *wanted[1:])")


def flown_by(law: str, folder: Path, *overrides: str, gains: tuple[float, ...] = (1.4,) * MANY) -> list[Scenario]:
    """Platoons that fly this law, one for each gain."""
    file = folder / "mine.py"
    file.write_text(law)
    scenario = platoon(*overrides)
    section = scenario.fleet.law.with_name(str(file))
    sections = [replace(section, parameters={"gain": gain}) for gain in gains]
    return [replace(scenario, fleet=replace(scenario.fleet, law=one)) for one in sections]


def fly(scenarios: list[Scenario]) -> BatchFlight:
    return fly_batch(scenarios, FLOWN_S)


def test_a_law_flies_in_arrays_as_vehicle_by_vehicle(tmp_path: Path) -> None:
    (tmp_path / "other").mkdir()
    gains = tuple(np.linspace(1.0, 2.0, MANY).tolist())
    scenarios = flown_by(PLAIN, tmp_path, gains=gains)
    arrays = fly(scenarios)
    assert arrays.remarks == {}
    alone = fly(flown_by(COMPARES, tmp_path / "other", gains=gains))
    np.testing.assert_allclose(arrays.positions_enu_m, alone.positions_enu_m, atol=1e-6)
    assert sorted(alone.remarks) == list(range(MANY))
    (remark,) = set(alone.remarks.values())
    assert remark.startswith("flown vehicle by vehicle, slower and with the same result, as it takes no arrays (line 1")
    assert "truth value" in remark
    for b in (0, MANY - 1):  # the gains do differ
        np.testing.assert_allclose(arrays.positions_enu_m[:, b], fly([scenarios[b]]).positions_enu_m[:, 0], atol=1e-6)
    assert np.abs(arrays.positions_enu_m[-1, 0] - arrays.positions_enu_m[-1, -1]).max() > 0.01


def test_a_law_that_gives_something_else_for_arrays_flies_vehicle_by_vehicle(tmp_path: Path) -> None:
    scenarios = flown_by(MIXES, tmp_path)
    together = fly(scenarios)
    assert all("ValueError: arrays give other results" in remark for remark in together.remarks.values())
    assert len(together.remarks) == MANY
    np.testing.assert_allclose(together.positions_enu_m[:, 3], fly(scenarios[:1]).positions_enu_m[:, 0], atol=1e-6)


@pytest.mark.parametrize(
    ("law", "reason"),
    [(FAILS, "vehicle 2: line [0-9]+: ZeroDivisionError"), (NOT_FINITE, "vehicle .: the law gives .*inf")],
)
def test_a_law_that_fails_ends_its_formation_alone(law: str, reason: str, tmp_path: Path) -> None:
    scenarios = [platoon(), *flown_by(law, tmp_path)]
    flight = fly(scenarios)
    assert sorted(flight.failures) == list(range(1, MANY + 1))
    assert all(re.search(f"^ended after 0.0[24] s: {reason}", text) for text in flight.failures.values())
    assert np.isnan(flight.positions_enu_m[3:, 1:]).all()
    np.testing.assert_array_equal(flight.positions_enu_m[:, 0], fly([platoon()]).positions_enu_m[:, 0])
    settle_s = batch_figures(flight).settle_s
    assert np.isnan(settle_s[1:]).all()


def test_neighbours_that_come_and_go_are_as_many_for_any_law() -> None:
    """The average law weighs its neighbours, and is asked about vehicles with one and with two of them at once."""
    lossy = [
        platoon(
            "fleet.law.name=average_22", "links.peer_loss=0.7", "fleet.peers.max_age_s=0.1", f"stand_in.seed={seed}"
        )
        for seed in range(1, 5 * MANY)
    ]
    together = fly_batch(lossy, 1.0, keep_neighbours=True)
    assert together.neighbours is not None
    assert len(np.unique(together.neighbours.sum(axis=3))) == 3
    for b in (0, 7):
        alone = fly_batch([lossy[b]], 1.0).positions_enu_m[:, 0]
        np.testing.assert_allclose(together.positions_enu_m[:, b], alone, atol=1e-6)
