"""Where a module constant is used: by its name, and by the names of constants that are made of it."""

from __future__ import annotations

import ast
from functools import cache
from pathlib import Path

from tests.mutants.mutate import Mutant, module_statements

CORE = Path("companion/core")
ASSEMBLY = Path("companion/assembly.py")  # makes the parts of the core from the fleet file
Functions = list[ast.FunctionDef]


class Uses:
    """Of all modules of the core, and of what assembles it."""

    def __init__(self) -> None:
        self._functions: list[tuple[str, ast.FunctionDef]] = []
        self._at_import: list[tuple[set[str], set[str]]] = []  # names that are set, names that they are made of
        for path in (*CORE.rglob("*.py"), ASSEMBLY):
            module = ast.parse(path.read_text(encoding="utf-8"))
            bodies = [module.body, *(node.body for node in module.body if isinstance(node, ast.ClassDef))]
            functions = [node for body in bodies for node in body if isinstance(node, ast.FunctionDef)]
            self._functions += [(path.as_posix(), node) for node in functions]
            self._at_import += [({name}, _names(value)) for name, value in module_statements(module)]
            defaults = [(node.name, d) for node in functions for d in (*node.args.defaults, *node.decorator_list)]
            self._at_import += [({name}, _names(default)) for name, default in defaults]

    def are_at_import(self, mutant: Mutant) -> bool:
        """Whether more than the value of this one name changes."""
        return len(self._changed(mutant.function)) > 1 or not _is_plain(mutant)

    @cache  # noqa: B019
    def _changed(self, name: str) -> frozenset[str]:
        """The names that are made of this one while modules are imported, by functions as well."""
        made_of = set().union(*(names for _, names in self._at_import))
        changed: set[str] = set()
        grown = {name}
        while grown - changed:
            changed |= grown
            called = {node.name for _, node in self._functions if node.name in made_of and _names(node) & changed}
            grown = set(called)
            for targets, names in self._at_import:
                if names & (changed | called):
                    grown |= targets
        return frozenset(changed)

    @cache  # noqa: B019
    def _of(self, name: str) -> dict[str, frozenset[int]]:
        names = self._changed(name)
        lines: dict[str, frozenset[int]] = {}
        for path, function in self._functions:
            used = frozenset(node.lineno for node in ast.walk(function) if _name(node) in names)  # type: ignore[attr-defined]
            if used:
                lines[path] = lines.get(path, frozenset()) | used
        return lines

    def of(self, mutant: Mutant) -> dict[str, frozenset[int]]:
        """The lines of functions that use the constant."""
        return self._of(mutant.function)


def _is_plain(mutant: Mutant) -> bool:
    module = ast.parse(mutant.path.read_text(encoding="utf-8"))
    classes = [node for node in module.body if isinstance(node, ast.ClassDef)]
    in_class = {name for c in classes for name, _ in module_statements(ast.Module(body=c.body, type_ignores=[]))}
    return mutant.function not in in_class


def _name(node: ast.AST) -> str | None:
    if isinstance(node, ast.Name):
        return node.id
    if isinstance(node, ast.Attribute):
        return node.attr
    return node.value if isinstance(node, ast.Constant) and isinstance(node.value, str) else None


def _names(node: ast.AST) -> set[str]:
    return {name for each in ast.walk(node) if (name := _name(each))}
