"""The `law` of a fleet file: which formation law flies, and which of its parameters are changed."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Annotated, Literal

from msgspec import Meta
from msgspec.structs import replace

from companion.config.validation import Problem
from companion.config.values import Section

Gain = Annotated[float, Meta(gt=0, le=10)]
LawName = Literal["cooperative", "weighted", "average_22", "average_26"]
PAPER_LAWS: tuple[LawName, ...] = ("weighted", "average_22", "average_26")


class Gains(Section, frozen=True):
    """Gains K = [k1, k2] of eq. 14. Without a value the law's own gain applies."""

    position_1_s2: Annotated[Gain, Meta(description="k1, on the position error")] | None = None
    velocity_1_s: Annotated[Gain, Meta(description="k2, on the velocity error")] | None = None


class AltitudeHoldGains(Section, frozen=True):
    """Gains of the altitude controller of a vehicle that holds its own altitude."""

    position_1_s2: Annotated[Gain, Meta(description="on the altitude error")] = 2.0
    velocity_1_s: Annotated[Gain, Meta(description="on the climb rate")] = 2.4


class Law(Section, frozen=True):
    """The formation law and its parameters. A parameter that is left out has the value of the named law."""

    name: Annotated[
        LawName,
        Meta(
            description="`cooperative` is the law to fly; `weighted` is the paper's; `average_22` and `average_26` are those"
            " that the paper compares it with"
        ),
    ] = "cooperative"
    gains: Gains = Gains()
    exponent: (
        Annotated[
            float, Meta(ge=0, le=16, description="alpha of the weights rho^p / p^alpha; 1 in the paper's Algorithm 2")
        ]
        | None
    ) = None
    weight_ratio: (
        Annotated[float, Meta(ge=0.001, le=1, description="rho of the weights rho^p / p^alpha; 1 in the paper")] | None
    ) = None
    feedforward: (
        Annotated[float, Meta(ge=0, le=0.99, description="share of the neighbours' acceleration that is fed forward")]
        | None
    ) = None
    leader_uses_neighbours: (
        Annotated[bool, Meta(description="`false`: a leader tracks its reference without its neighbours")] | None
    ) = None
    altitude: Annotated[
        Literal["formation", "hold"],
        Meta(
            description="`formation`: the law controls z too; `hold`: each vehicle holds the altitude it entered with"
        ),
    ] = "formation"
    altitude_hold_gains: AltitudeHoldGains = AltitudeHoldGains()
    disturbance_bandwidth_1_s: Annotated[
        float,
        Meta(ge=0, le=5, description="bandwidth of the observer for wind and hover thrust error; 0 switches it off"),
    ] = 4.0
    velocity_correction_1_s: Annotated[
        float,
        Meta(
            ge=0,
            le=10,
            description="bandwidth of the filter that makes the velocity agree with the position; 0 switches it off",
        ),
    ] = 2.0

    def renamed(self, name: LawName) -> Law:
        """Another law with these settings, for comparisons. The paper's three laws share their gains."""
        if name == self.name:
            return self
        same_gains = name in PAPER_LAWS and self.name in PAPER_LAWS
        return replace(
            self,
            name=name,
            gains=self.gains if same_gains else Gains(),
            exponent=None,
            weight_ratio=None,
            feedforward=None,
            leader_uses_neighbours=None,
        )


def law_problems(law: Law, where: str) -> Iterator[Problem]:
    """Parameters that an average law does not have: with them it would be the weighted law with another exponent."""
    if law.name not in ("average_22", "average_26"):
        return
    for field in ("exponent", "weight_ratio", "feedforward", "leader_uses_neighbours"):
        if getattr(law, field) is not None:
            hint = "take it out, or fly weighted (its average is exponent: 0)"
            yield Problem(f"{where}.{field}", f"{law.name} takes no {field}; {hint}")
