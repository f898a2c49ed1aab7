"""Runs the tests against mutants, each in a fork of its own, with the tests that reach the changed lines.

Tests are imported and collected once: a mutant of a function only gets other bytecode, one of a constant another value in every
module that has imported it. What is used while modules are imported (a default, a row of a table, a constant made of another)
is tried by importing everything again.
"""

from __future__ import annotations

import importlib.abc
import os
import pickle
import resource
import sys
import types
from collections import Counter
from collections.abc import Callable, Collection, Iterable, Iterator, Sequence
from importlib.util import spec_from_file_location
from pathlib import Path
from time import process_time
from typing import Any

import pytest
from _pytest.runner import runtestprotocol
from coverage import Coverage
from hypothesis import Phase, settings

from tests.mutants.mutate import Key, Mutant
from tests.mutants.uses import ASSEMBLY, CORE, Uses

ARGUMENTS = ["-q", "--assert=plain", "-p", "no:cacheprovider", "-m", "not long", "--hypothesis-profile=mutants"]
MOST_TESTS = 300  # of one mutant: nearly all tests of the core pass the output limits
FEW_TESTS = 40  # of one that is listed as equivalent
FEW_FILES = 4  # test files that are imported first where everything is imported again
MOST_BYTES = 3 << 30

Contexts = dict[str, dict[int, list[str]]]
"""Of each file of the product the tests that reach a line."""


def run(
    tests: Sequence[str], mutants: Sequence[Mutant], listed: Collection[Key], report: Callable[[Mutant, bool], None]
) -> None:
    """`report` gets each mutant once, and whether it was killed. `listed`: what is expected to survive is tried by few tests.

    Raises RuntimeError where a test fails without a mutant.
    """
    # No search for a smaller example: one failure is enough.
    phases = (Phase.explicit, Phase.generate)
    quick = settings(deadline=None, derandomize=True, max_examples=30, database=None, phases=phases)
    settings.register_profile("mutants", quick)
    reader, writer = os.pipe()
    if not (child := os.fork()):
        os.close(reader)
        forget_imports()
        with os.fdopen(writer, "wb") as out:
            pytest.main([*ARGUMENTS, *tests], plugins=[_Collected(mutants, listed, out)])
        os._exit(0)
    os.close(writer)
    imported_again, seconds = [], {}
    with os.fdopen(reader, "rb") as results:
        while True:
            try:
                kind, value = pickle.load(results)
            except EOFError:
                break
            if kind == "tests":
                seconds = value
            elif value[1] is None:
                imported_again.append((mutants[value[0]], value[2]))
            else:
                report(mutants[value[0]], value[1])
    os.waitpid(child, 0)
    if not seconds:
        raise RuntimeError("the tests do not pass without a mutant")
    for mutant, chosen in imported_again:
        report(mutant, _killed_by_import(mutant, chosen, seconds))


def forget_imports() -> None:
    """What shows the progress has imported some of the product: without the change, and before its lines were watched."""
    for name in [name for name in sys.modules if name.partition(".")[0] in ("companion", "sitl")]:
        del sys.modules[name]


