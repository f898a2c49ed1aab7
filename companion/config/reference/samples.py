"""Points with their times, flown smoothly through all of them."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from functools import lru_cache
from itertools import pairwise
from pathlib import Path
from typing import Annotated, Any

from msgspec import Meta

from companion.config.file import ConfigError, read_text
from companion.config.reference.timed import TimedReference
from companion.config.validation import InvalidFieldError
from companion.config.values import HIGHEST_M, LOWEST_M, Coordinate, Text
from companion.geometry.curves import Curve
from companion.geometry.spline import through
from companion.types.values import quoted

COLUMNS = ("t", "x", "y", "z")
MOST_SAMPLES, MOST_IN_COMMAND = 1000, 50  # as a command is judged in flight
PER_INTERVAL = 4  # points between two samples at which the motion is judged
DIGITS = 6  # of what is read from a file, so that the file of a flight can hold all samples
Row = tuple[Coordinate, Coordinate, Coordinate, Coordinate]


class SamplesReference(TimedReference, frozen=True, kw_only=True, omit_defaults=True, tag_field="kind", tag="samples"):
    """Through all samples at their times, with continuous acceleration. It stops only where two samples in a row are equal.

    samples: rows of t in seconds, rising, and x, y, z; the reference begins at the first one
    file: a CSV file beside this file with a line `t,x,y,z` and a line for each sample, instead of `samples`; yaw is
        not flown, each vehicle keeps its own
    """

    TITLE, POSITION = "Samples", "samples"

    samples: Annotated[tuple[Row, ...], Meta(max_length=MOST_SAMPLES)] = ()
    file: Text | None = None

    @classmethod
    def read(cls, section: dict[str, Any], where: str, beside: Path) -> dict[str, Any]:
        """With the samples of the file."""
        name = section.get("file")
        if not isinstance(name, str):
            return section
        if section.get("samples"):
            raise ConfigError(beside, f"{where}.samples", "goes without file; give one of them")
        return section | {"file": None, "samples": read_samples(beside.parent / name)}

    def contradictions(self) -> Iterator[tuple[str, str]]:
        if len(self.samples) < 2:
            yield "samples", "expected at least two rows [t, x, y, z], or a file with them"
        for index, (before, after) in enumerate(pairwise(self.samples)):
            if after[0] <= before[0]:
                yield (
                    f"samples[{index + 1}]",
                    f"t is {after[0]:g} s; expected more than {before[0]:g} s, that of the row before",
                )

    def refusal_as_command(self) -> tuple[str, str] | None:
        if self.file is not None:
            return "file", f"{quoted(self.file)}: a command brings no file; expected samples"
        if len(self.samples) > MOST_IN_COMMAND:
            return "samples", f"{len(self.samples)} rows; a command brings at most {MOST_IN_COMMAND}"
        return None

    def given(self) -> tuple[Curve, Sequence[float]]:
        if any(self.contradictions()):
            raise InvalidFieldError
        return _flown(self.samples)


@lru_cache(maxsize=8)
def _flown(samples: tuple[Row, ...]) -> tuple[Curve, Sequence[float]]:
    begin_s = samples[0][0]
    times_s = [row[0] - begin_s for row in samples]
    between = [a + (b - a) * index / PER_INTERVAL for a, b in pairwise(times_s) for index in range(PER_INTERVAL)]
    return through(times_s, [row[1:] for row in samples]), [*between, times_s[-1]]


def read_samples(path: Path) -> list[list[float]]:
    """The rows t, x, y, z of a CSV file. Raises ConfigError, which names the line and the column."""
    text = read_text(path).removeprefix("\ufeff")  # which spreadsheets write
    lines = [
        (number, [cell.strip() for cell in line.split(",")])
        for number, line in enumerate(text.splitlines(), 1)
        if line.strip(", ")
    ]
    header = lines[0][1] if lines else []
    if sorted(header) != sorted(COLUMNS):
        yaw = "; a reference has no yaw, each vehicle keeps its own" if "yaw" in ",".join(header).lower() else ""
        raise ConfigError(path, "line 1", f"{quoted(','.join(header))}: expected the columns {','.join(COLUMNS)}{yaw}")
    order = [header.index(column) for column in COLUMNS]
    rows: list[list[float]] = []
    for number, cells in lines[1:]:
        if len(cells) != len(COLUMNS):
            raise ConfigError(path, f"line {number}", f"{len(cells)} values; expected {len(COLUMNS)}")
        row = [_number(path, number, column, cells[at]) for column, at in zip(COLUMNS, order, strict=True)]
        if rows and row[0] <= rows[-1][0]:
            raise ConfigError(
                path, f"line {number}, t", f"{row[0]:g}: expected more than {rows[-1][0]:g}, that of the line before"
            )
        rows.append(row)
    if not 2 <= len(rows) <= MOST_SAMPLES:
        raise ConfigError(path, "", f"{len(rows)} samples; expected 2 to {MOST_SAMPLES}")
    return rows


def _number(path: Path, line: int, column: str, text: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = float("nan")
    if not LOWEST_M <= value <= HIGHEST_M:
        raise ConfigError(
            path, f"line {line}, {column}", f"{quoted(text)}: expected a number from {LOWEST_M:g} to {HIGHEST_M:g}"
        )
    return round(value, DIGITS)


KIND = SamplesReference
