"""companion/types/generated/codes.py, from companion/types/codes.toml: what the agent needs of the codes."""

from __future__ import annotations

from collections.abc import Iterable

from companion.types.code_table import code_entries, code_table

HEAD = '''\
"""Generated from companion/types/codes.toml by `make docs`. Do not edit it."""

from __future__ import annotations

from enum import StrEnum
'''
CODE = "The stable part of a notice. Tests, JSON output and the troubleshooting page go by it; texts may change."
HEALTH_FLAG = "Present faults, causes before what they cause. `core/safety/failsafe.py` has the actions."


def module() -> str:
    """The text of the module: two enumerations and the texts of flags and rejected input."""
    texts = [f'    "{code}": "{entry.text}",' for code, entry in code_entries().items() if entry.text]
    parts = [
        HEAD,
        _enumeration("Code", CODE, code_entries()),
        _enumeration("HealthFlag", HEALTH_FLAG, code_table().causes_first),
        "\n".join(["TEXTS: dict[str, str] = {", *texts, "}\n"]),
    ]
    return "\n\n".join(parts)


def _enumeration(name: str, docstring: str, members: Iterable[str]) -> str:
    lines = [f"class {name}(StrEnum):", f'    """{docstring}"""', ""]
    return "\n".join([*lines, *(f'    {member} = "{member}"' for member in members), ""])
