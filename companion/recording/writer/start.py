"""Configuration -> recorder of one start of an agent."""

from __future__ import annotations

from pathlib import Path

from msgspec.structs import replace

from companion.assembly import law_of
from companion.config.vehicle import AgentConfig
from companion.recording.configuration import as_json
from companion.recording.records import SOFTWARE, Header
from companion.recording.writer.chunk import MessageChunk
from companion.recording.writer.files import PartFiles
from companion.recording.writer.folder import MB, MCAP, TLOG, FlightFiles
from companion.recording.writer.mcap_part import McapPart
from companion.recording.writer.recorder import TOPICS, Recorder
from companion.recording.writer.tlog import TlogPart
from companion.recording.writer.writing import Writing


def recorder_of(
    config: AgentConfig, session: int, folder: Path, unix_s: float, monotonic_s: float, writing: Writing
) -> Recorder:
    """The recorder of an agent. `unix_s` and `monotonic_s` are the same moment. No file is made before the first record."""
    vehicle, settings = config.vehicle, config.vehicle.recording
    header = Header(
        software=SOFTWARE,
        fleet=config.fleet.name,
        vehicle_id=vehicle.id,
        session=session,
        part=1,
        unix_s=unix_s,
        monotonic_s=monotonic_s,
        fleet_file=as_json(config.fleet),
        vehicle_file=as_json(vehicle),
    )
    flight, part_bytes = FlightFiles(folder, f"vehicle_{vehicle.id}", settings.keep_mb * MB), settings.part_mb * MB
    mcap: PartFiles[MessageChunk] = PartFiles(
        flight, MCAP, part_bytes, lambda part: McapPart(replace(header, part=part), TOPICS)
    )
    tlog = PartFiles(flight, TLOG, part_bytes, lambda _part: TlogPart()) if settings.tlog else None
    return Recorder(header, law_of(config.fleet.law), writing, mcap, tlog)
