"""The formation companion: the agent that runs on each vehicle, and its ground tools."""

import sys
from pathlib import Path

__version__ = "0.1.0"


def how_to_install(extra: str) -> str:
    """Advice for this installation. The project is in no package index: only its source tree can be installed."""
    source = Path(__file__).parents[1]
    if (source / "pyproject.toml").is_file():
        return f"{sys.executable} -m pip install '{source}[{extra}]'"
    return f"this installation is without the extra [{extra}]; install it on a computer with the source tree"


GROUND_INSTALL = how_to_install("ground")
