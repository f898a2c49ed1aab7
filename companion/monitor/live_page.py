"""`companion monitor` without --tui: from its options to the running server."""

from __future__ import annotations

import sys
from contextlib import ExitStack, closing
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from companion.config.fleet import FleetConfig
from companion.ground.session import FleetSession
from companion.link.byte_links import LinkError
from companion.monitor import MonitorError, check_fleet_name
from companion.monitor.commander import Commander
from companion.monitor.ground_logs import GroundLogs
from companion.monitor.server import Address, listen_address, serve
from companion.monitor.sources import LiveSource
from companion.monitor.station import Station
from companion.monitor.tiles import Tiles, open_tiles
from companion.security.names import ParticipantRole

if TYPE_CHECKING:
    from companion.monitor.qgroundcontrol import FleetFeed
    from companion.monitor.recordings import GroundRecording
    from companion.security.identity import Identity


@dataclass(frozen=True, slots=True)
class LivePage:
    """What to show and where. `fleet_name` is * for every fleet; `fleet` is None without its file.

    `mavlink` is the endpoint of QGroundControl, `record` the folder of a recording on the ground, `replay` that of a flight to
    show instead of live vehicles. None of them where it is None.
    """

    fleet_name: str
    fleet: FleetConfig | None
    fleet_file: Path | None
    endpoints: tuple[str, ...]
    endpoints_are_guessed: bool
    identity: Identity | None
    listen: str
    control: bool
    tiles: Path | None
    mavlink: str | None
    record: Path | None
    replay: Path | None


def run_live_page(options: LivePage) -> None:
    """Until Ctrl-C. Raises MonitorError and link.fleet.zenoh_session.EndpointError."""
    try:
        address = listen_address(options.listen)
    except ValueError as error:
        raise MonitorError(f"--listen {error}") from error
    tiles = open_tiles(options.tiles) if options.tiles else None
    if options.replay is None:
        _show_vehicles(options, address, tiles)
    else:
        _show_recording(options, options.replay, address, tiles)


def _show_vehicles(options: LivePage, address: Address, tiles: Tiles | None) -> None:
    fleet, name, commanded = options.fleet, _fleet_name(options), _commanded(options) if options.control else None
    with ExitStack() as stack:
        session = stack.enter_context(FleetSession(name, options.endpoints, identity=options.identity))
        station = Station(
            LiveSource(session, options.endpoints),
            {fleet.name: fleet} if fleet else {},
            session.operator,
            commands=commanded.name if commanded else "",
            endpoints_are_guessed=options.endpoints_are_guessed,
        )
        if options.mavlink is not None:
            station.views.append(stack.enter_context(_feed(options.mavlink, fleet)).forward)
        if options.record is not None:
            recording = stack.enter_context(closing(_recording(options.record, session, fleet, station)))
            station.listeners.append(recording.listen)
        commander = stack.enter_context(closing(Commander(session, commanded, station.log))) if commanded else None
        serve(station, commander, address, tiles, GroundLogs(options.record))


def _recording(folder: Path, session: FleetSession, fleet: FleetConfig | None, station: Station) -> GroundRecording:
    """Raises MonitorError."""
    from companion.monitor.recordings import GroundRecording

    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise MonitorError(f"--record {folder}: cannot be created: {error.strerror}") from error
    return GroundRecording(
        folder, session, fleet, lambda notice: station.log(session.fleet, None, "event", notice.code, notice.text)
    )


def _show_recording(options: LivePage, folder: Path, address: Address, tiles: Tiles | None) -> None:
    from companion.monitor.recordings import NoFlightError, read_flight
    from companion.recording.reader import RecordingError

    if options.control or options.record is not None:
        raise MonitorError("--replay shows a recorded flight: it goes with neither --control nor --record")
    try:
        flight = read_flight(folder, lambda line: print(line, file=sys.stderr))
    except (RecordingError, NoFlightError) as error:
        raise MonitorError(f"--replay: {error}") from error
    fleets = with_file(flight.fleets, options)
    with ExitStack() as stack:
        station = Station(flight.source, fleets, operator="")
        if options.mavlink is not None:
            shown = options.fleet or next(iter(fleets.values()), None)
            station.views.append(stack.enter_context(_feed(options.mavlink, shown)).forward)
        serve(station, None, address, tiles, GroundLogs(folder))


def with_file(recorded: dict[str, FleetConfig], options: LivePage) -> dict[str, FleetConfig]:
    """The fleet files of the recordings, and --fleet-file in the place of that of its fleet."""
    fleet = options.fleet
    if fleet is None:
        return recorded
    flown = recorded.get(fleet.name)
    if recorded and flown is None:
        print(
            f"companion monitor: {options.fleet_file} is of fleet {fleet.name}, this flight of {', '.join(sorted(recorded))}",
            file=sys.stderr,
        )
    if flown is not None and flown.formation_hash() != fleet.formation_hash():
        print(
            f"companion monitor: {options.fleet_file} is not the fleet file of this flight: slots, fence and the figures of"
            " the law are those of the file",
            file=sys.stderr,
        )
    return recorded | {fleet.name: fleet}


def _feed(endpoint: str, fleet: FleetConfig | None) -> FleetFeed:
    """The output for QGroundControl. Raises MonitorError."""
    from companion.monitor.qgroundcontrol import FleetFeed

    if fleet is None:
        raise MonitorError(
            "--mavlink needs the fleet file, for the origin of the positions: give --fleet-file, or save one:"
            " companion fleet use FILE"
        )
    try:
        return FleetFeed(endpoint, fleet)
    except LinkError as error:
        raise MonitorError(f'--mavlink "{endpoint}": {error}') from error


def _fleet_name(options: LivePage) -> str:
    """The fleet to receive from. Raises MonitorError."""
    name = options.fleet_name
    check_fleet_name(name)
    if not options.control or options.fleet is None:
        return name
    if name not in ("*", options.fleet.name):
        raise MonitorError(
            f"--fleet {name}: --control commands the fleet of {options.fleet_file}, {options.fleet.name}"
        )
    return options.fleet.name


def _commanded(options: LivePage) -> FleetConfig:
    """The fleet that --control commands. Raises MonitorError."""
    if options.fleet is None:
        raise MonitorError("--control needs the fleet file: give --fleet-file, or save one: companion fleet use FILE")
    identity = options.identity
    if identity is not None and identity.role is not ParticipantRole.GROUND:
        raise MonitorError(f"--control: {identity.common_name} may not command; expected the identity of a ground")
    if identity is not None and identity.fleet != options.fleet.name:
        raise MonitorError(f'--identity is of fleet "{identity.fleet}", the fleet file of "{options.fleet.name}"')
    return options.fleet
