"""The MAVLink messages: those that the code uses, and all others of the dialect as they came.

`mavlink` is a dialect as pymavlink generates it, with few messages (`generate.py`). A message that is not among them has no
fields here, but its checksum and its signature are verified, it is passed on unchanged, and its receiver is known.
"""

from __future__ import annotations

import struct
from collections.abc import Iterator
from typing import Any, ClassVar

from companion.mavlink.generated import in_use
from companion.mavlink.generated.others import OTHERS

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
