"""A real agent process on a serial line and on TCP: the same flight as over UDP, with packets in pieces."""

from __future__ import annotations

import os
import select
import socket
import threading
import tty
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from common import until
from companion.ground.session import FleetSession
from companion.types.commands import CommandName
from companion.types.flight import FlightPhase
from processes import agent, agent_files, free_port
from wire_autopilots import LOITER, HoveringAutopilot

PIECE_BYTES = 7  # packets arrive in pieces, as on a slow line


@contextmanager
def bridge(udp_port: int, stream: Callable[[], int]) -> Iterator[None]:
    """Copies between the UDP port of the autopilot and a stream; `stream` returns its file descriptor."""
    ended = threading.Event()
    udp = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    udp.bind(("127.0.0.1", udp_port))

    def copy() -> None:
        fd, autopilot = stream(), None
        while not ended.is_set():
            readable, _, _ = select.select([udp, fd], [], [], 0.05)
            if udp in readable:
                data, autopilot = udp.recvfrom(4096)
                for at in range(0, len(data), PIECE_BYTES):
                    os.write(fd, data[at : at + PIECE_BYTES])
            if fd in readable:
                try:
                    data = os.read(fd, 4096)
                except OSError:
                    return  # the agent has ended
                if not data:
                    return
                if autopilot:
                    udp.sendto(data, autopilot)

    thread = threading.Thread(target=copy)
    thread.start()
    try:
        yield
    finally:
        ended.set()
        thread.join()
        udp.close()


def fly(folder: Path, mavlink: str, stream: Callable[[], int]) -> None:
    files = agent_files(folder, mavlink=mavlink)
    with (
        HoveringAutopilot(1, files.udp_port) as autopilot,
        bridge(files.udp_port, stream),
        agent(files) as process,
        FleetSession("processtest", (files.zenoh,)) as session,
    ):
        process.wait_for_log("heartbeat of autopilot 1")
        phases: list[FlightPhase] = []

        def phase_is(phase: FlightPhase) -> bool:
            phases.extend(report.status.phase for report in session.drain())
            return bool(phases) and phases[-1] is phase

        for name, phase in ((CommandName.HOLD, FlightPhase.HOLD), (CommandName.FORM, FlightPhase.FORMATION)):
            until(lambda wanted=name: getattr(session.command([1], wanted, 5.0)[1], "accepted", False))
            until(lambda wanted=phase: phase_is(wanted))
        sent = len(autopilot.target_times_s)
        until(lambda: len(autopilot.target_times_s) > sent + 50)
        assert process.stop() == 0
        assert autopilot.mode == LOITER
        assert "Traceback" not in process.log


def test_on_a_serial_line(tmp_path: Path) -> None:
    master, slave = os.openpty()
    tty.setraw(slave)
    try:
        fly(tmp_path, f"serial:{os.ttyname(slave)}:57600", lambda: master)
    finally:
        os.close(master)
        os.close(slave)


def test_over_tcp(tmp_path: Path) -> None:
    port = free_port(socket.SOCK_STREAM)
    with socket.create_server(("127.0.0.1", port)) as server:
        server.settimeout(20.0)
        connections: list[socket.socket] = []

        def accept() -> int:
            connection, _ = server.accept()
            connections.append(connection)
            return connection.fileno()

        try:
            fly(tmp_path, f"tcp:127.0.0.1:{port}", accept)
        finally:
            for connection in connections:
                connection.close()


@pytest.mark.parametrize("baud", [0, 1, 10**9, 10**12])
def test_an_unusual_baud_rate_is_accepted_or_refused_in_one_line(baud: int) -> None:
    """Devices accept different rates; none may cause a traceback."""
    from companion.link.byte_links import LinkError, SerialLine

    master, slave = os.openpty()
    try:
        SerialLine(os.ttyname(slave), baud)
    except LinkError as error:
        assert "\n" not in str(error)
    finally:
        os.close(master)
        os.close(slave)
