"""Laws of any form: as numbers, against the closed forms of the built-in ones, and flown tick by tick."""

# ruff: noqa: ARG002 -- methods of laws have the arguments of laws
from __future__ import annotations

import json
from collections import deque
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import ClassVar

import numpy as np
import pytest
import yaml

from common import ROOT
from companion.analysis.compression import Chain
from companion.analysis.interaction import Coupling, couple, eigenvalues
from companion.analysis.linear_law import ALONG_X, NEAR, NOWHERE, linearised
from companion.analysis.margins import delay_margin_with_lag_s, is_stable, string_gains
from companion.analysis.prediction import DIVERGED_M, errors_over_time
from companion.analysis.response import TICK_S, LinearModel, flown_model
from companion.cli.main import main
from companion.config.file import ConfigError
from companion.laws import FormationState, Law, Memory, Neighbour, Own, Values
from companion.laws._neighbour_feedback import NeighbourFeedback
from companion.types.autopilot import AutopilotKind
from companion.types.formation import Gains
from companion.types.values import ZERO3, Vector3
from sitl.flight.flights import DivergesError, check_convergence
from sitl.flight.scenario import load_scenario
from tests.helpers.closed_forms import fed_forward, interaction_matrix, mode_eigenvalues, mode_figures, symmetric_like
from tests.helpers.law_files.by_distance import ByDistance
from tests.helpers.law_files.integral import Integral
from tests.helpers.law_files.two_in_series import TwoInSeries
from tests.helpers.laws import average_22, average_26, cooperative, law_of, weighted

Graph = dict[int, list[int]]
LAW_FILES = ROOT / "tests" / "helpers" / "law_files"
BUILT_IN = [
    weighted(),
    average_22(),
    average_26(),
    cooperative(),
    law_of(Gains(1.0, 2.0), 1.0, False, 0.9),
    law_of(Gains(6.0, 5.0), 8.0, True, 0.3),
]
ONE_AXIS = (ZERO3, (1.0, 0.0, 0.0))


def chain(n: int) -> Graph:
    return {i: [j for j in (i - 1, i + 1) if 1 <= j <= n] for i in range(1, n + 1)}


