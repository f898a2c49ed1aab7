"""Budgets of the source, of a tick, and of the way from a position to its setpoint; tests/unit/test_budgets.py holds them.

python -m tests.bench.budgets              what exceeds its budget; exit code 1 where something does
python -m tests.bench.budgets --tighten    write today's figures where they are lower; never raises one

Budgets stand in tests/unit/budgets.json. Code lines are those that are neither blank, import, comment nor docstring.
Generated code does not count. Exceptions are listed by name, so that a module may move.
"""

from __future__ import annotations

import ast
import json
import sys
from collections import Counter
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import asdict
from pathlib import Path

from tests.bench import hot_path, tick

TOP = Path(__file__).parents[2]
FILE = TOP / "tests" / "unit" / "budgets.json"
PROGRAMS = ("companion", "sitl")
LABORATORY = ("tests/bench", "tests/soak", "tests/fuzz")
LONGEST_FUNCTION = 60  # lines
MOST_POSITIONAL = 8  # parameters of a public function, arguments of a call

Group = dict[str, float]
Budgets = dict[str, Group]  # group -> name -> budget
DOCUMENTED = (ast.Module, ast.ClassDef, ast.FunctionDef, ast.AsyncFunctionDef)
Function = ast.FunctionDef | ast.AsyncFunctionDef


class Module:
    """A module, read once for all its figures."""

    def __init__(self, text: str) -> None:
        tree = ast.parse(text)
        self.text, self.nodes, self.functions = text, list(ast.walk(tree)), list(_functions(tree))


def source_budgets() -> Budgets:
    """Today's figures of the source. A group of exceptions has no entry for what needs none."""
    modules = {path: Module(path.read_text(encoding="utf-8")) for path in _sources(PROGRAMS)}
    files, lines = Counter[str](), Counter[str]()
    for path, module in modules.items():
        package = "/".join(path.relative_to(TOP).parts[:-1][:2])
        files[package] += 1
        lines[package] += code_lines(module)
    return {
        "total": {"files": files.total(), "code_lines": lines.total()},
        "files": _sorted(files),
        "code_lines": _sorted(lines),
        **exceptions(list(modules.values())),
    }


def exceptions(modules: Collection[Module]) -> Budgets:
    """What is too long, named twice or too wide in these modules."""
    return {
        "lines_of_long_functions": _long_functions(modules),
        "repeated_class_names": _repeated_classes(modules),
        "positional_parameters": _wide_functions(modules),
        "calls_with_many_positional_arguments": _wide_calls(modules),
    }


def laboratory_exceptions() -> Budgets:
    """Those of the laboratory, without its tests."""
    paths = [path for path in _sources(LABORATORY) if not path.name.startswith("test_")]
    return exceptions([Module(path.read_text(encoding="utf-8")) for path in paths])


def tick_budgets() -> Group:
    """Today's figures of one tick."""
    return asdict(tick.figures_of(tick.platoon_ticks()))


def hot_path_budgets() -> Group:
    """Today's figures from a position to its setpoint."""
    return asdict(hot_path.figures())


def stored() -> Budgets:
    """The budgets of the file."""
    budgets: Budgets = json.loads(FILE.read_text(encoding="utf-8"))
    return budgets


def exceeded(figures: Mapping[str, Mapping[str, float]], budgets: Budgets) -> list[str]:
    """A line for each figure above its budget. What has no budget may not exist."""
    return [
        f"{group} of {name}: {figure:g}, budget {budgets[group].get(name, 0):g}"
        for group, named in figures.items()
        for name, figure in named.items()
        if figure > budgets[group].get(name, 0)
    ]


def tightened(figures: Budgets, budgets: Budgets) -> Budgets:
    """The lower of both. A budget of what no longer exists is left out."""
    return {
        group: {name: min(budget, figures[group][name]) for name, budget in named.items() if name in figures[group]}
        for group, named in budgets.items()
    }


