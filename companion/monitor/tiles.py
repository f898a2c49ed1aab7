"""Map tiles below the map of the live page: a folder Z/X/Y.png, or an MBTiles file, which is one SQLite database."""

from __future__ import annotations

import re
import sqlite3
from contextlib import closing
from html import unescape
from pathlib import Path
from threading import Lock
from typing import Any, Protocol

from companion.monitor import MonitorError
from companion.monitor.api import TilesView
from companion.types.values import cut, printable

DEEPEST_ZOOM = 24
ATTRIBUTION_FILE = "attribution.txt"  # in a folder
LONGEST_ATTRIBUTION = 200  # characters
TAG = re.compile(r"<[^<>]*>")  # an MBTiles file may have links: their text is shown
TYPES = {b"\x89PNG": "image/png", b"\xff\xd8\xff": "image/jpeg", b"RIFF": "image/webp"}  # by the first bytes
IMAGE_FORMATS = ("png", "jpg", "jpeg", "webp")
EXPECTED = "expected a folder with Z/X/Y.png, or an MBTiles file"


class Tiles(Protocol):
    """Tiles as OpenStreetMap counts them: zoom, column from the west, row from the north."""

    @property
    def view(self) -> TilesView:
        """What the page needs to know."""

    def read(self, z: int, x: int, y: int) -> bytes | None:
        """The image, None where there is none. Any thread may call it; it may block on the disk."""


def open_tiles(path: Path) -> Tiles:
    """Raises MonitorError."""
    try:
        if path.is_dir():
            return FolderTiles(path)
    except OSError as error:
        raise MonitorError(f"--tiles {path}: cannot be read: {error.strerror}") from error
    if path.is_file():
        return MbTiles(path)
    raise MonitorError(f"--tiles {path}: no such folder or file; {EXPECTED}")


def content_type(image: bytes) -> str | None:
    """By its first bytes; None for what is no image."""
    return next((kind for first, kind in TYPES.items() if image.startswith(first)), None)


class FolderTiles:
    """FOLDER/Z/X/Y.png; the attribution is in FOLDER/attribution.txt."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        zooms = [int(one.name) for one in folder.iterdir() if re.fullmatch(r"\d{1,2}", one.name) and one.is_dir()]
        zooms = [zoom for zoom in zooms if zoom <= DEEPEST_ZOOM]
        file = folder / ATTRIBUTION_FILE
        text = file.read_text(encoding="utf-8", errors="replace") if file.is_file() else ""
        self.view = TilesView(min(zooms, default=0), max(zooms, default=0), _plain(text))

    def read(self, z: int, x: int, y: int) -> bytes | None:
        file = self._folder / str(z) / str(x) / f"{y}.png"
        is_below = file.is_file() and file.resolve().is_relative_to(self._folder.resolve())  # a link may lead anywhere
        return file.read_bytes() if is_below else None


class MbTiles:
    """Read only. MBTiles 1.3 counts rows from the south."""

    def __init__(self, file: Path) -> None:
        """Raises MonitorError for what is no MBTiles file with images."""
        self._lock = Lock()
        try:
            self._database = sqlite3.connect(f"{file.resolve().as_uri()}?mode=ro", uri=True, check_same_thread=False)
            known = dict(self._rows("SELECT name, value FROM metadata"))
            ((least, most),) = self._rows("SELECT min(zoom_level), max(zoom_level) FROM tiles")
        except (sqlite3.Error, ValueError) as error:
            raise MonitorError(f"--tiles {file}: {printable(str(error))}; {EXPECTED}") from error
        image_format = str(known.get("format", "png")).lower()
        if image_format not in IMAGE_FORMATS:
            found = f"has tiles of format {cut(printable(image_format))}"
            raise MonitorError(f"--tiles {file}: {found}; expected images: {', '.join(IMAGE_FORMATS)}")
        if not all(isinstance(zoom, int) and 0 <= zoom <= DEEPEST_ZOOM for zoom in (least, most)):
            raise MonitorError(f"--tiles {file}: has no tiles of zoom 0 to {DEEPEST_ZOOM}")
        self.view = TilesView(least, most, _plain(str(known.get("attribution", ""))))

    def read(self, z: int, x: int, y: int) -> bytes | None:
        query = "SELECT tile_data FROM tiles WHERE zoom_level = ? AND tile_column = ? AND tile_row = ?"
        try:
            found = self._rows(query, z, x, (1 << z) - 1 - y)
        except sqlite3.Error:  # as where the disk was removed
            return None
        return found[0][0] if found and isinstance(found[0][0], bytes) else None

    def _rows(self, query: str, *values: int) -> list[tuple[Any, ...]]:
        with self._lock, closing(self._database.execute(query, values)) as cursor:
            return cursor.fetchall()


def _plain(text: str) -> str:
    """One line without tags."""
    return cut(printable(" ".join(unescape(TAG.sub("", text)).split())), LONGEST_ATTRIBUTION)
