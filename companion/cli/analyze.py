"""Commands that need neither a vehicle nor a recording: `companion analyze` and `companion explain`."""

from __future__ import annotations

import argparse
import os
from pathlib import Path

from companion.cli.options import add_json, add_law, add_overrides
from companion.cli.program import command
from companion.types.errors import EXIT_DONE, UnusableError

EXIT_CONVERGES, EXIT_CANNOT_CONVERGE = 0, 1


def _add_analyze(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "file", type=Path, metavar="FILE", help="a scenario or fleet file (YAML), or the name of a shipped scenario"
    )
    add_law(parser, "analyze it with this law")
    add_overrides(parser, "change one key of the file")
    add_json(parser, "all figures as one JSON object instead of the text")


def _run_analyze(options: argparse.Namespace) -> int:
    """Predict the behaviour of a formation before it flies: the neighbours of each vehicle, the
    interaction matrix G under each law, its eigenvalues, rate, damping and delay margin, the largest
    and smallest distances to expect, and a verdict.

    examples:
      companion analyze platoon                          a scenario of `sitl scenarios`
      companion analyze platoon --law my_law.py
      companion analyze chain_16 --set fleet.law.parameters.weight_ratio=0.1
      companion analyze /etc/companion/fleet.yaml --json | jq '.laws.weighted.lambda_min'

    A scenario defines the start positions and the reference; a fleet file alone is analyzed for a
    step of 1 m. The predictions are of a linear model with the attitude loop as measured, the tick,
    drag and the delay of the scenario's links, without noise, limits and the separation filter. The
    law must be stable with that delay; with any up to 0.1 s where the scenario has the usual 1 ms.
    --set takes any key of the file and a YAML value.

    exit codes:
      0    the formation converges, whatever else the verdict reports
      1    it cannot converge: no path to a leader, or an unstable law with these delays
      2    the file cannot be used
      130  ended by Ctrl-C
    """

    os.environ.setdefault("OMP_NUM_THREADS", "1")  # numpy's matrices are small: threads only wait for each other

    import msgspec

    from companion.config.named_files import law_override
    from companion.config.shipped import scenario_file
    from companion.tools.analysis import analyse
    from companion.tools.analysis_report import report, verdict
    from companion.tools.output import json_text
    from companion.tools.subject import load_subject

    overrides = [*([law_override(options.law)] if options.law else []), *options.overrides]
    subject = load_subject(scenario_file(options.file), overrides)
    analysis = analyse(msgspec.structs.replace(subject, file=options.file))  # named as it was given
    if options.json:
        figures = msgspec.to_builtins(analysis) | {"verdict": msgspec.to_builtins(verdict(analysis))}
        print(json_text(figures))
    else:
        print(report(analysis))
    return EXIT_CONVERGES if analysis.converges else EXIT_CANNOT_CONVERGE


def _add_explain(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "code", nargs="?", metavar="CODE", help="a code, such as SLOT_TOO_CLOSE; in any case of letters"
    )


def _run_explain(options: argparse.Namespace) -> int:
    """Explain a code of a message: its symptom, cause and remedy. Without a code: all codes, in one line
    each. The same texts are the page docs/troubleshooting.md.

    examples:
      companion explain SLOT_TOO_CLOSE
      companion explain | grep LEADER

    exit codes:
      0    explained
      2    no such code
    """

    from companion.tools.explanations import listing, report
    from companion.types.code_table import code_entries

    if options.code is None:
        print(listing())
        return EXIT_DONE
    code = options.code.upper().replace("-", "_")
    if code not in code_entries():
        raise UnusableError(f"companion explain: no code {code}; `companion explain` lists all codes")
    print(report(code))
    return EXIT_DONE


ANALYZE = command("analyze", "predicts the behaviour of a formation before it flies", _add_analyze, _run_analyze)


EXPLAIN = command("explain", "explains a code of a message: symptom, cause, remedy", _add_explain, _run_explain)
