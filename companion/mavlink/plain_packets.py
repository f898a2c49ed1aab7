"""MAVLink 2 packets that are not signed and carry no text: the same messages and bytes as pymavlink's, in a fifth of its time.

These are nearly all packets of a flight. Whatever else comes, and every damaged packet, is left to pymavlink. Messages that
only pass are checked here too.
"""

from __future__ import annotations

import struct
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from operator import attrgetter, itemgetter
from typing import Any

from msgspec import Struct

from companion.mavlink.checksum import mcrf4xx
from companion.mavlink.messages import mavlink

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
