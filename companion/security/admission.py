"""The admission list: the participants that a fleet admits, and those that it has revoked, signed by its authority.

The file is a JSON object with the list as text (`payload`) and an ECDSA signature over exactly this text. There is one form of
a list in bytes: a file with any other byte is refused. A list is JSON and a certificate is DER, so that no signature of the
authority is good for both.
"""

from __future__ import annotations

import re
from collections import Counter
from datetime import UTC, datetime
from typing import Annotated

import msgspec
from cryptography import x509
from cryptography.hazmat.primitives import serialization
from cryptography.hazmat.primitives.asymmetric import ec
from msgspec import Meta, Struct

from companion.security.certificates import HASH, UNUSABLE, common_name, organization, p256, public_key_of
from companion.security.names import FORM, ParticipantName, ParticipantRole, parse_common_name
from companion.types.values import FleetName, printable

MAX_LIST_BYTES = 256 * 1024
MAX_PARTICIPANTS = 256
MAX_REVOKED = 512
MAX_LIST_NUMBER = 2**31
SPKI_BYTES = 91  # of a P-256 key

CommonName = Annotated[str, Meta(max_length=64, pattern=rf"^{re.sub(r'[?]P<[a-z]+>', '', FORM.pattern)}\Z")]
Serial = Annotated[str, Meta(pattern=r"^[1-9a-f][0-9a-f]{0,39}\Z")]
Instant = Annotated[datetime, Meta(tz=True)]


class AdmissionError(Exception):
    """An admission list that is refused. str() is one printable line without the name of the file."""

    def __init__(self, problem: str) -> None:
        super().__init__(printable(problem))


