"""Four real agents beside a C loop, an asyncio timer and mavsdk, all at the same time: lateness, and telemetry to command."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import ExitStack
from dataclasses import dataclass, field
from pathlib import Path
from statistics import median

import msgspec
import yaml

from companion.link.tick import PERIOD_S
from sitl.flight.files import autopilot_file, autopilot_path, autopilots_of
from sitl.links.free_ports import reserved_ports
from sitl.links.ports import LOOPBACK, ports_of
from tests.bench.figures import Row, Section, Target, Window, lateness_us, percentile, windows_of, within
from tests.bench.processes import module, start_silent
from tests.bench.programs.loops import Cycle, build_c_loop, cycles_of
from tests.bench.programs.relay import commands_of
from tests.bench.real_flight import FORM_S, Flown, delays_of_ticks, fly
from tests.bench.scenarios import line

VEHICLES = 4
MEASURED, MAVSDK = 2, 5  # the follower behind the relay, and mavsdk's vehicle
LATE_HOW = """\
Four real agents fly in formation in real time with their stand-in autopilots, on default settings: they record, and \
each agent uses the states of three peers. A loop in C (clock_nanosleep to absolute times, built by the bench) and one \
with stock asyncio (sleep to absolute times) run beside them, in the same seconds; each of five windows of 7 s is a \
repeat. An agent has no timer: a tick is due when the autopilot's position arrives, 50 times a second. So its delay is \
the time from the kernel's receipt of the position, rounded down to 10 us, to the beginning of the tick, when it has \
read and decoded all telemetry that waits; both times are in its recording. For the timers it is the time from the \
due time to the wake-up.

On the grid, for information, the ticks of all programs are judged by one formula: how much later than the earliest \
twentieth of the window's ticks a tick begins, on a grid of 20 ms. There an agent's lateness also contains that of its \
stand-in, a Python process, which is why it is no measure of the agent."""
COMMAND_HOW = """\
In the same flight. By the agent's own clock it is the time from the kernel's receipt of the position to the setpoint \
at the socket, of all four agents. On the wire it is measured from outside, equally for both programs: a relay between \
autopilot and client notes when it forwards a position and the kernel's time stamp of the first attitude setpoint \
after it. mavsdk flies no formation: it has a vehicle of its own, and its callback for position and velocity calls \
set_attitude at once with a constant, with its synchronous Python interface, which is its fastest. The kernel stamps a \
packet before the call that sends it returns: on the wire the agents are faster than by their own clock. What the agents need \
more than a constant answer is the decision in code and data that have left the caches of the processor since the last tick: \
Agent.step takes four times as long after 20 ms of waiting (below)."""


@dataclass
class WindowFigures:
    """One value for each window."""

    figures: dict[str, list[float]] = field(default_factory=dict)

    def add(self, name: str, values: Sequence[float]) -> None:
        """Median and 99 % of one window; nothing where a program did not run."""
        if values:
            self.figures.setdefault(f"{name} p50", []).append(percentile(values, 0.5))
            self.figures.setdefault(f"{name} p99", []).append(percentile(values, 0.99))

    def of(self, name: str) -> tuple[float, ...]:
        return tuple(self.figures.get(name, ()))


def measure(folder: Path) -> tuple[list[Section], Flown]:
    """The sections, and the flight for the table of CPU and memory."""
    scenario = line(VEHICLES, FORM_S)
    autopilots = autopilots_of(scenario) | {MAVSDK: scenario.stand_in.autopilot}
    with reserved_ports(autopilots, None) as offset, ExitStack() as stack:
        c_loop = build_c_loop(folder)

        def prepare() -> None:
            ports = ports_of(MEASURED, offset)
            behind_relay(folder / f"vehicle_{MEASURED}.yaml", ports.companion, ports.zenoh)
            file = msgspec.structs.replace(autopilot_file(scenario, 1), id=MAVSDK)
            content = yaml.safe_dump(msgspec.to_builtins(file), sort_keys=False)
            autopilot_path(folder, MAVSDK).write_text(content, encoding="utf-8")
            _start_beside(stack, folder, offset, c_loop)

        flown = fly(scenario, folder, offset, prepare)
    measured = _measured(flown, folder)
    return [_lateness(measured, c_loop, flown.failure), _command(measured, c_loop, flown.failure)], flown


def behind_relay(vehicle_file: Path, autopilot_port: int, client_port: int) -> None:
    """Let the agent listen where the relay forwards to."""
    text, before = vehicle_file.read_text(encoding="utf-8"), f"udpin:{LOOPBACK}:{autopilot_port}"
    if text.count(before) != 1:
        raise ValueError(f"{vehicle_file}: expected {before} once")
    vehicle_file.write_text(text.replace(before, f"udpin:{LOOPBACK}:{client_port}"), encoding="utf-8")


def _start_beside(stack: ExitStack, folder: Path, offset: int, c_loop: Path | None) -> None:
    """The UDP ports of Zenoh are free with TCP as transport."""
    for vehicle_id in (MEASURED, MAVSDK):
        ports, out = ports_of(vehicle_id, offset), str(folder / f"relay_{vehicle_id}.txt")
        start_silent(stack, _program("relay", str(ports.companion), str(ports.zenoh), out))
    config = str(autopilot_path(folder, MAVSDK))
    start_silent(stack, module("sitl", "autopilot", "--config", config, "--port-offset", str(offset)))
    start_silent(stack, _program("mavsdk_client", str(ports_of(MAVSDK, offset).zenoh)))
    start_silent(stack, _program("loops", str(folder / "asyncio.txt")))
    if c_loop:
        start_silent(stack, [str(c_loop), str(folder / "c.txt")])


