"""An agent in virtual time that records, and a disk that fails when it is told to."""

from __future__ import annotations

import errno
import os
import threading
import time
from collections.abc import Callable
from pathlib import Path

import pytest
from msgspec.structs import replace

import companion.recording.files as files
from companion.config.fleet import EdgeNeighbours, FleetConfig, FormationMember
from companion.config.reference import PointReference
from companion.config.vehicle import AgentConfig, RecordingSettings, VehicleConfig
from companion.recording.recorder import Recorder, recorder_of
from companion.recording.writing import Writing
from companion.types.flight import Role

SESSION, BEGAN_UNIX_S, BEGAN_S = 7, 1_700_000_000.0, 100.0


def config(recording: RecordingSettings | None = None) -> AgentConfig:
    """That of vehicle 3, which leads alone."""
    member = FormationMember(id=3, role=Role.LEADER, slot_enu_m=(0.0, 0.0, 0.0))
    fleet = FleetConfig(name="one", origin="indoor", vehicles=(member,), neighbours=EdgeNeighbours(edges=()))
    vehicle = VehicleConfig(
        id=3,
        fleet="fleet.yaml",
        mavlink="udpin:127.0.0.1:14540",
        hover_thrust_norm=0.5,
        reference=PointReference(point_enu_m=(20.0, 0.0, 5.0)),
        recording=recording or RecordingSettings(),
    )
    return AgentConfig(vehicle, fleet, member)


def recorder(folder: Path, writing: Writing, **settings: object) -> Recorder:
    """A recorder of that agent; `settings` are of the section `recording`."""
    recording = replace(RecordingSettings(), **settings)
    return recorder_of(config(recording), SESSION, folder, BEGAN_UNIX_S, BEGAN_S, writing)


class Disk:
    """The system calls of recordings, with room for a number of bytes, that can hang."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.room = 1 << 40
        self.works = threading.Event()
        self.works.set()
        self.waiting = threading.Event()
        self._write = os.write
        monkeypatch.setattr(files.os, "write", self.write)
        monkeypatch.setattr(files.os, "fdatasync", self.sync)

    def write(self, descriptor: int, data: bytes) -> int:
        fits = min(self.room, len(data))
        if not fits:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        self.room -= fits
        return self._write(descriptor, data[:fits])

    def sync(self, _descriptor: int) -> None:
        if not self.works.is_set():
            self.waiting.set()
            self.works.wait(60.0)


def until(holds: Callable[[], bool], within_s: float = 60.0) -> None:
    """Wait for another thread."""
    give_up_s = time.monotonic() + within_s
    while not holds():
        assert time.monotonic() < give_up_s
        time.sleep(0.002)
