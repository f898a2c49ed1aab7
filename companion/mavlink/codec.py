"""MAVLink packets: bytes -> good packets -> messages, and messages -> bytes. No sockets, no files.

This room alone knows the form of a packet and what pymavlink does with it:

- `mavlink` is a dialect as pymavlink generates it, with few messages (`generate.py`). A message that is not among them has no
  fields here (`OtherMessage`), but its checksum and signature are verified, and its receiver is known.
- `read_packet` judges bytes, `PacketReader` finds packets among bytes, `SignedMavlink` judges signatures.
- `Packet` has the numbers of a message at once, and pymavlink's message when it is asked for.
- `MavlinkCodec` is one end of a link.
"""

from __future__ import annotations

import hashlib
import struct
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from types import SimpleNamespace
from typing import Any, ClassVar

from msgspec import Struct

from companion.mavlink.generated import in_use, mcrf4xx
from companion.mavlink.generated.others import OTHERS
from companion.types.notices import Code

mavlink = in_use
MavlinkMessage = Any  # pymavlink generates its classes without types


def named(prefix: str, *names: str) -> frozenset[int]:
    """The dialect's numbers of these names, which spaces separate, like "HEARTBEAT PING" of MAVLINK_MSG_ID."""
    return frozenset(getattr(mavlink, f"{prefix}_{name}") for line in names for name in line.split())


# ---------------------------------------------------------------- messages that nothing reads


class OtherMessage(mavlink.MAVLink_message):
    """A message whose fields nothing reads. `payload` is without the zeros at its end, which MAVLink 2 does not send."""

    def __init__(self, kind: _OtherKind, payload: bytes) -> None:
        super().__init__(kind.id, kind.msgname)
        self._kind = kind
        self._fieldnames = kind.fieldnames
        self.payload = payload
        if kind.target_at >= 0:
            self.target_system = payload[kind.target_at] if len(payload) > kind.target_at else 0

    def pack(self, mav: mavlink.MAVLink, force_mavlink1: bool = False) -> bytes:
        """The same payload in another packet."""
        whole = self._kind.unpacker.pack(self.payload)
        return self._pack(mav, self._kind.crc_extra, whole, force_mavlink1)


class _OtherKind:
    """Has in pymavlink's table of messages the place of a class: a message with one field, its payload."""

    __slots__ = ("crc_extra", "id", "msgname", "target_at", "unpacker")

    orders, lengths = (0,), (1,)
    fieldnames: ClassVar[list[str]] = ["payload"]
    ordered_fieldnames = fieldnames

    def __init__(self, id_: int, name: str, crc_extra: int, unpacker: struct.Struct, target_at: int) -> None:
        self.id, self.msgname, self.crc_extra = id_, name, crc_extra
        self.unpacker, self.target_at = unpacker, target_at

    def __call__(self, payload: bytes) -> OtherMessage:
        return OtherMessage(self, payload)


def _other_kinds() -> Iterator[tuple[int, Any]]:
    sizes = {size: struct.Struct(f"{size}s") for _, _, _, size, _ in OTHERS}
    for id_, name, crc_extra, size, target_at in OTHERS:
        yield id_, _OtherKind(id_, name, crc_extra, sizes[size], target_at)


mavlink.mavlink_map.update(_other_kinds())

# ---------------------------------------------------------------- one packet

MAVLINK_2, MAVLINK_1 = 0xFD, 0xFE  # first byte of a packet
SIGNED = 0x01  # the only incompat_flag that is defined
PAYLOAD_AT = {MAVLINK_2: 10, MAVLINK_1: 6}  # bytes of the header
CHECKSUM_BYTES, SIGNATURE_BYTES, HASH_BYTES = 2, 13, 6
OVERHEAD = {magic: size + CHECKSUM_BYTES for magic, size in PAYLOAD_AT.items()}
UNKNOWN: int = mavlink.MAVLINK_MSG_ID_UNKNOWN  # id of a message that no dialect knows
# After the magic: length, flags, system, component, and the id of 24 bits
_HEADER_2 = struct.Struct("<xBBxxBBHB")
_HEADER_1 = struct.Struct("<xBxBBB")
_SENT_HEADER = struct.Struct("<BBBBBBHB")  # length, flags of both kinds, sequence, system, component, and the id
_CHECKSUM_EXTRAS = {id_: bytes((kind.crc_extra,)) for id_, kind in mavlink.mavlink_map.items()}
_UNPACKERS: dict[int, struct.Struct] = {id_: kind.unpacker for id_, kind in mavlink.mavlink_map.items()}


