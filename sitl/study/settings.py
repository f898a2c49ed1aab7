"""The compared settings of the law: the paper's laws, each part of `cooperative` alone, and combinations."""

from __future__ import annotations

from dataclasses import dataclass

from companion.config.law import LawSection, feedback_law_of

SHARPER = {"exponent": 0.0, "weight_ratio": 0.03}
DESIGNED = {"position_gain_1_s2": 2.0, "velocity_gain_1_s": 2.4}
FED_FORWARD = 0.98


@dataclass(frozen=True, slots=True)
class Setting:
    """A law with its label. `is_part` marks a setting that differs from the paper's law in one part."""

    label: str
    law: LawSection
    is_part: bool = False


def _weighted(**changed: float | bool) -> LawSection:
    return LawSection(name="weighted", parameters=dict(changed))


def _cooperative(**changed: float | bool) -> LawSection:
    return LawSection(name="cooperative", parameters=dict(changed))


AVERAGE_22 = Setting("average, eq. 22", LawSection(name="average_22"))
WEIGHTED = Setting("weighted (the paper)", LawSection(name="weighted"))
COOPERATIVE = Setting("cooperative", LawSection(name="cooperative"))
MAIN = (AVERAGE_22, WEIGHTED, COOPERATIVE)

SETTINGS: tuple[Setting, ...] = (
    AVERAGE_22,
    Setting("average, eq. 26", LawSection(name="average_26")),
    WEIGHTED,
    Setting("a: ratio 0.03", _weighted(**SHARPER), is_part=True),
    Setting("b: K = (2, 2.4)", _weighted(**DESIGNED), is_part=True),
    Setting("c: feed-forward 0.98", _weighted(feedforward=FED_FORWARD), is_part=True),
    Setting("d: leader uncoupled", _weighted(leader_uses_neighbours=False), is_part=True),
    Setting("a + b", _weighted(**SHARPER, **DESIGNED)),
    Setting("a + c", _weighted(**SHARPER, feedforward=FED_FORWARD)),
    Setting("b + c", _weighted(**DESIGNED, feedforward=FED_FORWARD)),
    COOPERATIVE,
    Setting("cooperative, leader uncoupled", _cooperative(leader_uses_neighbours=False)),
    Setting("cooperative, g = 0.8", _cooperative(feedforward=0.8)),
    Setting("cooperative, g = 0.9", _cooperative(feedforward=0.9)),
    Setting("cooperative, alpha 8, rho 1", _cooperative(exponent=8.0, weight_ratio=1.0)),
    Setting("cooperative, alpha 16, rho 1", _cooperative(exponent=16.0, weight_ratio=1.0)),
    Setting("cooperative, K = (1, 2)", _cooperative(position_gain_1_s2=1.0, velocity_gain_1_s=2.0)),
    Setting("cooperative, K = (1.39, 3)", _cooperative(position_gain_1_s2=1.39, velocity_gain_1_s=3.0)),
)


def parameters_text(setting: Setting) -> str:
    """All parameters of the law, for tables."""
    law = feedback_law_of(setting.law)
    leader = "" if law.leader_uses_neighbours else ", leader uncoupled"
    gains = f"K = ({law.position_gain_1_s2:g}, {law.velocity_gain_1_s:g})"
    rho = "" if law.weight_ratio == 1.0 else f", rho {law.weight_ratio:g}"
    return f"alpha {law.exponent:g}{rho}, {gains}, g {law.feedforward:g}{leader}"
