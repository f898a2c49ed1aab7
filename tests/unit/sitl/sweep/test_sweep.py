"""Parts of a sweep: --vary, chunks of flights, statistics, table and plot."""

import csv
from collections.abc import Sequence
from pathlib import Path

import pytest
from matplotlib.figure import Figure

from companion.config.file import ConfigError
from lockstep_fleet import PLATOON_FILE, platoon
from sitl.flight.scenario import load_scenario
from sitl.sweep.figure import MOST_CURVES, save_sweep
from sitl.sweep.flights import (
    MAX_PAIRS,
    MAX_SAMPLES,
    Chunk,
    FlightFigures,
    SeededFlight,
    chunk_size,
    chunks_of,
    fly_chunk,
)
from sitl.sweep.options import MAX_FLIGHTS
from sitl.sweep.points import Axis, Point, axes_of, axis_of, base_scenario, formation_time_s, points_of
from sitl.sweep.report import MOST_ROWS, Row, short_name, table_text, write_csv
from sitl.sweep.statistics import Sweep, combination, spread


def figures(settle_s: float | None = 12.0, final_error_m: float = 0.01) -> FlightFigures:
    return FlightFigures(
        settle_s=settle_s,
        largest_neighbouring_distance_m=1.8,
        smallest_neighbouring_distance_m=1.2,
        smallest_distance_m=1.1,
        final_error_m=final_error_m,
    )


def points(*varied: str) -> list[Point]:
    return points_of(PLATOON_FILE, (), axes_of(varied, 1), lambda _number, _of: None)


# ---------------------------------------------------------------- points


def test_values_are_yaml() -> None:
    axis = axis_of("links.peer_loss=0, 0.1,true,word")
    assert axis.key == "links.peer_loss"
    assert [choice.value for choice in axis.choices] == [0, 0.1, True, "word"]
    assert [choice.text for choice in axis.choices] == ["0", "0.1", "true", "word"]


@pytest.mark.parametrize(
    ("text", "numeric"), [("a=0,1.5", True), ("a=0", False), ("a=0,x", False), ("a=true,false", False)]
)
def test_several_numbers_make_an_axis_of_the_plot(text: str, numeric: bool) -> None:
    assert axis_of(text).is_numeric is numeric


def test_all_combinations_are_made_and_the_last_key_varies_fastest() -> None:
    made = points("fleet.law.name=weighted,cooperative", "links.peer_loss=0,0.2,0.4")
    assert [(p.scenario.fleet.law.name, p.scenario.links.peer_loss) for p in made] == [
        (law, loss) for law in ("weighted", "cooperative") for loss in (0.0, 0.2, 0.4)
    ]
    assert made[1].choices[1].value == 0.2


def test_without_vary_there_is_one_combination() -> None:
    (point,) = points()
    assert point.choices == ()
    assert point.scenario == load_scenario(PLATOON_FILE)


@pytest.mark.parametrize(
    ("varied", "text"),
    [
        (("fleet.law.parameters.exponent",), "--vary: fleet.law.parameters.exponent: expected KEY=V1,V2,..."),
        (
            ("fleet.law.parameters.exponent=",),
            "--vary: fleet.law.parameters.exponent: has an empty value; expected values separated",
        ),
        (("fleet.law.parameters.exponent=1,,2",), "has an empty value"),
        (("fleet.law.parameters.exponent=1,2,1.0",), "1.0 is listed twice"),
        (
            ("fleet.law.parameters.exponent=1", "fleet.law.parameters.exponent=2"),
            "fleet.law.parameters.exponent: is given twice",
        ),
        (("reference.point_enu_m=[1, 0, 1],[2, 0, 1]",), "lists and mappings cannot be varied"),
        (("fleet.law.name=null",), "'null': expected a number, true, false or a string"),
        (("stand_in.seed=1,2",), "use --seeds N"),
        (("timeline[3].for_s=10,20",), "use --seconds S"),
        (
            ("fleet.law.parameters.exponnt=1",),
            '--vary fleet.law.parameters.exponnt=1: fleet.law.parameters.exponnt: unknown key; did you mean "exponent"',
        ),
        (
            ("links.peer_loss=0,1.5", "fleet.law.parameters.exponent=1,2"),
            "--vary links.peer_loss=1.5: links.peer_loss: 1.5: expected float <= 1.0",
        ),
        (
            ("fleet.law.name=weighted,average_22", "fleet.law.parameters.exponent=0,1"),
            "--vary fleet.law.name=average_22 with --vary fleet.law.parameters.exponent=0:"
            " fleet.law.parameters.exponent: unknown key",
        ),
    ],
)
def test_a_bad_vary_is_one_line_that_names_the_value(varied: tuple[str, ...], text: str) -> None:
    with pytest.raises(ConfigError) as error:
        points(*varied)
    assert text in str(error.value)
    assert "\n" not in str(error.value)


