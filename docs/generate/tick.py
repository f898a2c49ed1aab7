"""The stages of one tick, from the source of Agent.decide and Agent.report: each stage with its inputs and outputs.

python docs/generate/tick.py             the stages as text
python docs/generate/tick.py --diagram   the same as a Mermaid diagram
python docs/generate/tick.py --count     fly the platoon in lockstep; count files, classes, calls and depth of the
                                         ticks of a follower in formation
"""

from __future__ import annotations

import ast
import inspect
import statistics
import sys
import textwrap
import types
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, get_type_hints

from companion.core.agent import Agent

TOP = Path(__file__).parent.parent.parent
SCENARIO = TOP / "config" / "scenarios" / "platoon.yaml"
FOLLOWER_ID = 2
TICKS = 500


@dataclass(frozen=True, slots=True)
class Stage:
    """One call of a stage in a tick. `inputs` are (name, type) of its parameters, without self."""

    owner: str
    method: str
    inputs: tuple[tuple[str, str], ...]
    output: str


def stages() -> list[Stage]:
    """The stages in the order in which Agent.decide and Agent.report call them."""
    classes = get_type_hints(Agent.__init__)
    found = []
    for call in [*_calls(Agent.decide), *_calls(Agent.report)]:
        match call.func:
            case ast.Attribute(ast.Attribute(ast.Name("self"), attribute), method):
                owner = classes[attribute.removeprefix("_")]
                hints = get_type_hints(getattr(owner, method))
                output = _name(hints.pop("return"))
                inputs = tuple((name, _name(kind)) for name, kind in hints.items())
                found.append(Stage(owner.__name__, method, inputs, output))
    return found


def _calls(method: Callable[..., object]) -> list[ast.Call]:
    """All calls in the source of a method, in order."""
    function = ast.parse(textwrap.dedent(inspect.getsource(method)))
    calls = [node for node in ast.walk(function) if isinstance(node, ast.Call)]
    return sorted(calls, key=lambda call: (call.lineno, call.col_offset))


def _name(kind: Any) -> str:
    """A type without the packages of its parts."""
    if isinstance(kind, type) and not isinstance(kind, types.GenericAlias):
        return kind.__name__
    parts = [
        part if part == "..." else part.rpartition(".")[2]
        for part in str(kind).replace("[", " [ ").replace("]", " ] ").split()
    ]
    return " ".join(parts).replace(" [ ", "[").replace(" ]", "]").replace(" ,", ",")


def text() -> str:
    """A block for each stage."""
    blocks = []
    for number, stage in enumerate(stages(), start=1):
        inputs = [f"     in   {name}: {kind}" for name, kind in stage.inputs]
        blocks.append("\n".join([f"{number:2}. {stage.owner}.{stage.method}", *inputs, f"     out  {stage.output}"]))
    return "\n".join(blocks)


def diagram() -> str:
    """A Mermaid flow chart. An edge carries the result that a later stage takes, by its type."""
    found = stages()
    lines = ["```mermaid", "flowchart TD"]
    lines += [f'    s{i}["{stage.owner}.{stage.method}"]' for i, stage in enumerate(found)]
    for i, stage in enumerate(found):
        taken = {kind for _, kind in stage.inputs}
        produced: dict[str, int] = {}  # the newest producer of each type
        for earlier, before in enumerate(found[:i]):
            produced[before.output] = earlier
            if before.output == "Perception":
                produced["VehicleState"] = earlier  # its field `vehicle`
        lines += [f"    s{j} -->|{kind.split('[')[0]}| s{i}" for kind, j in produced.items() if kind in taken]
    return "\n".join([*lines, "```"])


@dataclass(slots=True)
class Count:
    """What Python code ran in one tick."""

    files: set[str]
    classes: set[str]
    calls: int = 0
    depth: int = 0


def count() -> str:
    """The median tick of a follower in formation, flown in lockstep."""
    from companion.types.flight import FlightPhase
    from sitl.flight.scenario import load_scenario
    from sitl.flight.virtual_flight import fly_in_virtual_time
    from sitl.report.progress import Progress

    counts: list[Count] = []
    step = Agent.step

    def counted(agent: Agent, now_s: float, inbox: Any) -> Any:
        if agent.phase is not FlightPhase.FORMATION or len(counts) == TICKS:
            return step(agent, now_s, inbox)
        tick, now = Count(set(), set()), 0

        def profile(frame: types.FrameType, event: str, _argument: object) -> None:
            nonlocal now
            if event == "call":
                now += 1
                code = frame.f_code
                tick.calls, tick.depth = tick.calls + 1, max(tick.depth, now)
                tick.files.add(code.co_filename)
                if "." in code.co_qualname and "<locals>" not in code.co_qualname:
                    tick.classes.add(code.co_qualname.rpartition(".")[0])
            elif event == "return":
                now -= 1

        sys.setprofile(profile)
        try:
            outbox = step(agent, now_s, inbox)
        finally:
            sys.setprofile(None)
        if outbox.peer_packet and outbox.peer_packet.vehicle_id == FOLLOWER_ID and outbox.status is None:
            counts.append(tick)
        return outbox

    Agent.step = counted  # type: ignore[method-assign]
    try:
        fly_in_virtual_time(load_scenario(SCENARIO), Progress("tick", True, 0.0))
    finally:
        Agent.step = step  # type: ignore[method-assign]
    if not counts:
        raise SystemExit("the follower was never in formation")
    figures = {
        "files": statistics.median([len(tick.files) for tick in counts]),
        "classes": statistics.median([len(tick.classes) for tick in counts]),
        "calls": statistics.median([tick.calls for tick in counts]),
        "depth": statistics.median([tick.depth for tick in counts]),
    }
    named = ", ".join(f"{name} {figure:g}" for name, figure in figures.items())
    return f"vehicle {FOLLOWER_ID}, {len(counts)} ticks in formation without a status, median: {named}"


def main(arguments: list[str]) -> int:
    """The exit code."""
    if "--count" in arguments:
        print(count())
    elif "--diagram" in arguments:
        print(diagram())
    else:
        print(text())
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
