"""Link to the autopilot: telemetry in, setpoints and requests out, heartbeat and message rates kept up.

The key of a signed link comes from a file or a systemd credential, and never appears in a message.
"""

from __future__ import annotations

import asyncio
import logging
import os
import re
import stat
import time
from collections import Counter, deque
from collections.abc import Callable, Iterable, Mapping, Sequence
from math import floor
from pathlib import Path
from typing import NoReturn

from companion.config.file import ConfigError, read_regular
from companion.config.vehicle import Signing, VehicleConfig
from companion.link.byte_links import LinkError, open_link
from companion.link.tick import monotonic_s
from companion.mavlink.clock import REQUEST_PERIOD_S
from companion.mavlink.codec import KEY_BYTES, Packet, SigningKey
from companion.mavlink.translator import Translator
from companion.types.autopilot import (
    AttitudeTarget,
    AutopilotRequest,
    HeartbeatSample,
    ModeSample,
    PositionSample,
    Telemetry,
)
from companion.types.errors import EXIT_NO_AUTOPILOT, EndingError
from companion.types.notices import Code
from companion.types.peers import BodyPose

HEARTBEAT_PERIOD_S = 1.0
STREAM_CHECK_PERIOD_S = 2.0
SAMPLES_KEPT = 512  # for the next tick: a second of all telemetry at the requested rates

SIGNATURE_ADVICE = {
    Code.MAVLINK_UNSIGNED: "its packets are not signed; give it the key (in MAVProxy: signing setup), or remove signing from"
    " the vehicle file: PX4 1.16 cannot sign",
    Code.MAVLINK_WRONG_KEY: "its packets are signed with another key; give both the same key",
    Code.MAVLINK_OLD_SIGNATURE: "its signatures are older than this computer's clock; correct the clock, or wait for its GPS",
}

RecordPacket = Callable[[bytes, float], None]  # (packet, time on the monotonic clock)

_log = logging.getLogger(__name__)


class AutopilotSilentError(EndingError):
    """No answer of the autopilot. `str()` is one line: file, field, endpoint, what was expected, what to do."""

    exit_code = EXIT_NO_AUTOPILOT

    def __init__(self, file: Path, vehicle: VehicleConfig, waited_s: float, why: str) -> None:
        super().__init__(
            f'{file}: mavlink: "{vehicle.mavlink}": no HEARTBEAT of system {vehicle.id} in {waited_s:g} s; {why}'
        )


