"""What is changed: the functions by the mutators of mutmut, the numbers of module and class bodies by those of this module.

mutmut mutates no module constants, and they are the safety margins.
"""

from __future__ import annotations

import ast
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import libcst
from libcst.metadata import MetadataWrapper, PositionProvider
from mutmut.mutation.file_mutation import MutationVisitor, deep_replace
from mutmut.mutation.mutators import mutation_operators
from mutmut.mutation.pragma_handling import IgnoredCode

Key = tuple[str, str, str]
"""File, function and change."""


@dataclass(frozen=True)
class Mutant:
    """One change of one file. `function` is its qualified name, or the name of a constant; `change` tells it from the others
    of that function. `lines` are those of the changed expression, or none where that is not known.
    """

    path: Path
    function: str
    change: str
    source: str
    lines: range
    is_constant: bool = False

    @property
    def key(self) -> Key:
        return self.path.as_posix(), self.function, self.change


def mutants_of(path: Path) -> list[Mutant]:
    """All mutants of this file; a change that occurs again in a function is numbered."""
    seen: dict[Key, int] = {}
    numbered = []
    for mutant in (*_functions(path), *_constants(path)):
        count = seen[mutant.key] = seen.get(mutant.key, 0) + 1
        change = mutant.change if count == 1 else f"{mutant.change} #{count}"
        numbered.append(Mutant(path, mutant.function, change, mutant.source, mutant.lines, mutant.is_constant))
    return numbered


def _functions(path: Path) -> Iterator[Mutant]:
    source = path.read_text(encoding="utf-8")
    visitor = MutationVisitor(mutation_operators, IgnoredCode(set(), set(), set()))
    wrapper = MetadataWrapper(libcst.parse_module(source))
    module = wrapper.visit(visitor)
    positions = wrapper.resolve(PositionProvider)
    owners = {
        method: (f"{node.name.value}.{method.name.value}", node)
        for node in module.body
        if isinstance(node, libcst.ClassDef)
        for method in node.body.body
        if isinstance(method, libcst.FunctionDef)
    }
    for mutation in visitor.mutations:
        function = mutation.contained_by_top_level_function
        if not isinstance(function, libcst.FunctionDef) or _is_message(mutation.original_node):
            continue
        name, statement = owners.get(function, (function.name.value, function))
        changed = deep_replace(statement, mutation.original_node, mutation.mutated_node)
        body = [changed if each is statement else each for each in module.body]
        at = positions[mutation.original_node]
        before, after = (_one_line(module.code_for_node(n)) for n in (mutation.original_node, mutation.mutated_node))
        lines = range(at.start.line, at.end.line + 1)
        yield Mutant(path, name, _difference(before, after), module.with_changes(body=body).code, lines)


def _is_message(node: libcst.CSTNode) -> bool:
    """Words for people: tests do not assert sentences."""
    return isinstance(node, libcst.SimpleString) and " " in node.value


def _one_line(code: str) -> str:
    return " ".join(code.split())


def _difference(before: str, after: str) -> str:
    """`before -> after`, without what both begin and end with, as far as whole words."""
    head = 0
    while head < min(len(before), len(after)) and before[head] == after[head]:
        head += 1
    tail = 0
    while tail < min(len(before), len(after)) - head and before[-1 - tail] == after[-1 - tail]:
        tail += 1
    head = max(head - 20, 0)
    tail = max(tail - 20, 0)
    return f"{before[head : len(before) - tail]} -> {after[head : len(after) - tail]}"


def _constants(path: Path) -> Iterator[Mutant]:
    source = path.read_text(encoding="utf-8")
    offsets = [0]
    for line in source.splitlines(keepends=True):
        offsets.append(offsets[-1] + len(line.encode()))
    raw = source.encode()
    for name, statement in module_statements(ast.parse(source)):
        for node in ast.walk(statement):
            if not isinstance(node, ast.Constant) or not isinstance(node.value, int | float):
                continue
            first = offsets[node.lineno - 1] + node.col_offset
            last = offsets[node.end_lineno - 1] + node.end_col_offset  # type: ignore[operator]
            for other in _others(node.value):
                changed = (raw[:first] + repr(other).encode() + raw[last:]).decode()
                where = " ".join(source.splitlines()[node.lineno - 1].split())
                change = f"{where[:40]}: {node.value!r} -> {other!r}"
                yield Mutant(path, name, change, changed, range(0), is_constant=True)


def module_statements(module: ast.Module) -> Iterator[tuple[str, ast.expr]]:
    """The name and the value of each assignment in the body of the module and of its classes."""
    bodies = [module.body, *(node.body for node in module.body if isinstance(node, ast.ClassDef))]
    for statement in (statement for body in bodies for statement in body):
        if isinstance(statement, ast.Assign | ast.AnnAssign) and statement.value is not None:
            target = statement.targets[0] if isinstance(statement, ast.Assign) else statement.target
            names = target.elts if isinstance(target, ast.Tuple) else [target]
            for each in names:
                values = statement.value.elts if len(names) > 1 and isinstance(statement.value, ast.Tuple) else None
                value = values[names.index(each)] if values else statement.value
                if isinstance(each, ast.Name):
                    yield each.id, value


def _others(value: float) -> tuple[float, ...]:
    if isinstance(value, bool):
        return (not value,)
    if isinstance(value, int) or value == 0.0:
        return (value + 1, value - 1)
    return (value * 0.5, value * 2.0, -value)