GRID = {i: [j for j in range(9) if abs(i // 3 - j // 3) + abs(i % 3 - j % 3) == 1] for i in range(9)}
GRAPHS: list[tuple[Graph, set[int]]] = [
    (chain(1), {1}),
    (chain(2), {1}),
    (chain(16), {16}),
    (chain(60), {1}),
    (GRID, {0, 5}),
]


# ---------------------------------------------------------------- built-in laws, against their closed forms


@pytest.mark.parametrize(("graph", "leaders"), GRAPHS)
@pytest.mark.parametrize("law", BUILT_IN)
def test_spectra_and_modes_are_those_of_the_closed_forms(
    graph: Graph, leaders: set[int], law: NeighbourFeedback
) -> None:
    coupling, expected = couple(graph, leaders, law), interaction_matrix(graph, leaders, law)
    modes = [mode_figures(law.gains, value) for value in mode_eigenvalues(graph, leaders, law)]
    assert pytest.approx(expected, abs=1e-12) == coupling.G
    assert coupling.spectrum == pytest.approx(np.linalg.eigvalsh(symmetric_like(expected)), abs=1e-9)
    assert coupling.rate_1_s == pytest.approx(min(mode.rate_1_s for mode in modes), abs=1e-9)
    assert coupling.damping == pytest.approx(min(1.0, *[mode.damping for mode in modes], 1.0), abs=1e-9)


@pytest.mark.parametrize(("graph", "leaders"), GRAPHS)
@pytest.mark.parametrize("law", BUILT_IN)
@pytest.mark.parametrize("model", [LinearModel(drag_1_s=0.3), flown_model(link_s=0.1)], ids=["lag", "flown"])
def test_responses_are_those_of_the_closed_form(
    graph: Graph, leaders: set[int], law: NeighbourFeedback, model: LinearModel
) -> None:
    """[(I - g W e^{-s l}) A e^{sd} / H + (k1 + k2 s)(D - W e^{-s m})] y = (k1 + k2 s + g A) L r, with A = s^2 + c s."""
    matrix, forward = interaction_matrix(graph, leaders, law), fed_forward(graph, leaders, law)
    own, leads = np.diag(np.diag(matrix)), np.array([i in leaders for i in sorted(graph)])
    coupling = couple(graph, leaders, law, drag_1_s=model.drag_1_s)
    for omega in (0.05, 0.7, 5.0):
        s = 1j * omega
        plant, back = s * (s + model.drag_1_s), law.position_gain_1_s2 + law.velocity_gain_1_s * s
        loop = own - (own - matrix) * np.exp(-s * model.neighbour_delay_s)
        vehicle = plant * np.exp(s * model.delay_s) / model.flown_share(s)
        left = vehicle * (np.eye(len(own)) - forward * np.exp(-s * model.feedforward_delay_s)) + back * loop
        expected = np.linalg.solve(left, (back + law.feedforward * plant) * leads)
        assert coupling.loop.response(omega, model) == pytest.approx(expected, abs=1e-9)


def test_an_unstable_pair_of_leaders_is_not_taken_for_stable() -> None:
    """Roots by Pade filters of order 6 cross the axis at 0.0493 s (test_delay_margin.py)."""
    ring = {i: [(i - 1) % 16, (i + 1) % 16] for i in range(16)}
    coupling = couple(ring, {1, 3}, weighted(Gains(1.39, 0.36)))
    assert delay_margin_with_lag_s(coupling, LinearModel()) == pytest.approx(0.0493, rel=2e-3)


# ---------------------------------------------------------------- laws in files, against their flight tick by tick


def flown(coupling: Coupling, start_m: Sequence[float], late: int, ticks: int, slots: dict[int, Vector3]) -> np.ndarray:
    """Positions (ticks, n) of double integrators on x; states and values of neighbours are `late` ticks old."""
    law, network = coupling.law, coupling.network
    ids, leads = network.ids, dict(zip(network.ids, coupling.is_leader, strict=True))
    state = {i: (x, 0.0) for i, x in zip(ids, start_m, strict=True)}
    memory: dict[int, Memory] = dict.fromkeys(ids, (ZERO3,) * law.memory)
    command = dict.fromkeys(ids, 0.0)
    at_rest: dict[int, Values] = {
        i: tuple([(float(v), 0.0, 0.0) for v in (coupling.published @ np.array(start_m)).reshape(-1, len(ids))[:, k]])
        for k, i in enumerate(ids)
    }
    sent = deque([(state, command, at_rest)] * late, maxlen=late)
    track = []
    for _ in range(ticks):
        track.append([state[i][0] for i in ids])
        heard_state, heard_command, heard_values = sent[0]
        commands: dict[int, float] = {}
        values: dict[int, Values] = {}
        for i in ids:
            neighbours = [
                Neighbour(
                    (heard_state[j][0], 0.0, 0.0),
                    (heard_state[j][1], 0.0, 0.0),
                    (heard_command[j], 0.0, 0.0),
                    network.prcs[j],
                    slots[j],
                    values=heard_values[j],
                )
                for j in network.neighbours[i]
            ]
            reference = FormationState(ZERO3, ZERO3) if leads[i] else None
            (x, v) = state[i]
            own = Own((x, 0.0, 0.0), (v, 0.0, 0.0), (command[i], 0.0, 0.0), slots[i], memory=memory[i])
            commands[i] = law.acceleration(own, neighbours, reference)[0]
            if law.memory:
                memory[i] = law.remember(own, neighbours, reference)
            own = Own((x, 0.0, 0.0), (v, 0.0, 0.0), (commands[i], 0.0, 0.0), slots[i], memory=memory[i])
            values[i] = law.publish(own, neighbours, reference) if law.publishes else ()
        sent.append((state, commands, values))
        command = commands
        state = {
            i: (x + v * TICK_S + 0.5 * command[i] * TICK_S**2, v + command[i] * TICK_S) for i, (x, v) in state.items()
        }
    return np.array(track)


class Everything(Law, frozen=True):
    """Uses all that a law may: last command, two memories, and values that depend on all of them."""

    memory: ClassVar[int] = 2
    publishes: ClassVar[int] = 2

    def acceleration(self, own: Own, neighbours: Sequence[Neighbour], reference: FormationState | None) -> Vector3:
        to = [reference] if reference else neighbours
        x = sum(1.2 * (o.position_enu_m[0] - own.position_enu_m[0]) for o in to) / len(to)
        x += sum(1.9 * (o.velocity_enu_m_s[0] - own.velocity_enu_m_s[0]) for o in to) / len(to)
        x += sum(0.1 * n.values[0][0] - 0.05 * n.values[1][0] + 0.2 * n.acceleration_enu_m_s2[0] for n in neighbours)
        x += 0.1 * own.acceleration_enu_m_s2[0] - 0.2 * own.memory[0][0] + 0.1 * own.memory[1][0]
        return (x, 0.0, 0.0)

    def remember(self, own: Own, neighbours: Sequence[Neighbour], reference: FormationState | None) -> Memory:
        first = 0.9 * own.memory[0][0] + 0.1 * own.velocity_enu_m_s[0] - 0.02 * own.memory[1][0]
        second = 0.8 * own.memory[1][0] + sum(0.1 * n.values[1][0] + 0.02 * n.position_enu_m[0] for n in neighbours)
        second -= 0.02 * own.position_enu_m[0] * len(neighbours) + 0.03 * own.acceleration_enu_m_s2[0]
        return ((first, 0.0, 0.0), (second, 0.0, 0.0))

    def publish(self, own: Own, neighbours: Sequence[Neighbour], reference: FormationState | None) -> Values:
        first = own.velocity_enu_m_s[0] + 0.2 * own.memory[0][0] + 0.3 * own.acceleration_enu_m_s2[0]
        second = 0.1 * own.memory[1][0] + sum(
            0.2 * n.values[0][0] + 0.1 * n.acceleration_enu_m_s2[0] for n in neighbours
        )
        return ((first, 0.0, 0.0), (second, 0.0, 0.0))


SLOTS = {i: (-1.5 * i, 0.4 * (i % 3), 0.0) for i in range(9)} | {9: (-9.0, 3.0, 0.0)}
CASES = [(Integral(), 1.0, 1e-9), (TwoInSeries(), 1.0, 1e-9), (Everything(), 1.0, 1e-9), (ByDistance(), 0.01, 0.02)]


@pytest.mark.parametrize("late", [1, 3])
@pytest.mark.parametrize(("law", "size_m", "tolerance"), CASES)
def test_the_prediction_is_the_flight_tick_by_tick(law: Law, size_m: float, tolerance: float, late: int) -> None:
    coupling = couple(GRID, {0}, law, SLOTS)
    start_m = [size_m * x for x in (1.0, -0.5, 0.3, 0.8, -1.0, 0.2, 0.1, -0.7, 0.6)]
    model = LinearModel(0.0, 0.5 * TICK_S, late * TICK_S, late * TICK_S)
    predicted_m = errors_over_time(coupling, np.array(start_m)[:, np.newaxis], model, 12.0)[..., 0]
    track_m = flown(coupling, start_m, late, len(predicted_m), SLOTS)
    assert np.abs(track_m[-1]).max() < 0.5 * size_m
    assert predicted_m == pytest.approx(track_m, abs=tolerance * size_m)


@pytest.mark.parametrize("law", [Integral(), TwoInSeries(), ByDistance()])
def test_errors_decay_at_the_rate_of_the_slowest_mode(law: Law) -> None:
    coupling = couple(GRID, {0}, law, SLOTS)
    model = LinearModel(0.0, 0.5 * TICK_S, TICK_S, TICK_S)
    errors_m = np.abs(errors_over_time(coupling, np.full((9, 1), 1.0), model, 120.0)).max(axis=(1, 2))
    peaks = [errors_m[k : k + 1000].max() for k in (1000, 2000)]
    assert np.log(peaks[0] / peaks[1]) / 20.0 == pytest.approx(coupling.rate_1_s, rel=0.1)


@pytest.mark.parametrize("model", [LinearModel(), flown_model(link_s=0.1)], ids=["lag", "flown"])
@pytest.mark.parametrize("law", [Integral(), TwoInSeries(), ByDistance(), Integral(integral_gain_1_s3=1.2)])
def test_the_prediction_diverges_only_above_the_delay_margin(law: Law, model: LinearModel) -> None:
    coupling = couple(GRID, {0}, law, SLOTS)
    margin_s = delay_margin_with_lag_s(coupling, model)
    assert margin_s > 0.02
    assert not grows(coupling, replace(model, delay_s=0.97 * margin_s))
    assert grows(coupling, replace(model, delay_s=1.05 * margin_s))


def grows(coupling: Coupling, model: LinearModel) -> bool:
    start_m = np.linspace(-0.3, 1.0, len(coupling.prcs))[:, np.newaxis]
    errors_m = np.abs(errors_over_time(coupling, start_m, model, 240.0)).max(axis=(1, 2))
    quarter = len(errors_m) // 4
    return bool(errors_m[-1] > DIVERGED_M or errors_m[-quarter:].max() > errors_m[-2 * quarter : -quarter].max())


class Runaway(Integral, frozen=True):
    """Its memory grows by itself, though nothing uses it."""

    def remember(self, own: Own, neighbours: Sequence[Neighbour], reference: FormationState | None) -> Memory:
        return tuple([(1.1 * x, 1.1 * y, 1.1 * z) for x, y, z in own.memory])


def test_a_memory_that_grows_by_itself_is_unstable() -> None:
    assert is_stable(couple(chain(3), {1}, Integral()), LinearModel())
    assert not is_stable(couple(chain(3), {1}, Runaway(integral_gain_1_s3=0.0)), LinearModel())


@pytest.mark.parametrize("law", [TwoInSeries(), ByDistance(), Integral()])
def test_any_law_follows_a_slow_reference(law: Law) -> None:
    chained = Chain(law, chain(4), frozenset({1}), 0.0, 12.0, 4.5, SLOTS)
    assert [abs(one - 1.0) < 1e-3 for one in chained.responses(1e-3).values()] == [True] * 4
    coupling = couple(chain(4), {1}, law, SLOTS)
    assert [*chained.responses(0.8).values()] == pytest.approx(coupling.loop.response(0.8, LinearModel()), abs=1e-9)
    gains = string_gains(coupling, LinearModel())
    assert gains is not None
    assert gains.to_last >= gains.per_hop >= 1.0


# ---------------------------------------------------------------- one law as numbers


def test_an_integral_law_as_numbers() -> None:
    linear = linearised(Integral(), False, [2, 1], [ZERO3] * 3)
    assert linear.own == ((-2.0, -2.4, 0.0, -0.3), (0.02, 0.0, 0.0, 1.0))
    assert linear.neighbours == (((0.0, 0.0, 0.0), (0.0, 0.0, 0.0)), ((2.0, 2.4, 0.0), (-0.02, 0.0, 0.0)))
    assert linear.remarks == ()
    assert linearised(Integral(), True, [2], ONE_AXIS).reference == ((2.0, 2.4, 0.0), (-0.02, 0.0, 0.0))


def test_slots_count_only_for_a_law_that_reads_them() -> None:
    near, far = ((0.0, 0.0, 0.0), (1.0, 0.0, 0.0), (4.0, 0.0, 0.0)), ((0.0, 0.0, 0.0), (4.0, 0.0, 0.0), (1.0, 0.0, 0.0))
    one, other = (linearised(ByDistance(), False, [1, 1], slots) for slots in (near, far))
    assert one.neighbours[0][0][0] == pytest.approx(0.75 * 1.5, rel=1e-5)
    assert other.neighbours[0][0][0] == pytest.approx(0.25 * 1.5, rel=1e-5)
    assert one.remarks == (NEAR,)
    assert linearised(Integral(), False, [1, 1], near) is linearised(Integral(), False, [1, 1], far)


class Saturating(Law, frozen=True):
    """At most 0.2 m/s^2 from the position."""

    def acceleration(self, own: Own, neighbours: Sequence[Neighbour], reference: FormationState | None) -> Vector3:
        x, y, z = (self._of(p, v) for p, v in zip(own.position_enu_m, own.velocity_enu_m_s, strict=True))
        return (x, y, z)

    def _of(self, position_m: float, velocity_m_s: float) -> float:
        return -min(max(2.0 * position_m, -0.2), 0.2) - velocity_m_s


class Trimming(Saturating, frozen=True):
    """Only in one direction."""

    def _of(self, position_m: float, velocity_m_s: float) -> float:
        return -max(position_m, 0.0) - velocity_m_s


class OtherHeight(Saturating, frozen=True):
    """Half the gain on z."""

    def acceleration(self, own: Own, neighbours: Sequence[Neighbour], reference: FormationState | None) -> Vector3:
        x, y, z = own.position_enu_m
        return (-x, -y, -0.5 * z)


@pytest.mark.parametrize(
    ("law", "remarks", "gain"),
    [(Saturating(), (NEAR,), 2.0), (Trimming(), (NOWHERE,), 0.5), (OtherHeight(), (ALONG_X,), 1.0)],
)
def test_a_law_that_is_not_linear_says_so(law: Law, remarks: tuple[str, ...], gain: float) -> None:
    linear = linearised(law, True, [], [ZERO3])
    assert linear.remarks == remarks
    assert linear.own[0][0] == pytest.approx(-gain)


class Short(Integral, frozen=True):
    """Forgets its memory."""

    def remember(self, own: Own, neighbours: Sequence[Neighbour], reference: FormationState | None) -> Memory:
        return ()


class Failing(Integral, frozen=True):
    """Does not expect to be alone."""

    def acceleration(self, own: Own, neighbours: Sequence[Neighbour], reference: FormationState | None) -> Vector3:
        return neighbours[1].position_enu_m


@pytest.mark.parametrize(("law", "said"), [(Short(), "expected 1 vectors"), (Failing(), "IndexError")])
def test_a_law_that_fails_is_named_in_one_line(law: Law, said: str) -> None:
    with pytest.raises(ConfigError) as failed:
        couple(chain(3), {1}, law)
    assert type(law).__name__ in str(failed.value)
    assert said in str(failed.value)
    assert "\n" not in str(failed.value)


def test_eigenvalues_of_a_cycle_in_one_direction_are_real_parts() -> None:
    cycle = np.eye(3) * 1.5 - np.roll(np.eye(3), 1, axis=1)
    assert eigenvalues(cycle) == pytest.approx([0.5, 2.0, 2.0])


# ---------------------------------------------------------------- fleets with a law in a file


def scenario(folder: Path, law: str, **parameters: float) -> Path:
    data = yaml.safe_load((ROOT / "config" / "scenarios" / "four_in_line.yaml").read_text())
    (folder / f"{law}.py").write_text((LAW_FILES / f"{law}.py").read_text())
    data["fleet"]["law"] = {"name": law, "file": f"{law}.py", "parameters": parameters}
    (folder / "scenario.yaml").write_text(yaml.safe_dump(data))
    return folder / "scenario.yaml"


@pytest.mark.parametrize("law", ["integral", "by_distance", "two_in_series"])
def test_a_fleet_with_a_law_in_a_file_is_analysed(tmp_path: Path, law: str, capsys: pytest.CaptureFixture[str]) -> None:
    path = scenario(tmp_path, law)
    assert main(["analyze", str(path), "--json"]) == 0
    figures = json.loads(capsys.readouterr().out)
    assert list(figures["laws"]) == ["cooperative", "weighted", "average_22", "average_26", law]
    own = figures["laws"][law]
    assert own["stable"]
    assert own["predicted_settle_s"] < 60.0
    assert own["feedforward"] is None
    assert (own["more_velocity_gain_helps"] is None) == (law != "integral")
    check_convergence(load_scenario(path))


def test_advice_on_gains_needs_the_parameters(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = scenario(tmp_path, "by_distance", k1=9.0)
    assert main(["analyze", str(path)]) == 1
    assert "no advice on gains" in " ".join(capsys.readouterr().out.split())
    with pytest.raises(DivergesError, match="by_distance is unstable"):
        check_convergence(load_scenario(path))


def test_the_law_of_a_file_that_cannot_keep_the_pace_is_refused(tmp_path: Path) -> None:
    data = yaml.safe_load(scenario(tmp_path, "two_in_series").read_text())
    data["reference"] = {
        "kind": "figure_8",
        "centre_enu_m": [0.0, 0.0, 5.0],
        "width_m": 16.0,
        "height_m": 8.0,
        "period_s": 14.0,
    }
    (tmp_path / "scenario.yaml").write_text(yaml.safe_dump(data))
    with pytest.raises(ConfigError, match="with two_in_series"):
        load_scenario(tmp_path / "scenario.yaml")


def test_the_margin_without_lag_of_a_sampled_integral_is_that_of_the_continuous_loop() -> None:
    """One vehicle with its reference: (k2 s + k1 + k3/s) e^(-sd) / s^2 crosses 1 once, and its phase margin is the delay."""
    omega = np.geomspace(0.5, 10.0, 20_000)
    loop = (2.4j * omega + 2.0 + 0.3 / (1j * omega)) / (1j * omega) ** 2
    crossing = int(np.argmin(np.abs(np.abs(loop) - 1.0)))
    margin_s = (np.pi + np.angle(loop[crossing])) % (2.0 * np.pi) / omega[crossing]
    found_s = delay_margin_with_lag_s(couple(chain(1), {1}, Integral()), LinearModel(0.0, 0.0, 0.0))
    assert found_s == pytest.approx(margin_s, abs=0.01)


class Counting(Integral, frozen=True):
    """As Integral, and it counts its positions, which changes nothing."""

    memory: ClassVar[int] = 2

    def remember(self, own: Own, neighbours: Sequence[Neighbour], reference: FormationState | None) -> Memory:
        return (*Integral.remember(self, own, neighbours, reference), (own.memory[1][0] + 1.0, 0.0, 0.0))


def test_a_counter_in_the_memory_does_not_make_a_formation_unstable() -> None:
    linear = linearised(Counting(), False, [1], [ZERO3] * 2)
    assert linear.own[1] == (0.02, 0.0, 0.0, 1.0, 0.0)  # the integral stays
    assert set(linear.own[2]) == {0.0}
    model = flown_model(AutopilotKind.PX4, 0.001, 0.0)
    counting, plain = (couple(chain(3), {1}, law) for law in (Counting(), Integral()))
    assert is_stable(counting, model)
    assert delay_margin_with_lag_s(counting, model) == pytest.approx(delay_margin_with_lag_s(plain, model), abs=1e-3)
