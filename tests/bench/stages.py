"""The stages of one tick, from the source of its parts in `Agent`: each stage with its inputs and outputs."""

from __future__ import annotations

import ast
import inspect
import textwrap
import types
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, get_args, get_type_hints

from companion.core.agent import Agent

PARTS = (Agent.prepare, Agent.decide, Agent.report)


@dataclass(frozen=True, slots=True)
class Stage:
    """One call of a stage in a tick, in one `part` of it. `inputs` are (name, type) of its parameters, without self."""

    part: str
    owner: str
    method: str
    inputs: tuple[tuple[str, str], ...]
    output: str


def stages() -> list[Stage]:
    """The stages in the order in which the parts of a tick call them."""
    classes = get_type_hints(Agent.__init__)
    found = []
    for of_part, call in [(part, call) for part in PARTS for call in _calls(part)]:
        match call.func:
            case ast.Attribute(ast.Attribute(ast.Name("self"), attribute), method):
                declared = classes[attribute.removeprefix("_")]
                owner = next(iter(get_args(declared)), declared)  # of a stage that small fleets lack, without None
                hints = get_type_hints(getattr(owner, method))
                output = _name(hints.pop("return"))
                inputs = tuple((name, _name(kind)) for name, kind in hints.items())
                found.append(Stage(of_part.__name__, owner.__name__, method, inputs, output))
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
        title = f"{number:2}. {stage.part}: {stage.owner}.{stage.method}"
        blocks.append("\n".join([title, *inputs, f"     out  {stage.output}"]))
    return "\n".join(blocks)


def diagram(calls: Mapping[str, int] | None = None) -> str:
    """A Mermaid flow chart with a box for each part. An edge carries the result that a later stage takes, by its type.

    With `calls`, made in a stage named "Class.method", a stage also says how many calls it makes.
    """
    found = stages()
    lines = ["```mermaid", "flowchart TD"]
    for part in dict.fromkeys(stage.part for stage in found):
        lines.append(f"    subgraph {part}")
        for i, stage in enumerate(found):
            if stage.part == part:
                label = f"{stage.owner}.{stage.method}"
                made = f"<br>{calls.get(label, 0)} calls" if calls is not None else ""
                lines.append(f'        s{i}["{label}{made}"]')
        lines.append("    end")
    for i, stage in enumerate(found):
        taken = {kind for _, kind in stage.inputs}
        produced: dict[str, int] = {}  # the newest producer of each type
        for earlier, before in enumerate(found[:i]):
            produced[before.output] = earlier
            if before.output == "Perception":
                produced["VehicleState"] = earlier  # its field `vehicle`
        lines += [f"    s{j} -->|{kind.split('[')[0]}| s{i}" for kind, j in produced.items() if kind in taken]
    return "\n".join([*lines, "```"])
