"""Every command of the field guide, in its order: real agents with identities, from `companion init` to the logs."""

import re
from pathlib import Path

import pytest

from common import ROOT
from deploy.boot.documented import PAGE as INSTALLATION
from guided_field import Field
from processes import free_fleet_offset

pytestmark = [pytest.mark.fleet, pytest.mark.long, pytest.mark.timeout(600)]

GUIDE = ROOT / "docs" / "field-guide.md"
BLOCK = re.compile(r"^```sh\n(.*?)^```$", re.DOTALL | re.MULTILINE)


def commands() -> list[str]:
    return [line for block in BLOCK.findall(GUIDE.read_text(encoding="utf-8")) for line in block.splitlines()]


def test_every_command_of_the_field_guide_does_what_it_says(tmp_path: Path) -> None:
    with Field(tmp_path, free_fleet_offset()) as field:
        for line in commands():
            field.perform(line)
        assert list((tmp_path / "operator" / "logs").iterdir())
    installation = INSTALLATION.read_text(encoding="utf-8")
    for line in field.on_debian:
        program = " ".join(line.split()[:3])
        assert program in installation, line
