"""A serial line is unplugged in flight and plugged in again: a real agent process on a pseudo-terminal."""

from __future__ import annotations

import os
import select
import socket
import threading
import time
import tty
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from common import until
from companion.ground.session import FleetSession
from companion.mavlink.codec import mavlink
from companion.types.commands import CommandName
from processes import agent, agent_files
from wire_autopilots import LOITER, OFFBOARD, HoveringAutopilot


class Cable:
    """Copies between the UDP port of the autopilot and a pseudo-terminal, which can be removed and restored."""

    def __init__(self, device: Path, udp: socket.socket) -> None:
        self._device = device
        self._udp = udp
        self._lock = threading.Lock()
        self._end: int | None = None
        self._ended = threading.Event()

    def plug(self) -> None:
        end, slave = os.openpty()
        tty.setraw(slave)
        self._device.symlink_to(os.ttyname(slave))
        os.close(slave)
        os.set_blocking(end, False)
        with self._lock:
            self._end = end

    def unplug(self) -> None:
        """Remove the device with its name, as udev does."""
        with self._lock:
            end, self._end = self._end, None
        if end is not None:
            self._device.unlink()
            os.close(end)

    def copy(self) -> None:
        """Until `end`."""
        autopilot = None
        while not self._ended.is_set():
            if select.select([self._udp], [], [], 0.005)[0]:
                data, autopilot = self._udp.recvfrom(4096)
                self._write(data)
            data = self._read()
            if data and autopilot:
                self._udp.sendto(data, autopilot)

    def end(self) -> None:
        self._ended.set()

    def _write(self, data: bytes) -> None:
        with self._lock:
            if self._end is not None:
                try:
                    os.write(self._end, data)
                except BlockingIOError:
                    return  # no process reads it yet

    def _read(self) -> bytes:
        with self._lock:
            try:
                return os.read(self._end, 4096) if self._end is not None else b""
            except OSError:
                return b""  # no device, or no process has it open


@contextmanager
def cable(device: Path, udp_port: int) -> Iterator[Cable]:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as udp:
        udp.bind(("127.0.0.1", udp_port))
        plugged = Cable(device, udp)
        plugged.plug()
        thread = threading.Thread(target=plugged.copy)
        thread.start()
        try:
            yield plugged
        finally:
            plugged.end()
            thread.join()
            plugged.unplug()


def test_a_line_unplugged_in_formation_is_opened_again_and_the_agent_observes(tmp_path: Path) -> None:
    device = tmp_path / "ttyAutopilot"
    files = agent_files(tmp_path, mavlink=f"serial:{device}:921600")
    with (
        HoveringAutopilot(1, files.udp_port) as autopilot,
        cable(device, files.udp_port) as line,
        agent(files) as process,
        FleetSession("processtest", (files.zenoh,)) as session,
    ):

        def command(name: CommandName) -> None:
            until(lambda: getattr(session.command([1], name, 5.0)[1], "accepted", False))

        process.wait_for_log("heartbeat of autopilot 1")
        command(CommandName.HOLD)
        process.wait_for_log("-> hold")
        command(CommandName.FORM)
        process.wait_for_log("engage -> formation")
        until(lambda: len(autopilot.target_times_s) > 50)

        line.unplug()
        process.wait_for_log("formation -> observe (no setpoint for 0.5 s")
        process.wait_for_log("connecting again")
        autopilot.received.clear()
        sent = len(autopilot.target_times_s)
        time.sleep(2.0)  # longer than one check of the telemetry
        line.plug()

        asked = mavlink.MAVLINK_MSG_ID_LOCAL_POSITION_NED
        requests = mavlink.MAV_CMD_SET_MESSAGE_INTERVAL
        until(lambda: asked in [m.param1 for m in autopilot.commands(requests)])
        until(lambda: process.log.rfind("all telemetry arrives") > process.log.rfind("is open"))
        assert autopilot.mode == OFFBOARD  # it would follow a stream at once
        assert len(autopilot.target_times_s) == sent
        assert autopilot.commands(mavlink.MAV_CMD_DO_SET_MODE) == []

        command(CommandName.HOLD)
        until(lambda: autopilot.mode == LOITER)
        until(lambda: process.log.count("-> hold") == 2)
        command(CommandName.FORM)
        until(lambda: len(autopilot.target_times_s) > sent + 50)
        assert process.stop() == 0
        assert "Traceback" not in process.log
