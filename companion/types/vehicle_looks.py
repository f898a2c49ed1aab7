"""The look of a vehicle by its id: one table for the figures of `sitl`, the report and the live page, which is served it.

Colours alone do not tell vehicles apart in grey, so a vehicle has dashes, too; 28 vehicles differ in one of both.
"""

from __future__ import annotations

from typing import NamedTuple

DARK_INK, LIGHT_INK = "#0b0f13", "#ffffff"


class VehicleColour(NamedTuple):
    """The same hue on white, and bright enough on dark."""

    on_light: str
    on_dark: str


# Those of Okabe and Ito, safe for the colour-blind; indigo in place of their black, which is that of text and limits.
COLOURS = (
    VehicleColour("#0072b2", "#4da3dd"),
    VehicleColour("#d55e00", "#ff8b3d"),
    VehicleColour("#009e73", "#34c99a"),
    VehicleColour("#332288", "#907cff"),
    VehicleColour("#cc79a7", "#e3a3c6"),
    VehicleColour("#e69f00", "#f0b542"),
    VehicleColour("#56b4e9", "#8ccdf2"),
)
# Lengths of dashes and gaps in widths of the line.
DASHES: tuple[tuple[float, ...], ...] = ((), (6.0, 2.0), (5.0, 1.5, 1.0, 1.5), (2.0, 1.2))


def ink_on(colour: str) -> str:
    """What text on this colour is drawn with: the ink with more contrast."""
    return max((DARK_INK, LIGHT_INK), key=lambda ink: contrast(ink, colour))


def contrast(one: str, other: str) -> float:
    """Contrast ratio of two colours #RRGGBB by WCAG 2, 1 to 21."""
    dark, light = sorted((_luminance(one), _luminance(other)))
    return (light + 0.05) / (dark + 0.05)


def _luminance(colour: str) -> float:
    parts = (int(colour[i : i + 2], 16) / 255.0 for i in (1, 3, 5))
    red, green, blue = (part / 12.92 if part <= 0.04045 else ((part + 0.055) / 1.055) ** 2.4 for part in parts)
    return 0.2126 * red + 0.7152 * green + 0.0722 * blue
