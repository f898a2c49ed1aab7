"""MAVLink over a byte stream: a TCP connection or a serial line, opened again after it is lost."""

from __future__ import annotations

import asyncio
import contextlib
import errno
import fcntl
import logging
import os
import socket
import struct
import termios
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

from companion.link.endpoint import AllRead, LinkError, Received, encoded_host, explain

READ_BYTES = 4096  # at once, some 100 messages; the rest wakes the loop again, after a tick that may be due
RECONNECT_FIRST_S, RECONNECT_MAX_S = 0.2, 2.0
BACKLOG_BYTES = 1024  # most unsent bytes in the kernel before data is dropped: a third of a second of setpoints
# The link counts as free up to this number of unsent bytes.
SERIAL_IDLE_BYTES = 64
TCP_IDLE_BYTES = 512  # sent but not acknowledged
SILENT_PEER_MS = 5000  # a TCP connection without acknowledgements for this time is lost

_log = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True)
class Stream:
    """An open, non-blocking file descriptor and the function that closes it."""

    fd: int
    close: Callable[[], None]
    idle_bytes: int  # it counts as free up to this number of unsent bytes


class Line(Protocol):
    """Opens a stream. `name` is for messages."""

    name: str

    async def open(self) -> Stream:
        """An open stream. Raises OSError."""


class StreamLink:
    """One byte stream to the autopilot, opened again until it succeeds."""

    def __init__(self, line: Line, received: Received, all_read: AllRead) -> None:
        self._line = line
        self._received, self._all_read = received, all_read
        self._stream: Stream | None = None
        self._rest = b""  # unsent part of a message
        self._lost: asyncio.Future[str] | None = None
        self._problem = ""

    def send(self, data: bytes) -> None:
        if not self._stream or self._rest:
            return
        try:
            if _waiting_bytes(self._stream.fd) <= BACKLOG_BYTES:
                self._write(data)
        except OSError as error:
            self._lose(error.strerror or str(error))

    def offer(self, data: bytes) -> bool:
        if not self._stream or self._rest:
            return False
        try:
            if _waiting_bytes(self._stream.fd) > self._stream.idle_bytes:
                return False
            self._write(data)
        except OSError as error:
            self._lose(error.strerror or str(error))
            return False
        return True

    async def run(self) -> None:
        delay_s = RECONNECT_FIRST_S
        try:
            while True:
                try:
                    self._stream = await self._line.open()
                except OSError as error:
                    self._problem = explain(error, self._line.name)
                    await asyncio.sleep(delay_s)
                    delay_s = min(2 * delay_s, RECONNECT_MAX_S)
                    continue
                self._problem = await self._receive(self._stream)
                _log.info("%s: %s, connecting again", self._line.name, self._problem)
                delay_s = RECONNECT_FIRST_S
                await asyncio.sleep(delay_s)
        finally:
            self.close()

    def problem(self) -> str:
        return (
            self._problem or f"{self._line.name} is open, but no packet of this autopilot arrived; check the other end"
        )

    def close(self) -> None:
        if self._stream:
            self._stream.close()
            self._stream = None

    async def _receive(self, stream: Stream) -> str:
        """Receive until the stream is lost; returns the reason."""
        _log.info("%s is open", self._line.name)
        self._problem, self._rest = "", b""
        loop = asyncio.get_running_loop()
        self._lost = loop.create_future()
        loop.add_reader(stream.fd, self._readable, stream.fd)
        try:
            return await self._lost
        finally:
            loop.remove_reader(stream.fd)
            loop.remove_writer(stream.fd)
            self.close()

    def _readable(self, fd: int) -> None:
        try:
            data = os.read(fd, READ_BYTES)
        except BlockingIOError:
            return
        except OSError as error:
            self._lose(error.strerror or str(error))
            return
        if not data:
            self._lose("closed by the other end")
            return
        self._received(data, time.monotonic())
        self._all_read()

    def _write(self, data: bytes) -> None:
        """Write as much as the kernel takes. The rest of the message follows when possible, to keep the stream intact."""
        assert self._stream is not None
        fd = self._stream.fd
        with contextlib.suppress(BlockingIOError):
            data = data[os.write(fd, data) :]
            if data:
                self._rest = data
                asyncio.get_running_loop().add_writer(fd, self._writable, fd)

    def _writable(self, fd: int) -> None:
        try:
            self._rest = self._rest[os.write(fd, self._rest) :]
        except BlockingIOError:
            return
        except OSError as error:
            self._lose(error.strerror or str(error))
        if not self._rest:
            asyncio.get_running_loop().remove_writer(fd)

    def _lose(self, why: str) -> None:
        if self._lost and not self._lost.done():
            self._lost.set_result(why)


def _waiting_bytes(fd: int) -> int:
    """Unsent bytes in the kernel (TIOCOUTQ), of a serial line or a TCP socket."""
    buffer = fcntl.ioctl(fd, termios.TIOCOUTQ, b"\0" * 4)
    return int(struct.unpack("@i", buffer)[0])


# ---------------------------------------------------------------- TCP and serial


class TcpConnection:
    """TCP connection to a listening autopilot, such as ArduPilot's simulation."""

    def __init__(self, host: str, port: int) -> None:
        """Raises LinkError."""
        self.name = f"tcp:{host}:{port}"
        self._host, self._port = encoded_host(host), port

    async def open(self) -> Stream:
        loop = asyncio.get_running_loop()
        found = await loop.getaddrinfo(self._host, self._port, type=socket.SOCK_STREAM)
        family, kind, protocol, _, address = found[0]
        connection = socket.socket(family, kind, protocol)
        try:
            connection.setblocking(False)
            connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            if hasattr(socket, "TCP_USER_TIMEOUT"):
                connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_USER_TIMEOUT, SILENT_PEER_MS)
            await loop.sock_connect(connection, address)
        except BaseException:
            connection.close()
            raise
        return Stream(connection.fileno(), connection.close, TCP_IDLE_BYTES)


class SerialLine:
    """A serial device. The constructor opens it, so that a wrong name is found at the start. Raises LinkError."""

    def __init__(self, device: str, baud: int) -> None:
        self.name = f"serial device {device}"
        self._device, self._baud = device, baud
        try:
            self._first: Stream | None = self._open()
        except OSError as error:
            raise LinkError(explain(error, self.name)) from error

    async def open(self) -> Stream:
        stream, self._first = self._first or self._open(), None
        return stream

    def _open(self) -> Stream:
        import serial  # only an agent with a serial link loads it

        try:
            line = serial.Serial(self._device, self._baud, timeout=0, write_timeout=0, exclusive=True)
        except serial.SerialException as error:
            if error.errno is None:  # pyserial reports a refused terminal setting without its errno
                raise OSError(errno.ENOTTY, str(error)) from error
            raise
        except (ValueError, OverflowError) as error:
            raise OSError(errno.EINVAL, f"{self._baud} baud is refused") from error
        return Stream(line.fileno(), line.close, SERIAL_IDLE_BYTES)
