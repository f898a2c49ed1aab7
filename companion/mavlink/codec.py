"""The MAVLink messages: those that the code uses, and all others of the dialect as they came.

`mavlink` is a dialect as pymavlink generates it, with few messages (`generate.py`). A message that is not among them has no
fields here, but its checksum and its signature are verified, it is passed on unchanged, and its receiver is known.
"""

from __future__ import annotations

import hashlib
import struct
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from operator import attrgetter, itemgetter
from typing import Any, ClassVar

from msgspec import Struct

from companion.mavlink.checksum import mcrf4xx
from companion.mavlink.generated import in_use
from companion.mavlink.generated.others import OTHERS
from companion.types.notices import Code

mavlink = in_use


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


KEY_BYTES = 32
UNITS_PER_S = 100_000  # a stamp counts 10 us
EPOCH_UNIX_S = 1_420_070_400  # from 2015-01-01 UTC
HASH_BYTES = 6

SIGNATURE_CODES = (Code.MAVLINK_UNSIGNED, Code.MAVLINK_WRONG_KEY, Code.MAVLINK_OLD_SIGNATURE)


@dataclass(frozen=True, slots=True)
class SigningKey:
    """Secret, link id and clock of one end of a signed link."""

    secret: bytes = field(repr=False)
    link_id: int
    unix_time_s: Callable[[], float]


class SignedMavlink(mavlink.MAVLink):
    """A MAVLink end that signs all packets and accepts only correctly signed ones.

    pymavlink accepts a time stamp before it checks the signature, so one forged packet would make the genuine ones look old.
    Here the signature is checked first.

    A stamp never goes backwards, even if the clock does. A clock that is behind, as on a computer without a battery, is
    corrected by the stamps of the other end, which has kept the newest ones it received.
    """

    def __init__(self, system_id: int, component_id: int, key: SigningKey) -> None:
        super().__init__(None, srcSystem=system_id, srcComponent=component_id)
        self._unix_time_s = key.unix_time_s
        self._secret = self.signing.secret_key = key.secret
        self.signing.link_id = key.link_id
        self.signing.sign_outgoing = True
        self.signing.allow_unsigned_callback = _refuse_unsigned

    def keep_time(self) -> None:
        """Advance the next stamp to now, unless it is later already."""
        now = int((self._unix_time_s() - EPOCH_UNIX_S) * UNITS_PER_S)
        self.signing.timestamp = max(self.signing.timestamp, now)

    def check_signature(self, msgbuf: bytearray, srcSystem: int, srcComponent: int) -> bool:  # noqa: N803
        """True for a correct signature. Raises MAVError with one of SIGNATURE_CODES otherwise."""
        digest = hashlib.sha256(self._secret + msgbuf[:-HASH_BYTES]).digest()
        if digest[:HASH_BYTES] != msgbuf[-HASH_BYTES:]:
            raise mavlink.MAVError(Code.MAVLINK_WRONG_KEY)
        self.keep_time()
        if not super().check_signature(msgbuf, srcSystem, srcComponent):
            raise mavlink.MAVError(Code.MAVLINK_OLD_SIGNATURE)
        self.signing.timestamp += 1  # newer than every stamp that the other end has received
        return True


def _refuse_unsigned(_mav: mavlink.MAVLink, _message_id: int) -> bool:
    """Refuse unsigned packets. The protocol would accept RADIO_STATUS, inserted by a radio; the agent does not use it."""
    raise mavlink.MAVError(Code.MAVLINK_UNSIGNED)


MavlinkMessage = Any  # pymavlink generates its classes without types

MAGIC = 0xFD
HEADER_BYTES, CHECKSUM_BYTES = 10, 2
OVERHEAD_BYTES = HEADER_BYTES + CHECKSUM_BYTES
PAYLOAD_AT = {MAGIC: HEADER_BYTES, 0xFE: 6}  # by the first byte: MAVLink 2 and 1
# Magic, length, flags, compatible flags, sequence, system, component, id (24 bits)
_HEADER = struct.Struct("<BBBBBBBHB")
_CHECKED = struct.Struct("<BBBxxBBHB")  # the same without what no check needs


