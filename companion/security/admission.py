"""What a fleet's authority signs: the certificates of participants, and the list of those that the fleet admits.

Certificates are X.509 with EC P-256. The admission list has the participants that a fleet admits and those that it has
revoked. Its file is a JSON object with the list as text (`payload`) and an ECDSA signature over exactly this text. There is one
form of a list in bytes: a file with any other byte is refused. A list is JSON and a certificate is DER, so that no signature of
the authority is good for both. No files, no clocks.
"""

from __future__ import annotations

import re
from collections import Counter
from datetime import UTC, datetime, timedelta
from typing import Annotated

import msgspec
from cryptography import x509
from cryptography.exceptions import InvalidSignature, UnsupportedAlgorithm
from cryptography.hazmat.primitives import hashes, serialization
from cryptography.hazmat.primitives.asymmetric import ec
from cryptography.hazmat.primitives.asymmetric.types import PrivateKeyTypes, PublicKeyTypes
from cryptography.x509.oid import ExtendedKeyUsageOID, NameOID
from msgspec import Meta, Struct

from companion.config.validation import in_plain_words
from companion.security.names import FORM, ParticipantName, ParticipantRole, parse_common_name
from companion.types.errors import CompanionError
from companion.types.values import FleetName, printable

AUTHORITY_DAYS = 3650
BACKDATED = timedelta(hours=1)  # so that a board whose clock is a little slow accepts a new certificate
HASH = hashes.SHA256()
KEY_USAGES = (
    "digital_signature", "content_commitment", "key_encipherment", "data_encipherment", "key_agreement", "key_cert_sign",
    "crl_sign", "encipher_only", "decipher_only",
)  # fmt: skip
UNUSABLE = (
    ValueError,
    TypeError,
    UnsupportedAlgorithm,
    InvalidSignature,
    x509.InvalidVersion,
    x509.DuplicateExtension,
)
"""What `cryptography` raises for keys and certificates that cannot be used."""


def new_key() -> ec.EllipticCurvePrivateKey:
    """A new P-256 key."""
    return ec.generate_private_key(ec.SECP256R1())


def authority_certificate(fleet: str, key: ec.EllipticCurvePrivateKey, now: datetime) -> x509.Certificate:
    """The self-signed certificate of a fleet's authority, valid for AUTHORITY_DAYS."""
    subject = _subject(f"{fleet} authority", fleet)
    usage = _key_usage("digital_signature", "key_cert_sign", "crl_sign")
    return (
        _builder(subject, subject, key.public_key(), now, AUTHORITY_DAYS)
        .add_extension(x509.BasicConstraints(ca=True, path_length=0), critical=True)
        .add_extension(usage, critical=True)
        .sign(key, HASH)
    )


def participant_certificate(
    name: ParticipantName,
    public_key: ec.EllipticCurvePublicKey,
    authority: x509.Certificate,
    authority_key: ec.EllipticCurvePrivateKey,
    now: datetime,
    days: int,
) -> x509.Certificate:
    """A certificate for both ends of a TLS connection. Raises ValueError where it would outlive the authority's."""
    last = (authority.not_valid_after_utc - now).days
    if not 1 <= days <= last:
        raise ValueError(f"{days} days, expected 1 to {last}: the authority ends on {day(authority)}")
    usages = x509.ExtendedKeyUsage([ExtendedKeyUsageOID.SERVER_AUTH, ExtendedKeyUsageOID.CLIENT_AUTH])
    signer = x509.AuthorityKeyIdentifier.from_issuer_public_key(authority_key.public_key())
    return (
        _builder(_subject(str(name), organization(authority)), authority.subject, public_key, now, days)
        .add_extension(x509.BasicConstraints(ca=False, path_length=None), critical=True)
        .add_extension(_key_usage("digital_signature"), critical=True)
        .add_extension(usages, critical=False)
        .add_extension(x509.SubjectAlternativeName([x509.DNSName(str(name))]), critical=False)
        .add_extension(signer, critical=False)
        .sign(authority_key, HASH)
    )


def read_certificate(pem: bytes) -> x509.Certificate:
    """The certificate in a PEM file, with a P-256 key and a readable subject. Raises ValueError."""
    try:
        certificate = x509.load_pem_x509_certificate(pem)
        is_p256 = public_key_of(certificate) is not None
        common_name(certificate)
        organization(certificate)
    except UNUSABLE as error:
        raise ValueError("is not a certificate of a fleet in PEM form") from error
    if not is_p256:
        raise ValueError("its key is not EC P-256")
    return certificate


def read_key(pem: bytes) -> ec.EllipticCurvePrivateKey:
    """The P-256 key in a PEM file without password. Raises ValueError, which does not contain the key."""
    try:
        key: PrivateKeyTypes | None = serialization.load_pem_private_key(pem, password=None)
    except UNUSABLE:
        key = None
    if not isinstance(key, ec.EllipticCurvePrivateKey) or not isinstance(key.curve, ec.SECP256R1):
        raise ValueError("is not an EC P-256 private key in PEM form without password")
    return key