class _Collected:
    """Plugin of one session: collects the tests, runs them once, then those that reach it against each mutant."""

    def __init__(self, mutants: Sequence[Mutant], listed: Collection[Key], out: Any) -> None:
        self._mutants, self._listed, self._out = mutants, listed, out
        self._coverage = _coverage()
        self._coverage.start()
        self._killers: Counter[tuple[str, str]] = Counter()

    def pytest_runtestloop(self, session: pytest.Session) -> bool:
        self._coverage.stop()
        imports = _contexts(self._coverage)
        contexts, seconds = _in_fork(lambda: _run_all(session.items))
        if not seconds:
            return True
        self._send("tests", seconds)
        items = {item.nodeid: item for item in session.items}
        uses = Uses()
        for index, mutant in enumerate(self._mutants):
            at_import = mutant.is_constant and uses.are_at_import(mutant)
            chosen = self._nearest(mutant, _reaching(mutant, contexts, uses), seconds)
            apply = None if at_import else _change_of(mutant)
            if apply is None:
                self._send("result", (index, None, self._more(mutant, chosen, contexts, seconds)))
                continue
            killer = _killer(apply, [(items[name], seconds[name]) for name in chosen])
            if killer is not None and chosen:
                self._killers[mutant.function, chosen[killer]] += 1
            again = killer is None and not mutant.is_constant and _reached(mutant, imports)
            if again:
                self._send("result", (index, None, self._more(mutant, chosen, contexts, seconds)))
            else:
                self._send("result", (index, killer is not None, []))
        return True

    def _nearest(self, mutant: Mutant, names: list[str], seconds: dict[str, float]) -> list[str]:
        """First what killed others of this function, then those of the same package; of each the short ones, and the first
        cases of all tests before the second ones.
        """
        folder, cases = f"/{mutant.path.parent.name}/", Counter[str]()
        keys = {}
        for name in sorted(names, key=seconds.__getitem__):
            cases[test := name.partition("[")[0]] += 1
            keys[name] = (-self._killers[mutant.function, name], folder not in name, cases[test])
        return sorted(keys, key=keys.__getitem__)[: FEW_TESTS if mutant.key in self._listed else MOST_TESTS]

    def _more(self, mutant: Mutant, chosen: list[str], contexts: Contexts, seconds: dict[str, float]) -> list[str]:
        """These, then the tests of anything in the module: they may use what was made at import."""
        lines = contexts.get(mutant.path.as_posix(), {}).values()
        others = {name for names in lines for name in names} - set(chosen)
        half = MOST_TESTS // 2
        return [*chosen, *self._nearest(mutant, sorted(others), seconds)[:half]]

    def _send(self, kind: str, value: object) -> None:
        pickle.dump((kind, value), self._out)
        self._out.flush()


def _coverage() -> Coverage:
    return Coverage(data_file=None, include=[f"{CORE}/*", str(ASSEMBLY)], config_file=False)


def _contexts(coverage: Coverage) -> Contexts:
    data = coverage.get_data()
    return {str(Path(name).relative_to(Path.cwd())): data.contexts_by_lineno(name) for name in data.measured_files()}


def _run_all(items: list[pytest.Item]) -> tuple[Contexts, dict[str, float]]:
    """The tests that reach each line, and the seconds of each test; none where one fails."""
    coverage, seconds = _coverage(), {}
    coverage.start()
    for item, following in _pairs(items):
        coverage.switch_context(item.nodeid)
        reports = runtestprotocol(item, log=False, nextitem=following)
        if any(each.failed for each in reports):
            print(f"{item.nodeid} fails without a mutant:\n{reports}", file=sys.__stderr__)
            return {}, {}
        seconds[item.nodeid] = sum(each.duration for each in reports)
    coverage.stop()
    return _contexts(coverage), seconds


def _pairs(items: Sequence[pytest.Item]) -> Iterator[tuple[pytest.Item, pytest.Item | None]]:
    return zip(items, [*items[1:], None], strict=True)


def _in_fork(function: Callable[[], Any]) -> Any:
    """What the function returns, without what it leaves in this process."""
    reader, writer = os.pipe()
    if not (child := os.fork()):
        with os.fdopen(writer, "wb") as out:
            pickle.dump(function(), out)
        os._exit(0)
    os.close(writer)
    with os.fdopen(reader, "rb") as results:
        value = pickle.load(results)
    os.waitpid(child, 0)
    return value


def _reached(mutant: Mutant, contexts: Contexts) -> set[str]:
    lines = contexts.get(mutant.path.as_posix(), {})
    return {name for line in mutant.lines for name in lines.get(line, ())}


def _reaching(mutant: Mutant, contexts: Contexts, uses: Uses) -> list[str]:
    if not mutant.is_constant:
        return sorted(_reached(mutant, contexts))
    used = ((path, line) for path, lines in uses.of(mutant).items() for line in lines)
    return sorted({name for path, line in used for name in contexts.get(path, {}).get(line, ())})


def _module(mutant: Mutant) -> str:
    return ".".join(mutant.path.with_suffix("").parts)


