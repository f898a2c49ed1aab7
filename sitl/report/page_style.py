"""The style of the pages of `sitl paper` and `sitl compare`."""

from pathlib import Path

STYLE = Path(__file__).with_name("page.css").read_text(encoding="utf-8")
