"""What the checks of the companion computer refer to exists."""

from __future__ import annotations

import re

from common import ROOT
from companion.tools.host_checks import KEEP_PERFORMANCE, SWITCH_OFF


def test_the_remedies_name_headings_of_the_guide() -> None:
    headings = re.findall(r"^## (.+)$", (ROOT / "docs" / "installation.md").read_text(encoding="utf-8"), re.MULTILINE)
    anchors = {title.lower().replace(" ", "-") for title in headings}
    for remedy in (SWITCH_OFF, KEEP_PERFORMANCE):
        assert re.findall(r"docs/installation\.md#([\w-]+)", remedy)[0] in anchors
