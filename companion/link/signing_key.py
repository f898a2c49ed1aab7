"""Key of a signed MAVLink link, from a file or a systemd credential. The key never appears in a message."""

from __future__ import annotations

import os
import re
import stat
import time
from collections.abc import Mapping
from pathlib import Path

from companion.config.bounded_read import read_regular
from companion.config.file import ConfigError
from companion.config.vehicle import Signing
from companion.mavlink.signing import KEY_BYTES, SigningKey

EARLIEST_UNIX_S = 1_767_225_600  # 2026-01-01 UTC: before this program was written
WANTED = "expected 32 bytes or 64 hexadecimal digits (head -c 32 /dev/urandom > FILE makes a key)"


def read_signing_key(vehicle_file: Path, signing: Signing, environment: Mapping[str, str] = os.environ) -> SigningKey:
    """The key that the vehicle file names.

    Raises ConfigError for an invalid key, a key file that all users may read, and a clock that was never set.
    """
    if signing.key_file is not None:
        field, path = "signing.key_file", vehicle_file.parent / signing.key_file
    else:
        field, path = "signing.credential", _credential(vehicle_file, str(signing.credential), environment)
    secret = _secret(vehicle_file, f"{field}: {path}", path)
    if time.time() < EARLIEST_UNIX_S:
        raise ConfigError(
            vehicle_file,
            "signing",
            f"this computer's clock shows {time.strftime('%Y-%m-%d', time.gmtime())}; set it first (NTP, or a clock with a"
            " battery): signatures carry the time, so that old packets are not accepted as new",
        )
    return SigningKey(secret, signing.link_id, time.time)


def _credential(vehicle_file: Path, name: str, environment: Mapping[str, str]) -> Path:
    folder = environment.get("CREDENTIALS_DIRECTORY", "")
    if not folder:
        raise ConfigError(
            vehicle_file,
            "signing.credential",
            f'"{name}": no credentials given; put LoadCredential={name}:FILE into the systemd unit, or use key_file',
        )
    return Path(folder) / name


def _secret(vehicle_file: Path, where: str, path: Path) -> bytes:
    try:
        content, state = read_regular(path)
    except OSError as error:
        raise ConfigError(vehicle_file, where, f"{error.strerror}; check the path and its permissions") from error
    if state.st_mode & stat.S_IRWXO:
        raise ConfigError(vehicle_file, where, f"every user of this computer has access to the key; chmod 600 {path}")
    secret = _decoded(content)
    if secret is None:
        raise ConfigError(vehicle_file, where, f"{len(content)} bytes that are not a key; {WANTED}")
    if not any(secret):
        raise ConfigError(vehicle_file, where, f"a key of zeros means no signing; {WANTED}")
    return secret


def _decoded(content: bytes) -> bytes | None:
    """The key in a file's content, or None. 32 hexadecimal digits are half a key, not 32 bytes."""
    if re.fullmatch(rb"\s*[0-9a-fA-F]{64}\s*", content):
        return bytes.fromhex(content.decode("ascii"))
    is_digits = re.fullmatch(rb"\s*[0-9a-fA-F]*\s*", content) is not None
    return content if len(content) == KEY_BYTES and not is_digits else None
