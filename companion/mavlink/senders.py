"""Who sends on the autopilot's link: others than the autopilot, and two autopilots with one id. No sockets, no clocks."""

from __future__ import annotations

from collections import deque
from math import inf

from companion.mavlink.codec import Packet, mavlink

AUTOPILOT = mavlink.MAV_COMP_ID_AUTOPILOT1
RADIO_STATUS = mavlink.MAVLINK_MSG_ID_RADIO_STATUS
MOST_NAMED = 8
STEPS_BACK, WITHIN_S = 10, 3.0  # reordered datagrams are fewer; two streams give some 20 a second
BESIDE, BESIDE_WITHIN_S = 3, 5.0  # HEARTBEATs alone come once a second; a router that starts again gives one
AHEAD = 128  # a sequence number counts modulo 256: a larger step is one back


class OtherSenders:
    """Senders that are not the autopilot of this link. Radios and ground stations are no autopilots with another id.

    `autopilots`: system ids of those that sent a HEARTBEAT of an autopilot.
    """

    def __init__(self) -> None:
        self.autopilots: set[int] = set()
        self._names: dict[tuple[int, int], str] = {}

    def receive(self, packet: Packet) -> None:
        """A packet of another system, or of another component than the autopilot."""
        system_id, component_id, message_id = packet.system_id, packet.component_id, packet.message_id
        sender = (system_id, component_id)
        if message_id == RADIO_STATUS:
            self._names[sender] = f"a radio (system {system_id}, component {component_id})"
        elif message_id == mavlink.MAVLINK_MSG_ID_HEARTBEAT:
            beat = packet.fields
            if beat.type == mavlink.MAV_TYPE_GCS:
                self._names[sender] = f"a ground station (system {system_id}, component {component_id})"
            elif component_id == AUTOPILOT and beat.autopilot != mavlink.MAV_AUTOPILOT_INVALID:
                self.autopilots.add(system_id)
        self._names.setdefault(sender, f"system {system_id}, component {component_id}")

    def __str__(self) -> str:
        """All of them; "" where none was received."""
        names = [self._names[sender] for sender in sorted(self._names)]
        more = [f"{len(names) - MOST_NAMED} others"] if len(names) > MOST_NAMED else []
        return ", ".join(names[:MOST_NAMED] + more)


class StreamOrder:
    """Whether the packets of the autopilot are of one stream.

    Behind a multipoint radio, or a program that merges links, two autopilots with one system id look like one that obeys, and
    both arm. Their sequence numbers and clocks go to and fro; those of one autopilot only increase, whatever is lost. Over UDP
    two may come from two addresses. One that comes from a new one is no second one: the old one is silent from then on.
    """

    def __init__(self) -> None:
        self._back_s: deque[float] = deque(maxlen=STEPS_BACK)  # when a number went back
        self._last: tuple[int, bytes] | None = None
        self._boot_s = -inf
        self._beside_s: deque[float] = deque(maxlen=BESIDE)  # when another address sent, after this one had sent again
        self._heard_since = False

    def receive(self, packet: Packet, received_s: float) -> None:
        """A packet of the autopilot."""
        if packet.message_id == RADIO_STATUS:
            return
        self._heard_since = True
        last, self._last = self._last, (packet.sequence, packet.data)
        if last is None:
            return
        step = (self._last[0] - last[0]) % 256
        if step >= AHEAD or (step == 0 and packet.data != last[1]):
            self._back_s.append(received_s)

    def receive_beside(self, received_s: float) -> None:
        """A packet with the autopilot's id from another address than the one that is followed."""
        if self._heard_since:
            self._heard_since = False
            self._beside_s.append(received_s)

    def receive_clock(self, boot_s: float, received_s: float) -> None:
        """The autopilot's clock in one of its positions."""
        if boot_s < self._boot_s:
            self._back_s.append(received_s)
        self._boot_s = boot_s

    def interleaves(self, now_s: float) -> bool:
        """Whether two streams have arrived in turn just now."""
        if len(self._beside_s) == BESIDE and now_s - self._beside_s[0] < BESIDE_WITHIN_S:
            return True
        return len(self._back_s) == STEPS_BACK and now_s - self._back_s[0] < WITHIN_S
