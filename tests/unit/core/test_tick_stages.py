"""The stages of one tick, from the source of its parts."""

from tests.bench import stages


def test_stages_are_listed_in_the_order_of_the_data_flow() -> None:
    outputs = [stage.output for stage in stages.stages()]
    flow = ["Perception", "Consensus", "Guidance", "Safety", "Setpoint", "Report"]
    assert [output for output in outputs if output in flow] == flow


def test_only_the_phase_machine_returns_a_flight() -> None:
    owners = {stage.owner for stage in stages.stages() if stage.output == "Flight"}
    assert owners == {"PhaseMachine"}


def test_the_diagram_shows_every_stage() -> None:
    diagram = stages.diagram()
    assert diagram.startswith("```mermaid")
    assert all(f"{stage.owner}.{stage.method}" in diagram for stage in stages.stages())


def test_the_diagram_shows_the_parts_of_a_tick_in_their_order() -> None:
    parts = [line.split()[1] for line in stages.diagram().splitlines() if "subgraph" in line]
    assert parts == ["prepare", "decide", "report"]


def test_the_diagram_shows_the_calls_of_a_stage() -> None:
    assert "ReportStage.step<br>3 calls" in stages.diagram({"ReportStage.step": 3})