def test_too_many_flights_are_refused_before_any_scenario_is_made() -> None:
    axes_of(["a=1,2"], MAX_FLIGHTS // 2)
    with pytest.raises(ConfigError, match=rf"2 x 50001 seeds are 100002 flights; expected at most {MAX_FLIGHTS}"):
        axes_of(["a=1,2"], MAX_FLIGHTS // 2 + 1)


def test_a_seed_cannot_be_set() -> None:
    with pytest.raises(ConfigError, match="use --seeds N"):
        base_scenario(PLATOON_FILE, ["stand_in.seed=3"])


def test_a_sweep_with_ardupilot_is_refused() -> None:
    with pytest.raises(ConfigError, match=r"stand_in.autopilot: .*px4 only"):
        base_scenario(PLATOON_FILE, ["stand_in.autopilot=ardupilot"])


def test_a_sweep_with_a_target_is_refused() -> None:
    with pytest.raises(ConfigError, match=r'reference.kind: "target": a sweep does not support targets'):
        base_scenario(PLATOON_FILE, ["fleet.law.name=cooperative", "reference={kind: target, start_enu_m: [0, 0, 1]}"])


def test_a_sweep_with_a_turning_formation_is_refused() -> None:
    with pytest.raises(
        ConfigError, match=r'fleet.formation_heading: "course": a sweep does not support turning formations'
    ):
        base_scenario(PLATOON_FILE, ["fleet.formation_heading=course"])


def test_the_duration_is_that_of_the_form_step() -> None:
    assert formation_time_s(PLATOON_FILE, platoon()) == 75.0
    with pytest.raises(ConfigError, match="no step with command: form; set the duration with --seconds S"):
        formation_time_s(PLATOON_FILE, platoon("timeline=[{command: prepare}]"))
    with pytest.raises(ConfigError, match="for_s: 1; expected 2 or more"):
        formation_time_s(PLATOON_FILE, platoon("timeline[3].for_s=1"))


# ---------------------------------------------------------------- chunks


def test_every_point_is_flown_with_every_seed_once() -> None:
    own = points("fleet.law.parameters.exponent=0,1,2", "links.peer_loss=0,0.1")
    chunks = chunks_of(own, 400, 75.0)
    flown = [(flight.point, flight.seed) for chunk in chunks for flight in chunk.flights]
    assert sorted(flown) == [(point, seed) for point in range(6) for seed in range(1, 401)]
    for chunk in chunks:
        for flight, scenario in zip(chunk.flights, chunk.scenarios, strict=True):
            assert scenario.stand_in.seed == flight.seed
            assert scenario.fleet.law == own[flight.point].scenario.fleet.law
            assert scenario.links == own[flight.point].scenario.links


def test_flights_of_different_kinds_are_in_different_chunks() -> None:
    own = points("stand_in.airframe.attitude=rigid_body,instant", "links.peer_loss=0,0.1")
    chunks = chunks_of(own, 2, 10.0)
    assert [{flight.point for flight in chunk.flights} for chunk in chunks] == [{0}, {1}, {2}, {3}]


@pytest.mark.parametrize(
    ("flights", "vehicles", "seconds"), [(100_000, 4, 75.0), (5000, 100, 20.0), (300, 250, 3600.0)]
)
def test_chunks_fit_memory(flights: int, vehicles: int, seconds: float) -> None:
    size = chunk_size(flights, vehicles, seconds)
    assert size == 1 or (size * vehicles * seconds * 50.0 <= MAX_SAMPLES and size * vehicles**2 <= MAX_PAIRS)


def test_few_flights_are_one_chunk_and_many_are_spread_over_the_cores() -> None:
    assert chunk_size(20, 4, 75.0) >= 20
    assert chunk_size(4000, 4, 75.0) == 250


def test_figures_of_a_chunk_are_in_the_order_of_its_flights() -> None:
    quick, slow = platoon("fleet.law={name: cooperative}"), platoon("fleet.law.name=average_26")
    chunk = Chunk((SeededFlight(0, 1), SeededFlight(1, 1)), (quick, slow), 8.0)
    one, other = fly_chunk(chunk)
    assert one.settle_s == pytest.approx(2.2, abs=0.3)
    assert other.settle_s is None
    assert one.final_error_m is not None and other.final_error_m is not None
    assert one.final_error_m < 0.01 < 0.1 < other.final_error_m
    assert one.smallest_distance_m == one.smallest_neighbouring_distance_m == pytest.approx(1.49, abs=0.02)


# ---------------------------------------------------------------- statistics


def test_percentiles_are_interpolated() -> None:
    some = spread([0.1 * number for number in range(21)])
    assert (some.p5, some.median, some.p95) == pytest.approx((0.1, 1.0, 1.9))


def test_an_unsettled_flight_counts_as_later_than_all_settled_ones() -> None:
    half = spread([5.0, None, 3.0, None, None])
    assert (half.p5, half.median, half.p95) == (pytest.approx(3.4), None, None)
    most = spread([1.0, 2.0, None])
    assert (most.median, most.p95) == (2.0, None)
    assert spread([None]).p5 is None


def test_a_combination_counts_settled_flights() -> None:
    one = combination({"a": 1}, [figures(10.0), figures(None), figures(20.0), figures(12.0)])
    assert (one.flights, one.settled_share) == (4, 0.75)
    assert one.settle_s.median == pytest.approx(16.0)
    assert one.settle_s.p95 is None
    assert one.final_error_m.median == 0.01


# ---------------------------------------------------------------- results


def sweep_of(axes: Sequence[Axis], settle_s: float | None = 12.0) -> Sweep:
    combinations = [
        {axis.key: choice.value for axis, choice in zip(axes, point, strict=True)} for point in _product(axes)
    ]
    return Sweep(
        scenario="platoon",
        overrides=[],
        vehicles=4,
        seconds=40.0,
        seeds=1,
        vary={axis.key: [choice.value for choice in axis.choices] for axis in axes},
        flights=len(combinations),
        complete=True,
        combinations=[combination(values, [figures(settle_s)]) for values in combinations],
    )


def _product(axes: Sequence[Axis]) -> list[tuple[object, ...]]:
    made: list[tuple[object, ...]] = [()]
    for axis in axes:
        made = [(*some, choice) for some in made for choice in axis.choices]
    return made


def test_the_csv_has_a_row_per_flight(tmp_path: Path) -> None:
    axes = axes_of(["fleet.law.name=weighted,cooperative"], 1)
    own = points("fleet.law.name=weighted,cooperative")
    rows = [Row(SeededFlight(0, 1), figures(None)), Row(SeededFlight(1, 2), figures(3.5))]
    write_csv(tmp_path / "sweep.csv", axes, own, rows)
    first, second = csv.DictReader((tmp_path / "sweep.csv").open())
    assert (first["fleet.law.name"], first["seed"], first["settle_s"]) == ("weighted", "1", "")
    assert (second["fleet.law.name"], second["seed"], second["settle_s"]) == ("cooperative", "2", "3.5")
    assert second["largest_neighbouring_distance_m"] == "1.8"


def test_the_table_is_aligned_and_shows_never() -> None:
    lines = table_text(sweep_of(axes_of(["fleet.law.name=weighted,cooperative", "a=1"], 1), None)).splitlines()
    assert lines[0] == "platoon: 2 flights of 4 vehicles, 40 s each"
    head, *rows = lines[2:]
    column = head.index("settled [s]")
    assert [row[column:].split()[0] for row in rows] == ["never", "never"]
    assert rows[0].startswith("weighted ")


def test_a_long_table_is_cut_with_a_note() -> None:
    lines = table_text(sweep_of([axis_of("a=" + ",".join(map(str, range(MOST_ROWS + 5))))])).splitlines()
    assert len(lines) == 3 + MOST_ROWS + 1
    assert lines[-1] == "and 5 more combinations, see sweep.json"


def test_keys_are_shortened_in_the_table() -> None:
    assert short_name("stand_in.airframe.mass_kg") == "airframe.mass_kg"


@pytest.fixture
def drawn(monkeypatch: pytest.MonkeyPatch) -> list[Figure]:
    """The saved plots, without the time to render them."""
    saved: list[Figure] = []
    monkeypatch.setattr(Figure, "savefig", lambda figure, *_args, **_more: saved.append(figure))
    return saved


def test_a_numeric_key_is_drawn_as_curves(drawn: list[Figure]) -> None:
    axes = axes_of(["fleet.law.name=weighted,cooperative", "fleet.law.parameters.exponent=8,0,2"], 1)
    save_sweep(Path("s.png"), sweep_of(axes), axes)
    (figure,) = drawn
    assert "platoon: 6 flights of 4 vehicles, 40 s each" in figure.get_suptitle()
    assert [text.get_text() for text in figure.legends[0].get_texts()] == ["law.name weighted", "law.name cooperative"]
    assert [axes.get_xlabel() for axes in figure.axes[3:]] == ["fleet.law.parameters.exponent"] * 3
    assert all("[" in axes.get_title() for axes in figure.axes)
    curve = next(line for line in figure.axes[1].lines if line.get_label() == "law.name weighted")
    assert list(curve.get_xdata()) == [0.0, 2.0, 8.0]
    assert list(curve.get_ydata()) == [12.0, 12.0, 12.0]


def test_strings_are_drawn_as_rows(drawn: list[Figure]) -> None:
    axes = axes_of(["fleet.law.name=weighted,cooperative", "stand_in.sensors=ideal,default"], 1)
    save_sweep(Path("s.png"), sweep_of(axes), axes)
    labels = [label.get_text() for label in drawn[0].axes[0].get_yticklabels()]
    assert labels[0] == "law.name weighted, stand_in.sensors ideal"
    assert len(labels) == 4


def test_too_many_curves_are_cut_with_a_note_in_the_title(drawn: list[Figure]) -> None:
    axes = axes_of(["a=" + ",".join(f"word{k}" for k in range(MOST_CURVES + 3)), "b=1,2"], 1)
    save_sweep(Path("s.png"), sweep_of(axes), axes)
    assert f"{MOST_CURVES} of {MOST_CURVES + 3} curves" in drawn[0].get_suptitle()


def test_never_is_drawn_at_the_end_of_the_flights(drawn: list[Figure]) -> None:
    axes = axes_of(["b=1,2"], 1)
    save_sweep(Path("s.png"), sweep_of(axes, settle_s=None), axes)
    assert [text.get_text() for text in drawn[0].axes[1].texts] == ["never"]
    assert all(set(line.get_ydata()) == {40.0} for line in drawn[0].axes[1].lines)


def test_panels_have_a_smallest_span(drawn: list[Figure]) -> None:
    axes = axes_of(["b=1,2"], 1)
    save_sweep(Path("s.png"), sweep_of(axes), axes)
    for panel in drawn[0].axes[2:]:
        low_m, high_m = panel.get_ylim()
        assert high_m - low_m >= 0.0999
