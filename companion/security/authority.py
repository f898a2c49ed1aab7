"""The folder of a fleet's authority: its private key, its certificate and the newest admission list."""

from __future__ import annotations

from dataclasses import dataclass
from datetime import datetime
from pathlib import Path

from cryptography import x509
from cryptography.hazmat.primitives.asymmetric import ec

from companion.config.bounded_read import read_regular
from companion.config.file import ConfigError
from companion.security.admission import AdmissionError, Admitted, now_in_seconds, sign
from companion.security.certificates import (
    authority_certificate,
    certificate_pem,
    key_pem,
    new_key,
    read_certificate,
    read_key,
)
from companion.security.identity import ADMITTED_FILE, AUTHORITY_FILE, KEY_FILE, MAX_PEM_BYTES, read_admitted
from companion.security.private_files import PRIVATE, new_folder, write_file

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
        try:
            key = read_key(_authority_content(file))
        except ValueError as error:
            raise ConfigError(file, "", f"{error}; {RESTORE}") from error
        if key.public_key() != self.certificate.public_key():
            raise ConfigError(file, "", f"is not the key of {AUTHORITY_FILE}; {RESTORE}")
        return key


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
    try:
        certificate = read_certificate(_authority_content(file))
    except ValueError as error:
        raise ConfigError(file, "", f"{error}; {RESTORE}") from error
    return Authority(folder, certificate, read_admitted(folder / ADMITTED_FILE, certificate))


def signed(authority: Authority, key: ec.EllipticCurvePrivateKey, admitted: Admitted) -> bytes:
    """The file of a new list. Raises ConfigError for one that is too large."""
    try:
        return sign(admitted, key, authority.certificate)
    except AdmissionError as error:
        raise ConfigError(authority.folder / ADMITTED_FILE, "", f"the new list {error}") from error


def _authority_content(file: Path) -> bytes:
    try:
        return read_regular(file, MAX_PEM_BYTES)[0]
    except OSError as error:
        raise ConfigError(file, "", f"cannot be read: {error.strerror}; {RESTORE}") from error
