"""The packages and their import directions, from the import contracts in pyproject.toml and the package docstrings."""

from __future__ import annotations

import ast
import re
import tomllib
from pathlib import Path

TOP = Path(__file__).parent.parent.parent


def diagram() -> str:
    """The layers of `companion` as a flow chart, and the purpose of each package."""
    layers = [", ".join(re.findall(r"companion\.(\w+)", layer)) for layer in _layers()]
    lines = ["```mermaid", "flowchart TD", "    sitl[sitl] --> layer0"]
    lines += [f"    layer{index}[{names}]" for index, names in enumerate(layers)]
    lines += [f"    layer{index} --> layer{index + 1}" for index in range(len(layers) - 1)]
    lines += ["```", "", "| package | what it holds |", "|---|---|"]
    for top in ("companion", "sitl"):
        for package in sorted((TOP / top).rglob("__init__.py")):
            name = ".".join(package.parent.relative_to(TOP).parts)
            lines.append(f"| `{name}` | {_purpose(package)} |")
    return "\n".join(lines)


def _layers() -> list[str]:
    contracts = tomllib.loads((TOP / "pyproject.toml").read_text())["tool"]["importlinter"]["contracts"]
    layers: list[str] = next(contract["layers"] for contract in contracts if contract["type"] == "layers")
    return layers


def _purpose(package: Path) -> str:
    docstring = ast.get_docstring(ast.parse(package.read_text())) or ""
    return " ".join(docstring.split("\n\n")[0].split())
