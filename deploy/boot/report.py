"""The results of the boot: one line each, a table, and a page of the documentation."""

from __future__ import annotations

import os
from dataclasses import dataclass, field

PAGE = """\
# A boot, measured

Written by `make boot`: systemd boots a bare Debian {suite} root in a container, the Debian package
is installed into it without a network, and a stand-in autopilot runs beside the agent.
[Installation](installation.md) explains the package. The times are of a computer with {cores}
cores; a Raspberry Pi needs longer to start Python.

| step | measured | wanted | result |
|---|---|---|---|
{rows}
"""


@dataclass(frozen=True)
class Result:
    """One check: what was found and what is wanted."""

    step: str
    found: str
    wanted: str
    passed: bool

    def __str__(self) -> str:
        return f"{'ok  ' if self.passed else 'FAIL'}  {self.step:<52}  {self.found:<28}  wanted: {self.wanted}"


@dataclass
class Results:
    """All checks so far; each is printed at once."""

    all: list[Result] = field(default_factory=list)

    def check(self, step: str, passed: bool, found: str, wanted: str) -> None:
        """Record a check that has passed or not."""
        self.all.append(Result(step, found, wanted, passed))
        print(self.all[-1], flush=True)

    def time(self, step: str, found_s: float, limit_s: float) -> None:
        """Record a time with its limit."""
        self.check(step, found_s < limit_s, f"{found_s:.2f} s", f"under {limit_s:g} s")

    @property
    def failed(self) -> int:
        return sum(not result.passed for result in self.all)

    def page(self, suite: str) -> str:
        """The page of the documentation."""
        rows = [
            f"| {result.step} | {_cell(result.found)} | {_cell(result.wanted)} | {'ok' if result.passed else '**failed**'} |"
            for result in self.all
        ]
        return PAGE.format(suite=suite, rows="\n".join(rows), cores=os.cpu_count())


def _cell(text: str) -> str:
    return text.replace("|", "\\|")