class AutopilotLink:
    """Decodes telemetry as it arrives and keeps it for the next tick.

    Calls `position_arrived` with its time when all that waited is read and a position was among it: what an autopilot sends
    together is decided on together. Packets are recorded and passed on after that, when the setpoint has left. Calls `reject`
    with the code of every damaged or implausible packet.
    """

    def __init__(
        self,
        vehicle_id: int,
        endpoint: str,
        translator: Translator,
        position_arrived: Callable[[float], None],
        reject: Callable[[str], None],
        record: RecordPacket | None = None,
    ) -> None:
        """Opens the endpoint. `record` gets every packet of either direction. Raises LinkError."""
        self._vehicle_id = vehicle_id
        self._translator = translator
        self._position_arrived = position_arrived
        self._reject = reject
        self._telemetry: deque[Telemetry] = deque(maxlen=SAMPLES_KEPT)  # in a flood only the newest remain
        self._received: Counter[type[Telemetry]] = Counter()  # samples since the last check of the streams
        # Neither counted, recorded nor passed on yet
        self._arrived: list[tuple[float, Sequence[Packet], list[Telemetry]]] = []
        self._position_s: float | None = None  # when the newest position arrived among what was read just now
        self._heartbeat_received = asyncio.Event()
        # Any valid packet, or one signed with an old timestamp: that autopilot first needs the time of this computer.
        self._present = asyncio.Event()
        self._pass_on: Callable[[Sequence[bytes]], None] | None = None
        self._record = record
        self._link = open_link(endpoint, self._bytes_arrived, self._all_read, translator.receive_beside)

    @property
    def is_connected(self) -> bool:
        """Whether a HEARTBEAT of the autopilot was ever received."""
        return self._heartbeat_received.is_set()

    def keep(self, sample: Telemetry) -> None:
        """A sample for the next tick that does not come from the autopilot."""
        self._telemetry.append(sample)

    def pose(self, pose: BodyPose, measured_s: float, covariance: Sequence[float], resets: int) -> None:
        """Send a motion-capture pose, once the autopilot was heard."""
        if self.is_connected:
            self._send(self._translator.pose(pose, measured_s, covariance, resets))

    def drain(self) -> tuple[Telemetry, ...]:
        """All telemetry since the last call."""
        telemetry = tuple(self._telemetry)
        self._telemetry.clear()
        return telemetry

    def command(self, target: AttitudeTarget, now_s: float) -> None:
        """Send one setpoint."""
        self._send(self._translator.attitude_target(target, now_s))

    def request(self, requests: Iterable[AutopilotRequest]) -> None:
        """Send requests."""
        for request in requests:
            self._send(self._translator.request(request))

    def pass_on_to(self, listener: Callable[[Sequence[bytes]], None]) -> None:
        """Pass received packets, unchanged, to one more listener."""
        self._pass_on = listener

    def offer(self, packet: bytes) -> bool:
        """Send another program's packet if the link is free. Returns whether it was sent."""
        sent = self._link.offer(packet)
        if sent and self._record:
            self._record(packet, monotonic_s())
        return sent

    def relay(self, data: bytes) -> None:
        """Send the messages of another program on this computer as packets of this agent."""
        for packet in self._translator.relay(data):
            self._send(packet)

    async def receive(self) -> None:
        """Receive until cancelled."""
        await self._link.run()

    async def keep_in_touch(self) -> NoReturn:
        """Send the companion's heartbeat, from the autopilot's first packet until cancelled."""
        await self._present.wait()
        while True:
            self._send(self._translator.heartbeat())
            await asyncio.sleep(HEARTBEAT_PERIOD_S)

    async def keep_time(self) -> NoReturn:
        """Measure the way to the autopilot by TIMESYNC, from its first HEARTBEAT until cancelled."""
        await self._heartbeat_received.wait()
        while True:
            self._send(self._translator.time_request(monotonic_s()))
            await asyncio.sleep(REQUEST_PERIOD_S)

    @property
    def round_trip_s(self) -> float | None:
        """The shortest round trip of the last answers to TIMESYNC; None where none came."""
        return self._translator.clock.round_trip_s

    async def keep_streams(self) -> NoReturn:
        """Request the telemetry rates at the first HEARTBEAT, and again while one of them is too low.

        Each request is a packet of its own that may be lost, so every stream is checked.
        """
        await self._heartbeat_received.wait()
        _log.info("heartbeat of autopilot %d, %s", self._vehicle_id, self._translator.dialect.NAME)
        if self._translator.lacks_key:
            _log.warning(
                "the autopilot signs its packets and may ignore unsigned ones: set signing in the vehicle file"
            )
        slow_before: list[str] = []
        while True:
            for request in self._translator.stream_requests():
                self._send(request)
            while True:
                self._received.clear()
                await asyncio.sleep(STREAM_CHECK_PERIOD_S)
                slow = self._slow_streams()
                if slow != slow_before:
                    _log.info("%s", f"too few {', '.join(slow)}: requesting again" if slow else "all telemetry arrives")
                slow_before = slow
                if slow:
                    break

    def _slow_streams(self) -> list[str]:
        """Names of the telemetry whose rate was too low since the last check."""
        self._received[ModeSample] -= self._received[HeartbeatSample]  # every HEARTBEAT gives a mode sample too
        least_hz = self._translator.dialect.MIN_RATE_HZ
        return [name for kind, (name, rate) in least_hz.items() if self._received[kind] < rate * STREAM_CHECK_PERIOD_S]

    def why_silent(self) -> str:
        """Why no HEARTBEAT was received, and what to do."""
        if self._translator.refused_signature is not None:
            return SIGNATURE_ADVICE[self._translator.refused_signature]
        others = self._translator.others
        if self._translator.refused_heartbeat:
            return self._translator.refused_heartbeat
        if others.autopilots:
            received = ", ".join(str(system_id) for system_id in sorted(others.autopilots))
            return f"received system {received} instead; correct the id here or in the autopilot (MAV_SYS_ID)"
        if heard := str(others):
            return (
                f"received {heard}, and no autopilot; is it connected behind that, and does it send MAVLink to this port"
                " (MAV_x_CONFIG, SERIALx_PROTOCOL) at the line's rate?"
            )
        return self._link.problem()

    def close(self) -> None:
        """Close the link."""
        self._link.close()

    def _send(self, packet: bytes) -> None:
        self._link.send(packet)
        if self._record:
            self._record(packet, monotonic_s())

    def _bytes_arrived(self, data: bytes, received_s: float) -> bool:
        received_s = floor(received_s * 1e5) / 1e5  # more digits would be noise in a recording; never after the tick
        samples = self._translator.telemetry(data, received_s)
        for _ in range(len(self._telemetry) + len(samples) - SAMPLES_KEPT):
            self._reject(Code.TELEMETRY_OVERLOAD)
        self._telemetry.extend(samples)
        while self._translator.answers:
            self._send(self._translator.answers.popleft())
        rejected = self._translator.rejected
        from_autopilot = bool(samples) or Code.MAVLINK_OLD_SIGNATURE in rejected
        if from_autopilot:
            self._present.set()
        if rejected:
            for code in rejected.elements():
                self._reject(code)
            rejected.clear()
        for sample in samples:
            if isinstance(sample, PositionSample):
                self._position_s = received_s
            elif isinstance(sample, HeartbeatSample):
                self._heartbeat_received.set()
        self._arrived.append((received_s, self._translator.packets, samples))
        return from_autopilot

    def _all_read(self) -> None:
        if (arrived_s := self._position_s) is not None:
            self._position_s = None
            self._position_arrived(arrived_s)
        self._look_through()

    def _look_through(self) -> None:
        """Count, record and pass on what has arrived: a setpoint does not wait for that."""
        for received_s, packets, samples in self._arrived:
            self._received.update(map(type, samples))
            if self._record:
                for packet in packets:
                    self._record(packet.data, received_s)
            if self._pass_on and self.is_connected:
                self._pass_on([packet.data for packet in packets])
        self._arrived.clear()


