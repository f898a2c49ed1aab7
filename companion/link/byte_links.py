"""Byte links to the autopilot: UDP, TCP or serial. `companion.mavlink` encodes and decodes the bytes.

Nothing is queued: data that cannot be sent now is dropped, because a late setpoint is worse than none. A byte stream (TCP or
serial) is opened again after it is lost. What the other links of this computer need of sockets is here, too.
"""

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
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial
from typing import Any, TypeVar

from companion.types.errors import CompanionError

Received = Callable[[bytes, float], bool]  # (bytes, time of arrival) -> whether they are from the autopilot
ReceivedBeside = Callable[[bytes, float], bool]  # likewise from another address -> whether two autopilots send in turn
Datagram = TypeVar("Datagram")
AllRead = Callable[[], None]  # after `Received` was called for all that waited, up to a limit

LONGEST_NUMBER = 9  # digits; Python refuses to parse thousands of them
_log = logging.getLogger(__name__)

_IN_USE = "{what} is in use; stop the other program (an agent or ground station?) or choose another one"
_ADVICE = {
    errno.EADDRINUSE: _IN_USE,
    errno.EBUSY: _IN_USE,
    errno.EAGAIN: _IN_USE,  # the lock on a serial device
    errno.EADDRNOTAVAIL: "this machine has no such address; use one of its own, or 0.0.0.0 for all of them",
    errno.ENODEV: "this machine has no network interface with this address",
    errno.EACCES: "no permission for {what}; use a port above 1023, or join the device's group (usually dialout)",
    errno.EPERM: "no permission for {what}; join the device's group (usually dialout)",
    errno.ENOENT: "there is no {what}; is it plugged in? expected a device like /dev/ttyACM0, see /dev/serial/by-id",
    errno.ECONNREFUSED: "no program listens at {what}; is the autopilot running?",
    errno.ENOTTY: "{what} is not a serial device; expected one like /dev/ttyACM0, see /dev/serial/by-id",
}


class LinkError(CompanionError):
    """An endpoint that cannot be opened. `str()` is the reason and the remedy."""


def encoded_host(host: str) -> bytes:
    """The host as `socket` passes it to the operating system. Raises LinkError where no lookup takes it.

    Only a name that is not ASCII needs Python's codec for names, and `socket` itself would load it: half an MB of an agent.
    """
    if "\0" in host:
        raise LinkError("there is a zero byte in the host, expected one like 192.168.1.11")
    try:
        if host.isascii() and host and not all(0 < len(label) < 64 for label in host.removesuffix(".").split(".")):
            raise ValueError("label empty or too long")
        return host.encode() if host.isascii() else host.encode("idna")
    except ValueError as error:
        raise LinkError("the host is neither an address nor a name, expected one like 192.168.1.11") from error


def explain(error: OSError, what: str) -> str:
    """Message for an operating system's error about `what`, with the remedy."""
    advice = _ADVICE.get(error.errno or 0)
    return advice.format(what=what) if advice else f"{what} cannot be opened: {error.strerror or error}"


def check_port(port: int) -> None:
    """Raises LinkError."""
    if not 0 < port <= 65535:
        raise LinkError(f"port {port}, expected 1 to 65535")


def resolve(host: str, port: int, hint: str, family: int = 0) -> tuple[int, int, int, Any]:
    """Family, kind, protocol and address of a UDP socket. Raises LinkError, with the hint for a name without an address."""
    check_port(port)
    name = encoded_host(host)
    try:
        family, kind, protocol, _, address = socket.getaddrinfo(name, port, family, socket.SOCK_DGRAM)[0]
    except socket.gaierror as error:
        raise LinkError(hint) from error
    return family, kind, protocol, address


def read_waiting(receive: Callable[[], Datagram], most: int) -> Iterator[Datagram]:
    """What waits on a non-blocking UDP socket, at most so many datagrams."""
    for _ in range(most):
        try:
            yield receive()
        except BlockingIOError:
            return
        except OSError:
            continue  # ICMP error for a datagram sent earlier


def no_autopilot(_data: bytes, _received_s: float) -> bool:
    """What other addresses send is not looked at."""
    return False


def open_link(
    endpoint: str, received: Received, all_read: AllRead, beside: ReceivedBeside = no_autopilot
) -> UdpLink | StreamLink:
    """The link for "udpin:HOST:PORT", "tcp:HOST:PORT" or "serial:DEVICE:BAUD". Raises LinkError."""
    kind, _, rest = endpoint.partition(":")
    address, _, number = rest.rpartition(":")
    if len(number) > LONGEST_NUMBER:
        raise LinkError(f"the number at the end has {len(number)} digits, expected at most {LONGEST_NUMBER}")
    if kind == "serial":
        return StreamLink(SerialLine(address, int(number)), received, all_read)
    if kind == "tcp":
        return StreamLink(TcpConnection(address, int(number)), received, all_read)
    return UdpLink(address, int(number), received, all_read, beside)


