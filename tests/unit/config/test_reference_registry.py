"""Kinds of reference and shapes: one file more is one more in files, commands, page and documentation."""

import os
import shutil
import subprocess
import sys
from pathlib import Path
from typing import get_args

from common import ROOT
from companion.cli.main import parser
from companion.config.planned_flight import ShapeName
from companion.config.reference import ASKED, KINDS, PLACED, FirstKind, KnownReference, Reference
from companion.geometry.formations import SHAPES
from companion.monitor.command_requests import reference_forms
from companion.monitor.server import page_files

FOLDER = "companion/config/reference"
KIND = '''"""An arc."""
from companion.config.reference.base import Asked, BaseReference, Size
from companion.config.values import PositionM


class ArcReference(BaseReference, frozen=True, tag_field="kind", tag="arc"):
    """A part of a circle.

    centre_enu_m: its centre
    bend_m: its radius
    """

    TITLE, POSITION = "Arc", "centre_enu_m"
    ASKED = {"bend_m": Asked("--bend", "of an arc, metres", "Bend", 3.0)}

    centre_enu_m: PositionM
    bend_m: Size

    @classmethod
    def first(cls, size_m, height_m):
        return cls(centre_enu_m=(0.0, 0.0, height_m), bend_m=size_m)


KIND = ArcReference
'''
SHAPE = """

@shape
def wedge(n: int) -> list[Vector3]:
    return line(n)
"""
QUESTIONS = """
import sys
from companion.cli.main import main
from companion.config.new_formation import NewFormation, planned_formation
from companion.config.reference import ReferenceSection, commanded
from companion.monitor.command_requests import FormationContent, reference_forms
from companion.monitor.server import page_files
from msgspec import convert
from pathlib import Path
arc = commanded(Path("x"), {"reference": {"kind": "arc", "centre_enu_m": [0, 0, 3], "bend_m": 2}})
assert arc.bend_m == 2.0
assert [form["inputs"][0]["title"] for form in reference_forms() if form["kind"] == "arc"] == ["Bend"]
new = NewFormation(name="a", vehicles=3, shape="wedge", reference="arc")
assert planned_formation(new, lambda *_: []).reference.kind == "arc"
assert convert({"shape": "wedge", "spacing_m": 2.0}, FormationContent).shape == "wedge"
assert b'"wedge"' in page_files()["index.html"].body
sys.path.insert(0, sys.argv[1])
from docs.generate.configuration import configuration
page = configuration()
assert "### Arc reference" in page and "`wedge`" in page
main(["fleet", "reference", "--help"])
"""


def test_another_kind_and_another_shape_are_one_file_each(tmp_path: Path) -> None:
    for program in ("companion", "sitl"):
        shutil.copytree(ROOT / program, tmp_path / program, symlinks=True, ignore=shutil.ignore_patterns("__pycache__"))
    (tmp_path / FOLDER / "arc.py").write_text(KIND, encoding="utf-8")
    with (tmp_path / "companion/geometry/formations.py").open("a", encoding="utf-8") as shapes:
        shapes.write(SHAPE)
    environment = os.environ | {"PYTHONPATH": str(tmp_path)}
    asked = subprocess.run(
        [sys.executable, "-c", QUESTIONS, str(ROOT)], capture_output=True, text=True, env=environment, cwd=tmp_path
    )
    assert asked.returncode == 0, asked.stderr
    assert "--bend" in asked.stdout and "arc" in asked.stdout


def test_the_registry_is_what_everything_names() -> None:
    modules = {path.stem for path in (ROOT / FOLDER).glob("*.py")} - {"__init__", "base", "timed"}
    assert len(modules) == len(KINDS) == len(get_args(Reference))
    assert set(get_args(Reference)) - set(get_args(KnownReference)) == {KINDS["target"]}
    assert get_args(ShapeName) == tuple(SHAPES)
    assert {form["kind"] for form in reference_forms()} == set(PLACED) == set(KINDS) - {"file", "samples"}
    assert all(KINDS[name].first(10.0, 3.0) for name in get_args(FirstKind))
    assert all(key in kind.__struct_fields__ for kind in KINDS.values() for key in kind.ASKED)
    one = parser().parse_args(["fleet", "reference", "circle", "--at", "0", "0", "3"])
    assert {name for name in vars(one) if name.startswith("reference.")} == {f"reference.{key}" for key in ASKED}
    index = page_files()["index.html"].body
    assert all(f'"{shape}"'.encode() in index for shape in SHAPES)
