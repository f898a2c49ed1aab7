"""The bench's arithmetic: medians, ratios and targets, lateness on a grid, and windows of a flight."""

from __future__ import annotations

from pathlib import Path

import pytest

from agent_on_bytes import FailingFlight
from companion.recording.records import TimingRecord
from companion.recording.writing import WritingAtOnce
from companion.types.autopilot import AutopilotKind, PositionSample
from companion.types.values import ZERO3
from recordings import recorder
from tests.bench.batch import section as batch_section
from tests.bench.control_loop import rate_of_slowest_hz
from tests.bench.figures import AgentsUse, Row, Target, Window, cpu_percent, lateness_us, percentile, windows_of, within
from tests.bench.peer_states import section as peers_section
from tests.bench.processes import CoreTime, stolen_percent, used_by_others
from tests.bench.programs.peer_vehicle import Ages, PeerAges
from tests.bench.real_flight import Flown, delays_of_ticks
from tests.bench.resources import FEW, MANY, SOME
from tests.bench.resources import section as resources_section

pytestmark = pytest.mark.long


def row(*values: float, beside: tuple[float, ...] = (), target: Target | None = None) -> Row:
    name = "other" if beside else ""
    return Row(what="x", unit="us", values=values, beside=name, beside_values=beside, target=target)


def test_a_figure_is_the_median_of_its_repeats() -> None:
    assert row(5.0, 1.0, 9.0, 2.0, 3.0).value == 3.0
    assert row().value is None


def test_the_ratio_is_to_the_other_program_or_else_to_the_limit() -> None:
    assert row(6.0, beside=(2.0, 3.0, 4.0)).ratio == 2.0
    assert row(6.0, target=Target("value", most=4.0)).ratio == 1.5
    assert row(6.0, target=Target("value", least=3.0)).ratio == 2.0
    assert row(6.0, target=Target("value", least=3.0, most=9.0)).ratio is None
    assert row(6.0).ratio is None
    assert row(beside=(2.0,)).ratio is None


def test_a_target_is_met_within_its_limits() -> None:
    assert row(4.0, target=Target("value", most=4.0)).is_met is True
    assert row(4.1, target=Target("value", most=4.0)).is_met is False
    assert row(50.6, target=Target("value", least=49.5, most=50.5)).is_met is False
    assert row(6.0, beside=(3.0,), target=Target("ratio", most=2.0)).is_met is True
    assert row(6.0, target=Target("ratio", most=2.0)).is_met is None, "the other program was not measured"
    assert row(6.0).is_met is None


def test_a_percentile_is_a_measured_value() -> None:
    values = [float(n) for n in range(1, 101)]
    assert percentile(values, 0.5) == 50.0
    assert percentile(values, 0.99) == 99.0
    assert percentile([7.0], 0.99) == 7.0
    with pytest.raises(ValueError, match="no values"):
        percentile([], 0.5)


@pytest.mark.parametrize("phase_s", [0.0, 0.0001, 0.0101, 0.0199])
def test_lateness_is_relative_to_the_early_ticks_whatever_the_phase(phase_s: float) -> None:
    times_s = [1000.0 + phase_s + 0.02 * n + (0.0005 if n % 2 else 0.0) for n in range(400)]
    times_s[100] += 0.004
    late_us = lateness_us(times_s, 0.02)
    assert late_us[0] == pytest.approx(0.0, abs=0.01)
    assert late_us[1] == pytest.approx(500.0, abs=0.01)
    assert late_us[100] == pytest.approx(4000.0, abs=0.01)


def test_a_stall_with_ticks_made_up_for_does_not_make_the_others_late() -> None:
    due_s = [50.0 + 0.02 * n for n in range(400)]
    times_s = [max(one_s, 54.0 + 1e-5 * n) if 196 <= n < 204 else one_s for n, one_s in enumerate(due_s)]
    late_us = lateness_us(times_s, 0.02)
    assert percentile(late_us, 0.5) < 1.0


def test_lateness_of_no_ticks() -> None:
    assert lateness_us([], 0.02) == []


def uses(cpu: float) -> list[AgentsUse]:
    """Three samples a second apart of two agents that use this share of a core."""
    return [AgentsUse(10.0 + n, {1: cpu * n, 2: cpu * n}, {1: 50.0, 2: 52.0}) for n in range(3)]


