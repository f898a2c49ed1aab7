"""New identities and the list that admits them, in memory: nothing is written here."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from datetime import datetime

from msgspec.structs import replace

from companion.config.file import ConfigError
from companion.security.admission import Admitted, AdmittedParticipant, RevokedParticipant, now_in_seconds
from companion.security.authority import Authority, signed
from companion.security.certificates import (
    certificate_pem,
    key_der,
    key_pem,
    new_key,
    participant_certificate,
    serial_of,
)
from companion.security.names import ParticipantName

COMMAND = "companion provision"


@dataclass(frozen=True, slots=True)
class Issued:
    """A new identity that is not written yet."""

    name: ParticipantName
    entry: AdmittedParticipant
    certificate: bytes
    key: bytes = field(repr=False)


def issue(authority: Authority, names: Sequence[ParticipantName], days: int, now: datetime) -> list[Issued]:
    """Keys and certificates. The authority's key is not read where there are none to make."""
    if not names:
        return []
    authority_key, issued = authority.key(), []
    for name in names:
        key = new_key()
        try:
            certificate = participant_certificate(
                name, key.public_key(), authority.certificate, authority_key, now, days
            )
        except ValueError as error:
            raise ConfigError(COMMAND, "--days", str(error)) from error
        entry = AdmittedParticipant(
            name=str(name),
            serial=serial_of(certificate),
            public_key=key_der(key.public_key()),
            expires_at=certificate.not_valid_after_utc,
        )
        issued.append(Issued(name, entry, certificate_pem(certificate), key_pem(key)))
    return issued


def with_issued(admitted: Admitted, issued: Sequence[Issued]) -> tuple[AdmittedParticipant, ...]:
    """The participants with the new entries in place of those with the same names, and the others at the end."""
    entries = {one.name: one for one in admitted.participants} | {one.entry.name: one.entry for one in issued}
    return tuple(entries.values())


def next_list(
    authority: Authority,
    participants: tuple[AdmittedParticipant, ...],
    revoked: tuple[RevokedParticipant, ...],
    now: datetime,
) -> bytes:
    old = authority.admitted
    new = replace(old, number=old.number + 1, issued_at=now_in_seconds(now), participants=participants, revoked=revoked)
    return signed(authority, authority.key(), new)
