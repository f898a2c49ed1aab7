"""What all kinds of reference have in common, and what those share that lap or have limits."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from math import ceil, floor, hypot
from pathlib import Path
from typing import Annotated, Any, ClassVar, NamedTuple, Self

from msgspec import Meta
from msgspec.structs import replace

from companion.config.values import Section, about
from companion.geometry.curves import Curve, Harmonic
from companion.types.values import ZERO3, Vector3

RAMP_SAMPLES, LAP_SAMPLES = 100, 500
RATES = (0.1, 0.3, 1.0, 2.0, 4.0)  # frequencies of any motion to check, times largest acceleration over speed
CRUISE_M_S = 2.0  # speed of a first reference

Speed = Annotated[float, about("largest speed", ge=0.01, le=100)]
Size = Annotated[float, Meta(ge=0.01, le=1000)]


@dataclass(frozen=True, slots=True)
class Asked:
    """How an operator is asked for a key: by an option of `companion fleet reference`, and with a `title` on the page.

    The page begins with `initial`, without one with the default of the key.
    """

    option: str
    meaning: str
    title: str = ""
    initial: float | str | None = None


PERIOD = Asked("--period", "of one lap of a circle or figure 8, seconds", "Period", 40.0)
RAMP = Asked("--ramp", "until a circle or figure 8 reaches its speed, seconds", "Time to full speed")
SPEED = Asked("--speed", "limit for waypoints or a target, m/s", "Speed")
ACCELERATION = Asked("--acceleration", "limit for waypoints or a target, m/s^2", "Acceleration")


class Slower(NamedTuple):
    """A key, what it asks for, and what was expected, in words and as values of this key and those beside it."""

    key: str
    asks: str
    expected: str
    accepts: tuple[tuple[str, float], ...]


class BaseReference(Section, frozen=True):
    """What every kind answers. What a kind does not say itself is that of a point at rest."""

    TITLE: ClassVar[str]  # on the page
    POSITION: ClassVar[str]  # the key that --at and the map fill
    PLACE: ClassVar[str] = "point"  # what that position is
    MOST_POSITIONS: ClassVar[int] = 1
    AWAITED: ClassVar[bool] = False  # whether the fleet may wait for it where it is
    MOVES: ClassVar[bool] = True
    PLACED: ClassVar[bool] = True  # whether positions and ASKED describe it whole, on a command line and the page
    ASKED: ClassVar[Mapping[str, Asked]] = {}

    @classmethod
    def first(cls, size_m: float, height_m: float) -> Self | None:
        """One of this size at this height for `sitl new`, at CRUISE_M_S; None for a kind that needs more choices."""
        del size_m, height_m
        return None

    @classmethod
    def read(cls, section: dict[str, Any], where: str, beside: Path) -> dict[str, Any]:
        """The plain section with what it names read; a path begins beside the file that has the section.

        Raises ConfigError. `where` is the path of the section in that file.
        """
        del where, beside
        return section

    @classmethod
    def carried(cls, section: dict[str, Any], folder: Path) -> dict[str, Any]:
        """The plain section for a file in another folder, where a copy of what it names is put."""
        del folder
        return section

    def contradictions(self) -> Iterator[tuple[str, str]]:
        """Keys that contradict others, each with the problem."""
        return iter(())

    def refusal_as_command(self) -> tuple[str, str] | None:
        """(key, problem) of one that no vehicle takes by command."""
        return None

    @property
    def kind(self) -> str:
        return str(self.__struct_config__.tag)

    @property
    def start_enu_m(self) -> Vector3:
        position: Vector3 = getattr(self, self.POSITION)
        return position

    def corners_enu_m(self) -> tuple[Vector3, Vector3]:
        """Lowest and highest corner of the box that contains the curve."""
        return self.start_enu_m, self.start_enu_m

    def curve(self) -> Curve:
        """Where it leads; of a kind that is not known beforehand, the curve before it is known."""
        return lambda _time_s: (self.start_enu_m, ZERO3, ZERO3)

    def legs_enu_m(self) -> Sequence[tuple[Vector3, Vector3]]:
        """The straight lines that it flies one after the other; none of a curve."""
        return ()

    def largest_pace(self) -> tuple[float, float]:
        """Largest speed [m/s] and acceleration [m/s^2] at any time, or its limits."""
        return 0.0, 0.0

    def whole_s(self) -> float | None:
        """Time that shows the whole of it, seconds; None where it has no end."""
        return None

    def curve_s(self) -> float:
        """Time along `curve` after which it repeats itself, or is at rest, seconds."""
        return 0.0

    def motions(self, slots_turn: bool) -> list[list[Harmonic]]:
        """What the law has to follow, each motion by itself, its harmonics at the same time; none of a reference at rest.

        The slots of a formation that turns point in all directions in turn.
        """
        del slots_turn
        return []

    def excess(self, limit: str, most: float, times: float) -> Slower:
        """Where it is this many times too fast for `most` of a limit."""
        raise NotImplementedError

    def slower_pace(self, times: float) -> Slower:
        """Where it must take this many times longer."""
        raise NotImplementedError

    def turning_s(self) -> Sequence[float]:
        """Times at which the turn of its course is judged, for a formation that turns with it."""
        return ()

    def slower_turn(self, times: float) -> Slower:
        """Where its course must turn so many times slower."""
        return self.slower_pace(times)

    def largest_climb(self) -> tuple[float, float]:
        """Largest rate upwards and downwards [m/s] of one that has no legs."""
        return 0.0, 0.0

    def slow_down(self, times: float) -> Self:
        """The same with a pace that takes this many times longer, in rounded values."""
        del times
        return self


class LappingReference(BaseReference, frozen=True, kw_only=True):
    """One that laps.

    period_s: time of a lap at full pace
    ramp_s: time from rest to full pace
    """

    LAP_SAMPLES: ClassVar[int]  # so many of the LAP_SAMPLES points of a lap differ in pace or turn
    PLACE = "centre"

    period_s: Annotated[float, Meta(ge=1, le=3600)]
    ramp_s: Annotated[float, Meta(ge=0.1, le=60)] = 5.0

    def turning_s(self) -> list[float]:
        """Times of a lap at full pace, as far as pace and turns differ."""
        return [self.ramp_s + self.period_s * index / LAP_SAMPLES for index in range(self.LAP_SAMPLES)]

    def largest_pace(self) -> tuple[float, float]:
        return _pace_of_laps(self)

    def whole_s(self) -> float:
        """A lap, and the time to get up to its speed and back."""
        return float(ceil(self.period_s + 2.0 * self.ramp_s))

    def curve_s(self) -> float:
        return self.ramp_s + self.period_s

    def excess(self, limit: str, most: float, times: float) -> Slower:
        del limit, most
        slower, asks = self.slower_pace(times), f"{self.period_s:g} s with ramp_s {self.ramp_s:g} asks"
        return Slower(slower.key, asks, f"{slower.expected}, or a smaller figure", slower.accepts)

    def slower_pace(self, times: float) -> Slower:
        period_s, ramp_s = (ceil(seconds * times * 10.0) / 10.0 for seconds in (self.period_s, self.ramp_s))
        expected, accepts = (
            f"at least {period_s:g} s with ramp_s {ramp_s:g}",
            (("period_s", period_s), ("ramp_s", ramp_s)),
        )
        return Slower("period_s", f"{self.period_s:g} s", expected, accepts)

    def slower_turn(self, times: float) -> Slower:
        period_s = ceil(self.period_s * times * 10.0) / 10.0
        return Slower("period_s", f"{self.period_s:g} s", f"at least {period_s:g} s", (("period_s", period_s),))

    def slow_down(self, times: float) -> Self:
        return replace(self, period_s=float(ceil(self.period_s * times)))


@lru_cache(maxsize=8)  # several checks of a reference need it
def _pace_of_laps(reference: LappingReference) -> tuple[float, float]:
    curve = reference.curve()
    ramp_s = [reference.ramp_s * index / RAMP_SAMPLES for index in range(RAMP_SAMPLES)]
    motions = [curve(time_s) for time_s in ramp_s + reference.turning_s()]
    return max(hypot(*m[1]) for m in motions), max(hypot(*m[2]) for m in motions)


class LimitedReference(BaseReference, frozen=True, kw_only=True):
    """One within limits; the kind declares its `max_speed_m_s`.

    max_acceleration_m_s2: largest acceleration
    """

    max_acceleration_m_s2: Annotated[float, Meta(ge=0.01, le=50)] = 1.0

    @property
    def max_speed_m_s(self) -> float:
        raise NotImplementedError

    @property
    def limits(self) -> tuple[float, float]:
        return self.max_speed_m_s, self.max_acceleration_m_s2

    def largest_pace(self) -> tuple[float, float]:
        return self.limits

    def excess(self, limit: str, most: float, times: float) -> Slower:
        del times
        accepted = floor(most * 100.0) / 100.0
        return Slower(limit, f"{getattr(self, limit):g} asks", f"at most {accepted:g}", ((limit, accepted),))

    def slower_pace(self, times: float) -> Slower:
        speed_m_s = floor(self.max_speed_m_s / times * 1000.0) / 1000.0
        acceleration_m_s2 = floor(self.max_acceleration_m_s2 / times**2 * 1000.0) / 1000.0
        return Slower(
            "max_acceleration_m_s2",
            f"{self.max_acceleration_m_s2:g} m/s^2",
            f"at most {acceleration_m_s2:g} m/s^2 with max_speed_m_s {speed_m_s:g}",
            (("max_speed_m_s", speed_m_s), ("max_acceleration_m_s2", acceleration_m_s2)),
        )

    def slow_down(self, times: float) -> Self:
        return replace(
            self,
            max_speed_m_s=round(self.max_speed_m_s / times, 3),
            max_acceleration_m_s2=round(self.max_acceleration_m_s2 / times**2, 3),
        )


def any_motions(speed_m_s: float, acceleration_m_s2: float, up: float) -> list[list[Harmonic]]:
    """Motions at any rate within these limits, in any horizontal direction, with the share `up` of them vertically."""
    if speed_m_s <= 0.0 or acceleration_m_s2 <= 0.0:
        return []
    motions = []
    for share in RATES:
        rate_rad_s = share * acceleration_m_s2 / speed_m_s
        most_m = min(speed_m_s / rate_rad_s, acceleration_m_s2 / rate_rad_s**2)
        motions.append([Harmonic(rate_rad_s, (most_m, most_m, up * most_m), rotates=True)])
    return motions


def box_about(centre_m: Vector3, a_m: float, b_m: float) -> tuple[Vector3, Vector3]:
    """Lowest and highest corner of a level box of this half width and half height."""
    x, y, z = centre_m
    return (x - a_m, y - b_m, z), (x + a_m, y + b_m, z)
