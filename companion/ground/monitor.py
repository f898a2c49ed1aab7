"""`companion monitor`: the fleet in the terminal, from Zenoh alone."""

from __future__ import annotations

import re
import shutil
import sys
import time
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any

import msgspec

from companion import GROUND_INSTALL
from companion.ground.endpoints import unreachable
from companion.ground.fleet_status import FleetState, VehicleRow, fold, rows
from companion.ground.monitor_table import by_fleet, cells, columns_for, note, plain_lines
from companion.ground.session import FleetSession
from companion.types.bounds import FLEET_NAME

if TYPE_CHECKING:
    from companion.security.identity import Identity

ONCE_LISTEN_S = 3.0
ONCE_SETTLE_S = 0.5  # five status periods: every connected vehicle has reported by then
LIVE_PERIOD_S = 0.2
PLAIN_PERIOD_S = 1.0
PLAIN_WIDTH = 120  # where the output is no terminal and COLUMNS is not set
EXIT_ENDED, EXIT_NO_REPORT = 0, 1

Print = Callable[[list[VehicleRow]], None]


class MonitorError(Exception):
    """The monitor cannot run as requested. str() is one line with what to do."""


def run_monitor(fleet: str, endpoints: Sequence[str], identity: Identity | None, once: bool, as_json: bool) -> int:
    """The exit code. Raises MonitorError and link.zenoh_session.EndpointError."""
    if fleet != "*" and not re.fullmatch(FLEET_NAME, fleet):
        raise MonitorError(f"--fleet {fleet!r}: expected the name in a fleet file, like platoon, or * for every fleet")
    live = _live_table() if sys.stdout.isatty() and not (once or as_json) else None
    with FleetSession(fleet, endpoints, identity=identity) as session:
        try:
            if once:
                return _once(session, endpoints, _json if as_json else _plain_table)
            if live:
                live(session, endpoints)
            else:
                _repeat(session, _json if as_json else _plain_table)
        except KeyboardInterrupt:
            return EXIT_ENDED
    return EXIT_ENDED


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
    show(rows(state, time.monotonic()))
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


def _repeat(session: FleetSession, show: Print) -> None:
    state = FleetState()
    while True:
        time.sleep(PLAIN_PERIOD_S)
        state = _updated(session, state)
        show(rows(state, time.monotonic()))
        sys.stdout.flush()


def _updated(session: FleetSession, state: FleetState) -> FleetState:
    now_s = time.monotonic()
    for report in session.drain():
        state = fold(state, report, now_s)
    return state


def _plain_table(table: list[VehicleRow]) -> None:
    for line in plain_lines(table, shutil.get_terminal_size((PLAIN_WIDTH, 24)).columns):
        print(line)


def _json(table: list[VehicleRow]) -> None:
    print(msgspec.json.encode(table).decode())


def _live_table() -> Callable[[FleetSession, Sequence[str]], None]:
    """Shows the live table until Ctrl-C. Raises MonitorError where its package is missing."""
    try:
        from rich.console import Group
        from rich.live import Live
        from rich.table import Table
        from rich.text import Text
    except ImportError as error:
        raise MonitorError(
            f"the live table needs the package rich: {GROUND_INSTALL}, or use --once, --json or a pipe"
        ) from error

    def table_of(of_fleet: list[VehicleRow], width: int) -> Any:
        columns = columns_for(width)
        shown = Table(box=None, padding=(0, 1, 0, 0), pad_edge=False)
        for column in columns:
            shown.add_column(
                column.name, min_width=column.width, no_wrap=True, justify="right" if column.right else "left"
            )
        for row in of_fleet:
            texts = (Text(text) for text in cells(row, columns))  # Text: brackets are no markup
            shown.add_row(*texts, style=_style(row))
        return shown

    def notes_of(of_fleet: list[VehicleRow]) -> list[Any]:
        return [Text(f"  {row.vehicle_id}: {note(row)}", style=_style(row) or "dim") for row in of_fleet if note(row)]

    def screen_of(table: list[VehicleRow], endpoints: Sequence[str], width: int) -> Any:
        if not table:
            return Text(f"no report yet from {', '.join(endpoints)}")
        parts: list[Any] = []
        for heading, of_fleet in by_fleet(table):
            parts += [Text(heading, style="bold"), table_of(of_fleet, width), *notes_of(of_fleet)]
        return Group(*parts)

    def live(session: FleetSession, endpoints: Sequence[str]) -> None:
        state = FleetState()
        with Live(screen_of([], endpoints, 80), auto_refresh=False) as screen:
            while True:
                state = _updated(session, state)
                table = rows(state, time.monotonic())
                screen.update(screen_of(table, endpoints, screen.console.width), refresh=True)
                time.sleep(LIVE_PERIOD_S)

    return live


def _style(row: VehicleRow) -> str:
    if row.silent:
        return "bold red"
    return "yellow" if row.flags else ""
