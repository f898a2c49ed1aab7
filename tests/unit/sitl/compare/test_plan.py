"""The plan of a comparison: laws, places, --vary, and the jobs that its flights are flown in."""

from pathlib import Path

import pytest

from companion.config.file import ConfigError
from companion.config.law import LawSection
from lockstep_fleet import PLATOON_FILE
from sitl.compare.flights import MAX_PAIRS, MAX_SAMPLES, chunk_size, jobs_of
from sitl.compare.options import MAX_FLIGHTS, CompareOptions
from sitl.compare.plan import Place, Plan, law_of_text, plan_of
from sitl.compare.vary import axis_of
from tests.helpers.bad_laws import BAD_LAWS, write_law

PULL = """
from companion.laws import Law

class Pull(Law, frozen=True):
    def acceleration(self, own, neighbours, reference):
        others = [*neighbours, *([reference] if reference else [])]
        def pull(axis):
            off = sum(o.position_enu_m[axis] - own.position_enu_m[axis] for o in others)
            return 2.0 * off + 2.0 * sum(o.velocity_enu_m_s[axis] - own.velocity_enu_m_s[axis] for o in others)
        return (pull(0), pull(1), pull(2))
"""


def plan(**options: object) -> Plan:
    return plan_of(CompareOptions(**options), lambda _share: None)  # type: ignore[arg-type]


def of_platoon(*varied: str, **options: object) -> Plan:
    return plan(scenario=PLATOON_FILE, varied=varied, **{"seeds": 1} | options)


# ---------------------------------------------------------------- cells


def test_all_cells_have_the_same_seeds_and_graphs() -> None:
    made = plan(
        laws=["weighted", "cooperative"], graphs=["random", "chain"], conditions=["noise"], vehicles=[4, 6], seeds=3
    )
    assert [flight.seed for flight in made.flights] == [1, 2, 3] * 8
    cells = list(dict.fromkeys(flight.cell for flight in made.flights))
    assert [(cell.place.graph, cell.place.vehicles, cell.law) for cell in cells] == [
        (graph, n, law) for graph in ("random", "chain") for n in (4, 6) for law in ("weighted", "cooperative")
    ]
    one, other = (made.flights[k].scenario for k in (1, 4))
    assert one.fleet.neighbours == other.fleet.neighbours
    assert one.stand_in == other.stand_in and one.stand_in.seed == 2 and one.stand_in.sensors == "default"
    assert one.fleet.law != other.fleet.law
    assert made.flights[0].scenario.fleet.neighbours != one.fleet.neighbours, "another graph with another seed"


def test_a_scenario_flies_as_it_is_without_options() -> None:
    (flight,) = of_platoon().flights
    assert (flight.cell.law, flight.cell.place.graph, flight.cell.place.vehicles) == ("weighted", "platoon", 4)
    assert of_platoon().seconds == 75.0
    assert flight.scenario.timeline[-1].command == "form"


def test_all_combinations_are_made_and_the_last_key_varies_fastest() -> None:
    made = of_platoon("fleet.law.name=weighted,cooperative", "links.peer_loss=0,0.2,0.4")
    assert [(f.scenario.fleet.law.name, f.scenario.links.peer_loss) for f in made.flights] == [
        (law, loss) for law in ("weighted", "cooperative") for loss in (0.0, 0.2, 0.4)
    ]
    assert made.flights[1].cell.place.varied == ("fleet.law.name=weighted", "links.peer_loss=0.2")


def test_a_law_has_its_parameters_and_a_file_its_digest(tmp_path: Path) -> None:
    base = LawSection(disturbance_bandwidth_1_s=0.0)
    label, section = law_of_text("weighted:exponent=2:position_gain_1_s2=1", base)
    assert label == "weighted exponent=2 position_gain_1_s2=1"
    assert section.parameters == {"exponent": 2, "position_gain_1_s2": 1}
    assert section.disturbance_bandwidth_1_s == 0.0
    (tmp_path / "pull.py").write_text(PULL)
    label, section = law_of_text(str(tmp_path / "pull.py"), base)
    assert label == "pull" and section.sha256 is not None


@pytest.mark.parametrize(
    ("options", "text"),
    [
        ({"laws": ["weightd"]}, 'weightd: expected one of cooperative, .*did you mean "weighted"'),
        ({"laws": ["weighted:exponent"]}, "expected NAME:KEY=VALUE"),
        ({"laws": ["weighted:exponent=-1"]}, "law.parameters.exponent: -1"),
        ({"laws": ["weighted", "weighted"]}, "weighted: is listed twice"),
        ({"laws": ["/nowhere/law.py"]}, "/nowhere/law.py"),
        ({"graphs": ["chian"]}, 'chian: expected some of chain, .*did you mean "chain"'),
        ({"conditions": ["nois"]}, 'did you mean "noise"'),
        ({"scenario": PLATOON_FILE, "graphs": ["chain"]}, "a scenario has its own graph and vehicles"),
        ({"overrides": ["stand_in.seed=3"]}, "use --seeds N"),
        ({"seeds": MAX_FLIGHTS}, f"expected at most {MAX_FLIGHTS}"),
    ],
)
def test_what_cannot_be_flown_is_one_line(options: dict[str, object], text: str) -> None:
    with pytest.raises(ConfigError, match=text) as error:
        plan(**options)
    assert "\n" not in str(error.value)


