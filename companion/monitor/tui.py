"""`companion monitor --tui`: the fleet in the terminal, from Zenoh alone.

The live picture is refreshed in place on the second screen of the terminal: at the end it is as it was before.
"""

from __future__ import annotations

import contextlib
import os
import re
import shutil
import signal
import sys
import threading
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from functools import partial
from importlib import import_module
from types import FrameType
from typing import TYPE_CHECKING, Any, Self

import msgspec
import zenoh

from companion import GROUND_INSTALL
from companion.ground.answers import id_list
from companion.ground.current_fleet import unreachable
from companion.ground.fleet_state import FleetState, ReportedVehicle, fold, formation_text, reference_text, vehicles_at
from companion.ground.session import FleetSession
from companion.monitor import MonitorError
from companion.monitor.tui_page import Line, Style, fit_page, page
from companion.monitor.tui_rows import NO_MEMBERS, Members, fleets
from companion.types.values import FLEET_NAME
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
PRINTED_OF_STATUS = (
    *("fleet", "vehicle_id", "role", "phase", "mode_name", "armed", "position_enu_m", "prc", "battery_percent"),
    *("hover_thrust_norm", "disturbance_enu_m_s2", "neighbours", "peers", "position_error", "lacks", "holder"),
    *("separation", "last_event", "network"),
)

Print = Callable[[list[ReportedVehicle]], None]


def run_monitor(
    fleet: str,
    endpoints: Sequence[str],
    identity: Identity | None,
    once: bool,
    as_json: bool,
    endpoints_are_guessed: bool = False,
    members: Members = NO_MEMBERS,
) -> int:
    """The exit code. With `endpoints_are_guessed` the live table does not tell which of them are not reached.

    Raises MonitorError and link.fleet.zenoh_session.EndpointError.
    """
    if fleet != "*" and not re.fullmatch(FLEET_NAME, fleet):
        raise MonitorError(f"--fleet {fleet!r}: expected the name in a fleet file, like platoon, or * for every fleet")
    is_live = _is_live_terminal() and not (once or as_json)
    if is_live:
        _need_rich()
    show: Print = _json if as_json else partial(_plain_table, members=members)
    show_once: Print = partial(json_once, members=members) if as_json else show
    with FleetSession(fleet, endpoints, identity=identity) as session:
        try:
            if once:
                return _once(session, endpoints, show_once)
            if is_live:
                known = () if endpoints_are_guessed else endpoints
                show_live(_reader(session), endpoints, lambda: unreachable(known, session.linked()), members)
            else:
                _repeat(session, show)
        except KeyboardInterrupt:
            return EXIT_ENDED
    return EXIT_ENDED


def _is_live_terminal() -> bool:
    return sys.stdout.isatty() and os.environ.get("TERM", "") not in WITHOUT_CURSOR


def _once(session: FleetSession, endpoints: Sequence[str], show: Print) -> int:
    state = FleetState()
    end_s = time.monotonic() + ONCE_LISTEN_S
    while (now_s := time.monotonic()) < end_s:
        before = len(state.vehicles)
        state = _updated(session, state)
        if before == 0 and state.vehicles:
            end_s = min(end_s, now_s + ONCE_SETTLE_S)
        time.sleep(0.02)
    if not state.vehicles:
        print(f"companion monitor: {_nothing_received(session, endpoints)}", file=sys.stderr)
        return EXIT_NO_REPORT
    show(vehicles_at(state, time.monotonic()))
    return EXIT_ENDED


def _nothing_received(session: FleetSession, endpoints: Sequence[str]) -> str:
    """One line with the endpoints that cannot be reached."""
    failed = unreachable(endpoints, session.linked())
    reached = [endpoint for endpoint in endpoints if endpoint not in failed]
    states = [f"{endpoint}: {reason}" for endpoint, reason in failed.items()]
    states += [f"{endpoint}: reached, without a report" for endpoint in reached]
    other_fleet = f", or leave --fleet {session.fleet} out to show every fleet" if session.fleet != "*" else ""
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


