"""`make mutants`: changes one thing of the code at a time and runs the tests that reach it; they have to fail.

Prints a table: of each module the mutants of its functions and of its constants, how many were killed, how many survived, and
how many are listed in equivalent.txt, as nothing that matters changes. The share is of those that are not listed.

Exit codes: 0 functions and constants reach the share; 1 one does not, or the list is wrong; 2 an argument cannot be used.
"""

from __future__ import annotations

import argparse
import sys
from collections import defaultdict
from collections.abc import Callable, Collection
from pathlib import Path

from sitl.report.progress import ShareProgress
from tests.mutants.mutate import Key, Mutant, mutants_of
from tests.mutants.trial import run

PACKAGES = ("companion/core/safety", "companion/core/control", "companion/core/filter")
CORE_TESTS = "tests/unit/core"
TESTS = (
    *(f"{CORE_TESTS}/{name}" for name in ("safety", "control", "filter", "command")),
    *(f"{CORE_TESTS}/{name}.py" for name in ("test_agent", "test_agent_thrust", "test_tick_stages")),
    "tests/unit/link/test_failing_stages.py",
)
EQUIVALENT = Path(__file__).with_name("equivalent.txt")
OUT = Path("runs/mutants")
SURVIVED = OUT / "survived.txt"  # each with module, function and change, as soon as it is known
WANTED = 0.95


def main() -> int:
    """The exit code."""
    parser = argparse.ArgumentParser(
        prog="python -m tests.mutants", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("modules", nargs="*", metavar="MODULE", help="such as safety/limits; all without any")
    parser.add_argument("--again", action="store_true", help="only those that survived the last run")
    parser.add_argument("--tests", nargs="+", default=TESTS, metavar="PATH", help="default: those of the core")
    parsed = parser.parse_args()
    paths = [path for package in PACKAGES for path in sorted(Path(package).glob("[a-z]*.py"))]
    if unknown := [name for name in parsed.modules if not any(_is_named(path, name) for path in paths)]:
        parser.error(f"no module {', '.join(unknown)} in {', '.join(PACKAGES)}")
    paths = [path for path in paths if not parsed.modules or any(_is_named(path, name) for name in parsed.modules)]
    mutants = [mutant for path in paths for mutant in mutants_of(path)]
    reasons = listed()
    stale = [key for key in reasons if Path(key[0]) in paths and key not in {m.key for m in mutants}]
    if parsed.again:
        if not SURVIVED.exists():
            parser.error(f"no run before this one has written {SURVIVED}")
        survived = {tuple(line.split("\t")) for line in SURVIVED.read_text(encoding="utf-8").splitlines()}
        mutants = [mutant for mutant in mutants if mutant.key in survived]
    OUT.mkdir(parents=True, exist_ok=True)
    with SURVIVED.open("w", encoding="utf-8") as out:
        results = _run(
            mutants, parsed.tests, reasons, lambda key: key in reasons or print(*key, sep="\t", file=out, flush=True)
        )
    share = _print_table(mutants, results, reasons)
    print(f"survivors: {SURVIVED}")
    killed = [mutant.key for mutant in mutants if results[mutant.key] and mutant.key in reasons]
    for text, keys in (("no mutant any more", stale), ("killed", killed)):
        for key in keys:
            print(f"{EQUIVALENT.name}: {text}: {' | '.join(key)}")
    return 0 if share >= WANTED and not stale and not killed else 1


def _is_named(path: Path, name: str) -> bool:
    return path.with_suffix("").as_posix().endswith(f"/{name}") or path.parent.as_posix().endswith(f"/{name}")


def listed() -> dict[Key, str]:
    """The reason of each mutant of equivalent.txt: a line of module, function, change and reason, with tabs between them."""
    listed = {}
    for line in EQUIVALENT.read_text(encoding="utf-8").splitlines():
        if line and not line.startswith("#"):
            path, function, change, reason = line.split("\t")
            listed[path, function, change] = reason
    return listed


def _run(
    mutants: list[Mutant], tests: list[str], listed: Collection[Key], survives: Callable[[Key], object]
) -> dict[Key, bool]:
    """Whether each mutant was killed."""
    results: dict[Key, bool] = {}
    with ShareProgress(quiet=False) as progress:
        progress.begin("mutants")

        def report(mutant: Mutant, killed: bool) -> None:
            results[mutant.key] = killed
            if not killed:
                survives(mutant.key)
            alive = len(results) - sum(results.values())
            progress.show(len(results) / len(mutants), f"{len(results)} of {len(mutants)}, {alive} survived")

        run(tests, mutants, listed, report)
    return results


def _print_table(mutants: list[Mutant], results: dict[Key, bool], reasons: dict[Key, str]) -> float:
    """The share that was killed, of all functions or of all constants, whichever is less."""
    rows: dict[str, list[Mutant]] = defaultdict(list)
    for mutant in mutants:
        name = "/".join(mutant.path.with_suffix("").parts[-2:])
        rows[f"{name}, constants" if mutant.is_constant else name].append(mutant)
    totals = {"all": [m for m in mutants if not m.is_constant], "all, constants": [m for m in mutants if m.is_constant]}
    print("| module | mutants | killed | survived | equivalent | share |\n|---|---|---|---|---|---|")
    least = 1.0
    for name, row in (rows | totals).items():
        equivalent = sum(mutant.key in reasons for mutant in row)
        killed = sum(results[mutant.key] for mutant in row if mutant.key not in reasons)
        judged = len(row) - equivalent
        share = killed / judged if judged else 1.0
        if name in totals:
            least = min(least, share)
        print(f"| {name} | {len(row)} | {killed} | {judged - killed} | {equivalent} | {100.0 * share:.1f} % |")
    return least


if __name__ == "__main__":
    sys.exit(main())