def test_a_law_file_that_fails_is_named_once(tmp_path: Path) -> None:
    file = write_law(tmp_path, "raises", BAD_LAWS["raises"])
    with pytest.raises(ConfigError) as error:
        plan(laws=[str(file)])
    assert str(error.value) == f"{file}: line 8: ZeroDivisionError: float division by zero"


# ---------------------------------------------------------------- --vary


def test_values_are_yaml() -> None:
    axis = axis_of("links.peer_loss=0, 0.1,true,word")
    assert [choice.value for choice in axis.choices] == [0, 0.1, True, "word"]
    assert [choice.text for choice in axis.choices] == ["0", "0.1", "true", "word"]


@pytest.mark.parametrize(
    ("varied", "panel"),
    [
        (("links.peer_loss=0.1",), "noise, peer_loss=0.1"),
        (
            ("stand_in.vehicles.1.sensors=ideal", "stand_in.sensors=default"),
            "noise, 1.sensors=ideal, stand_in.sensors=default",
        ),
        (("sensors=ideal", "stand_in.sensors=default"), "noise, sensors=ideal, stand_in.sensors=default"),
    ],
)
def test_varied_keys_are_told_apart_in_figures(varied: tuple[str, ...], panel: str) -> None:
    assert Place("chain", 4, "noise", varied).panel == panel


@pytest.mark.parametrize(
    ("varied", "text"),
    [
        (("links.peer_loss",), "--vary: links.peer_loss: expected KEY=V1,V2,..."),
        (("links.peer_loss=",), "has an empty value; expected values separated"),
        (("links.peer_loss=0,1,0.0",), "0.0 is listed twice"),
        (("links.peer_loss=0", "links.peer_loss=1"), "links.peer_loss: is given twice"),
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
            "--vary links.peer_loss=1.5: links.peer_loss: 1.5: expected a number <= 1.0",
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
        of_platoon(*varied)
    assert text in str(error.value)
    assert "\n" not in str(error.value)


# ---------------------------------------------------------------- jobs


def test_every_flight_is_flown_once_in_batches_of_one_kind() -> None:
    made = plan(
        laws=["weighted"],
        graphs=["chain", "range"],
        conditions=["ideal", "delay_loss", "lying"],
        vehicles=[4],
        seeds=3,
        lockstep=2,
    )
    jobs = jobs_of(made.flights, made.check, made.seconds)
    numbers = sorted(number for job in jobs for number in job.numbers)
    assert numbers == list(range(len(made.flights) + 2))
    batches = [job for job in jobs if not job.by_agents]
    assert [{(f.cell.place.graph, f.cell.place.condition) for f in job.flights} for job in batches] == [
        {("chain", "ideal")},
        {("chain", "delay_loss")},
        {("range", "ideal")},
        {("range", "delay_loss")},
    ]
    assert all(len(job.flights) == 1 for job in jobs if job.by_agents)
    assert sum(flight.cell.place.condition == "lying" for job in jobs for flight in job.flights if job.by_agents) == 6


@pytest.mark.parametrize(
    "overrides",
    [
        "stand_in.autopilot=ardupilot",
        "fleet.formation_heading=course",
        "reference={kind: target, start_enu_m: [0, 0, 1]}",
    ],
)
def test_what_a_batch_does_not_model_is_flown_by_the_agents(overrides: str) -> None:
    (flight,) = of_platoon(laws=["cooperative"], overrides=[overrides]).flights
    assert flight.by_agents
    assert not of_platoon().flights[0].by_agents


def test_flights_to_check_are_evenly_chosen() -> None:
    made = plan(
        laws=["weighted", "cooperative"],
        graphs=["chain"],
        conditions=["ideal", "noise", "step", "lying"],
        vehicles=[4],
        seeds=2,
        lockstep=3,
    )
    assert len({flight.cell.place.condition for flight in made.check}) == 3
    assert all(flight.seed == 1 and flight in made.flights and not flight.by_agents for flight in made.check)
    assert plan(laws=["weighted"], graphs=["chain"], conditions=["ideal"], lockstep=9).check == [
        plan(laws=["weighted"], graphs=["chain"], conditions=["ideal"]).flights[0]
    ]


@pytest.mark.parametrize(
    ("flights", "vehicles", "seconds"), [(100_000, 4, 75.0), (5000, 100, 20.0), (300, 250, 3600.0)]
)
def test_chunks_fit_memory(flights: int, vehicles: int, seconds: float) -> None:
    size = chunk_size(flights, vehicles, seconds)
    assert size == 1 or (size * vehicles * seconds * 50.0 <= MAX_SAMPLES and size * vehicles**2 <= MAX_PAIRS)


def test_few_flights_are_one_chunk_and_many_are_spread_over_the_cores() -> None:
    assert chunk_size(20, 4, 75.0) >= 20
    assert chunk_size(4000, 4, 75.0) == 250
