"""Folders of keys: of one participant (`Identity`) and of a fleet's authority (`Authority`), and how their files are written.

A participant's folder has its key and certificate, the certificate of the authority and the admission list; that of the
authority its private key, its certificate and the newest list. Files and folders are complete or absent, with permissions that
do not depend on the umask.
"""

from __future__ import annotations

import fcntl
import os
import shutil
import stat
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path

from cryptography import x509
from cryptography.hazmat.primitives.asymmetric import ec

from companion.config.atomic import PART, PRIVATE, part_of, sync_folder, write_file
from companion.config.file import ConfigError, read_regular
from companion.security.admission import (
    MAX_LIST_BYTES,
    AdmissionError,
    Admitted,
    authority_certificate,
    certificate_pem,
    common_name,
    issued_by,
    key_pem,
    new_key,
    now_in_seconds,
    organization,
    read_certificate,
    read_key,
    sign,
    verify,
)
from companion.security.names import ParticipantName, ParticipantRole, parse_common_name

PRIVATE_FOLDER, PUBLIC_FOLDER = 0o700, 0o755


@contextmanager
def new_folder(path: Path, mode: int = PRIVATE_FOLDER) -> Iterator[Path]:
    """A folder under another name, which gets its name when it is complete. Nothing is left of it after an exception."""
    part = part_of(path)
    try:
        make_folder(part, mode)
        yield part
        sync_folder(part)
        part.rename(path)
        sync_folder(path.parent)
    except BaseException:
        shutil.rmtree(part, ignore_errors=True)
        raise


def make_folder(path: Path, mode: int = PRIVATE_FOLDER) -> None:
    """A folder, for its owner alone without a `mode`. Raises OSError where it exists."""
    path.mkdir(PRIVATE_FOLDER)
    path.chmod(mode)


def remove_parts(folder: Path) -> None:
    """Removes what a run that was killed left under other names."""
    for part in folder.glob(f".*{PART}"):
        shutil.rmtree(part) if part.is_dir() else part.unlink()


@contextmanager
def one_at_a_time(folder: Path) -> Iterator[None]:
    """Only one process at a time is in here for a folder. Raises ConfigError for the second one, and for any OSError."""
    try:
        descriptor = os.open(folder, os.O_RDONLY | os.O_DIRECTORY | os.O_CLOEXEC)
    except OSError as error:
        raise ConfigError(folder, "", f"{error.strerror}; check the path") from error
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        yield
    except BlockingIOError as error:
        raise ConfigError(folder, "", "another companion provision is at work here; wait until it has ended") from error
    except OSError as error:
        problem = f"{error.strerror}; then run the same command again, it completes what is missing"
        raise ConfigError(error.filename or folder, "", problem) from error
    finally:
        os.close(descriptor)


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

    def key(self) -> ec.EllipticCurvePrivateKey:
        """The private key. Raises IdentityError."""
        certificate = _certificate(self.certificate_file, _content(self.certificate_file)[0])
        return _key(self.key_file, _content(self.key_file)[0], certificate, self.certificate_file)


def load_identity(folder: Path, now: datetime, credentials: Path | None = None) -> Identity:
    """The identity in a folder. `now` has a time zone; `credentials` is the folder $CREDENTIALS_DIRECTORY of systemd.

    A credential identity.key is used instead of private.key. Raises IdentityError for what other participants would refuse.
    """
    authority_file, certificate_file = folder / AUTHORITY_FILE, folder / CERTIFICATE_FILE
    for path in (folder, authority_file, certificate_file, folder / ADMITTED_FILE):
        _check_not_writable(path)
    authority, certificate = (_certificate(file, _content(file)[0]) for file in (authority_file, certificate_file))
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
        return verify(_content(file, most_bytes=MAX_LIST_BYTES)[0], authority)
    except AdmissionError as error:
        raise IdentityError(file, str(error)) from error


def _content(
    file: Path, remedy: str = f"check the path and its permissions, or {COPY_AGAIN}", most_bytes: int = MAX_PEM_BYTES
) -> tuple[bytes, os.stat_result]:
    try:
        return read_regular(file, most_bytes)
    except OSError as error:
        raise IdentityError(file, f"cannot be read: {error.strerror}; {remedy}") from error