def public_key_of(certificate: x509.Certificate) -> ec.EllipticCurvePublicKey | None:
    """The key, None where it is not on P-256."""
    return p256(certificate.public_key())


def p256(key: PublicKeyTypes) -> ec.EllipticCurvePublicKey | None:
    """The key where it is one on P-256, else None."""
    return key if isinstance(key, ec.EllipticCurvePublicKey) and isinstance(key.curve, ec.SECP256R1) else None


def issued_by(certificate: x509.Certificate, authority: x509.Certificate) -> bool:
    """Whether the authority's key signed the certificate in the authority's name."""
    try:
        certificate.verify_directly_issued_by(authority)
    except UNUSABLE:
        return False
    return True


def common_name(certificate: x509.Certificate) -> str:
    """The one common name of the subject. Raises ValueError."""
    return _one(certificate, NameOID.COMMON_NAME, "common name")


def organization(certificate: x509.Certificate) -> str:
    """The one organization of the subject: the name of the fleet. Raises ValueError."""
    return _one(certificate, NameOID.ORGANIZATION_NAME, "organization")


def serial_of(certificate: x509.Certificate) -> str:
    """The serial number in hexadecimal, without leading zeros."""
    return f"{certificate.serial_number:x}"


def day(certificate: x509.Certificate) -> str:
    """The last day of validity (UTC), like 2027-11-22."""
    return f"{certificate.not_valid_after_utc:%Y-%m-%d}"


def certificate_pem(certificate: x509.Certificate) -> bytes:
    return certificate.public_bytes(serialization.Encoding.PEM)


def key_pem(key: ec.EllipticCurvePrivateKey) -> bytes:
    """The private key without password: an agent must start without a person."""
    return key.private_bytes(
        serialization.Encoding.PEM, serialization.PrivateFormat.PKCS8, serialization.NoEncryption()
    )


def key_der(key: ec.EllipticCurvePublicKey) -> bytes:
    """The public key as SubjectPublicKeyInfo; 91 bytes."""
    return key.public_bytes(serialization.Encoding.DER, serialization.PublicFormat.SubjectPublicKeyInfo)


def _one(certificate: x509.Certificate, attribute: x509.ObjectIdentifier, words: str) -> str:
    values = [found.value for found in certificate.subject.get_attributes_for_oid(attribute)]
    if len(values) != 1 or not isinstance(values[0], str):
        raise ValueError(f"its subject has {len(values)} entries for the {words}, expected one")
    return values[0]


def _subject(name: str, fleet: str) -> x509.Name:
    return x509.Name(
        [x509.NameAttribute(NameOID.COMMON_NAME, name), x509.NameAttribute(NameOID.ORGANIZATION_NAME, fleet)]
    )


def _builder(
    subject: x509.Name, issuer: x509.Name, key: ec.EllipticCurvePublicKey, now: datetime, days: int
) -> x509.CertificateBuilder:
    return (
        x509.CertificateBuilder()
        .subject_name(subject)
        .issuer_name(issuer)
        .public_key(key)
        .serial_number(x509.random_serial_number())
        .not_valid_before(now - BACKDATED)
        .not_valid_after(now + timedelta(days=days))
        .add_extension(x509.SubjectKeyIdentifier.from_public_key(key), critical=False)
    )


def _key_usage(*allowed: str) -> x509.KeyUsage:
    """A key usage that allows these and nothing else."""
    return x509.KeyUsage(**{usage: usage in allowed for usage in KEY_USAGES})


MAX_LIST_BYTES = 256 * 1024
MAX_PARTICIPANTS = 256
MAX_REVOKED = 512
MAX_LIST_NUMBER = 2**31
SPKI_BYTES = 91  # length of a P-256 public key

CommonName = Annotated[str, Meta(max_length=64, pattern=rf"^{re.sub(r'[?]P<[a-z]+>', '', FORM.pattern)}\Z")]
Serial = Annotated[str, Meta(pattern=r"^[1-9a-f][0-9a-f]{0,39}\Z")]
Instant = Annotated[datetime, Meta(tz=True)]


class AdmissionError(CompanionError):
    """An admission list that is refused. str() is one printable line without the name of the file."""

    def __init__(self, problem: str) -> None:
        super().__init__(printable(problem))


class ListPart(Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """A part of the list: no unknown keys."""


class AdmittedParticipant(ListPart, frozen=True):
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


class RevokedParticipant(ListPart, frozen=True):
    """An identity that is no longer admitted. Its common name is never used again."""

    name: CommonName
    serial: Serial
    revoked_at: Instant


class Admitted(ListPart, frozen=True):
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


class SignedList(ListPart, frozen=True):
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
    return " ".join(in_plain_words(error).split())[:200]


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