class Packet(Struct, gc=False):
    """A packet with a good checksum; one whose message is UNKNOWN cannot be checked.

    `values` cost 3 us and pymavlink's message 15: at four packets a tick the difference is half the time of a decision
    (`tests/unit/mavlink/test_packets.py` holds it). So what comes often is read from its numbers.
    """

    data: bytes
    message_id: int
    system_id: int
    component_id: int
    is_signed: bool = False

    @property
    def values(self) -> tuple[Any, ...]:
        """Values of the fields in their order on the wire, those of an array one by one. A text is bytes."""
        data, unpacker = self.data, _UNPACKERS[self.message_id]
        start = PAYLOAD_AT[data[0]]
        if data[1] < unpacker.size:  # zeros at the end of a payload are not sent
            return unpacker.unpack(data[start : start + data[1]] + bytes(unpacker.size - data[1]))
        return unpacker.unpack_from(data, start)

    @property
    def sequence(self) -> int:
        """The sender counts its packets modulo 256."""
        return self.data[4 if self.data[0] == MAVLINK_2 else 2]

    @property
    def payload(self) -> bytes:
        """The bytes of the message, without the zeros at their end that are not sent."""
        start = PAYLOAD_AT[self.data[0]]
        return self.data[start : start + self.data[1]]

    @property
    def fields(self) -> Any:
        """Numbers by the names of the fields, as pymavlink's message has them; for a message without arrays and texts."""
        return SimpleNamespace(
            **dict(zip(mavlink.mavlink_map[self.message_id].ordered_fieldnames, self.values, strict=True))
        )

    @property
    def message(self) -> MavlinkMessage:
        """The message as pymavlink makes it."""
        return mavlink.MAVLink(None).decode(bytearray(self.data))


def read_packet(data: bytes) -> Packet | None:
    """The packet of these bytes where they are exactly one with a good checksum, as pymavlink judges it."""
    size = len(data)
    if size >= OVERHEAD[MAVLINK_2] and data[0] == MAVLINK_2:
        length, flags, system_id, component_id, id_low, id_high = _HEADER_2.unpack_from(data)
        message_id = id_low | id_high << 16
        end = PAYLOAD_AT[MAVLINK_2] + length
    elif size >= OVERHEAD[MAVLINK_1] and data[0] == MAVLINK_1:
        length, system_id, component_id, message_id = _HEADER_1.unpack_from(data)
        flags, end = 0, PAYLOAD_AT[MAVLINK_1] + length
    else:
        return None
    if flags & ~SIGNED or size != end + CHECKSUM_BYTES + (SIGNATURE_BYTES if flags else 0):
        return None
    extra = _CHECKSUM_EXTRAS.get(message_id)
    if extra is None:
        message_id = UNKNOWN
    elif mcrf4xx(data[1:end] + extra) != data[end] | data[end + 1] << 8:
        return None
    return Packet(data, message_id, system_id, component_id, bool(flags))


# ---------------------------------------------------------------- signatures

KEY_BYTES = 32
UNITS_PER_S = 100_000  # a stamp counts 10 us
EPOCH_UNIX_S = 1_420_070_400  # from 2015-01-01 UTC
SIGNATURE_CODES = (Code.MAVLINK_UNSIGNED, Code.MAVLINK_WRONG_KEY, Code.MAVLINK_OLD_SIGNATURE)