def _certificate(file: Path, content: bytes, remedy: str = COPY_AGAIN) -> x509.Certificate:
    try:
        return read_certificate(content)
    except ValueError as error:
        raise IdentityError(file, f"{error}; {remedy}") from error


def _key(
    file: Path, content: bytes, certificate: x509.Certificate, shown_in: Path | str, remedy: str = COPY_AGAIN
) -> ec.EllipticCurvePrivateKey:
    """The private key in this content, which must be that of the certificate."""
    try:
        key = read_key(content)
    except ValueError as error:
        raise IdentityError(file, f"{error}; {remedy}") from error
    if key.public_key() != certificate.public_key():
        raise IdentityError(file, f"is not the key of {shown_in}; {remedy}")
    return key


def _key_file(folder: Path, credentials: Path | None) -> Path:
    """The credential; where systemd found no key for it, the unit gives the word none, and the key is in the folder."""
    if credentials is not None and (credentials / KEY_CREDENTIAL).exists():
        content, _ = _content(credentials / KEY_CREDENTIAL)
        if content.strip() != NO_CREDENTIAL:
            return credentials / KEY_CREDENTIAL
    return folder / KEY_FILE


def _check_not_writable(path: Path) -> None:
    """Who writes the folder or a certificate in it decides whom this participant believes."""
    try:
        mode = path.stat().st_mode
    except OSError:
        return  # what reads it says so
    if mode & (stat.S_IWGRP | stat.S_IWOTH):
        raise IdentityError(path, f"other users of this computer may write it; chmod go-w {path}")


def _check_key(file: Path, *, is_credential: bool, certificate: x509.Certificate, shown_in: Path) -> None:
    """systemd protects a credential by its folder; a key in a folder has the permissions of its owner alone."""
    content, state = _content(file)
    if not is_credential and state.st_mode & (stat.S_IRWXG | stat.S_IRWXO):
        raise IdentityError(file, f"other users of this computer have access to the key; chmod 600 {file}")
    _key(file, content, certificate, shown_in)


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


RESTORE = "restore the folder from its backup"


@dataclass(frozen=True, slots=True)
class Authority:
    """The certificate of a fleet's authority and the newest list."""

    folder: Path
    certificate: x509.Certificate
    admitted: Admitted

    @property
    def fleet(self) -> str:
        return self.admitted.fleet

    def key(self) -> ec.EllipticCurvePrivateKey:
        """The private key. Raises ConfigError."""
        file = self.folder / KEY_FILE
        return _key(file, _content(file, RESTORE)[0], self.certificate, AUTHORITY_FILE, RESTORE)


def create_authority(folder: Path, fleet: str, now: datetime) -> None:
    """Makes the folder with a new key, for this fleet, and an empty list with the number 0. Raises OSError."""
    key = new_key()
    certificate = authority_certificate(fleet, key, now)
    empty = sign(Admitted(fleet=fleet, number=0, issued_at=now_in_seconds(now)), key, certificate)
    with new_folder(folder) as part:
        write_file(part / KEY_FILE, key_pem(key), PRIVATE)
        write_file(part / AUTHORITY_FILE, certificate_pem(certificate))
        write_file(part / ADMITTED_FILE, empty)


def open_authority(folder: Path) -> Authority:
    """The authority in a folder, without its private key. Raises ConfigError."""
    file = folder / AUTHORITY_FILE
    certificate = _certificate(file, _content(file, RESTORE)[0], RESTORE)
    return Authority(folder, certificate, read_admitted(folder / ADMITTED_FILE, certificate))


def sign_list(authority: Authority, key: ec.EllipticCurvePrivateKey, admitted: Admitted) -> bytes:
    """The file of a new list. Raises ConfigError for one that is too large."""
    try:
        return sign(admitted, key, authority.certificate)
    except AdmissionError as error:
        raise ConfigError(authority.folder / ADMITTED_FILE, "", f"the new list {error}") from error