# ---------------------------------------------------------------- what the vehicle file says of it


def open_autopilot_link(
    file: Path,
    vehicle: VehicleConfig,
    key: SigningKey | None,
    position_arrived: Callable[[float], None],
    reject: Callable[[str], None],
    record: RecordPacket | None = None,
) -> AutopilotLink:
    """The link that a vehicle file describes. Raises ConfigError."""
    translator = Translator(vehicle.id, vehicle.autopilot, key)
    try:
        return AutopilotLink(vehicle.id, vehicle.mavlink, translator, position_arrived, reject, record)
    except LinkError as error:
        raise ConfigError(file, "mavlink", f'"{vehicle.mavlink}": {error}') from error


EARLIEST_UNIX_S = 1_767_225_600  # 2026-01-01 UTC: before this program was written
WANTED = "expected 32 bytes or 64 hexadecimal digits (head -c 32 /dev/urandom > FILE makes a key)"


def read_signing_key(
    vehicle_file: Path, signing: Signing | None, environment: Mapping[str, str] = os.environ
) -> SigningKey | None:
    """The key that the vehicle file names; None for a link that is not signed.

    Raises ConfigError for an invalid key, a key file that all users may read, and a clock that was never set.
    """
    if signing is None:
        return None
    if signing.key_file is not None:
        field, path = "signing.key_file", vehicle_file.parent / signing.key_file
    else:
        field, name = "signing.credential", str(signing.credential)
        if not (folder := environment.get("CREDENTIALS_DIRECTORY")):
            advice = f"put LoadCredential={name}:FILE into the systemd unit, or use key_file"
            raise ConfigError(vehicle_file, field, f'"{name}": no credentials given; {advice}')
        path = Path(folder) / name
    secret = _secret(vehicle_file, f"{field}: {path}", path)
    if time.time() < EARLIEST_UNIX_S:
        raise ConfigError(
            vehicle_file,
            "signing",
            f"this computer's clock shows {time.strftime('%Y-%m-%d', time.gmtime())}; set it first (NTP, or a clock with a"
            " battery): signatures carry the time, so that old packets are not accepted as new",
        )
    return SigningKey(secret, signing.link_id, time.time)


def _secret(vehicle_file: Path, where: str, path: Path) -> bytes:
    try:
        content, state = read_regular(path)
    except OSError as error:
        raise ConfigError(vehicle_file, where, f"{error.strerror}; check the path and its permissions") from error
    if state.st_mode & stat.S_IRWXO:
        raise ConfigError(vehicle_file, where, f"every user of this computer has access to the key; chmod 600 {path}")
    secret = _decode_key(content)
    if secret is None:
        raise ConfigError(vehicle_file, where, f"{len(content)} bytes that are not a key; {WANTED}")
    if not any(secret):
        raise ConfigError(vehicle_file, where, f"a key of zeros means no signing; {WANTED}")
    return secret


def _decode_key(content: bytes) -> bytes | None:
    """The key in a file's content, or None. 32 hexadecimal digits are half a key, not 32 bytes."""
    if re.fullmatch(rb"\s*[0-9a-fA-F]{64}\s*", content):
        return bytes.fromhex(content.decode("ascii"))
    is_digits = re.fullmatch(rb"\s*[0-9a-fA-F]*\s*", content) is not None
    return content if len(content) == KEY_BYTES and not is_digits else None
