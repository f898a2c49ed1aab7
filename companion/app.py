"""The agent process: MAVLink and Zenoh links, connected to the control loop."""

from __future__ import annotations

import asyncio
import logging
import os
import selectors
import time
from contextlib import ExitStack, closing
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from companion.assembly import build_agent, check_agent
from companion.config.degrees import degree_notices
from companion.config.file import ConfigError
from companion.config.law import is_built_in, law_of
from companion.config.vehicle import AgentConfig, load_agent
from companion.core.agent import Agent
from companion.link.autopilot_link import AutopilotLink, AutopilotSilentError, open_autopilot_link, read_signing_key
from companion.link.byte_links import LinkError
from companion.link.control_loop import ControlLoop, Job
from companion.link.fleet.zenoh_link import ZenohLink
from companion.link.fleet.zenoh_session import EndpointError
from companion.link.ground_link import GroundStationLink
from companion.link.law_timer import LawTimer
from companion.link.log import flush_log
from companion.link.pose_relay import PoseRelay
from companion.link.systemd import Notifier, log_as_service
from companion.link.takeoff_file import TakeoffFile, takeoff_path
from companion.link.tick import TickTrigger, monotonic_s
from companion.mavlink.autopilot_types import AGENT_STREAMS
from companion.mavlink.ground_station import GroundStationFilter
from companion.recording.files import recordings_folder

if TYPE_CHECKING:
    from companion.link.fleet.identity import Admissions
    from companion.link.fleet.peer_datagrams import PeerDatagrams
    from companion.recording.recorder import Recorder
    from companion.security.identity import Identity

WAIT_FOR_AUTOPILOT_S = 15.0

_log = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True)
class Settings:
    """Command-line options of one run."""

    file: Path
    wait_s: float = WAIT_FOR_AUTOPILOT_S


def run_agent(settings: Settings) -> None:
    """Run the agent until SIGTERM or SIGINT. Raises ConfigError, AutopilotSilentError and AgentFailedError."""
    config = load_agent(settings.file)
    check_agent(settings.file, config)
    try:
        with asyncio.Runner(loop_factory=_loop) as runner:
            runner.run(_run(settings, config))
    finally:
        flush_log()


def _loop() -> asyncio.AbstractEventLoop:
    """Event loop with select: it wakes 0.2 ms late.

    epoll rounds timers up to whole milliseconds and wakes 0.6 to 1.1 ms late.
    """
    return asyncio.SelectorEventLoop(selectors.SelectSelector())


async def _run(settings: Settings, config: AgentConfig) -> None:
    session = int.from_bytes(os.urandom(4))
    vehicle, trigger, law = config.vehicle, TickTrigger(), law_of(config.fleet.law)
    timer = None if is_built_in(config.fleet.law) else LawTimer(law, [])
    agent = build_agent(config, session, law=timer or law)
    log_as_service(vehicle.id, lambda: agent.phase)
    key = read_signing_key(settings.file, vehicle.signing)
    identity = _identity(settings, config)
    with ExitStack() as stack:
        if recorder := _recorder(settings, config, session):
            stack.enter_context(closing(recorder))
        try:
            record = recorder.mavlink if recorder and recorder.records_mavlink else None
            autopilot = open_autopilot_link(settings.file, vehicle, key, trigger.position_arrived, agent.reject, record)
            stack.enter_context(closing(autopilot))
            datagrams = (
                stack.enter_context(closing(_datagrams(settings, config, agent, identity is not None)))
                if config.datagrams
                else None
            )
            peers = ZenohLink(vehicle.id, config.fleet, config.zenoh, agent.reject, datagrams, identity)
            stack.enter_context(closing(peers))
        except EndpointError as error:
            field = f"zenoh.{error.kind}" if vehicle.zenoh else "fleet"
            raise ConfigError(settings.file, field, f'"{error.endpoint}": {error}') from error
        if vision := config.fleet.external_vision:
            peers.hear_poses(PoseRelay(vision, agent, autopilot).receive)
        notifier = stack.enter_context(closing(Notifier()))
        signed = ", signed" if key else ""
        _log.info("%s of fleet %s, %s%s", config.member.role, config.fleet.name, vehicle.mavlink, signed)
        for notice in degree_notices(config.fleet.origin, {"fleet": config.fleet, "vehicle": vehicle}):
            _log.warning("%s", notice)
        if identity is None and config.fleet.security == "none":
            _log.warning("UNSECURED: strangers in the network of the fleet can command this vehicle (security: none)")
        beside: list[Job] = []
        if identity:
            beside.append(_admissions(identity, peers).run)
        if takeoff := _takeoff_file(config, agent):
            if kept := takeoff.read(monotonic_s()):
                autopilot.keep(kept)
            beside.append(takeoff.run)
        if vehicle.ground_station:
            ground = stack.enter_context(closing(_ground_station(settings, config, autopilot, agent)))
            beside.append(ground.run)
        jobs = [autopilot.receive, autopilot.keep_in_touch, autopilot.keep_streams, autopilot.keep_time, *beside]
        loop = ControlLoop(agent, autopilot, peers, trigger, notifier, recorder, timer)
        if not await loop.run(settings.wait_s, jobs):
            raise AutopilotSilentError(settings.file, vehicle, settings.wait_s, autopilot.why_silent())