DATAGRAM_BYTES = 4096  # autopilots send at most an Ethernet frame
DATAGRAMS_PER_WAKE_UP = 64  # the rest wakes the loop again, after a tick that may be due
BYTES_PER_WAKE_UP = 8192  # some 200 messages: 2 ms
RELOCK_AFTER_S = 5.0  # a restarted autopilot may send from another port
MOST_LOOKS = 64  # at datagrams of other addresses, in LOOKS_S: a flood of them costs no more
LOOKS_S = 1.0

_SO_TIMESTAMPNS = 35  # Linux; missing in the socket module
_TIMESPEC = struct.Struct("@ll")
_ANCILLARY_BYTES = socket.CMSG_SPACE(_TIMESPEC.size)


class UdpLink:
    """Listens and answers only the address that first sent packets of the autopilot.

    What other addresses send meanwhile goes to `beside` alone: another autopilot with the same id may be among them.

    Times of arrival are the kernel's: datagrams that waited during a pause of this process keep their true age.
    """

    def __init__(
        self, host: str, port: int, received: Received, all_read: AllRead, beside: ReceivedBeside = no_autopilot
    ) -> None:
        self._received, self._all_read, self._beside = received, all_read, beside
        self._looks, self._looks_since_s, self._has_warned = 0, float("-inf"), False
        self._socket = _bound_udp_socket(host, port)
        self._autopilot: tuple[str, int] | None = None
        self._heard_s = float("-inf")
        self._anything_arrived = False

    def send(self, data: bytes) -> None:
        """Hand one message to the operating system, or drop it. Never raises, never blocks."""
        if self._autopilot:
            # ConnectionRefused refers to an earlier datagram, BlockingIOError to a full buffer: both are lost packets.
            with contextlib.suppress(OSError):
                self._socket.sendto(data, self._autopilot)

    def offer(self, data: bytes) -> bool:
        """Like `send`, for data that may wait: only while the link is nearly free. Returns whether it was sent."""
        self.send(data)
        return self._autopilot is not None

    async def run(self) -> None:
        """Receive until cancelled."""
        loop = asyncio.get_running_loop()
        loop.add_reader(self._socket, self._readable)
        try:
            await loop.create_future()
        finally:
            loop.remove_reader(self._socket)

    def problem(self) -> str:
        """Why nothing is received, as far as this end knows."""
        if self._anything_arrived:
            return "packets arrived, none of them from this autopilot; check its id (MAV_SYS_ID)"
        return "nothing arrived; is the autopilot running, and does it send to this port?"

    def close(self) -> None:
        self._socket.close()

    def _readable(self) -> None:
        read_bytes = 0
        receive = partial(self._socket.recvmsg, DATAGRAM_BYTES, _ANCILLARY_BYTES)
        for data, ancillary, _, sender in read_waiting(receive, DATAGRAMS_PER_WAKE_UP):
            self._datagram(data, _arrival_s(ancillary), sender)
            read_bytes += len(data)
            if read_bytes > BYTES_PER_WAKE_UP:
                break
        self._all_read()

    def _datagram(self, data: bytes, received_s: float, sender: tuple[str, int]) -> None:
        self._anything_arrived = True
        is_locked = self._autopilot is not None and received_s - self._heard_s < RELOCK_AFTER_S
        if is_locked and sender != self._autopilot:
            self._look(data, received_s, sender)
            return
        if self._received(data, received_s):
            if sender != self._autopilot:
                self._autopilot, self._has_warned = sender, False
                _log.info("autopilot at %s:%d", *sender[:2])
            self._heard_s = received_s

    def _look(self, data: bytes, received_s: float, sender: tuple[str, int]) -> None:
        """At a datagram of another address than the autopilot's."""
        if not 0.0 <= received_s - self._looks_since_s < LOOKS_S:
            self._looks, self._looks_since_s = 0, received_s
        self._looks += 1
        if self._looks > MOST_LOOKS or not self._beside(data, received_s) or self._has_warned:
            return
        self._has_warned = True
        followed = self._autopilot or sender
        _log.warning(
            "an autopilot with the same id sends from %s:%d, too; %s:%d is followed", *sender[:2], *followed[:2]
        )


def _bound_udp_socket(host: str, port: int) -> socket.socket:
    hint = f'"{host}" is not an address of this machine; use 0.0.0.0 for all of them'
    family, kind, protocol, address = resolve(host, port, hint)
    udp = socket.socket(family, kind, protocol)
    try:
        udp.bind(address)
    except OSError as error:
        udp.close()
        raise LinkError(explain(error, f"UDP port {port}")) from error
    udp.setblocking(False)
    with contextlib.suppress(OSError):  # not Linux: the time of reading is used instead
        udp.setsockopt(socket.SOL_SOCKET, _SO_TIMESTAMPNS, 1)
    return udp


