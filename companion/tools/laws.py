"""`companion law`: list, new and check."""

from __future__ import annotations

import argparse
import re
from collections.abc import Iterator
from inspect import getdoc, getsource
from pathlib import Path

from companion.config.file import ConfigError, override, refuse
from companion.config.law import (
    BUILT_IN,
    LAW_NAME,
    PYTHON,
    LawSection,
    Parameter,
    law_class,
    law_in_file,
    law_names,
    law_problems,
)
from companion.config.new_formation import write_new
from companion.laws import _starting_point as starting_point
from companion.tools.law_check import LawFinding, check_law
from companion.tools.output import found_lines, json_text
from companion.types.errors import EXIT_DONE, EXIT_FAILED, UnusableError

TEST = '''"""{name}.py passes the check of laws."""

from pathlib import Path

from companion.tools.laws import check_file


def test_the_law_passes_its_check() -> None:
    findings = check_file(Path(__file__).parent / "{name}.py")
    assert not [finding for finding in findings if not finding.passed]
'''
NEXT = """\
written: {law} and {test}
next:
  companion law check {law}
  sitl run platoon --law {law}
  sitl compare --laws cooperative,{law}
"""


def run_law(options: argparse.Namespace) -> int:
    """`companion law ACTION`; returns the exit code. Raises ConfigError and UnusableError."""
    if options.action == "list":
        print("\n".join(_known()))
        return EXIT_DONE
    if options.action == "new":
        print(new_law(options.name, options.folder), end="")
        return EXIT_DONE
    parameters = override({}, options.overrides, "position_gain_1_s2=1.5")
    findings = (
        check_file(Path(options.law), parameters)
        if options.law.endswith(PYTHON)
        else check_name(options.law, parameters)
    )
    if options.json:
        print(json_text({"law": options.law, "findings": findings}))
    else:
        rows = [("ok" if finding.passed else "FAILED", finding.subject, finding.found, "") for finding in findings]
        print(f"{options.law}:", *found_lines(rows, verdict_width=6), sep="\n")
    return EXIT_DONE if all(finding.passed for finding in findings) else EXIT_FAILED


def check_file(path: Path, parameters: dict[str, Parameter] | None = None) -> list[LawFinding]:
    """What is found in the law of a file, with these parameters. Raises ConfigError for a file that cannot be read."""
    if not path.is_file():
        raise ConfigError(path, "", "is no file; expected a Python file with a law, which companion law new starts")
    if not re.fullmatch(LAW_NAME, path.stem) or path.stem in BUILT_IN:
        expected = "expected a name of lower-case letters, digits and _ that no built-in law has"
        raise ConfigError(path, "", f"{path.stem} cannot name a law; {expected}")
    try:
        section = LawSection(**law_in_file(str(path)), parameters=parameters or {})
        law_class(section)
    except ConfigError as error:
        return [LawFinding("code", False, str(error).removeprefix(f"{path}: "))]
    return [LawFinding("code", True, "computes and does nothing else, as far as it can be read"), *check_law(section)]


def check_name(name: str, parameters: dict[str, Parameter]) -> list[LawFinding]:
    """The same for a law that needs no file. Raises ConfigError for an unknown one."""
    section = LawSection(name=name, parameters=parameters)
    if name not in law_names():
        refuse("companion law check", law_problems(section, "law"))
    return list(check_law(section))


def new_law(name: str, folder: Path) -> str:
    """Write NAME.py and test_NAME.py; returns what to do next. Raises ConfigError and UnusableError."""
    if not re.fullmatch(LAW_NAME, name) or name in BUILT_IN:
        expected = "expected at most 41 lower-case letters, digits and _, a letter first, and no name of a built-in law"
        raise UnusableError(f"companion law new: {name}: {expected}")
    if name.startswith("test_") or name.endswith("_test"):
        expected = "expected one that pytest does not take for a test: without test_ before it and _test behind it"
        raise UnusableError(f"companion law new: {name}: {expected}")
    law, test = folder / f"{name}{PYTHON}", folder / f"test_{name}{PYTHON}"
    title = "".join(word.capitalize() for word in name.split("_"))
    source = getsource(starting_point).replace("StartingPoint", title)
    write_new({law: source, test: TEST.format(name=name)}, lambda: law_in_file(str(law)))
    return NEXT.format(law=law, test=test)


def _known() -> Iterator[str]:
    names = law_names()
    width = max(map(len, names))
    for name in names:
        lines = (getdoc(law_class(LawSection(name=name))) or "").splitlines()
        yield f"{name:<{width}}  {lines[0] if lines else ''}".rstrip()
