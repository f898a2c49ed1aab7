"""Words of the documentation that is written by hand: `make docs-words`.

Generated pages and blocks, measured pages and decisions do not count, nor do blocks of code.
"""

from __future__ import annotations

import re
import sys
from pathlib import Path

DOCS = Path(__file__).parent.parent
TOP = DOCS.parent
GENERATED = {"configuration.md", "troubleshooting.md"}
MEASURED = {
    *("attacks.md", "boot.md", "faults.md", "gauntlet.md", "hostile.md", "large-fleets.md", "performance.md"),
    *("soak.md", "transports.md"),
}
NOT_COUNTED = re.compile(
    r"<!-- generated: (?P<name>\w+) -->.*?<!-- end of (?P=name) -->|^```.*?^```", re.DOTALL | re.MULTILINE
)


WORD = re.compile(r"\S*\w\S*")


def pages() -> dict[str, int]:
    """Words of each hand-written page, by its path from the top of the repository."""
    found = [
        TOP / "README.md",
        TOP / "ARCHITECTURE.md",
        *sorted(DOCS.glob("*.md")),
        *sorted((DOCS / "architecture").glob("*.md")),
    ]
    counted = [path for path in found if path.name not in GENERATED | MEASURED]
    return {
        str(path.relative_to(TOP)): len(WORD.findall(NOT_COUNTED.sub("", path.read_text("utf-8")))) for path in counted
    }


def main() -> int:
    """The exit code."""
    words = pages()
    for page, count in sorted(words.items(), key=lambda item: -item[1]):
        print(f"{count:6}  {page}")
    print(f"{sum(words.values()):6}  in {len(words)} pages")
    return 0


if __name__ == "__main__":
    sys.exit(main())
