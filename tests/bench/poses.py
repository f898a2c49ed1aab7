"""Motion-capture poses of four real agents in formation: from the publisher to the autopilot's socket."""

from __future__ import annotations

from contextlib import ExitStack
from pathlib import Path

from sitl.flight.files import autopilots_of, cameras_path, mocap_path
from sitl.links.free_ports import reserved_ports
from sitl.links.ports import ports_of
from tests.bench.control_loop import behind_relay
from tests.bench.figures import Row, Section, Target, percentile, windows_of, within
from tests.bench.processes import module, start_silent
from tests.bench.programs.pose_source import PERIOD_S, SPARE
from tests.bench.programs.relay import commands_of
from tests.bench.real_flight import FORM_S, fly
from tests.bench.scenarios import laboratory

MOST_P99_MS = 10.0
HOW = """\
Four real agents of the laboratory's platoon fly in formation in real time with their stand-ins, which have no GPS. One \
process publishes the true pose of each of them at 100 Hz, as `companion mocap` does, and is the wire between each agent \
and its stand-in. The time is from before `PosePublisher.publish` to the kernel's time stamp of VISION_POSITION_ESTIMATE \
at the autopilot's socket. Each of five windows of 7 s is a repeat, over the poses of all four."""


def measure(folder: Path) -> Section:
    """Files of the flight are written into `folder`."""
    folder.mkdir()
    scenario, out = laboratory(FORM_S, 1.0 / PERIOD_S), folder / "poses.txt"
    autopilots = autopilots_of(scenario)
    spare = {i + SPARE: kind for i, kind in autopilots.items()}
    with reserved_ports(autopilots | spare, None) as offset, ExitStack() as stack:

        def prepare() -> None:
            for file in (cameras_path(folder), mocap_path(folder)):  # their place is taken
                file.unlink()
            for i in autopilots:
                ports, client = ports_of(i, offset), ports_of(i + SPARE, offset)
                behind_relay(folder / f"vehicle_{i}.yaml", ports.companion, client.companion)
            arguments = (scenario.fleet.name, str(offset), str(out), *map(str, autopilots))
            start_silent(stack, module("tests.bench.programs.pose_source", *arguments))

        flown = fly(scenario, folder, offset, prepare)
    poses = commands_of(out)
    windows_us = [us for window in windows_of(flown.uses) if (us := within(window, poses))]
    rows = tuple(
        Row(
            what=f"pose in to MAVLink out, p{100 * share:.0f}",
            unit="ms",
            values=tuple(percentile(us, share) / 1e3 for us in windows_us),
            target=target,
            remark=flown.failure,
        )
        for share, target in ((0.5, None), (0.99, Target("value", most=MOST_P99_MS)))
    )
    return Section(title="Motion-capture poses", how=HOW, rows=rows)
