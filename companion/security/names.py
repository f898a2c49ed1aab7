"""Names of participants: ROLE-ID, and from the second identity on ROLE-ID.GENERATION. Light to import."""

from __future__ import annotations

import re
from dataclasses import dataclass
from enum import StrEnum

from companion.types.values import FLEET_NAME, MAX_VEHICLES, quoted

MAX_GENERATION = 9999
FORM = re.compile(r"(?P<participant>(?P<role>[a-z]+)-(?P<id>[A-Za-z0-9_-]+))(?:\.(?P<generation>[1-9][0-9]{0,3}))?")


class ParticipantRole(StrEnum):
    """What a participant of the network is, and so what it may do there."""

    VEHICLE = "vehicle"
    GROUND = "ground"
    MONITOR = "monitor"
    TARGET = "target"
    TRAFFIC = "traffic"
    MOCAP = "mocap"


LOWER_CASE = ("[a-z0-9][a-z0-9_-]{0,31}", "at most 32 lower-case letters, digits, - and _, a letter or digit first")
IDS = {  # pattern of the ids of each role, and how messages describe it
    ParticipantRole.VEHICLE: ("[1-9][0-9]{0,2}", f"a vehicle id from 1 to {MAX_VEHICLES}"),
    ParticipantRole.GROUND: LOWER_CASE,
    ParticipantRole.MONITOR: LOWER_CASE,
    # As the name of a target reference
    ParticipantRole.TARGET: (FLEET_NAME, "at most 41 lower-case letters, digits, - and _, a letter or digit first"),
    # As in the key of a traffic sample
    ParticipantRole.TRAFFIC: ("[A-Za-z0-9_-]{1,32}", "at most 32 letters, digits, - and _"),
    ParticipantRole.MOCAP: LOWER_CASE,
}


@dataclass(frozen=True, slots=True)
class ParticipantName:
    """Role, id and generation. str() is the common name: vehicle-3, or vehicle-3.2 after a revocation."""

    role: ParticipantRole
    id: str
    generation: int = 1

    def __str__(self) -> str:
        return self.participant if self.generation == 1 else f"{self.participant}.{self.generation}"

    @property
    def participant(self) -> str:
        """ROLE-ID, the same for all generations: vehicle-3."""
        return f"{self.role}-{self.id}"


def participant_name(role: ParticipantRole, id_: str | int, generation: int = 1) -> ParticipantName:
    """The name with these parts. Raises ValueError, which names what was expected."""
    text = str(id_)
    too_high = role is ParticipantRole.VEHICLE and text.isdecimal() and int(text) > MAX_VEHICLES
    pattern, words = IDS[role]
    if not re.fullmatch(pattern, text) or too_high:
        raise ValueError(f"{quoted(text)}, expected {words}")
    if not 1 <= generation <= MAX_GENERATION:
        raise ValueError(f"generation {generation}, expected 1 to {MAX_GENERATION}")
    return ParticipantName(role, text, generation)


def parse_common_name(text: str) -> ParticipantName:
    """The name of a common name. Raises ValueError for what is none; there is one spelling of each name."""
    found = FORM.fullmatch(text)
    if found is None or found["role"] not in list(ParticipantRole) or found["generation"] == "1":
        roles = ", ".join(ParticipantRole)
        raise ValueError(f"{quoted(text)}, expected ROLE-ID or ROLE-ID.GENERATION with one of the roles {roles}")
    try:
        return participant_name(ParticipantRole(found["role"]), found["id"], int(found["generation"] or 1))
    except ValueError as error:
        raise ValueError(f"{quoted(text)}: {error}") from None
