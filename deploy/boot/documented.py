"""What docs/installation.md promises: journal lines, as patterns, and the commands of an installation."""

from __future__ import annotations

import re
from pathlib import Path

PAGE = Path(__file__).resolve().parents[2] / "docs" / "installation.md"
ROW = re.compile(r"^\| `([^`]+)` \|", re.MULTILINE)


def documented_lines(page: str) -> list[re.Pattern[str]]:
    """The first column of the table below the heading "Journal lines"; `...` stands for anything."""
    section = page.partition("## Journal lines")[2].partition("\n## ")[0]
    return [re.compile(".*".join(map(re.escape, line.split("...")))) for line in ROW.findall(section)]


def guide_commands(page: str) -> list[str]:
    """From a bare computer to READY: the first blocks below the headings "Prepare the files" and "Install"."""
    sections = (page.partition(f"## {heading}\n")[2] for heading in ("Prepare the files", "Install"))
    blocks = (section.partition("```sh\n")[2].partition("```")[0] for section in sections)
    return [line for block in blocks for line in block.splitlines() if line.strip()]


def missing_lines(page: str, journal: str) -> list[str]:
    """The documented lines that the journal does not have."""
    return [pattern.pattern for pattern in documented_lines(page) if not pattern.search(journal)]
