"""The compared settings of the law: the paper's laws, each part of `cooperative` alone, and combinations."""

from __future__ import annotations

from dataclasses import dataclass

from companion.assembly import law_of
from companion.config.fleet import Law, LawGains

SHARPER = {"exponent": 0.0, "weight_ratio": 0.03}
DESIGNED = LawGains(position_1_s2=2.0, velocity_1_s=2.4)
FED_FORWARD = 0.98


@dataclass(frozen=True, slots=True)
class Setting:
    """A law with its label. `is_part` marks a setting that differs from the paper's law in one part."""

    label: str
    law: Law
    is_part: bool = False


def _weighted(**changes: object) -> Law:
    return Law(name="weighted", **changes)  # type: ignore[arg-type]


AVERAGE_22 = Setting("average, eq. 22", Law(name="average_22"))
WEIGHTED = Setting("weighted (the paper)", Law(name="weighted"))
COOPERATIVE = Setting("cooperative", Law(name="cooperative"))
MAIN = (AVERAGE_22, WEIGHTED, COOPERATIVE)

SETTINGS: tuple[Setting, ...] = (
    AVERAGE_22,
    Setting("average, eq. 26", Law(name="average_26")),
    WEIGHTED,
    Setting("a: ratio 0.03", _weighted(**SHARPER), is_part=True),
    Setting("b: K = (2, 2.4)", _weighted(gains=DESIGNED), is_part=True),
    Setting("c: feed-forward 0.98", _weighted(feedforward=FED_FORWARD), is_part=True),
    Setting("d: leader uncoupled", _weighted(leader_uses_neighbours=False), is_part=True),
    Setting("a + b", _weighted(**SHARPER, gains=DESIGNED)),
    Setting("a + c", _weighted(**SHARPER, feedforward=FED_FORWARD)),
    Setting("b + c", _weighted(gains=DESIGNED, feedforward=FED_FORWARD)),
    COOPERATIVE,
    Setting("cooperative, leader uncoupled", Law(name="cooperative", leader_uses_neighbours=False)),
    Setting("cooperative, g = 0.8", Law(name="cooperative", feedforward=0.8)),
    Setting("cooperative, g = 0.9", Law(name="cooperative", feedforward=0.9)),
    Setting("cooperative, alpha 8, rho 1", Law(name="cooperative", exponent=8.0, weight_ratio=1.0)),
    Setting("cooperative, alpha 16, rho 1", Law(name="cooperative", exponent=16.0, weight_ratio=1.0)),
    Setting("cooperative, K = (1, 2)", Law(name="cooperative", gains=LawGains(position_1_s2=1.0, velocity_1_s=2.0))),
    Setting(
        "cooperative, K = (1.39, 3)", Law(name="cooperative", gains=LawGains(position_1_s2=1.39, velocity_1_s=3.0))
    ),
)


def parameters_text(setting: Setting) -> str:
    """All parameters of the law, for tables."""
    law = law_of(setting.law)
    leader = "" if law.leader_uses_neighbours else ", leader uncoupled"
    gains = f"K = ({law.gains.position_1_s2:g}, {law.gains.velocity_1_s:g})"
    rho = "" if law.weighting.ratio == 1.0 else f", rho {law.weighting.ratio:g}"
    return f"alpha {law.weighting.exponent:g}{rho}, {gains}, g {law.feedforward:g}{leader}"
