"""Regenerate what the documentation takes from the code: whole pages, and blocks within pages.

    python docs/generate/pages.py            write every generated page and block
    python docs/generate/pages.py --check    change nothing; exit code 1 where something is not current

A block stands between `<!-- generated: NAME -->` and `<!-- end of NAME -->` in a page. `make docs` and
`make docs-check` call this.
"""

from __future__ import annotations

import re
import sys
from collections.abc import Callable
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[2]))
sys.path.insert(0, str(Path(__file__).parent))

import api_tables
import code_files
import configuration
import flight_tables
import package_diagram
import protocol_tables

from tests.bench import stages

DOCS = Path(__file__).parent.parent
TOP = DOCS.parent

# Files that are generated as a whole, by their path from the top of the repository.
PAGES: dict[str, Callable[[], str]] = {
    "companion/types/generated/codes.py": code_files.enumerations,
    "docs/configuration.md": configuration.configuration,
    "docs/troubleshooting.md": code_files.troubleshooting,
}

# Blocks within pages that are written by hand.
BLOCKS: dict[str, Callable[[], str]] = {
    "failsafe": flight_tables.failsafes,
    "relied_on": flight_tables.parameters_relied_on,
    "api": api_tables.types,
    "metrics": api_tables.metrics,
    "packages": package_diagram.diagram,
    "phases": flight_tables.phases,
    "commands": flight_tables.commands,
    "tick": stages.diagram,
    "timing": protocol_tables.timing,
    "telemetry": protocol_tables.telemetry,
    "modes": protocol_tables.modes,
}

BLOCK = re.compile(r"<!-- generated: (?P<name>\w+) -->\n.*?<!-- end of (?P=name) -->", re.DOTALL)


def current_texts() -> dict[Path, str]:
    """Every page that has generated text, with the text that the code gives now. Raises KeyError for an unknown block."""
    texts = {TOP / page: text() for page, text in PAGES.items()}
    for path in sorted(DOCS.rglob("*.md")):
        if path not in texts:
            written = path.read_text(encoding="utf-8")
            if BLOCK.search(written):
                texts[path] = BLOCK.sub(_block, written)
    return texts


def _block(match: re.Match[str]) -> str:
    name = match["name"]
    return f"<!-- generated: {name} -->\n{BLOCKS[name]().strip()}\n<!-- end of {name} -->"


def main(arguments: list[str]) -> int:
    """The exit code."""
    old = [path for path, text in current_texts().items() if not path.exists() or path.read_text("utf-8") != text]
    if "--check" in arguments:
        for path in old:
            print(f"{path.relative_to(TOP)} is not current; run `make docs`", file=sys.stderr)
        return 1 if old else 0
    for path, text in current_texts().items():
        if path in old:
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_text(text, encoding="utf-8")
            print(f"wrote {path.relative_to(TOP)}")
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
