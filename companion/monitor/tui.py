"""`companion monitor --tui`: the fleet in the terminal, from Zenoh alone.

The live picture is refreshed in place on the second screen of the terminal: at the end it is as it was before.
"""

from __future__ import annotations

import contextlib
import os
import shutil
import signal
import sys
import threading
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from importlib import import_module
from types import FrameType, MappingProxyType
from typing import TYPE_CHECKING, Any, Self

import msgspec
import zenoh

from companion import GROUND_INSTALL
from companion.config.fleet import FleetConfig
from companion.ground.answers import id_list
from companion.ground.fleet_state import ReportedVehicle, formation_text, reference_text
from companion.ground.session import FleetSession
from companion.monitor import MonitorError, check_fleet_name
from companion.monitor.snapshot import Picture
from companion.monitor.sources import LiveSource, Moment
from companion.monitor.tui_page import Line, Style, cut, fit_page, page
from companion.wire.messages import STATUS_FORM

if TYPE_CHECKING:
    from rich.text import Text

    from companion.security.identity import Identity


ONCE_LISTEN_S = 3.0
ONCE_SETTLE_S = 0.5  # five status periods: every connected vehicle has reported by then
PLAIN_PERIOD_S = 1.0
PLAIN_WIDTH = 120  # where the output is no terminal and COLUMNS is not set
WITHOUT_CURSOR = ("dumb", "unknown", "")  # values of TERM: lines can only be added
EXIT_ENDED, EXIT_NO_REPORT = 0, 1
NO_FILES: Mapping[str, FleetConfig] = MappingProxyType({})
PRINTED_OF_STATUS = (
    *("fleet", "vehicle_id", "role", "phase", "mode_name", "armed", "position_enu_m", "prc", "battery_percent"),
    *("hover_thrust_norm", "disturbance_enu_m_s2", "neighbours", "peers", "position_error", "lacks", "holder"),
    *("separation", "last_event", "network"),
)

Print = Callable[[Picture, Moment], None]


def run_monitor(
    fleet: str,
    endpoints: Sequence[str],
    identity: Identity | None,
    once: bool,
    as_json: bool,
    endpoints_are_guessed: bool = False,
    fleets: Mapping[str, FleetConfig] = NO_FILES,
) -> int:
    """The exit code. With `endpoints_are_guessed` the live table does not tell which of them are not reached.

    Raises MonitorError and link.fleet.zenoh_session.EndpointError.
    """
    check_fleet_name(fleet)
    is_live = _is_live_terminal() and not (once or as_json)
    if is_live:
        _need_rich()
    with FleetSession(fleet, endpoints, identity=identity) as session:
        looked_at = () if is_live and endpoints_are_guessed else endpoints
        source, picture = LiveSource(session, looked_at), Picture(fleets, session.operator)
        try:
            if once:
                return _once(source, picture, fleet, json_once if as_json else _plain_table)
            if is_live:
                show_live(source, picture, endpoints)
            else:
                _repeat(source, picture, _json if as_json else _plain_table)
        except KeyboardInterrupt:
            return EXIT_ENDED
    return EXIT_ENDED


def _is_live_terminal() -> bool:
    return sys.stdout.isatty() and os.environ.get("TERM", "") not in WITHOUT_CURSOR


def _once(source: LiveSource, picture: Picture, fleet: str, show: Print) -> int:
    end_s = time.monotonic() + ONCE_LISTEN_S
    while (now_s := time.monotonic()) < end_s:
        had_vehicles = picture.has_vehicles
        picture.receive(source.drain())
        if picture.has_vehicles and not had_vehicles:
            end_s = min(end_s, now_s + ONCE_SETTLE_S)
        time.sleep(0.02)
    if not picture.has_vehicles:
        print(f"companion monitor: {_nothing_received(source, fleet)}", file=sys.stderr)
        return EXIT_NO_REPORT
    show(picture, source.moment())
    return EXIT_ENDED


def _nothing_received(source: LiveSource, fleet: str) -> str:
    """One line with the endpoints that cannot be reached."""
    reached, failed = source.connections()
    states = [*failed, *(f"{endpoint}: reached, without a report" for endpoint in reached)]
    other_fleet = f", or leave --fleet {fleet} out to show every fleet" if fleet != "*" else ""
    return (
        f"no report for {ONCE_LISTEN_S:g} s ({'; '.join(states)}); give the endpoints of running agents with --connect, and"
        f" the own identity where they have identities{other_fleet}"
    )


def _need_rich() -> None:
    """Raises MonitorError where its package is missing."""
    try:
        import_module("rich.console")
    except ImportError as error:
        needed = f"the live table needs the package rich: {GROUND_INSTALL}, or use --once, --json or a pipe"
        raise MonitorError(needed) from error


