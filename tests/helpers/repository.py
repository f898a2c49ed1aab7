"""Where the repository and its example files are."""

from pathlib import Path

ROOT = Path(__file__).parents[2]
