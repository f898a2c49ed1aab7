"""The cases: each transport at each loss, with four vehicles; their table, and its place in a Markdown page."""

from __future__ import annotations

import argparse
import re
import sys
from collections.abc import Iterator, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from statistics import fmean
from tempfile import TemporaryDirectory

import msgspec

from companion.security.names import parse_common_name
from companion.security.provisioning import provision_new
from tests.bench.hosts import HostsError, Radio, address, hosts, inside
from tests.bench.page import write_between_marks
from tests.bench.processes import HEARD_WITHIN_S, Program, module, wait_for
from tests.bench.programs.transport_vehicle import TransportAges

VEHICLES = (1, 2, 3, 4)
LOSSES = (0.0, 0.1, 0.3)
DELAY_S = 0.002
PORT, GROUP = 7447, "239.255.77.1:7446"
MARKS = "transports"  # of its page


@dataclass(frozen=True, slots=True)
class Transport:
    """A choice in the fleet file. `settings` are its lines there."""

    name: str
    settings: str
    secured: bool


TRANSPORTS = (
    Transport("TCP without identities", "transport: tcp\nsecurity: none\n", False),
    Transport("`tcp` (TLS)", "transport: tcp\n", True),
    Transport("`quic`", "transport: quic\n", True),
    Transport("`tcp` and `multicast`", f"transport: tcp\nmulticast: {GROUP}\n", True),
    Transport("`quic` and `multicast`", f"transport: quic\nmulticast: {GROUP}\n", True),
)


@dataclass(frozen=True, slots=True)
class TransportFigures:
    """One case: the worst vehicle of each figure, and the mean rate of sending. None where vehicles did not hear each other."""

    transport: str
    loss: float
    worst: TransportAges | None
    sent_kb_s: float

    def line(self) -> str:
        """Of the table."""
        name = f"| {self.transport} | {self.loss:.0%} | "
        if self.worst is None:
            return f"{name}not connected within {HEARD_WITHIN_S:g} s | | | | | |"
        w = self.worst
        ages = f"{w.median_ms:.1f} | {w.p99_ms:.1f} | {w.worst_ms:.0f} | {w.too_old:.2%}"
        return f"{name}{ages} | {self.sent_kb_s:.0f} | {w.cpu:.1%} |"


def measure_all(
    folder: Path, transports: Sequence[Transport], losses: Sequence[float], seconds: float
) -> Iterator[TransportFigures]:
    """One row after the other. Raises HostsError where the machine gives no namespaces."""
    for transport in transports:
        files = _files(folder / re.sub(r"\W+", "_", transport.name), transport)
        for loss in losses:
            with hosts(VEHICLES, loss, DELAY_S) as radio:
                yield _row(transport, files, radio, seconds)


def table(rows: Sequence[TransportFigures]) -> str:
    """In Markdown."""
    head = (
        "| transport | loss | median age [ms] | 99 % [ms] | worst [ms] | over 0.3 s | sent [kB/s] | CPU |\n"
        "|---|---|---|---|---|---|---|---|"
    )
    return "\n".join([head, *(row.line() for row in rows)])


def _files(folder: Path, transport: Transport) -> dict[int, Path]:
    """Vehicle files of a new fleet, with identities where it is secured."""
    folder.mkdir(parents=True)
    members = "".join(
        f"  - {{id: {i}, role: {'leader' if i == 1 else 'follower'}, slot_enu_m: [{-3.0 * i}, 0.0, 0.0],"
        f' address: "{address(i)}:{PORT}"}}\n'
        for i in VEHICLES
    )
    fleet = f"name: transports\norigin: indoor\nneighbours: {{kind: range, range_m: 20.0}}\n{transport.settings}"
    (folder / "fleet.yaml").write_text(f"{fleet}vehicles:\n{members}", encoding="utf-8")
    for i in VEHICLES:
        text = f"id: {i}\nfleet: fleet.yaml\nmavlink: udpin:127.0.0.1:14540\nhover_thrust_norm: 0.5\n"
        text += "reference: {kind: point, point_enu_m: [0.0, 0.0, 2.0]}\n" if i == 1 else ""
        text += "identity: identity\n" if transport.secured else ""
        (folder / f"vehicle-{i}.yaml").write_text(text, encoding="utf-8")
    if not transport.secured:
        return {i: folder / f"vehicle-{i}.yaml" for i in VEHICLES}
    provision_new(folder, [], parse_common_name("ground-bench"), 1, datetime.now(UTC))
    return {i: folder / "copy" / f"vehicle-{i}" / f"vehicle-{i}.yaml" for i in VEHICLES}


def _row(transport: Transport, files: dict[int, Path], radio: Radio, seconds: float) -> TransportFigures:
    with ExitStack() as stack:
        programs = {
            i: module("tests.bench.programs.transport_vehicle", str(file), str(seconds)) for i, file in files.items()
        }
        vehicles = [Program(stack, [*inside(i), *program]) for i, program in programs.items()]
        try:
            wait_for(vehicles, "heard")
        except RuntimeError:
            return TransportFigures(transport.name, radio.loss, None, 0.0)
        before = dict(radio.sent_bytes)
        for vehicle in vehicles:
            vehicle.begin()
        results = [vehicle.result(TransportAges) for vehicle in vehicles]
        sent_kb_s = fmean(radio.sent_bytes[i] - before[i] for i in VEHICLES) / seconds / 1e3
    worst = TransportAges(*(max(figures) for figures in zip(*map(msgspec.structs.astuple, results), strict=True)))
    return TransportFigures(transport.name, radio.loss, worst, sent_kb_s)


EXIT_UNUSABLE = 2


def main() -> int:
    parser = argparse.ArgumentParser(
        prog="python -m tests.bench.transports",
        description="Age of the peers' states over each transport, with four vehicles in network namespaces of this machine"
        " and a radio between them that loses packets. Needs root, for the namespaces.",
    )
    parser.add_argument("--seconds", type=float, default=20.0, metavar="S", help="for each case (default 20)")
    parser.add_argument("--page", type=Path, metavar="FILE", help="write the table between the marks of this page")
    options = parser.parse_args()
    rows = []
    try:
        with TemporaryDirectory(prefix="transports-") as folder:
            for row in measure_all(Path(folder), TRANSPORTS, LOSSES, options.seconds):
                print(row.line(), flush=True)
                rows.append(row)
    except HostsError as error:
        print(f"transports: {error}", file=sys.stderr)
        return EXIT_UNUSABLE
    if options.page:
        write_between_marks(options.page, MARKS, table(rows))
    return 0 if all(row.worst for row in rows) else 1


if __name__ == "__main__":
    sys.exit(main())
