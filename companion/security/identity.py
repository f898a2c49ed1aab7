"""The identity of one participant: a folder with its key and certificate, the authority and the admission list."""

from __future__ import annotations

import os
import stat
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path

from cryptography import x509

from companion.config.bounded_read import read_regular
from companion.config.file import ConfigError
from companion.security.admission import MAX_LIST_BYTES, AdmissionError, Admitted, verify
from companion.security.certificates import common_name, issued_by, organization, read_certificate, read_key
from companion.security.names import ParticipantName, ParticipantRole, parse_common_name

AUTHORITY_FILE, CERTIFICATE_FILE, KEY_FILE = "authority.pem", "certificate.pem", "private.key"
ADMITTED_FILE = "admitted.json"
KEY_CREDENTIAL = "identity.key"  # LoadCredential=identity.key:FILE in a systemd unit
NO_CREDENTIAL = b"none"  # SetCredential=identity.key:none in the unit
MAX_PEM_BYTES = 16 * 1024
COPY_AGAIN = "copy the whole folder again"


class IdentityError(ConfigError):
    """An identity that cannot be used. str() is one line: file, what is wrong, what to do."""

    def __init__(self, file: Path | str, problem: str) -> None:
        super().__init__(file, "", problem)


@dataclass(frozen=True, slots=True)
class Identity:
    """What a participant shows to others and checks of them. `expires_at` is the end of its certificate (UTC)."""

    fleet: str
    common_name: str
    role: ParticipantRole
    id: str
    authority: x509.Certificate
    authority_file: Path
    certificate_file: Path
    key_file: Path
    admitted: Admitted
    expires_at: datetime


def load_identity(folder: Path, now: datetime, credentials: Path | None = None) -> Identity:
    """The identity in a folder. `now` has a time zone; `credentials` is the folder $CREDENTIALS_DIRECTORY of systemd.

    A credential identity.key is used instead of private.key. Raises IdentityError for what other participants would refuse.
    """
    authority_file, certificate_file = folder / AUTHORITY_FILE, folder / CERTIFICATE_FILE
    authority, certificate = _certificate(authority_file), _certificate(certificate_file)
    key_file = _key_file(folder, credentials)
    _check_key(key_file, is_credential=key_file.parent != folder, certificate=certificate, shown_in=certificate_file)
    if not issued_by(certificate, authority):
        raise IdentityError(certificate_file, f"was not issued by the authority in {authority_file}; {COPY_AGAIN}")
    name, fleet = _name(certificate_file, certificate, authority)
    for file, one in ((authority_file, authority), (certificate_file, certificate)):
        _check_time(file, one, now)
    admitted = read_admitted(folder / ADMITTED_FILE, authority)
    _check_admitted(folder / ADMITTED_FILE, admitted, name)
    return Identity(
        fleet=fleet,
        common_name=str(name),
        role=name.role,
        id=name.id,
        authority=authority,
        authority_file=authority_file,
        certificate_file=certificate_file,
        key_file=key_file,
        admitted=admitted,
        expires_at=certificate.not_valid_after_utc,
    )


def read_admitted(file: Path, authority: x509.Certificate) -> Admitted:
    """The admission list in a file. Raises IdentityError."""
    try:
        return verify(_content(file, MAX_LIST_BYTES)[0], authority)
    except AdmissionError as error:
        raise IdentityError(file, str(error)) from error


def _content(file: Path, most_bytes: int = MAX_PEM_BYTES) -> tuple[bytes, os.stat_result]:
    try:
        return read_regular(file, most_bytes)
    except OSError as error:
        raise IdentityError(
            file, f"cannot be read: {error.strerror}; check the path and its permissions, or {COPY_AGAIN}"
        ) from error


def _certificate(file: Path) -> x509.Certificate:
    try:
        return read_certificate(_content(file)[0])
    except ValueError as error:
        raise IdentityError(file, f"{error}; {COPY_AGAIN}") from error


def _key_file(folder: Path, credentials: Path | None) -> Path:
    """The credential; where systemd found no key for it, the unit gives the word none, and the key is in the folder."""
    if credentials is not None and (credentials / KEY_CREDENTIAL).exists():
        content, _ = _content(credentials / KEY_CREDENTIAL)
        if content.strip() != NO_CREDENTIAL:
            return credentials / KEY_CREDENTIAL
    return folder / KEY_FILE


def _check_key(file: Path, *, is_credential: bool, certificate: x509.Certificate, shown_in: Path) -> None:
    """systemd protects a credential by its folder; a key in a folder has the permissions of its owner alone."""
    content, state = _content(file)
    if not is_credential and state.st_mode & (stat.S_IRWXG | stat.S_IRWXO):
        raise IdentityError(file, f"other users of this computer have access to the key; chmod 600 {file}")
    try:
        key = read_key(content)
    except ValueError as error:
        raise IdentityError(file, f"{error}; {COPY_AGAIN}") from error
    if key.public_key() != certificate.public_key():
        raise IdentityError(file, f"is not the key of {shown_in}; {COPY_AGAIN}")


def _name(file: Path, certificate: x509.Certificate, authority: x509.Certificate) -> tuple[ParticipantName, str]:
    try:
        name = parse_common_name(common_name(certificate))
    except ValueError as error:
        raise IdentityError(file, f"has the common name {error}; {COPY_AGAIN}") from error
    fleet = organization(certificate)
    if fleet != organization(authority):
        raise IdentityError(file, f'is of fleet "{fleet}", its authority of "{organization(authority)}"; {COPY_AGAIN}')
    return name, fleet


def _check_time(file: Path, certificate: x509.Certificate, now: datetime) -> None:
    begin, end = certificate.not_valid_before_utc, certificate.not_valid_after_utc
    here = f"the clock of this computer shows {now:%Y-%m-%d %H:%M}"
    if now < begin:
        raise IdentityError(file, f"is valid from {begin:%Y-%m-%d %H:%M} UTC, {here}; set the clock")
    if now > end:
        raise IdentityError(
            file, f"has expired on {end:%Y-%m-%d}, {here}; companion provision renew makes a new one, or set the clock"
        )


def _check_admitted(file: Path, admitted: Admitted, name: ParticipantName) -> None:
    if admitted.participant(str(name)) is not None:
        return
    if revoked := admitted.revocation(str(name)):
        problem = f"{name} is revoked since {revoked.revoked_at:%Y-%m-%d}; companion provision new makes a new identity"
    else:
        problem = f"does not admit {name}; {COPY_AGAIN}"
    raise IdentityError(file, problem)