def _repeat(source: LiveSource, picture: Picture, show: Print) -> None:
    while True:
        time.sleep(PLAIN_PERIOD_S)
        picture.receive(source.drain())
        show(picture, source.moment())
        sys.stdout.flush()


def _plain_table(picture: Picture, moment: Moment) -> None:
    lines = page(picture.snapshot(*moment), shutil.get_terminal_size((PLAIN_WIDTH, 24)).columns)
    print("\n".join(shown.text for shown in lines) or "no vehicle has reported yet")


def _json(picture: Picture, moment: Moment) -> None:
    print(msgspec.json.encode([vehicle_as_data(vehicle) for vehicle in picture.reported(moment.now_s)]).decode())


def vehicle_as_data(vehicle: ReportedVehicle) -> dict[str, Any]:
    """What --json prints of a vehicle."""
    status, flat = vehicle.status, STATUS_FORM.flat(vehicle.status)
    return {
        **{key: getattr(flat, key) for key in PRINTED_OF_STATUS},
        "position_enu_m": flat.position_enu_m if status.motion.is_known else None,
        "error_to_slot_m": vehicle.error_to_slot_m,
        "age_s": vehicle.age_s,
        "data_age_s": vehicle.data_age_s,
        "silent": vehicle.silent,
        "formation": formation_text(status),
        "reference": reference_text(status),
        "flags": vehicle.flags,
        "rejected": vehicle.rejected,
        "timing": vehicle.report.timing,
        "reference_enu_m": vehicle.reference_enu_m,
        "slot_position_enu_m": vehicle.slot_position_enu_m,
    }


def json_once(picture: Picture, moment: Moment) -> None:
    """On standard error those that the array cannot have, because they never reported."""
    _json(picture, moment)
    for fleet in picture.snapshot(*moment).fleets:
        if fleet.missing_ids:
            missing = f"NEVER HEARD: {id_list(fleet.missing_ids)} of its fleet file"
            print(f"companion monitor: fleet {fleet.name}: {missing}", file=sys.stderr)


PERIOD_S = 0.2
CONNECTIONS_EVERY_S = 3.0


def show_live(source: LiveSource, picture: Picture, endpoints: Sequence[str]) -> None:
    """Until Ctrl-C, which is raised as KeyboardInterrupt, as is SIGTERM."""
    from rich.console import Console
    from rich.live import Live

    console = Console(highlight=False)
    with (
        _Connections(source) as connections,
        _ended_by_sigterm(),
        Live(console=console, screen=True, auto_refresh=False, transient=True) as screen,
    ):
        while True:
            picture.receive(source.drain())
            width, height = console.size
            above = top_lines(time.strftime("%H:%M:%S"), connections.failed, width)
            snapshot = picture.snapshot(*source.moment())
            lines = fit_page(snapshot, width, height - len(above), time.monotonic()) or _nothing_yet(endpoints)
            screen.update(as_text([*above, *lines]), refresh=True)
            time.sleep(PERIOD_S)


def top_lines(clock: str, failed: Sequence[str], width: int) -> list[Line]:
    """The time of this picture, so that a connection that stalls is seen, and the endpoints that are not reached."""
    lines = [Line(clock, Style.QUIET)]
    if failed:
        lines.append(Line(cut(f"not reached: {'; '.join(failed)}", width), Style.WARNING))
    return lines


class _Connections:
    """Looks at the endpoints in a thread."""

    def __init__(self, source: LiveSource) -> None:
        self.failed: Sequence[str] = ()
        self._source = source
        self._ended = threading.Event()
        self._thread = threading.Thread(target=self._look, daemon=True)

    def _look(self) -> None:
        while not self._ended.wait(CONNECTIONS_EVERY_S):
            with contextlib.suppress(zenoh.ZError, OSError):  # the picture goes on without it
                _, self.failed = self._source.connections()

    def __enter__(self) -> Self:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._ended.set()
        self._thread.join(2.0)


def _nothing_yet(endpoints: Sequence[str]) -> list[Line]:
    return [Line(f"no report yet from {', '.join(endpoints)}", Style.QUIET), Line("Ctrl-C ends", Style.QUIET)]


def as_text(lines: Sequence[Line]) -> Text:
    """With the styles; NO_COLOR leaves their colours out."""
    from rich.text import Text

    return Text("\n").join(Text(shown.text, style=shown.style.value) for shown in lines)  # brackets are no markup


@contextmanager
def _ended_by_sigterm() -> Iterator[None]:
    """Without a handler a terminal that is killed would keep the second screen and hide its cursor."""

    def interrupt(_number: int, _frame: FrameType | None) -> None:
        raise KeyboardInterrupt

    before = signal.signal(signal.SIGTERM, interrupt)
    try:
        yield
    finally:
        signal.signal(signal.SIGTERM, before)