def _program(name: str, *arguments: str) -> list[str]:
    return module(f"tests.bench.programs.{name}", *arguments)


def _measured(flown: Flown, folder: Path) -> WindowFigures:
    measured = WindowFigures()
    loops = {"C": cycles_of(folder / "c.txt"), "asyncio": cycles_of(folder / "asyncio.txt")}
    wires = {
        "agent": commands_of(folder / f"relay_{MEASURED}.txt"),
        "mavsdk": commands_of(folder / f"relay_{MAVSDK}.txt"),
    }
    delays = delays_of_ticks(folder)
    for window in windows_of(flown.uses):
        measured.add("agent woken", within(window, delays))
        measured.add("agent late", _agents_late_us(flown, window))
        measured.add("agent own", _own_us(flown, window))
        for name, cycles in loops.items():
            here = [cycle for cycle in cycles if window.begin_s <= cycle.due_s < window.end_s]
            measured.add(f"{name} late", lateness_us([cycle.woken_s for cycle in here], PERIOD_S))
            measured.add(f"{name} woken", _woken_us(here))
        for name, commands in wires.items():
            measured.add(f"{name} wire", within(window, commands))
    return measured


def _agents_late_us(flown: Flown, window: Window) -> list[float]:
    """Of all agents, each on its own grid."""
    late_us: list[float] = []
    for timings in flown.timings.values():
        late_us += lateness_us(within(window, ((one.now_s, one.now_s) for one in timings)), PERIOD_S)
    return late_us


def _own_us(flown: Flown, window: Window) -> list[float]:
    return [
        float(one.telemetry_to_command_us)
        for timings in flown.timings.values()
        for one in timings
        if one.telemetry_to_command_us is not None and window.begin_s <= one.now_s < window.end_s
    ]


def _woken_us(cycles: Sequence[Cycle]) -> list[float]:
    return [(cycle.woken_s - cycle.due_s) * 1e6 for cycle in cycles]


def _lateness(measured: WindowFigures, c_loop: Path | None, failure: str) -> Section:
    remark = failure or ("" if c_loop else "gcc could not build the C loop")
    rows = [
        Row(
            what=f"{program}, {share}",
            unit="us",
            values=measured.of(f"{name} woken {share}"),
            beside="C loop",
            beside_values=measured.of(f"C woken {share}"),
            target=target if name == "agent" else None,
            remark=remark if name == "agent" else "",
        )
        for name, program in (("agent", "agents, position to tick"), ("asyncio", "stock asyncio timer, due to wake-up"))
        for share, target in (("p50", Target("ratio", most=2.0)), ("p99", None))
    ]
    rows += [
        Row(
            what=f"agents on the grid, {share}",
            unit="us",
            values=measured.of(f"agent late {share}"),
            beside=f"{beside} loop",
            beside_values=measured.of(f"{beside} late {share}"),
        )
        for share in ("p50", "p99")
        for beside in ("C", "asyncio")
    ]
    return Section(title="Tick lateness at 50 Hz", how=LATE_HOW, rows=tuple(rows))


def _command(measured: WindowFigures, c_loop: Path | None, failure: str) -> Section:
    no_mavsdk = "" if measured.of("mavsdk wire p50") else "mavsdk sent no commands here"
    rows = [
        Row(
            what="telemetry to command, the agents' own clock, p50",
            unit="ms",
            values=_ms(measured.of("agent own p50")),
            remark=failure,
        ),
        Row(
            what="telemetry to command, the agents' own clock, p99",
            unit="ms",
            values=_ms(measured.of("agent own p99")),
            beside="C loop, due time to wake-up, p99",
            beside_values=_ms(measured.of("C woken p99")),
            remark="" if c_loop else "gcc could not build the C loop",
        ),
    ]
    rows += [
        Row(
            what=f"telemetry to command on the wire, {share}",
            unit="ms",
            values=_ms(measured.of(f"agent wire {share}")),
            beside="mavsdk",
            beside_values=_ms(measured.of(f"mavsdk wire {share}")),
            target=Target("ratio", most=most),
            remark=no_mavsdk,
        )
        for share, most in (("p50", 1.0), ("p99", 1.5))
    ]
    return Section(title="Telemetry to command", how=COMMAND_HOW, rows=tuple(rows))


def _ms(values_us: Sequence[float]) -> tuple[float, ...]:
    return tuple(value / 1e3 for value in values_us)


def rate_of_slowest_hz(flown: Flown) -> tuple[float, ...]:
    """Ticks a second of the slowest agent in each window."""
    rates = []
    for window in windows_of(flown.uses):
        counts = [len(within(window, ((one.now_s, 1.0) for one in timings))) for timings in flown.timings.values()]
        rates.append(min(counts) / window.lasts_s)
    return tuple(rates)


def median_memory_mb(flown: Flown) -> tuple[float, ...]:
    """Of the agents, at the end of each window."""
    return tuple(median(use.memory_mb.values()) for use in flown.uses[1:])
