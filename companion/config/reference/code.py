"""A function of time in a Python file. It runs before the flight and never in it."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from functools import lru_cache
from itertools import pairwise
from math import ceil, dist, hypot, isfinite
from pathlib import Path
from typing import Annotated, Any

from msgspec import Meta

from companion.config.code_file import carried_section, code_error, loaded_code, read_section
from companion.config.file import ConfigError
from companion.config.reference.timed import TimedReference
from companion.config.values import Text, written
from companion.geometry.curves import Curve, Motion, ramped
from companion.geometry.spline import table
from companion.types.values import Vector3

NAME = "reference"
STEP_S = 0.05  # between two times at which the function is called; the flight interpolates to the fifth order
TOLERANCE = (
    0.02  # of velocities and accelerations against the changes of position and velocity: m/s and m/s^2, and a share
)
FORM = "expected (position, velocity, acceleration), each three finite numbers"


class FileReference(TimedReference, frozen=True, kw_only=True, tag_field="kind", tag="file"):
    """A function of time in a Python file: `reference(time_s)` returns position, velocity and acceleration, three numbers each.

    It runs before the flight alone, for all times from 0 to `lasts_s`. No command brings such a reference.

    file: the Python file, in the folder of this file; only root and the user of the process may be able to write either
    lasts_s: end of the time; the reference comes to rest there
    ramp_s: time from rest to full pace, and from it to rest
    sha256: hexadecimal SHA-256 that the content must have; without it any
    """

    TITLE, POSITION = "Python file", "file"

    file: Text
    lasts_s: Annotated[float, Meta(ge=1, le=600)]
    ramp_s: Annotated[float, Meta(ge=0.1, le=60)] = 5.0
    sha256: Annotated[str, written("^[0-9a-f]{64}$", "64 hexadecimal digits")] | None = None

    @classmethod
    def read(cls, section: dict[str, Any], where: str, beside: Path) -> dict[str, Any]:
        """With the whole path and the SHA-256 of the file, which is loaded."""
        return read_section(section, where, beside)

    @classmethod
    def carried(cls, section: dict[str, Any], folder: Path) -> dict[str, Any]:
        """With a copy of the file in the folder; others may write neither, whatever the umask."""
        return carried_section(section, folder)

    def contradictions(self) -> Iterator[tuple[str, str]]:
        if self.ramp_s > self.lasts_s:
            yield "ramp_s", f"{self.ramp_s:g}: expected at most lasts_s, {self.lasts_s:g}"

    def refusal_as_command(self) -> tuple[str, str] | None:
        return "kind", "file: a command brings no code; it is for a vehicle file or a scenario"

    def given(self) -> tuple[Curve, Sequence[float]]:
        curve, times_s = _tabulated(self.file, self.sha256, self.lasts_s)
        warped_s = [time_s * (1.0 + self.ramp_s / self.lasts_s) for time_s in times_s]
        return ramped(curve, self.lasts_s, self.ramp_s), warped_s

    def __reduce__(self) -> tuple[Callable[..., FileReference], tuple[Any, ...]]:
        """To another process of this machine, which loads the file itself."""
        return _restored, (self.file, self.sha256, self.lasts_s, self.ramp_s, self.pace)


def _restored(file: str, sha256: str | None, lasts_s: float, ramp_s: float, pace: float) -> FileReference:
    plain = {"file": file, "sha256": sha256, "lasts_s": lasts_s, "ramp_s": ramp_s, "pace": pace}
    return FileReference(**FileReference.read(plain, NAME, beside=Path(file)))


@lru_cache(maxsize=4)
def _tabulated(file: str, sha256: str | None, lasts_s: float) -> tuple[Curve, Sequence[float]]:
    """The motion at all times, and these. Raises ConfigError."""
    function = loaded_code(file, sha256).namespace.get(NAME)
    if not callable(function):
        raise ConfigError(file, NAME, f"missing; expected a function {NAME}(time_s)")
    count = ceil(lasts_s / STEP_S)
    times_s = [lasts_s * index / count for index in range(count + 1)]
    motions = [_motion(Path(file), function, time_s) for time_s in times_s]
    for (begin_s, before), (end_s, after) in pairwise(zip(times_s, motions, strict=True)):
        _check_derivatives(file, before, after, begin_s, end_s - begin_s)
    return table(times_s, motions), times_s


def _motion(file: Path, function: Callable[[float], Any], time_s: float) -> Motion:
    try:
        position, velocity, acceleration = (_vector(vector) for vector in function(time_s))
    except (Exception, SystemExit) as error:  # whatever foreign code raises
        found = code_error(file, error)
        raise ConfigError(found.lines[0], "", f"at {time_s:g} s; {FORM}") from error
    return position, velocity, acceleration


def _vector(values: Any) -> Vector3:
    x, y, z = (float(value) for value in values)
    if not isfinite(x + y + z):
        raise ValueError(f"{(x, y, z)} is not finite")
    return x, y, z


def _check_derivatives(file: str, before: Motion, after: Motion, time_s: float, step_s: float) -> None:
    """Each change must be the integral of what is given for it: of velocity by the trapezoid and its correction."""
    for order, (word, base, unit) in enumerate(
        (("velocity", "position", "m/s"), ("acceleration", "velocity", "m/s^2"))
    ):
        means = [(a + b) / 2.0 for a, b in zip(before[order + 1], after[order + 1], strict=True)]
        if order == 0:
            means = [m + step_s * (a - b) / 12.0 for m, a, b in zip(means, before[2], after[2], strict=True)]
        changes = [(b - a) / step_s for a, b in zip(before[order], after[order], strict=True)]
        if dist(means, changes) > TOLERANCE * (1.0 + hypot(*means)):
            given, found = (", ".join(f"{value:.3g}" for value in values) for values in (means, changes))
            problem = f"{word} ({given}) {unit} is not the derivative of the {base}, ({found}) {unit}"
            raise ConfigError(file, f"at {time_s:.2f} s", problem)


KIND = FileReference
