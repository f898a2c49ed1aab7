"""`companion explain`: symptom, cause and remedy of a code."""

from __future__ import annotations

import argparse

from companion.cli.options import fail

NAME = "explain"
SUMMARY = "explains a code of a message: symptom, cause, remedy"
EXIT_UNKNOWN = 2
DESCRIPTION = """\
Explain a code of a message: its symptom, cause and remedy. Without a code: all codes, in one line each. The same texts are the
page docs/troubleshooting.md.
"""

MORE = """\
examples:
  companion explain SLOT_TOO_CLOSE
  companion explain | grep LEADER

exit codes:
  0    explained
  2    no such code
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "code", nargs="?", metavar="CODE", help="a code, such as SLOT_TOO_CLOSE; in any case of letters"
    )


def run(options: argparse.Namespace) -> int:
    """The exit code."""
    from companion.tools.explanations import listing, report
    from companion.types.code_table import code_entries

    if options.code is None:
        print(listing())
        return 0
    code = options.code.upper().replace("-", "_")
    if code not in code_entries():
        return fail(f"companion explain: no code {code}; `companion explain` lists all codes", EXIT_UNKNOWN)
    print(report(code))
    return 0