@dataclass(frozen=True, slots=True)
class SigningKey:
    """Secret, link id and clock of one end of a signed link."""

    secret: bytes = field(repr=False)
    link_id: int
    unix_time_s: Callable[[], float]


class SignedMavlink(mavlink.MAVLink):
    """A MAVLink end that signs all packets and judges signatures: a time stamp and 48 bits of SHA-256 over key and packet.

    See https://mavlink.io/en/guide/message_signing.html. pymavlink accepts a time stamp before it checks the signature, so one
    forged packet would make the genuine ones look old. Here the signature is checked first.

    A stamp never goes backwards, even if the clock does. A clock that is behind, as on a computer without a battery, is
    corrected by the stamps of the other end, which has kept the newest ones it received.
    """

    def __init__(self, system_id: int, component_id: int, key: SigningKey) -> None:
        super().__init__(None, srcSystem=system_id, srcComponent=component_id)
        self._unix_time_s = key.unix_time_s
        self._secret = self.signing.secret_key = key.secret
        self.signing.link_id = key.link_id
        self.signing.sign_outgoing = True

    def keep_time(self) -> None:
        """Advance the next stamp to now, unless it is later already."""
        now = int((self._unix_time_s() - EPOCH_UNIX_S) * UNITS_PER_S)
        self.signing.timestamp = max(self.signing.timestamp, now)

    def refusal(self, packet: Packet) -> Code | None:
        """Why this packet is refused; one of SIGNATURE_CODES.

        A radio inserts its RADIO_STATUS unsigned, and the protocol accepts it. No agent uses it.
        """
        if not packet.is_signed:
            return None if packet.message_id == mavlink.MAVLINK_MSG_ID_RADIO_STATUS else Code.MAVLINK_UNSIGNED
        data = packet.data
        if hashlib.sha256(self._secret + data[:-HASH_BYTES]).digest()[:HASH_BYTES] != data[-HASH_BYTES:]:
            return Code.MAVLINK_WRONG_KEY
        self.keep_time()
        if not self.check_signature(bytearray(data), packet.system_id, packet.component_id):
            return Code.MAVLINK_OLD_SIGNATURE
        self.signing.timestamp += 1  # newer than every stamp that the other end has received
        return None


# ---------------------------------------------------------------- packets among bytes

MOST_DAMAGED = 16  # packets of one call; each costs a checksum, and what follows is discarded
MOST_KEPT = 1024  # bytes of packets of unknown ids that wait for a known one; the longest packet has 280


