"""What recording costs real agents: CPU, lateness of ticks, disk: python -m tests.bench.recording.

Four agents fly in formation, and two of them record: in each flight others, so that both kinds meet the same load at the same
time. Lateness differs more between flights than between the two kinds, so they are compared within each flight. The limits are
those of one agent at 50 Hz with three peers.
"""

from __future__ import annotations

import re
import sys
from math import log, sqrt
from pathlib import Path
from statistics import fmean, geometric_mean, stdev
from tempfile import TemporaryDirectory

from companion.link.tick import PERIOD_S
from companion.recording.files import MB, recorded_files
from companion.recording.reader import recordings
from companion.recording.records import INBOX
from sitl.flight.files import autopilots_of, ids_of, write_files
from sitl.flight.scenario import Scenario, load_scenario
from sitl.flight.watch import FlightWatch
from sitl.links.free_ports import reserved_ports
from tests.bench.real_flight import RealFlight
from tests.bench.scenarios import SCENARIOS

SCENARIO = SCENARIOS / "platoon.yaml"
FORM_S = 40.0
RECORDING = ((1, 3), (2, 4), (2, 4), (1, 3), (1, 3), (2, 4), (2, 4), (1, 3))  # in each flight
CPU_LIMIT_PERCENT, LATE_LIMIT, SIZE_LIMIT_MB = 3.0, 1.1, 1.0  # of a core; ratio of the p99; for a vehicle and minute
ENABLED = re.compile("^  enabled: true$", re.MULTILINE)


def main() -> int:
    scenario = load_scenario(SCENARIO, [f"timeline[3].for_s={FORM_S:g}", "stand_in.sensors=default"])
    cpu_percent: list[float] = []  # of those that record more than of the others, in each flight
    late_ratios: list[float] = []  # of the p99, in each flight
    mb_per_minute: list[float] = []
    for ids in RECORDING:
        with TemporaryDirectory(prefix="recording-") as name:
            watch = _flown(scenario, Path(name), ids)
            mb_per_minute += _sizes(Path(name))
        recorded, others = (
            [t for i, t in watch.newest_timing.items() if (i in ids) is which] for which in (True, False)
        )
        cpu_percent.append(fmean(t.cpu_percent for t in recorded) - fmean(t.cpu_percent for t in others))
        late_ratios.append(fmean(t.late_us.p99 for t in recorded) / fmean(t.late_us.p99 for t in others))
        print(
            f"  vehicles {ids[0]} and {ids[1]} record: {_in_words(watch, ids)}: {late_ratios[-1]:.2f} times", flush=True
        )
    cpu, late = fmean(cpu_percent), geometric_mean(late_ratios)
    error = stdev(map(log, late_ratios)) / sqrt(len(late_ratios))
    size = max(mb_per_minute)
    print(
        f"recording takes {cpu:.1f} % of a core, limit {CPU_LIMIT_PERCENT:g}\n"
        f"tick lateness, p99: {late:.2f} times that without, limit {LATE_LIMIT:g} (mean of {len(late_ratios)} flights, "
        f"standard error {100 * error:.0f} %)\n"
        f"size: {size:.2f} MB for a vehicle and minute at most, limit {SIZE_LIMIT_MB:g}"
    )
    return 0 if cpu <= CPU_LIMIT_PERCENT and late <= LATE_LIMIT and size <= SIZE_LIMIT_MB else 1


def _in_words(watch: FlightWatch, ids: tuple[int, ...]) -> str:
    return "  ".join(
        f"{i}{'*' if i in ids else ' '} {timing.cpu_percent:4.1f} %, late {timing.late_us.p99:5.0f} us"
        for i, timing in sorted(watch.newest_timing.items())
    )


def _flown(scenario: Scenario, folder: Path, recording: tuple[int, ...]) -> FlightWatch:
    """One flight. Raises SystemExit where it fails."""
    ids = ids_of(scenario)
    with reserved_ports(autopilots_of(scenario), None) as offset:
        write_files(scenario, folder, offset)
        for vehicle_id in set(ids) - set(recording):
            _do_not_record(folder / f"vehicle_{vehicle_id}.yaml")
        flight = RealFlight(scenario, folder, offset)
        failures = flight.fly()
    if failures:
        raise SystemExit("\n".join(failures))
    return flight.watch


def _do_not_record(vehicle_file: Path) -> None:
    text, count = ENABLED.subn("  enabled: false", vehicle_file.read_text(encoding="utf-8"))
    if count != 1:
        raise SystemExit(f"{vehicle_file}: expected one line with enabled")
    vehicle_file.write_text(text, encoding="utf-8")


def _sizes(folder: Path) -> list[float]:
    """MB for each vehicle and minute of ticks at 50 Hz."""
    sizes = []
    for recorded in recordings(folder, print):
        ticks = sum(1 for _ in recorded.undecoded([INBOX], print))
        own = [f.bytes for f in recorded_files(folder) if f.source == f"vehicle_{recorded.vehicle_id}"]
        sizes.append(sum(own) / MB / (ticks * PERIOD_S / 60.0))
    return sizes


if __name__ == "__main__":
    sys.exit(main())