def _reader(session: FleetSession) -> Callable[[], list[ReportedVehicle]]:
    """Gives the rows of all vehicles at each call."""
    state = FleetState()

    def read() -> list[ReportedVehicle]:
        nonlocal state
        state = _updated(session, state)
        return vehicles_at(state, time.monotonic())

    return read


def _repeat(session: FleetSession, show: Print) -> None:
    read = _reader(session)
    while True:
        time.sleep(PLAIN_PERIOD_S)
        show(read())
        sys.stdout.flush()


def _updated(session: FleetSession, state: FleetState) -> FleetState:
    now_s = time.monotonic()
    for report in session.drain():
        state = fold(state, report, now_s)
    return state


def _plain_table(vehicles: list[ReportedVehicle], members: Members) -> None:
    lines = page(vehicles, shutil.get_terminal_size((PLAIN_WIDTH, 24)).columns, members)
    print("\n".join(shown.text for shown in lines) or "no vehicle has reported yet")


def _json(vehicles: list[ReportedVehicle]) -> None:
    print(msgspec.json.encode([vehicle_as_data(vehicle) for vehicle in vehicles]).decode())


def vehicle_as_data(vehicle: ReportedVehicle) -> dict[str, Any]:
    """What --json prints of a vehicle."""
    status, flat = vehicle.status, STATUS_FORM.flat(vehicle.status)
    return {
        **{key: getattr(flat, key) for key in PRINTED_OF_STATUS},
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


def json_once(vehicles: list[ReportedVehicle], members: Members) -> None:
    """On standard error those that the array cannot have, because they never reported."""
    _json(vehicles)
    for fleet in fleets(vehicles, members):
        if fleet.missing_ids:
            missing = f"NEVER HEARD: {id_list(fleet.missing_ids)} of its fleet file"
            print(f"companion monitor: fleet {fleet.name}: {missing}", file=sys.stderr)


PERIOD_S = 0.2
CONNECTIONS_EVERY_S = 3.0


def show_live(
    vehicles: Callable[[], Sequence[ReportedVehicle]],
    endpoints: Sequence[str],
    unreachable: Callable[[], Mapping[str, str]],
    members: Members,
) -> None:
    """Until Ctrl-C, which is raised as KeyboardInterrupt, as is SIGTERM.

    `unreachable` gives the reason by endpoint and may take seconds.
    """
    from rich.console import Console
    from rich.live import Live

    console = Console(highlight=False)
    with (
        _Connections(unreachable) as connections,
        _ended_by_sigterm(),
        Live(console=console, screen=True, auto_refresh=False, transient=True) as screen,
    ):
        while True:
            width, height = console.size
            above = top_lines(time.strftime("%H:%M:%S"), connections.failed, width)
            room = height - len(above)
            lines = fit_page(vehicles(), width, room, time.monotonic(), members) or _nothing_yet(endpoints)
            screen.update(as_text([*above, *lines]), refresh=True)
            time.sleep(PERIOD_S)


def top_lines(clock: str, failed: Mapping[str, str], width: int) -> list[Line]:
    """The time of this picture, so that a connection that stalls is seen, and the endpoints that are not reached."""
    lines = [Line(clock, Style.QUIET)]
    if failed:
        text = "not reached: " + "; ".join(f"{endpoint}: {reason}" for endpoint, reason in failed.items())
        lines.append(Line(text if len(text) <= width else f"{text[: width - 1]}…", Style.WARNING))
    return lines


class _Connections:
    """Looks at the endpoints in a thread."""

    def __init__(self, unreachable: Callable[[], Mapping[str, str]]) -> None:
        self.failed: Mapping[str, str] = {}
        self._unreachable = unreachable
        self._ended = threading.Event()
        self._thread = threading.Thread(target=self._look, daemon=True)

    def _look(self) -> None:
        while not self._ended.wait(CONNECTIONS_EVERY_S):
            with contextlib.suppress(zenoh.ZError, OSError):  # the picture goes on without it
                self.failed = self._unreachable()

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