def _recorder(settings: Settings, config: AgentConfig, session: int) -> Recorder | None:
    """Only an agent that records loads the library for it."""
    if (folder := recordings_folder(settings.file, config.vehicle.recording, os.environ)) is None:
        return None
    from companion.recording.recorder import recorder_of
    from companion.recording.writing import WritingThread

    _log.info("records into %s", folder)
    return recorder_of(config, session, folder, time.time(), monotonic_s(), WritingThread())


def _takeoff_file(config: AgentConfig, agent: Agent) -> TakeoffFile | None:
    """Only where heights count from the take-off, and where the agent has a folder for its state."""
    path = takeoff_path(config.vehicle.id, os.environ)
    if path is None or config.fleet.altitude_source != "takeoff":
        return None
    return TakeoffFile(path, config, agent.perception)


def _identity(settings: Settings, config: AgentConfig) -> Identity | None:
    """Of the vehicle file. Only an agent with an identity loads the library for it. Raises ConfigError."""
    if config.vehicle.identity is None:
        return None
    from companion.link.fleet.identity import vehicle_identity

    return vehicle_identity(settings.file, config)


def _admissions(identity: Identity, link: ZenohLink) -> Admissions:
    from companion.link.fleet.identity import Admissions, list_file

    return Admissions(identity, list_file(identity.authority_file.parent, os.environ), link)


def _ground_station(
    settings: Settings, config: AgentConfig, autopilot: AutopilotLink, agent: Agent
) -> GroundStationLink:
    """Link of the ground station, connected to the autopilot link. Raises ConfigError."""
    vehicle = config.vehicle
    try:
        admission = GroundStationFilter(vehicle.id, AGENT_STREAMS)
        ground = GroundStationLink(
            vehicle.ground_station, admission, lambda: agent.phase, autopilot.offer, agent.reject
        )
    except LinkError as error:
        raise ConfigError(settings.file, "ground_station", f'"{vehicle.ground_station}": {error}') from error
    autopilot.pass_on_to(ground.pass_on)
    return ground


def _datagrams(settings: Settings, config: AgentConfig, agent: Agent, secured: bool) -> PeerDatagrams:
    """Link of the peer states where it is not Zenoh. Only an agent with one loads it. Raises ConfigError."""
    from companion.link.fleet.peer_datagrams import DatagramSeal, PeerDatagrams

    endpoints = config.datagrams
    assert endpoints is not None
    try:
        ids = [member.id for member in config.fleet.vehicles]
        seal = DatagramSeal(config.vehicle.id, ids) if secured else None
        return PeerDatagrams(endpoints, config.fleet, agent.reject, seal)
    except LinkError as error:
        raise ConfigError(settings.file, "datagrams", str(error)) from error