@dataclass(frozen=True, slots=True)
class _Layout:
    """Fields of one kind of message, in their order on the wire."""

    kind: type[Any]
    fields: struct.Struct
    padding: bytes  # a payload of zeros: trailing zeros are not sent
    checksum_extra: bytes
    attributes: dict[str, Any]  # of a new message
    names: tuple[str, ...]
    lengths: tuple[int, ...]
    values_of: Callable[[MavlinkMessage], tuple[Any, ...]]
    numbers: Callable[[tuple[Any, ...]], tuple[Any, ...]] | None  # those outside arrays; None without arrays
    number_names: tuple[str, ...]
    arrays: tuple[tuple[str, int, int], ...]  # name, first index and end among the values

    def attributes_with(self, values: tuple[Any, ...]) -> dict[str, Any]:
        """Attributes of a message with these values."""
        attributes = self.attributes.copy()
        if self.numbers is None:
            attributes.update(zip(self.names, values, strict=True))
            return attributes
        attributes.update(zip(self.number_names, self.numbers(values), strict=True))
        for name, start, end in self.arrays:
            attributes[name] = list(values[start:end])
        return attributes

    def payload_of(self, message: MavlinkMessage) -> bytes:
        values = self.values_of(message)
        if self.numbers is None:
            return self.fields.pack(*values)
        flat: list[Any] = []
        for length, value in zip(self.lengths, values, strict=True):
            if length == 1:
                flat.append(value)
            else:
                flat += value[:length]
        return self.fields.pack(*flat)


def _layouts() -> Iterator[tuple[int, _Layout]]:
    kinds: dict[int, Any] = mavlink.mavlink_map
    for message_id, kind in kinds.items():
        names = tuple(kind.ordered_fieldnames)
        if "s" in kind.unpacker.format or len(names) < 2:
            continue
        spans, start = [], 0
        for name, length in zip(names, kind.lengths, strict=True):
            spans.append((name, start, start + length))
            start += length
        arrays = tuple(span for span in spans if span[2] - span[1] > 1)
        numbers = [span for span in spans if span not in arrays]
        if arrays and len(numbers) < 2:
            continue
        yield (
            message_id,
            _Layout(
                kind=kind,
                fields=kind.unpacker,
                padding=bytes(kind.unpacker.size),
                checksum_extra=bytes((kind.crc_extra,)),
                attributes=dict(vars(kind(*(0 for _ in names)))),
                names=names,
                lengths=tuple(kind.lengths),
                values_of=attrgetter(*names),
                numbers=itemgetter(*(at for _, at, _ in numbers)) if arrays else None,
                number_names=tuple(name for name, _, _ in numbers),
                arrays=arrays,
            ),
        )


_LAYOUTS = dict(_layouts())
# Of the messages that are read here, and of those that only pass.
_CHECKSUM_EXTRAS = {
    message_id: bytes((kind.crc_extra,))
    for message_id, kind in mavlink.mavlink_map.items()
    if message_id in _LAYOUTS or not isinstance(kind, type)
}


class Packet(Struct, gc=False):
    """A good packet. Its pymavlink message is made only when it is asked for: the frequent ones are read by `values`."""

    data: bytes
    message_id: int
    system_id: int
    component_id: int
    is_signed: bool = False
    known: MavlinkMessage | None = None  # the message, if it has been made

    @property
    def values(self) -> tuple[Any, ...]:
        """Numbers of a message without text in their order on the wire, those of an array one by one."""
        data, layout = self.data, _LAYOUTS[self.message_id]
        start = PAYLOAD_AT[data[0]]
        return layout.fields.unpack_from(data[start : start + data[1]] + layout.padding)

    @property
    def message(self) -> MavlinkMessage:
        """The message as pymavlink makes it."""
        if self.known is None:
            self.known = self._made()
        return self.known

    def _made(self) -> MavlinkMessage:
        data, layout = self.data, _LAYOUTS.get(self.message_id)
        if layout is None:
            return mavlink.MAVLink(None).decode(bytearray(data))
        message = object.__new__(layout.kind)
        attributes = layout.attributes_with(self.values)
        attributes["_msgbuf"] = data
        attributes["_payload"] = data[6:-CHECKSUM_BYTES]  # from there, as pymavlink does
        attributes["_crc"] = data[-2] | data[-1] << 8
        length, compatible_flags, sequence = data[1], data[3], data[4]
        attributes["_header"] = mavlink.MAVLink_header(
            self.message_id, 0, compatible_flags, length, sequence, self.system_id, self.component_id
        )
        message.__dict__ = attributes
        return message