def _change_of(mutant: Mutant) -> Callable[[], None] | None:
    """What makes this process run the mutant; None where it has to be there when the modules are imported."""
    module = sys.modules[_module(mutant)]
    if mutant.is_constant:
        before = getattr(module, mutant.function, None)
        changed = types.ModuleType(module.__name__)
        changed.__file__ = module.__file__
        exec(compile(mutant.source, str(module.__file__), "exec"), changed.__dict__)
        after = getattr(changed, mutant.function, None)
        holders = [m for m in list(sys.modules.values()) if m and m.__dict__.get(mutant.function) is before]

        def replace() -> None:
            for holder in holders:
                setattr(holder, mutant.function, after)

        return None if before is None else replace
    function: Any = module
    for part in mutant.function.split("."):
        function = function.__dict__[part]
    function = getattr(function, "__func__", function)
    code = _code_of(mutant, str(module.__file__), function.__code__.co_qualname)
    if code is None or code == function.__code__ or code.co_freevars != function.__code__.co_freevars:
        return None
    return lambda: setattr(function, "__code__", code)


def _code_of(mutant: Mutant, file: str, qualname: str) -> types.CodeType | None:
    pending = [compile(mutant.source, file, "exec", dont_inherit=True)]
    while pending:
        code = pending.pop()
        if code.co_qualname == qualname:
            return code
        pending += [constant for constant in code.co_consts if isinstance(constant, types.CodeType)]
    return None


def _killer(apply: Callable[[], None], tests: Sequence[tuple[pytest.Item, float]]) -> int | None:
    """The place of the first test that fails, or does not end; None where all pass. `tests`: each with its usual seconds."""
    if not tests:
        return None
    reader, writer = os.pipe()
    if not (child := os.fork()):
        apply()
        for index, (item, following) in enumerate(_pairs([item for item, _ in tests])):
            os.write(writer, index.to_bytes(4, "big"))
            _limit(10.0 * tests[index][1])
            if any(each.failed for each in runtestprotocol(item, log=False, nextitem=following)):
                os._exit(1)
        os._exit(0)
    os.close(writer)
    with os.fdopen(reader, "rb") as begun:
        last = begun.read()[-4:]
    _, status = os.waitpid(child, 0)
    return None if status == 0 else int.from_bytes(last, "big")


def _limit(further_s: float) -> None:
    """CPU time and memory: a loop without an end is noticed, on a machine with other load as well."""
    seconds = int(process_time() + further_s) + 2
    resource.setrlimit(resource.RLIMIT_CPU, (seconds, resource.RLIM_INFINITY))
    resource.setrlimit(resource.RLIMIT_DATA, (MOST_BYTES, MOST_BYTES))


def _killed_by_import(mutant: Mutant, chosen: Iterable[str], seconds: dict[str, float]) -> bool:
    """The same with all modules imported after the change: first the files with most of these tests, then the others."""
    counts = Counter(name.partition("::")[0] for name in chosen)
    files = [file for file, _ in counts.most_common()]
    for part in (files[:FEW_FILES], files[FEW_FILES:]):
        names = {name for name in chosen if name.partition("::")[0] in part}
        if names and _fails(mutant, part, names, 20.0 + 4.0 * sum(seconds[name] for name in names)):
            return True
    return False


def _fails(mutant: Mutant, files: list[str], names: set[str], usual_s: float) -> bool:
    if not (child := os.fork()):
        _limit(usual_s)
        forget_imports()
        quiet = os.open(os.devnull, os.O_WRONLY)
        os.dup2(quiet, 1)
        os.dup2(quiet, 2)
        sys.meta_path.insert(0, Changed(mutant))
        os._exit(int(pytest.main(["-x", *ARGUMENTS, *files], plugins=[_Only(names)])))
    _, status = os.waitpid(child, 0)
    return status != 0


class _Only:
    def __init__(self, names: set[str]) -> None:
        self._names = names

    def pytest_collection_modifyitems(self, items: list[pytest.Item]) -> None:
        items[:] = [item for item in items if item.nodeid in self._names]


class Changed(importlib.abc.MetaPathFinder, importlib.abc.Loader):
    """Imports one module from the source of a mutant."""

    def __init__(self, mutant: Mutant) -> None:
        self._name, self._file, self._source = _module(mutant), mutant.path.resolve(), mutant.source

    def find_spec(self, fullname: str, path: object, target: object = None) -> Any:
        del path, target
        return spec_from_file_location(fullname, self._file, loader=self) if fullname == self._name else None

    def exec_module(self, module: types.ModuleType) -> None:
        exec(compile(self._source, self._file, "exec"), module.__dict__)