def code_lines(module: Module) -> int:
    """Lines of a module that are neither blank, import, comment nor docstring."""
    left_out: set[int] = set()
    for node in module.nodes:
        match node:
            case ast.Import() | ast.ImportFrom():
                left_out.update(_lines_of(node))
            case ast.Module() | ast.ClassDef() | ast.FunctionDef() | ast.AsyncFunctionDef() if (
                ast.get_docstring(node) is not None
            ):
                left_out.update(_lines_of(node.body[0]))
    counted = (line.strip() for number, line in enumerate(module.text.splitlines(), start=1) if number not in left_out)
    return sum(bool(line) and not line.startswith("#") for line in counted)


def _sources(folders: Sequence[str]) -> list[Path]:
    paths = (path for folder in folders for path in (TOP / folder).rglob("*.py"))
    return sorted(path for path in paths if "generated" not in path.parts)


def _lines_of(node: ast.stmt) -> range:
    return range(node.lineno, (node.end_lineno or node.lineno) + 1)


def _functions(tree: ast.AST, prefix: str = "") -> Iterator[tuple[str, Function]]:
    """Every function with its qualified name, those within functions too."""
    for node in ast.iter_child_nodes(tree):
        match node:
            case ast.FunctionDef(name) | ast.AsyncFunctionDef(name):
                yield prefix + name, node
                yield from _functions(node, f"{prefix}{name}.")
            case ast.ClassDef(name):
                yield from _functions(node, f"{prefix}{name}.")
            case ast.stmt() | ast.ExceptHandler() | ast.match_case():  # no expression holds a function
                yield from _functions(node, prefix)


def _long_functions(modules: Collection[Module]) -> Group:
    return _largest((name, len(_lines_of(node)), LONGEST_FUNCTION) for one in modules for name, node in one.functions)


def _repeated_classes(modules: Collection[Module]) -> Group:
    names = Counter(node.name for one in modules for node in one.nodes if isinstance(node, ast.ClassDef))
    return _sorted({name: count for name, count in names.items() if count > 1})


def _wide_functions(modules: Collection[Module]) -> Group:
    """Public functions, methods and constructors; `self` and `cls` do not count."""
    return _largest(
        (name, _positional(node), MOST_POSITIONAL)
        for one in modules
        for name, node in one.functions
        if not any(part.startswith("_") and part != "__init__" for part in name.split("."))
    )


def _positional(function: Function) -> int:
    names = [argument.arg for argument in (*function.args.posonlyargs, *function.args.args)]
    return len([name for name in names if name not in ("self", "cls")])


def _wide_calls(modules: Collection[Module]) -> Group:
    """The number of such calls by what is called. Constructors of MAVLink messages have no keywords in their source."""
    calls = (node for one in modules for node in one.nodes if isinstance(node, ast.Call))
    wide = Counter(ast.unparse(call.func).rpartition(".")[2] for call in calls if len(call.args) > MOST_POSITIONAL)
    return _sorted({name: count for name, count in wide.items() if not name.startswith("MAVLink_")})


def _largest(figures: Iterator[tuple[str, int, int]]) -> Group:
    """Of (name, figure, limit) those over the limit, each name with its largest figure."""
    found: Group = {}
    for name, figure, limit in figures:
        if figure > limit:
            found[name] = max(figure, found.get(name, 0))
    return _sorted(found)


def _sorted(figures: Mapping[str, float]) -> Group:
    return dict(sorted(figures.items()))


def main(arguments: list[str]) -> int:
    """The exit code."""
    figures = {"tick": tick_budgets(), "position_to_setpoint": hot_path_budgets(), **source_budgets()}
    problems = exceeded(figures, stored())
    print("\n".join(problems) or "all within their budgets")
    if "--tighten" in arguments:
        FILE.write_text(json.dumps(tightened(figures, stored()), indent=2) + "\n", encoding="utf-8")
    return 1 if problems else 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