def read_plain(data: bytes) -> Packet | None:
    """The packet of these bytes where they are one good packet. None where pymavlink has to judge them."""
    if len(data) < OVERHEAD_BYTES:
        return None
    magic, length, flags, system_id, component_id, id_low, id_high = _CHECKED.unpack_from(data)
    if magic != MAGIC or flags or len(data) != length + OVERHEAD_BYTES:
        return None
    message_id = id_low | id_high << 16
    extra = _CHECKSUM_EXTRAS.get(message_id)
    if extra is None or mcrf4xx(data[1:-CHECKSUM_BYTES] + extra) != data[-2] | data[-1] << 8:
        return None
    return Packet(data, message_id, system_id, component_id)


def encode_plain(message: MavlinkMessage, mav: mavlink.MAVLink) -> bytes | None:
    """The packet of a message from `mav`. None where pymavlink has to make it, as on a signed link."""
    layout = _LAYOUTS.get(message.id)
    if layout is None or layout.kind is not type(message) or mav.signing.sign_outgoing:
        return None
    payload = layout.payload_of(message)
    payload = payload.rstrip(b"\0") or payload[:1]
    message_id = message.id
    packet = (
        _HEADER.pack(
            MAGIC, len(payload), 0, 0, mav.seq, mav.srcSystem, mav.srcComponent, message_id & 0xFFFF, message_id >> 16
        )
        + payload
    )
    return packet + mcrf4xx(packet[1:] + layout.checksum_extra).to_bytes(CHECKSUM_BYTES, "little")


MAVLINK_2, MAVLINK_1 = 0xFD, 0xFE  # first byte of a packet
SIGNED = 0x01  # the only incompat_flag that is defined
OVERHEAD = {MAVLINK_2: 12, MAVLINK_1: 8}  # bytes of header and checksum
ID_AT = {MAVLINK_2: slice(7, 10), MAVLINK_1: slice(5, 6)}
SIGNATURE_BYTES = 13
MOST_DAMAGED = 16  # packets of one call; each costs a checksum, and what follows is discarded


class PacketReader:
    """Splits bytes into packets and checks them with `mav`. Keeps an incomplete packet until the next call.

    `refused` counts runs of garbage and packets with a refused signature, by code. pymavlink's own parser skips as many bytes
    as a damaged packet claims to have, and with them the good packets behind it.
    """

    def __init__(self, mav: mavlink.MAVLink) -> None:
        self._mav = mav
        self._has_key = mav.signing.secret_key is not None
        self._rest = b""
        self.refused: Counter[str] = Counter()

    @property
    def is_between_packets(self) -> bool:
        """Whether the bytes so far ended with a complete packet."""
        return not self._rest

    def read(self, data: bytes) -> list[Packet]:
        """All packets in the kept bytes and `data`, in order. Messages of unknown ones are MAVLink_unknown. Never raises."""
        if not self._rest and (packet := self._plain(data)) is not None:
            return [packet]  # nearly always
        if self._rest and _is_packet(data, 0):  # what was kept is garbage, or lost its other half
            self.refused[Code.MAVLINK_UNREADABLE] += 1
            self._rest = b""
        data = self._rest + data
        packets: list[Packet] = []
        at, damaged, in_garbage = 0, 0, False
        while (start := _next_magic(data, at)) < len(data):
            end = _claimed_end(data, start)
            if end > len(data):
                break  # the rest of this packet is yet to come
            packet = self._checked(data, start, end) if end > start else None
            if packet is None or start > at:
                self.refused[Code.MAVLINK_UNREADABLE] += not in_garbage
                in_garbage = True
            if packet is None:
                damaged, at = damaged + (end > start), start + 1
                if damaged == MOST_DAMAGED:
                    start = len(data)
                    break
                continue
            if packet.message_id != mavlink.MAVLINK_MSG_ID_BAD_DATA:
                packets.append(packet)
            at, in_garbage = end, False
        if start == len(data) and at < start:
            self.refused[Code.MAVLINK_UNREADABLE] += not in_garbage
        self._rest = data[start:]
        return packets

    def _plain(self, data: bytes) -> Packet | None:
        """A packet that no key protects; None where pymavlink has to judge it."""
        return None if self._has_key else read_plain(data)

    def _checked(self, data: bytes, start: int, end: int) -> Packet | None:
        """The packet of these bytes, BAD_DATA where its signature is refused, None where it is none."""
        candidate = data[start:end]
        if (packet := self._plain(candidate)) is not None:
            return packet
        try:
            message = self._mav.decode(bytearray(candidate))
        except mavlink.MAVError as error:
            reason = str(error)
            if reason not in SIGNATURE_CODES:
                return None
            self.refused[reason] += 1
            message = mavlink.MAVLink_bad_data(b"", reason)
        message_id = message.get_msgId()
        if message_id == mavlink.MAVLINK_MSG_ID_UNKNOWN and not _ends_well(data, start, end):
            return None
        sender, flags = (message.get_srcSystem(), message.get_srcComponent()), message.get_header().incompat_flags
        return Packet(candidate, message_id, *sender, is_signed=bool(flags), known=message)


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


