"""The `law` of a fleet file: which formation law flies, and what of it is changed."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

from msgspec import Meta
from msgspec.structs import replace

from companion.config.values import Section
from companion.config_file import ConfigError

Gain = Annotated[float, Meta(gt=0, le=10)]


class Gains(Section, frozen=True):
    """K = [k1, k2] of eq. 14: k1 on position [1/s^2], k2 on velocity [1/s]. What is None is as the law has it."""

    position_1_s2: Gain | None = None
    velocity_1_s: Gain | None = None


class AltitudeHoldGains(Section, frozen=True):
    """Of a vehicle that holds its own altitude: on position [1/s^2] and on velocity [1/s]."""

    position_1_s2: Gain = 2.0
    velocity_1_s: Gain = 2.4


LawName = Literal["cooperative", "weighted", "average_22", "average_26"]
PAPER_LAWS: tuple[LawName, ...] = ("weighted", "average_22", "average_26")


class Law(Section, frozen=True):
    """Which formation law flies, and what of it is changed; what is left out is as the law of that name has it.

    `weighted` is the paper's, `average_22` and `average_26` are what it is compared with, `cooperative` is the one to fly.
    `exponent` is alpha of the weights 1/p^alpha (1 is the paper's Algorithm 2), `feedforward` how much of the neighbours'
    acceleration is fed forward, and without `leader_heeds_neighbours` a leader tracks its reference alone.
    `disturbance_bandwidth_1_s` is how fast wind and a wrong hover thrust are found and made up for; 0 leaves them to the law.
    """

    name: LawName = "cooperative"
    gains: Gains = Gains()
    exponent: Annotated[float, Meta(ge=0, le=16)] | None = None
    feedforward: Annotated[float, Meta(ge=0, le=0.95)] | None = None
    leader_heeds_neighbours: bool | None = None
    altitude: Literal["formation", "hold"] = "formation"
    altitude_hold_gains: AltitudeHoldGains = AltitudeHoldGains()
    disturbance_bandwidth_1_s: Annotated[float, Meta(ge=0, le=5)] = 4.0

    def renamed(self, name: LawName) -> Law:
        """For comparisons: another law in this one's place. The paper's three are compared with the same gains."""
        if name == self.name:
            return self
        same_gains = name in PAPER_LAWS and self.name in PAPER_LAWS
        return replace(
            self,
            name=name,
            gains=self.gains if same_gains else Gains(),
            exponent=None,
            feedforward=None,
            leader_heeds_neighbours=None,
        )


def check_law(file: Path, where: str, law: Law) -> None:
    """The average laws are what they are; anything else would be the weighted law with another exponent. Raises ConfigError."""
    if law.name not in ("average_22", "average_26"):
        return
    for field in ("exponent", "feedforward", "leader_heeds_neighbours"):
        if getattr(law, field) is not None:
            raise ConfigError(
                file,
                f"{where}.{field}",
                f"{law.name} takes no {field}; take it out, or fly weighted (its average is exponent: 0)",
            )
