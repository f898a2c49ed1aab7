"""`companion law`: the laws that are known, the start of one of your own, and its check."""

from __future__ import annotations

import argparse
from pathlib import Path

from companion.cli.options import add_json, add_overrides
from companion.cli.program import command


def _add_law(parser: argparse.ArgumentParser) -> None:
    actions = parser.add_subparsers(dest="action", required=True, metavar="ACTION", title="actions")
    actions.add_parser("list", help="the laws that need no file, with a line each")
    new = actions.add_parser("new", help="write a commented law to start from, and its test")
    new.add_argument("name", metavar="NAME", help="of the law: lower-case letters, digits and _")
    new.add_argument("--folder", type=Path, default=Path(), metavar="DIR", help="where (default: .)")
    check = actions.add_parser("check", help="try a law before it flies")
    check.add_argument("law", metavar="LAW", help="a file that ends with .py, or the name of a law")
    add_overrides(check, "change one parameter of the law")
    add_json(check, "one JSON object instead of the lines")


def _run_law(options: argparse.Namespace) -> int:
    """Laws of formation flight. A law is one class in one Python file; the fleet file or the scenario beside it names the
    file, `law: {name: mine, file: mine.py}`, and every vehicle needs the same content.

    check reads the code (it may compute and do nothing else), asks the law in many states, and lets five ideal vehicles fly
    it: bounds of the parameters, finite and bounded answers, the same answer to the same question, the same flight
    wherever the formation is and however it is turned, whether it settles, and the time of a call. A law that passes can
    still be unstable in another graph or with delay: `companion analyze` and `sitl compare` tell.

    examples:
      companion law list
      companion law new my_law --folder lab
      companion law check lab/my_law.py
      companion law check lab/my_law.py --set position_gain_1_s2=1.5
      companion law check cooperative --json

    exit codes:
      0    listed, written, or the law passes
      1    the law fails; each line that begins with FAILED says what was found and what was expected
      2    an argument or a file cannot be used; the line names it
    """
    from companion.tools.laws import run_law

    return run_law(options)


LAW = command("law", "laws of your own: start one, check one, list all", _add_law, _run_law)