def _is_packet(data: bytes, start: int) -> bool:
    """Whether a known packet with a good checksum begins here, complete in the data."""
    if start >= len(data) or data[start] not in OVERHEAD:
        return False
    end = _claimed_end(data, start)
    if not start < end <= len(data):
        return False
    packet = data[start:end]
    known = mavlink.mavlink_map.get(int.from_bytes(packet[ID_AT[packet[0]]], "little"))
    if known is None:
        return False
    if packet[0] == MAVLINK_2 and packet[2]:
        packet = packet[:-SIGNATURE_BYTES]
    checksum = mcrf4xx(packet[1:-CHECKSUM_BYTES] + bytes([known.crc_extra]))
    return bool(checksum == int.from_bytes(packet[-CHECKSUM_BYTES:], "little"))


def _ends_well(data: bytes, start: int, end: int) -> bool:
    """Whether a packet of unknown id, whose checksum cannot be checked, is followed by another one and contains none."""
    if end < len(data) and data[end] not in OVERHEAD:
        return False
    inner = start + 1
    while (inner := _next_magic(data, inner)) < end:
        if _is_packet(data, inner):
            return False
        inner += 1
    return True


__all__ = ["MavlinkCodec", "MavlinkMessage", "mavlink"]


class MavlinkCodec:
    """One end of a MAVLink link. It keeps an incomplete packet between calls and counts its own sequence.

    `refused` counts refused packets by code. With a key every sent packet is signed, and unsigned packets are refused.
    """

    def __init__(self, system_id: int, component_id: int, key: SigningKey | None = None) -> None:
        self._signed = SignedMavlink(system_id, component_id, key) if key else None
        self._mav = self._signed or mavlink.MAVLink(None, srcSystem=system_id, srcComponent=component_id)
        self._reader = PacketReader(self._mav)
        self._packets: list[Packet] = []  # of the last `read`

    @property
    def refused(self) -> Counter[str]:
        return self._reader.refused

    @property
    def packets(self) -> list[bytes]:
        """Packets of the last `read`, unchanged, without refused ones."""
        return [packet.data for packet in self._packets]

    def read(self, data: bytes) -> list[Packet]:
        """All complete packets in the earlier remainder and `data`, in order. Unknown ones are left out. Never raises."""
        self._packets = self._reader.read(data)
        # The checksum and the signature of unknown messages are unchecked.
        return [packet for packet in self._packets if packet.message_id != mavlink.MAVLINK_MSG_ID_UNKNOWN]

    def decode(self, data: bytes) -> list[MavlinkMessage]:
        """The messages of `read`."""
        return [packet.message for packet in self.read(data)]

    def encode(self, message: MavlinkMessage) -> bytes:
        """The MAVLink 2 packet of a message."""
        if self._signed:
            self._signed.keep_time()
        packed: bytes = encode_plain(message, self._mav) or message.pack(self._mav)
        self._mav.seq = (self._mav.seq + 1) % 256
        return packed
