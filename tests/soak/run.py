"""Flies eight vehicles as real processes for a long time and samples the agents."""

from __future__ import annotations

import csv
from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path

import yaml

from sitl.flight.files import autopilots_of, write_files
from sitl.flight.orders import FlightFailure
from sitl.flight.scenario import Scenario, load_scenario
from sitl.flight.watch import FlightWatch
from sitl.links.free_ports import reserved_ports
from sitl.stopping import StopRequest
from tests.bench.machine import Meanwhile
from tests.bench.processes import use_of
from tests.bench.real_flight import RealFlight
from tests.soak.page import page, save_plot
from tests.soak.samples import Sample, Ticks, findings, table

VEHICLES = 8
SPACING_M = 2.0
LEAST_PERIOD_S, SAMPLES = 2.0, 360  # an hour is sampled every 10 s


def scenario_file(folder: Path, seconds: float) -> Path:
    """Two columns that follow a figure 8; every vehicle sees its neighbours within range."""
    positions = {i: [-SPACING_M * ((i - 1) // 2), SPACING_M * ((i - 1) % 2), 0.0] for i in range(1, VEHICLES + 1)}
    members = [
        {"id": i, "role": "leader" if i == 1 else "follower", "slot_enu_m": position}
        for i, position in positions.items()
    ]
    scenario = {
        "description": f"{VEHICLES} vehicles on a figure 8 for {seconds:g} s.",
        "fleet": {
            "name": "soak",
            "origin": {"latitude_deg": 47.397742, "longitude_deg": 8.545594, "altitude_amsl_m": 488.0},
            "vehicles": members,
            "neighbours": {"kind": "range", "range_m": 3.0, "hysteresis_m": 0.5},
            "law": {"name": "cooperative"},
            "takeoff_height_m": 2.0,
        },
        "starts_enu_m": positions,
        "reference": {
            "kind": "figure_8",
            "centre_enu_m": [0.0, 0.0, 2.0],
            "width_m": 6.0,
            "height_m": 3.0,
            "period_s": 50.0,
            "ramp_s": 8.0,
        },
        "stand_in": {"sensors": "ideal"},
        "timeline": [
            {"command": "prepare"},
            {"command": "arm"},
            {"command": "takeoff", "for_s": 3.0},
            {"command": "form", "for_s": seconds},
            {"command": "land"},
        ],
    }
    file = folder / "soak.yaml"
    file.write_text(yaml.safe_dump(scenario, sort_keys=False), encoding="utf-8")
    return file


class Sampler:
    """Samples the agents while they fly formation."""

    def __init__(self, seconds: float) -> None:
        self._period_s = max(LEAST_PERIOD_S, seconds / SAMPLES)
        self._due_s = 0.0
        self._before: dict[int, Ticks] | None = None
        self.samples: list[Sample] = []

    def update(self, pids: Mapping[int, int], watch: FlightWatch, now_s: float) -> None:
        """Take a sample where one is due and all vehicles have a formation's timing."""
        if now_s < self._due_s or len(watch.newest_timing) < len(pids):
            return
        self._due_s = now_s + self._period_s
        timings = watch.newest_timing
        ticks = {i: Ticks.of(timing) for i, timing in timings.items()}
        before, self._before = self._before, ticks
        if before is None or any(ticks[i].ticks < before[i].ticks for i in ticks):
            self.samples.clear()  # the timing begins again with the formation
            return
        uses = [use_of(pid) for pid in pids.values()]
        self.samples.append(
            Sample(
                time_s=now_s - watch.began_s,
                memory_mb=max(use.memory_mb for use in uses),
                files=max(use.files for use in uses),
                threads=max(use.threads for use in uses),
                rate_hz=min(ticks[i].rate_hz(before[i]) for i in ticks),
                missed=sum(ticks[i].missed - before[i].missed for i in ticks),
                command_p99_us=max(timing.telemetry_to_command_us.p99 for timing in timings.values()),
            )
        )


def run_soak(folder: Path, seconds: float, quiet: bool, page_file: Path | None) -> int:
    """The exit code: 0 where all figures are constant, 1 otherwise.

    Writes soak.csv and soak.png into `folder`, and where a page is wanted, the page and its plot in images/ beside it.
    """
    folder.mkdir(parents=True, exist_ok=True)
    meanwhile = Meanwhile()
    scenario = load_scenario(scenario_file(folder, seconds))
    with (
        reserved_ports(autopilots_of(scenario), None) as offset,
        StopRequest("stopped at once; the vehicles were not landed") as stop,
    ):
        samples, failures = _fly(scenario, folder, offset, seconds, quiet, stop)
    if not samples:
        print("\n".join([*failures, "no samples: the vehicles were never in formation"]))
        return 1
    _write(folder / "soak.csv", samples)
    save_plot(folder / "soak.png", samples)
    print("\n".join(table(samples)))
    try:
        verdict = findings(samples)
    except ValueError as error:
        print(f"no verdict: {error}")
        return 1
    for finding in verdict:
        print(f"{finding.name:<22} {'constant' if finding.constant else 'CHANGES':<9} {finding.text}")
    if page_file:
        page_file.write_text(page(meanwhile.machine(), samples, verdict, failures), encoding="utf-8")
        save_plot(page_file.parent / "images/soak.png", samples)
    print("\n".join([*failures, f"samples and plot in {folder}"]))
    return 0 if not failures and all(finding.constant for finding in verdict) else 1


def _fly(
    scenario: Scenario, folder: Path, offset: int, seconds: float, quiet: bool, stop: StopRequest
) -> tuple[list[Sample], list[str]]:
    def check() -> None:
        if stop.number:
            raise FlightFailure(f"interrupted by {stop.number.name}")

    write_files(scenario, folder, offset)
    sampler = Sampler(seconds)
    flight = RealFlight(scenario, folder, offset, sampler.update, check=check)
    failures = flight.fly(quiet)
    return sampler.samples, failures


def _write(path: Path, samples: list[Sample]) -> None:
    with path.open("w", newline="", encoding="ascii") as file:
        writer = csv.DictWriter(file, fieldnames=list(asdict(samples[0])))
        writer.writeheader()
        writer.writerows(asdict(sample) for sample in samples)
