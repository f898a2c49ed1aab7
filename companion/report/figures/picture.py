"""A matplotlib figure as a part of the page: inline SVG, or PNG where that is smaller."""

from __future__ import annotations

import base64
import io
import re
from dataclasses import dataclass
from typing import Any

import matplotlib
from matplotlib.figure import Figure

LARGE_SVG_BYTES = 150_000  # above this a PNG may be smaller
PNG_DPI = 170  # sharp on A4
# Text stays text: it can be searched, and a page of many figures stays small.
RC: Any = {"svg.fonttype": "none", "svg.hashsalt": "report", "font.sans-serif": ["DejaVu Sans"]}
FONT = "'DejaVu Sans'"  # what matplotlib draws with and measures by; the others are not wider
FONTS = f"{FONT}, Arial, Helvetica, sans-serif"
NO_METADATA = {"Date": None, "Creator": None, "Format": None, "Type": None}


@dataclass(frozen=True, slots=True)
class DrawnFigure:
    """One figure of the page. `body` is an `svg` or an `img` element."""

    id: str
    title: str
    caption: str
    body: str


def picture(figure: Figure, id_: str, title: str, caption: str) -> DrawnFigure:
    """Draws the figure. The title is that of the page's caption, and the picture's accessible name."""
    svg = _svg(figure, id_, title)
    if len(svg) > LARGE_SVG_BYTES:
        png = _png(figure, title)
        svg = min(svg, png, key=len)
    return DrawnFigure(id_, title, caption, svg)


def _svg(figure: Figure, id_: str, title: str) -> str:
    buffer = io.StringIO()
    with matplotlib.rc_context(RC):
        figure.savefig(buffer, format="svg", metadata=NO_METADATA)
    text = buffer.getvalue()
    text = text[text.index("<svg") :]
    text = re.sub(r"<metadata>.*?</metadata>", "", text, flags=re.DOTALL)
    text = re.sub(r' xmlns(:\w+)?="[^"]*"', "", text)  # HTML needs none, and a page without addresses is easy to check
    text = text.replace("xlink:href", "href").replace(FONT, FONTS)
    # Ids are unique in one figure only.
    text = re.sub(r'\bid="', f'id="{id_}-', text)
    text = re.sub(r"url\(#", f"url(#{id_}-", text)
    text = re.sub(r'href="#', f'href="#{id_}-', text)
    text = re.sub(r"(\d+\.\d\d)\d+", r"\1", text)  # a hundredth of a point
    return text.replace("<svg ", f'<svg role="img" aria-label="{_attribute(title)}" ', 1)


def _png(figure: Figure, title: str) -> str:
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png", dpi=PNG_DPI, pil_kwargs={"optimize": True})
    data = base64.b64encode(buffer.getvalue()).decode("ascii")
    return f'<img alt="{_attribute(title)}" src="data:image/png;base64,{data}">'


def _attribute(text: str) -> str:
    return text.replace("&", "&amp;").replace('"', "&quot;").replace("<", "&lt;")
