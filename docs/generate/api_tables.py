"""The tables of docs/api.md, from companion/monitor/api.py: each type with its fields, their JSON types and meanings;
and that of docs/metrics.md, from companion/monitor/metrics.py.
"""

from __future__ import annotations

import ast
import inspect
import textwrap
from collections.abc import Iterator

from companion.monitor import api
from companion.monitor.metrics import FLEET_MEASURES, OF_FLEET, OF_VEHICLE, SERVER_MEASURES, VEHICLE_MEASURES, Measure

NAMES = {
    "float": "number",
    "int": "integer",
    "str": "text",
    "bool": "boolean",
    "None": "null",
    "Vector3": "[x, y, z]",
    "Finite": "number",
    "FleetName": "text",
    "Word": "text",
    "NetworkState": "{security, admission}",
    "RecordingState": "{state, dropped}",
    "Severity": '"critical", "warning" or "info"',
}
NOT_TYPES = {"HistorySample": "a list with these values, in this order"}


def types() -> str:
    """A heading, a sentence and a table for each type, in the order of the file."""
    source = inspect.getsource(api)
    lines = source.splitlines()
    tree = ast.parse(source)
    return "\n".join(line for node in tree.body if isinstance(node, ast.ClassDef) for line in _type(node, lines))


def _type(node: ast.ClassDef, lines: list[str]) -> Iterator[str]:
    yield from (f"### {node.name}", "")
    if text := ast.get_docstring(node):
        yield from (*textwrap.wrap(text.replace("\n\n", " "), 100, break_on_hyphens=False), "")
    if node.name in NOT_TYPES:
        yield from (f"In JSON {NOT_TYPES[node.name]}.", "")
    yield from ("| field | JSON | meaning |", "|---|---|---|")
    tag = _keyword(node, "tag")
    if tag:
        yield f'| `{_keyword(node, "tag_field")}` | `"{tag}"` | which message this is |'
    for field in node.body:
        if isinstance(field, ast.AnnAssign) and isinstance(field.target, ast.Name):
            comment = lines[(field.end_lineno or field.lineno) - 1].partition("  # ")[2]
            cells = (f"`{field.target.id}`", json_type(field.annotation), comment)
            yield "| " + " | ".join(cell.replace("|", "\\|") for cell in cells) + " |"
    yield ""


def _keyword(node: ast.ClassDef, name: str) -> str:
    values = [word.value for word in node.keywords if word.arg == name]
    return str(values[0].value) if values and isinstance(values[0], ast.Constant) else ""


def json_type(node: ast.expr) -> str:
    """The JSON type of an annotation."""
    match node:
        case ast.BinOp(left=left, right=right):
            return f"{json_type(left)} or {json_type(right)}"
        case ast.Subscript(value=ast.Name(id="Annotated"), slice=ast.Tuple(elts=[inner, *_])):
            return json_type(inner)
        case ast.Subscript(value=ast.Name(id="Literal"), slice=ast.Tuple(elts=words)):
            return ", ".join(f'`"{ast.literal_eval(word)}"`' for word in words)
        case ast.Subscript(value=ast.Name(id="tuple"), slice=ast.Tuple(elts=[inner, ast.Constant(value=value)])) if (
            value is Ellipsis
        ):
            return f"list of {json_type(inner)}"
        case ast.Subscript(value=ast.Name(id="tuple"), slice=ast.Tuple(elts=inner)):
            return f"[{', '.join(map(json_type, inner))}]"
        case ast.Subscript(value=ast.Name(id="dict"), slice=ast.Tuple(elts=[_, inner])):
            return "object" if ast.unparse(inner) == "Any" else f"object of {json_type(inner)} by id"
        case ast.Name(id="VehicleIds"):
            return "list of integer"
        case ast.Name(id=name) if name in NAMES:
            return NAMES[name]
        case ast.Name(id=name) if (
            isinstance(getattr(api, name, None), type) and getattr(api, name).__module__ == api.__name__
        ):
            return f"[{name}](#{name.lower()})"
        case ast.Constant(value=None):
            return "null"
    return "object"


def metrics() -> str:
    rows = [_metric(measure, OF_VEHICLE) for measure in VEHICLE_MEASURES]
    rows += [_metric(measure, OF_FLEET) for measure in FLEET_MEASURES]
    rows += [f"| `{name}` | gauge | - | {text} |" for name, text in SERVER_MEASURES.items()]
    return "\n".join(["| metric | type | labels | value |", "|---|---|---|---|", *rows])


def _metric(measure: Measure, labels: tuple[str, ...]) -> str:
    names = ", ".join((*labels, measure.by) if measure.by else labels)
    return f"| `{measure.name}` | {'counter' if measure.is_counter else 'gauge'} | {names} | {measure.help} |"