def _arrival_s(ancillary: list[tuple[int, int, bytes]]) -> float:
    """Time at which the kernel received the datagram, on the monotonic clock; never later than now."""
    now_s = time.monotonic()
    for level, kind, value in ancillary:
        if (level, kind) == (socket.SOL_SOCKET, _SO_TIMESTAMPNS) and len(value) == _TIMESPEC.size:
            seconds, nanoseconds = _TIMESPEC.unpack(value)
            waited_s = (time.time_ns() - int(seconds) * 1_000_000_000 - int(nanoseconds)) * 1e-9
            return now_s - max(0.0, waited_s)
    return now_s


READ_BYTES = 4096  # at once, some 100 messages; the rest wakes the loop again, after a tick that may be due
RECONNECT_FIRST_S, RECONNECT_MAX_S = 0.2, 2.0
BACKLOG_BYTES = 1024  # most unsent bytes in the kernel before data is dropped: a third of a second of setpoints
SERIAL_IDLE_BYTES, TCP_IDLE_BYTES = 64, 512  # unsent bytes with which a link counts as idle; TCP: unacknowledged ones
_INT = struct.Struct("@i")
SILENT_PEER_MS = 5000  # a TCP connection without acknowledgements for this time is lost


@dataclass(frozen=True, slots=True)
class ByteStream:
    """An open, non-blocking file descriptor and the function that closes it."""

    fd: int
    close: Callable[[], None]
    idle_bytes: int  # it counts as free up to this number of unsent bytes


class StreamLink:
    """One byte stream to the autopilot, opened again until it succeeds."""

    def __init__(self, line: TcpConnection | SerialLine, received: Received, all_read: AllRead) -> None:
        self._line = line
        self._received, self._all_read = received, all_read
        self._stream: ByteStream | None = None
        self._rest = b""  # unsent part of a message
        self._lost: asyncio.Future[str] | None = None
        self._problem = ""

    def send(self, data: bytes) -> None:
        """Hand one message to the operating system, or drop it. Never raises, never blocks."""
        self._write_behind(BACKLOG_BYTES, data)

    def offer(self, data: bytes) -> bool:
        """Like `send`, for data that may wait: only while the link is nearly free. Returns whether it was sent."""
        return self._stream is not None and self._write_behind(self._stream.idle_bytes, data)

    def _write_behind(self, most_bytes: int, data: bytes) -> bool:
        """Write where at most so many unsent bytes wait. Returns whether it was written."""
        if not self._stream or self._rest:
            return False
        try:
            (unsent_bytes,) = _INT.unpack(fcntl.ioctl(self._stream.fd, termios.TIOCOUTQ, bytes(_INT.size)))
            if unsent_bytes > most_bytes:
                return False
            self._write(data)
        except OSError as error:
            self._lose(error.strerror or str(error))
            return False
        return True

    async def run(self) -> None:
        """Receive until cancelled; a lost connection is opened again."""
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
        silent = "is open, but no packet of this autopilot arrived; check the other end"
        return self._problem or f"{self._line.name} {silent}"

    def close(self) -> None:
        if self._stream:
            self._stream.close()
            self._stream = None

    async def _receive(self, stream: ByteStream) -> str:
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


# ---------------------------------------------------------------- TCP and serial


class TcpConnection:
    """TCP connection to a listening autopilot, such as ArduPilot's simulation."""

    def __init__(self, host: str, port: int) -> None:
        """Raises LinkError."""
        check_port(port)
        self.name = f"tcp:{host}:{port}"
        self._host, self._port = encoded_host(host), port

    async def open(self) -> ByteStream:
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
        return ByteStream(connection.fileno(), connection.close, TCP_IDLE_BYTES)


class SerialLine:
    """A serial device. The constructor opens it, so that a wrong name is found at the start. Raises LinkError."""

    def __init__(self, device: str, baud: int) -> None:
        self.name = f"serial device {device}"
        self._device, self._baud = device, baud
        try:
            self._first: ByteStream | None = self._open()
        except OSError as error:
            raise LinkError(explain(error, self.name)) from error

    async def open(self) -> ByteStream:
        stream, self._first = self._first or self._open(), None
        return stream

    def _open(self) -> ByteStream:
        import serial  # only an agent with a serial link loads it

        try:
            line = serial.Serial(self._device, self._baud, timeout=0, write_timeout=0, exclusive=True)
        except serial.SerialException as error:
            if error.errno is None:  # pyserial reports a refused terminal setting without its errno
                raise OSError(errno.ENOTTY, str(error)) from error
            raise
        except (ValueError, OverflowError) as error:
            raise OSError(errno.EINVAL, f"{self._baud} baud is refused") from error
        return ByteStream(line.fileno(), line.close, SERIAL_IDLE_BYTES)
