"""Commands on the recordings of a flight: `companion report`, `companion replay` and `companion export`."""

from __future__ import annotations

import argparse
from pathlib import Path

from companion import GROUND_INSTALL
from companion.cli.options import add_json, add_law, add_overrides, vehicle_id
from companion.cli.program import command
from companion.types.errors import EXIT_DONE, UnusableError


def _add_report(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("folder", type=Path, metavar="FOLDER", help="folder with the recordings of one flight")
    parser.add_argument("--out", type=Path, metavar="FILE", help="the page (default: report.html in FOLDER)")
    parser.add_argument(
        "--log",
        type=Path,
        nargs="+",
        action="extend",
        default=[],
        metavar="FILE",
        help="logs of autopilots outside of FOLDER: ULog (.ulg) or DataFlash (.bin)",
    )
    add_json(parser, "also print figures and findings as one JSON object")


def _run_report(options: argparse.Namespace) -> int:
    """Write one HTML page about a flight from the recordings of its vehicles: what deserves attention and
    what to do about it, tracks, distances, errors, the law, the leader, timing, health, commands and
    their answers. The page needs no network and prints on A4.

    examples:
      companion report flights/2026-11-23
      companion report flights/2026-11-23 --out report.html
      companion report flights/2026-11-23 --log vehicle-1_log-7.ulg vehicle-2_log-9.bin
      companion report flights/2026-11-23 --json | jq '.findings[] | {code, vehicle_id, time_s, text}'

    FOLDER has the recordings (*.mcap) of all vehicles, in any folders inside it; copy them together.
    Their clocks need not agree: the packets between the vehicles align them. Logs of the autopilots
    (*.ulg of PX4, *.bin of ArduPilot; companion logs downloads them) are found in it, too; their
    battery voltage, vibration, GPS quality, estimate and messages are shown beside. A log belongs to
    the vehicle of its name (vehicle-ID_...), else to the one that moved as the log says.

    Findings carry a code (companion explain CODE) and a severity: critical ones must be understood
    before the next flight. All records are judged, also where figures show fewer points.

    exit codes:
      0    written, without critical findings
      1    written, with critical findings
      2    nothing was written: a folder, a file or an argument cannot be used
      130  ended by Ctrl-C
    """

    try:
        from companion.report.command import ReportOptions, run_report
    except ImportError as error:
        raise UnusableError(f"companion report: {error.name} is not installed; {GROUND_INSTALL}") from error
    return run_report(ReportOptions(options.folder, options.out, tuple(options.log), options.json))


def _add_replay(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("folder", type=Path, metavar="FOLDER", help="the folder with the recordings of a flight")
    parser.add_argument("--vehicle", type=vehicle_id, metavar="N", help="only this vehicle (default: all)")
    parser.add_argument(
        "--code",
        type=Path,
        action="append",
        default=[],
        metavar="FILE",
        help="the Python file of a recorded law or reference, with the same content; may be given many times",
    )
    add_law(parser, "compare with this law")
    add_overrides(parser, "compare with another value of one key of the fleet or vehicle file")
    parser.add_argument(
        "--csv", type=Path, metavar="FILE", help="with --law or --set: the commands of every tick, recorded and other"
    )
    add_json(parser, "one JSON object instead of the text")


def _run_replay(options: argparse.Namespace) -> int:
    """Replay the recordings of a flight: feed every recorded input to the same agent again, with the
    configuration in the recording, and compare each output bit for bit: setpoint, requests, peer
    packet, status, replies and events. With --law or --set, show instead what other settings would
    have commanded in the same situations.

    examples:
      companion replay flights/2026-05-03
      companion replay flights/2026-05-03 --vehicle 2 --json | jq '.vehicles[0].difference'
      companion replay flights/2026-05-03 --code my_law.py
      companion replay flights/2026-05-03 --law average_22
      companion replay flights/2026-05-03 --set fleet.law.parameters.position_gain_1_s2=0.8 --csv commands.csv

    A recording has no code. Where a law or a reference is a Python file, the file with the same content
    beside the recording is run, as sitl run --record leaves it there; one elsewhere is named by --code.

    FOLDER is searched for files *.mcap, also in folders inside; a single file is possible. The replay
    of a vehicle begins with the start of its agent: without the first part of a recording it is
    refused, and at a tick that is not recorded it ends.

    --set takes any key of the fleet file (fleet.KEY) or the vehicle file (vehicle.KEY), [N] for the
    N-th item of a list from 0, and a YAML value. The inputs stay those of the flight: the vehicle does
    not fly by the other commands. So the differences show how the settings judge the same situation,
    not the flight that they would give.

    exit codes:
      0    every output is the recorded one; with --law or --set: compared
      1    an output differs; the first difference of each vehicle is printed
      2    a recording, a part of it or an argument cannot be used
      130  ended by Ctrl-C
    """

    from companion.config.code_file import load_code
    from companion.config.named_files import law_override
    from companion.replay.command import ReplayOptions, run_replay

    for file in options.code:
        load_code(file.absolute(), beside=file.absolute())
    overrides = [*([law_override(options.law)] if options.law else []), *options.overrides]
    if options.csv and not overrides:
        raise UnusableError("companion replay: --csv: needs --law or --set; without them the commands are equal")
    return run_replay(ReplayOptions(options.folder, options.vehicle, overrides, options.csv, options.json))


def _add_export(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("folder", type=Path, metavar="FOLDER", help="the folder with the recordings of a flight")
    parser.add_argument(
        "--out", type=Path, metavar="DIR", help="folder of the CSV files, created if missing (default: FOLDER/csv)"
    )


def _run_export(options: argparse.Namespace) -> int:
    """Write the decisions (50 a second) and the statuses (5 a second, and those with an event) of recorded
    flights as CSV files: vehicle-N_decision.csv and vehicle-N_status.csv for each vehicle, one row for
    each record.

    examples:
      companion export flights/2026-05-03
      companion export flights/2026-05-03 --out tables

    FOLDER is searched for files *.mcap, also in folders inside; a single file is possible. Columns are
    named after the fields of the recording, with units: position_east_m, late_us. Neighbours with
    their weights and ages, and flags, are lists with spaces. A cell without a value is empty; so are
    position, velocity and their age before the vehicle has a position.

    The name of a file ends in .part until it is complete. After Ctrl-C or a full disk an incomplete
    file is removed, and an older one of its name stays.

    time_s is in seconds since the first record of the flight, unix_s the same as Unix time by the
    clock of the first vehicle. The clocks of the vehicles are compared by the packets that they
    received from each other, to some milliseconds; a vehicle for which that is not possible has the
    time of its own clock, and a line on standard error says so.

    exit codes:
      0    written; the files are listed
      2    the folder has no recording that can be used, or a file cannot be written
      130  ended by Ctrl-C; the listed files are complete
    """

    from companion.tools.export import export

    folder: Path = options.folder
    beside = folder.parent if folder.is_file() else folder
    for written in export(folder, options.out or beside / "csv"):
        print(f"{written.path}: {written.rows} rows", flush=True)
    return EXIT_DONE


REPORT = command("report", "writes a page about a recorded flight, with figures and findings", _add_report, _run_report)


REPLAY = command(
    "replay", "feeds recorded inputs to the agent again and compares its commands", _add_replay, _run_replay
)


EXPORT = command("export", "writes recorded flights as CSV files", _add_export, _run_export)