class PacketReader:
    """Splits bytes into packets. Keeps an incomplete packet until the next call.

    `refused` counts runs of garbage and packets that `refusal` refuses, by code. Behind a damaged packet the search goes on
    one byte later, so that no good packet is lost: pymavlink's own parser skips as many bytes as a damaged packet claims to
    have, and with them the good packets behind it.

    A checksum has 16 bits, and payloads carry whole packets (TUNNEL, FILE_TRANSFER_PROTOCOL, a log). So what is found inside
    the claimed length of a damaged packet counts only where packet follows packet to beyond its end: then the length was
    damaged. A packet of unknown id, whose checksum nobody here can compute, counts only between certain boundaries: it follows
    a verified packet or begins the data, and a verified packet follows it, for which it waits.
    """

    def __init__(self, refusal: Callable[[Packet], Code | None] | None = None) -> None:
        self._refusal = refusal
        self._rest = b""
        self._doubtful = 0  # bytes of `_rest` and what follows that lie inside a damaged packet
        self._is_certain = True  # `_rest` begins where a packet begins
        self.refused: Counter[str] = Counter()

    @property
    def is_between_packets(self) -> bool:
        """Whether the bytes so far ended with a complete packet."""
        return not self._rest

    def read(self, data: bytes) -> list[Packet]:
        """All packets in the kept bytes and `data`, in order, also those of unknown messages. Never raises."""
        if not self._rest and (packet := read_packet(data)) is not None and packet.message_id != UNKNOWN:
            self._doubtful, self._is_certain = 0, True
            return [packet] if self._refusal is None or self._is_admitted(packet) else []  # nearly always
        waits = self._is_certain and bool(self._rest) and _known_after(self._rest, 0) == len(self._rest)
        waits = waits or (
            bool(self._rest) and _begins_packet(self._rest + data, 0)
        )  # it carries what the chunk begins with
        if not waits and _begins_packet(data, 0):  # a chunk begins with a packet
            if self._rest:  # garbage, or it lost its other half
                self.refused[Code.MAVLINK_UNREADABLE] += 1
            self._rest, self._doubtful, self._is_certain = b"", 0, True
        return self._split(self._rest + data)

    def _split(self, data: bytes) -> list[Packet]:
        packets: list[Packet] = []
        at, damaged, in_garbage = 0, 0, False
        certain, doubtful_to = self._is_certain, self._doubtful
        while (start := _next_magic(data, at)) < len(data):
            certain = certain and start == at
            end = _claimed_end(data, start)
            if end > len(data):
                break  # the rest of this packet is yet to come
            packet = read_packet(data[start:end])
            if packet is not None and packet.message_id == UNKNOWN:
                known_at = _known_after(data, start)
                if certain and known_at is not None and known_at >= len(data) and len(data) - start <= MOST_KEPT:
                    break  # a known packet is yet to come
                if not certain or known_at is None or known_at >= len(data) or _contains_others(data, start, end):
                    packet = None
            elif packet is not None and start < doubtful_to:
                leads_beyond = _leads_beyond(data, start, doubtful_to)
                if leads_beyond is None:
                    break
                packet = packet if leads_beyond else None
            if packet is None or start > at:
                self.refused[Code.MAVLINK_UNREADABLE] += not in_garbage
                in_garbage = True
            if packet is None:
                if start >= doubtful_to:
                    doubtful_to = end
                damaged, at, certain = damaged + (end > start), start + 1, False
                if damaged == MOST_DAMAGED:
                    start = len(data)
                    break
                continue
            if self._is_admitted(packet):
                packets.append(packet)
            at, in_garbage, certain, doubtful_to = end, False, True, 0
        if start == len(data) and at < start:
            self.refused[Code.MAVLINK_UNREADABLE] += not in_garbage
            certain = False
        self._rest, self._doubtful, self._is_certain = data[start:], max(0, doubtful_to - start), certain
        return packets

    def _is_admitted(self, packet: Packet) -> bool:
        if self._refusal is None:
            return True
        if code := self._refusal(packet):
            self.refused[code] += 1
        return code is None


def _next_magic(data: bytes, start: int) -> int:
    """Index of the first byte from `start` on that may begin a packet; the length of the data where there is none."""
    if start < len(data) and data[start] in OVERHEAD:  # nearly always
        return start
    found = [at for magic in (MAVLINK_2, MAVLINK_1) if (at := data.find(magic, start)) >= 0]
    return min(found, default=len(data))


def _claimed_end(data: bytes, start: int) -> int:
    """End of the packet that begins at `start`, by its header; `start` where it cannot be one. May lie beyond the data."""
    magic = data[start]
    if len(data) < start + 3:
        return start + OVERHEAD[magic]
    end = start + OVERHEAD[magic] + data[start + 1]
    if magic == MAVLINK_1:
        return end
    incompat_flags = data[start + 2]
    if incompat_flags & ~SIGNED:
        return start
    return end + SIGNATURE_BYTES if incompat_flags else end


def _packet_at(data: bytes, start: int) -> Packet | None:
    """The packet that begins here, complete in the data, of a known message with a good checksum or of an unknown one."""
    if start >= len(data) or data[start] not in OVERHEAD:
        return None
    return read_packet(data[start : _claimed_end(data, start)])


def _begins_packet(data: bytes, start: int) -> bool:
    """Whether a known packet with a good checksum begins here, complete in the data."""
    packet = _packet_at(data, start)
    return packet is not None and packet.message_id != UNKNOWN


