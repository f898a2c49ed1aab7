"""The command that prints the stages of one tick, from the source of Agent.step."""

import importlib.util
import sys
from types import ModuleType

from repository import ROOT


def command() -> ModuleType:
    spec = importlib.util.spec_from_file_location("tick_stages", ROOT / "docs" / "generate" / "tick.py")
    assert spec
    assert spec.loader
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module  # its dataclasses look themselves up
    spec.loader.exec_module(module)
    return module


def test_stages_are_listed_in_the_order_of_the_data_flow() -> None:
    outputs = [stage.output for stage in command().stages()]
    flow = ["Perception", "Consensus", "Guidance", "Safety", "Setpoint", "Report"]
    assert [output for output in outputs if output in flow] == flow


def test_only_the_phase_machine_returns_a_flight() -> None:
    owners = {stage.owner for stage in command().stages() if stage.output == "Flight"}
    assert owners == {"PhaseMachine"}


def test_the_diagram_shows_every_stage() -> None:
    module = command()
    diagram = module.diagram()
    assert diagram.startswith("```mermaid")
    assert all(f"{stage.owner}.{stage.method}" in diagram for stage in module.stages())