class Section(Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """A part of the list."""


class AdmittedParticipant(Section, frozen=True):
    """A participant with its newest certificate. `public_key` is a SubjectPublicKeyInfo in DER."""

    name: CommonName
    serial: Serial
    public_key: Annotated[bytes, Meta(min_length=SPKI_BYTES, max_length=SPKI_BYTES)]
    expires_at: Instant

    def key(self) -> ec.EllipticCurvePublicKey:
        """The public key. Raises AdmissionError; not for a list that `verify` returned."""
        try:
            key = p256(serialization.load_der_public_key(self.public_key))
        except UNUSABLE as error:
            raise AdmissionError(f"the public key of {self.name} is not usable") from error
        if key is None:
            raise AdmissionError(f"the public key of {self.name} is not EC P-256")
        return key


class RevokedParticipant(Section, frozen=True):
    """An identity that is no longer admitted. Its common name is never used again."""

    name: CommonName
    serial: Serial
    revoked_at: Instant


class Admitted(Section, frozen=True):
    """The list. `number` rises by one with each change; 0 is the empty list of a new authority."""

    fleet: FleetName
    number: Annotated[int, Meta(ge=0, le=MAX_LIST_NUMBER)]
    issued_at: Instant
    participants: Annotated[tuple[AdmittedParticipant, ...], Meta(max_length=MAX_PARTICIPANTS)] = ()
    revoked: Annotated[tuple[RevokedParticipant, ...], Meta(max_length=MAX_REVOKED)] = ()

    def participant(self, name: str) -> AdmittedParticipant | None:
        """The admitted participant with this common name."""
        return next((one for one in self.participants if one.name == name), None)

    def name_of(self, role: ParticipantRole, id_: str | int) -> str | None:
        """The common name that is admitted for this participant, like vehicle-3.2 for vehicle 3; None without one."""
        wanted = f"{role}-{id_}"
        return next((one.name for one in self.participants if parse_common_name(one.name).participant == wanted), None)

    def names(self, role: ParticipantRole) -> tuple[str, ...]:
        """The admitted common names of a role, in the order of the list."""
        return tuple(one.name for one in self.participants if parse_common_name(one.name).role is role)

    def revocation(self, name: str) -> RevokedParticipant | None:
        """The revocation of this common name."""
        return next((one for one in self.revoked if one.name == name), None)

    def next_name(self, name: ParticipantName) -> ParticipantName:
        """The name with the first generation that was never revoked."""
        revoked = [parse_common_name(one.name) for one in self.revoked]
        generations = [one.generation for one in revoked if one.participant == name.participant]
        return ParticipantName(name.role, name.id, max(generations, default=0) + 1)


class SignedList(Section, frozen=True):
    """The file: the list as JSON text, and the signature over this text in DER."""

    payload: str
    signature: bytes


_envelope_decoder = msgspec.json.Decoder(SignedList)
_list_decoder = msgspec.json.Decoder(Admitted)


def sign(admitted: Admitted, key: ec.EllipticCurvePrivateKey, authority: x509.Certificate) -> bytes:
    """The file of a list. Raises AdmissionError for a list that `verify` would refuse."""
    payload = msgspec.json.encode(admitted)
    data = _file(SignedList(payload=payload.decode("ascii"), signature=key.sign(payload, ec.ECDSA(HASH))))
    verify(data, authority)
    return data


def verify(data: bytes, authority: x509.Certificate) -> Admitted:
    """The list in a file. Raises AdmissionError for everything but a list of this authority's fleet with its signature.

    Every public key is checked: in the order of 10 ms for 256 participants, too long for a control tick.
    """
    if len(data) > MAX_LIST_BYTES:
        raise AdmissionError(f"larger than {MAX_LIST_BYTES // 1024} kB")
    try:
        signed = _envelope_decoder.decode(data)
        as_written = _file(signed)
    except (msgspec.DecodeError, UnicodeError) as error:
        raise AdmissionError("is not an admission list; copy it again") from error
    if as_written != data:
        raise AdmissionError("is not written as the authority writes it; copy it again")
    payload = signed.payload.encode("utf-8")
    _check_signature(payload, signed.signature, authority)
    try:
        admitted = _list_decoder.decode(payload)
    except (msgspec.DecodeError, UnicodeError) as error:
        raise AdmissionError(f"has a content that this version does not accept: {_line(error)}") from error
    _check(admitted, organization(authority))
    return admitted


def accept(data: bytes, authority: x509.Certificate, held: Admitted) -> Admitted:
    """The list in a file that may replace the one held. Raises AdmissionError, also for a lower number than that held."""
    admitted = verify(data, authority)
    if admitted.number < held.number:
        raise AdmissionError(f"has number {admitted.number}; list {held.number} is held, an older one is refused")
    if admitted.number == held.number and admitted != held:
        raise AdmissionError(f"has number {admitted.number} as the list that is held, with another content")
    return admitted


def now_in_seconds(now: datetime) -> datetime:
    """The time (UTC) in whole seconds, as lists and certificates carry it."""
    return now.astimezone(UTC).replace(microsecond=0)


def _file(signed: SignedList) -> bytes:
    return msgspec.json.encode(signed) + b"\n"


def _line(error: Exception) -> str:
    return " ".join(str(error).split())[:200]


def _check_signature(payload: bytes, signature: bytes, authority: x509.Certificate) -> None:
    key = public_key_of(authority)
    if key is None:
        raise AdmissionError("cannot be verified: the authority's key is not EC P-256")
    try:
        key.verify(signature, payload, ec.ECDSA(HASH))
    except UNUSABLE as error:
        raise AdmissionError(f"is not signed by {common_name(authority)}") from error


def _check(admitted: Admitted, fleet: str) -> None:
    """What no single field shows: of this fleet, every name and serial once, every key usable."""
    if admitted.fleet != fleet:
        raise AdmissionError(f'is of fleet "{admitted.fleet}", expected "{fleet}"')
    try:
        participants = [parse_common_name(one.name).participant for one in admitted.participants]
        for revoked in admitted.revoked:
            parse_common_name(revoked.name)
    except ValueError as error:
        raise AdmissionError(f"has the name {error}") from error
    everyone: list[AdmittedParticipant | RevokedParticipant] = [*admitted.participants, *admitted.revoked]
    for words, values in (
        ("participant", participants),
        ("name", [one.name for one in everyone]),
        ("serial", [one.serial for one in everyone]),
    ):
        twice = [value for value, count in Counter(values).items() if count > 1]
        if twice:
            raise AdmissionError(f"has the {words} {twice[0]} twice")
    for participant in admitted.participants:
        participant.key()