def _known_after(data: bytes, start: int) -> int | None:
    """Where a known packet begins behind packets of unknown ids that begin at `start`.

    The end of the data where they end there, and a later place where a packet is incomplete. None where something else comes.
    """
    at = start
    while at < len(data) and data[at] in OVERHEAD:
        end = _claimed_end(data, at)
        if end > len(data):
            return end
        packet = read_packet(data[at:end])
        if packet is None:
            return None
        if packet.message_id != UNKNOWN:
            return at
        at = end
    return at if at == len(data) else None


def _leads_beyond(data: bytes, start: int, end: int) -> bool | None:
    """Whether from `start` known packet follows known packet to beyond `end`; None where the next one is yet to come.

    What a payload carries ends in front of the checksum of its packet, so it never does.
    """
    at = start
    while at <= end:
        if at == len(data) or (data[at] in OVERHEAD and _claimed_end(data, at) > len(data)):
            return None
        if not _begins_packet(data, at):
            return False
        at = _claimed_end(data, at)
    return True


def _contains_others(data: bytes, start: int, end: int) -> bool:
    """Whether known packets fill these bytes to their end: then the length of the packet that claims them is damaged."""
    inner = start + 1
    while (inner := _next_magic(data, inner)) < end:
        at = inner
        while at < end and (packet := _packet_at(data, at)) is not None and packet.message_id != UNKNOWN:
            at += len(packet.data)
        if at == end:
            return True
        inner += 1
    return False


# ---------------------------------------------------------------- one end of a link


class MavlinkCodec:
    """One end of a MAVLink link. It keeps an incomplete packet between calls and counts its own sequence.

    `refused` counts refused packets by code. With a key every sent packet is signed, and unsigned packets are refused.
    """

    def __init__(self, system_id: int, component_id: int, key: SigningKey | None = None) -> None:
        self._signed = SignedMavlink(system_id, component_id, key) if key else None
        self._mav = self._signed or mavlink.MAVLink(None, srcSystem=system_id, srcComponent=component_id)
        self._reader = PacketReader(self._signed.refusal if self._signed else None)
        self.refused = self._reader.refused
        self.packets: Sequence[Packet] = ()  # accepted ones of the last `read`, also of unknown messages

    def read(self, data: bytes) -> list[Packet]:
        """All complete packets in the earlier remainder and `data`, in order. Unknown ones are left out. Never raises."""
        self.packets = packets = self._reader.read(data)
        return [packet for packet in packets if packet.message_id != UNKNOWN]

    def decode(self, data: bytes) -> list[MavlinkMessage]:
        """The messages of `read`."""
        return [packet.message for packet in self.read(data)]

    def encode(self, message: MavlinkMessage) -> bytes:
        """The MAVLink 2 packet of a message."""
        if self._signed:
            self._signed.keep_time()
        packed: bytes = message.pack(self._mav)
        self._mav.seq = (self._mav.seq + 1) % 256
        return packed

    def encode_values(self, message_id: int, *values: float) -> bytes:
        """The same packet from the message's values, in their order on the wire: for what every tick sends.

        pymavlink makes eleven calls for it, and takes five times as long.
        """
        kind, mav = mavlink.mavlink_map[message_id], self._mav
        payload: bytes = kind.unpacker.pack(*values)
        if self._signed:
            self._signed.keep_time()
            message: MavlinkMessage = mavlink.MAVLink_message(message_id, kind.msgname)
            packed: bytes = message._pack(mav, kind.crc_extra, payload)
        else:
            payload = payload.rstrip(b"\0") or payload[:1]  # zeros at the end are not sent
            size, system, low, high = len(payload), mav.srcSystem, message_id & 0xFFFF, message_id >> 16
            covered = _SENT_HEADER.pack(size, 0, 0, mav.seq, system, mav.srcComponent, low, high) + payload
            checksum: int = mcrf4xx(covered + _CHECKSUM_EXTRAS[message_id])
            packed = b"\xfd" + covered + checksum.to_bytes(2, "little")
        mav.seq = (mav.seq + 1) % 256
        return packed
