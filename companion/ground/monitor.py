"""`companion monitor`: the fleet in the terminal, from Zenoh alone."""

from __future__ import annotations

import re
import sys
import time
from collections.abc import Callable, Sequence
from math import hypot, isfinite
from typing import Any, TextIO

import msgspec

from companion import GROUND_INSTALL
from companion.config.fleet import FLEET_NAME
from companion.ground.fleet_status import FleetState, VehicleRow, fold, rows
from companion.ground.session import FleetSession

DEFAULT_ENDPOINTS = tuple(f"tcp/127.0.0.1:{port}" for port in range(7448, 7456))
ONCE_LISTEN_S = 3.0
ONCE_SETTLE_S = 0.5  # five status periods: whoever is connected has spoken by then
LIVE_PERIOD_S = 0.2
PLAIN_PERIOD_S = 1.0

COLUMNS = (
    *("vehicle", "phase", "mode", "armed", "altitude", "PrC", "error", "hover, push", "data", "rej"),
    *("formation", "reference", "commanded by", "what"),
)
_WIDTHS = (9, 9, 14, 5, 9, 3, 8, 15, 9, 5, 15, 23, 16, 0)


class MonitorError(Exception):
    """The monitor cannot run as asked. str() is one line with what to do."""


def run_monitor(fleet: str, connect: Sequence[str] | None, once: bool, as_json: bool) -> int:
    """The exit code. Raises MonitorError and link.zenoh_session.EndpointError."""
    if fleet != "*" and not re.fullmatch(FLEET_NAME, fleet):
        raise MonitorError(f"--fleet {fleet!r}: expected the name in a fleet file, like platoon, or * for every fleet")
    endpoints = tuple(connect or DEFAULT_ENDPOINTS)
    show = _json if as_json else _plain_table
    live = not once and not as_json and sys.stdout.isatty()
    rich_live = _rich_live() if live else None
    with FleetSession.open(fleet, endpoints) as session:
        try:
            if once:
                return _once(session, endpoints, show)
            if rich_live:
                rich_live(session, endpoints)
            else:
                _repeat(session, show)
        except KeyboardInterrupt:
            return 0
    return 0


def _once(session: FleetSession, endpoints: Sequence[str], show: Callable[[list[VehicleRow], TextIO], None]) -> int:
    state = FleetState()
    end_s = time.monotonic() + ONCE_LISTEN_S
    while (now_s := time.monotonic()) < end_s:
        before = len(state.vehicles)
        state = _heard(session, state)
        if before == 0 and state.vehicles:
            end_s = min(end_s, now_s + ONCE_SETTLE_S)
        time.sleep(0.02)
    if not state.vehicles:
        print(
            f"companion monitor: nobody was heard for {ONCE_LISTEN_S:g} s at {', '.join(endpoints)};"
            " are agents running there? give their endpoints (zenoh.listen in a vehicle file) with --connect"
            + (f", or leave --fleet {session.fleet} out to hear every fleet" if session.fleet != "*" else ""),
            file=sys.stderr,
        )
        return 1
    show(rows(state, time.monotonic()), sys.stdout)
    return 0


def _repeat(session: FleetSession, show: Callable[[list[VehicleRow], TextIO], None]) -> None:
    state = FleetState()
    while True:
        time.sleep(PLAIN_PERIOD_S)
        state = _heard(session, state)
        show(rows(state, time.monotonic()), sys.stdout)
        sys.stdout.flush()


def _heard(session: FleetSession, state: FleetState) -> FleetState:
    now_s = time.monotonic()
    for report in session.drain():
        state = fold(state, report, now_s)
    return state


# ---------------------------------------------------------------- what a row looks like


def cells(row: VehicleRow, several_fleets: bool) -> tuple[str, ...]:
    """One row's text per column of COLUMNS."""
    name = f"{row.fleet}/{row.vehicle_id}" if several_fleets else str(row.vehicle_id)
    what = f"SILENT for {_seconds(row.age_s)}" if row.silent else "; ".join(row.flags) or row.last_event
    texts = (
        name,
        row.phase,
        row.mode_name,
        "armed" if row.armed else "-",
        f"{row.altitude_m:.2f} m",
        str(row.prc),
        "-" if row.error_to_slot_m is None else f"{row.error_to_slot_m:.2f} m",
        f"{row.hover_thrust_norm:.2f}, {hypot(*row.disturbance_enu_m_s2):.1f} m/s2",
        _seconds(row.data_age_s),
        str(row.rejected),
        row.formation,
        row.reference,
        row.holder or "nobody",
        what,
    )
    # Events quote the autopilot's own words: nothing of them may steer the terminal.
    return tuple("".join(c if c.isprintable() else "?" for c in text) for text in texts)


def _seconds(age_s: float) -> str:
    if not isfinite(age_s) or age_s >= 1e5:
        return "never"
    return f"{age_s * 1000:.0f} ms" if age_s < 1.0 else f"{age_s:.1f} s"


def _several_fleets(table: list[VehicleRow]) -> bool:
    return len({row.fleet for row in table}) > 1


def _plain_table(table: list[VehicleRow], out: TextIO) -> None:
    lines = [COLUMNS] + [cells(row, _several_fleets(table)) for row in table]
    for line in lines:
        padded = (text.ljust(width) for text, width in zip(line, _WIDTHS, strict=True))
        print(" ".join(padded).rstrip(), file=out)


def _json(table: list[VehicleRow], out: TextIO) -> None:
    print(msgspec.json.encode(table).decode(), file=out)


def _rich_live() -> Callable[[FleetSession, Sequence[str]], None]:
    """The live table. Raises MonitorError where its package is missing."""
    try:
        from rich.live import Live
        from rich.table import Table
        from rich.text import Text
    except ImportError as error:
        raise MonitorError(
            f"the live table needs the package rich: {GROUND_INSTALL}, or use --once, --json or a pipe"
        ) from error

    def table_of(table: list[VehicleRow], endpoints: Sequence[str]) -> Any:
        if not table:
            return f"nobody heard yet at {', '.join(endpoints)}"
        shown = Table(*COLUMNS)
        for row in table:
            texts = (Text(text) for text in cells(row, _several_fleets(table)))  # Text: brackets are no markup
            shown.add_row(*texts, style="bold red" if row.silent else None)
        return shown

    def live(session: FleetSession, endpoints: Sequence[str]) -> None:
        state = FleetState()
        with Live(table_of([], endpoints), auto_refresh=False) as screen:
            while True:
                state = _heard(session, state)
                screen.update(table_of(rows(state, time.monotonic()), endpoints), refresh=True)
                time.sleep(LIVE_PERIOD_S)

    return live