def flown(cpu: float, failure: str = "") -> Flown:
    ticks = {1: 50, 2: 48}
    return Flown(
        uses(cpu),
        {i: [TimingRecord(10.0 + n / rate, 0, 0, 0, None) for n in range(2 * rate)] for i, rate in ticks.items()},
        failure,
    )


def test_windows_lie_between_the_samples() -> None:
    windows = windows_of(uses(0.05))
    assert windows == [Window(10.0, 11.0), Window(11.0, 12.0)]
    assert within(windows[0], [(9.9, 1.0), (10.0, 2.0), (10.9, 3.0), (11.0, 4.0)]) == [2.0, 3.0]
    assert windows_of([]) == []


def test_cpu_is_the_mean_of_the_agents() -> None:
    before = AgentsUse(10.0, {1: 1.0, 2: 2.0}, {})
    assert cpu_percent(before, AgentsUse(12.0, {1: 1.1, 2: 2.3}, {})) == pytest.approx(10.0)


def test_the_slowest_agent_counts_for_the_rate() -> None:
    assert rate_of_slowest_hz(flown(0.05)) == pytest.approx((48.0, 48.0))


def test_a_tick_is_due_when_its_first_position_arrives(tmp_path: Path) -> None:
    recording = recorder(tmp_path, WritingAtOnce())
    flight = FailingFlight(AutopilotKind.PX4, recording)
    for now_s, ages_s in ((101.0, (0.0009, 0.0004)), (101.02, ()), (101.04, (0.0001,))):
        flight.link.telemetry = tuple(PositionSample(now_s - age_s, now_s, ZERO3, ZERO3) for age_s in ages_s)
        flight.loop.tick(now_s)
    recording.close()
    (first_s, first_us), (last_s, last_us) = delays_of_ticks(tmp_path)
    assert (first_s, last_s) == (101.0, 101.04)
    assert (first_us, last_us) == pytest.approx((900.0, 100.0))


def test_agents_use_what_passes_between_two_samples() -> None:
    rows = resources_section({FEW: flown(0.05), SOME: flown(0.06), MANY: flown(0.074, "vehicle 3 left")}).rows
    by_name = {one.what: one for one in rows}
    assert by_name["CPU of an agent, 3 peers"].value == pytest.approx(5.0)
    assert by_name["CPU of an agent, 15 peers"].value == pytest.approx(7.4)
    assert by_name["ticks of the slowest of 16 agents"].is_met is False
    assert "vehicle 3 left" in by_name["ticks of the slowest of 16 agents"].remark


def test_ages_are_those_of_the_median_vehicle_in_each_window() -> None:
    results = [PeerAges([Ages(a, 20.0), Ages(a + 1.0, 20.0)], [Ages(9.0, 19.0)] * 2) for a in (10.0, 11.0, 30.0)]
    median = peers_section(results).rows[0]
    assert median.values == (11.0, 12.0)
    assert median.beside_values == (9.0, 9.0)


def test_rows_of_a_batch_without_rotorpy_say_so() -> None:
    rows = batch_section({}, "RotorPy is missing").rows
    assert {one.remark for one in rows} == {"RotorPy is missing"}
    assert all(one.ratio is None for one in rows)


def test_batches_are_beside_rotorpy_with_the_same_integrator() -> None:
    models = {"vehicle model, RK4": [3e6, 4e6, 5e6], "RotorPy, RK4, no drag": [1e6, 2e6, 3e6]}
    rows = {one.what: one for one in batch_section({1000: models}, "").rows}
    assert rows["vehicle model, RK4, 1,000 vehicles"].ratio == 2.0


def test_the_share_that_the_hypervisor_took() -> None:
    assert stolen_percent(CoreTime(1010.0, 10.0), CoreTime(1110.0, 15.0)) == 5.0


def test_what_others_use_is_not_of_this_process_nor_of_those_that_it_started() -> None:
    processes = {1: (0, 1000), 10: (1, 100), 20: (10, 10), 30: (20, 5), 40: (1, 7)}
    assert used_by_others(10, processes) == 1007
    assert used_by_others(20, processes) == 1107
