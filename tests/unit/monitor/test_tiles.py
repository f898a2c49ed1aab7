"""Tiles of a folder and of an MBTiles file: what is found, and what is refused."""

from __future__ import annotations

import sqlite3
from contextlib import closing
from pathlib import Path

import pytest

from companion.monitor import MonitorError
from companion.monitor.api import TilesView
from companion.monitor.tiles import LONGEST_ATTRIBUTION, content_type, open_tiles

PNG, JPEG = b"\x89PNG image", b"\xff\xd8\xff image"


def mbtiles(file: Path, tiles: dict[tuple[int, int, int], object], **metadata: str) -> Path:
    with closing(sqlite3.connect(file)) as database, database:
        database.execute("CREATE TABLE metadata (name text, value text)")
        database.execute(
            "CREATE TABLE tiles (zoom_level integer, tile_column integer, tile_row integer, tile_data blob)"
        )
        database.executemany("INSERT INTO metadata VALUES (?, ?)", metadata.items())
        database.executemany("INSERT INTO tiles VALUES (?, ?, ?, ?)", [(*at, data) for at, data in tiles.items()])
    return file


def test_rows_of_a_file_are_counted_from_the_south(tmp_path: Path) -> None:
    file = mbtiles(tmp_path / "a.mbtiles", {(3, 4, 1): JPEG, (5, 0, 31): PNG, (3, 4, 2): "no image"}, format="jpg")
    tiles = open_tiles(file)
    assert tiles.view == TilesView(3, 5, "")
    assert tiles.read(3, 4, 6) == JPEG
    assert tiles.read(5, 0, 0) == PNG
    assert [tiles.read(3, 4, 1), tiles.read(3, 4, 5), tiles.read(4, 4, 6)] == [None, None, None]
    assert [content_type(JPEG), content_type(PNG), content_type(b"<svg>")] == ["image/jpeg", "image/png", None]


def test_a_file_is_not_changed(tmp_path: Path) -> None:
    file = mbtiles(tmp_path / "a.mbtiles", {(0, 0, 0): PNG})
    before = file.read_bytes()
    open_tiles(file).read(0, 0, 0)
    assert file.read_bytes() == before
    assert [one.name for one in tmp_path.iterdir()] == ["a.mbtiles"]


def test_the_attribution_is_one_plain_line(tmp_path: Path) -> None:
    text = '<a href="x">&copy; Survey</a>\n of <b>2026</b>'
    assert (
        open_tiles(mbtiles(tmp_path / "a", {(0, 0, 0): PNG}, attribution=text)).view.attribution == "© Survey of 2026"
    )
    folder = tmp_path / "tiles"
    (folder / "17").mkdir(parents=True)
    (folder / "9").mkdir()
    (folder / "attribution.txt").write_text("© " + "A" * 500)
    view = open_tiles(folder).view
    assert (view.least_zoom, view.most_zoom) == (9, 17)
    assert len(view.attribution) == LONGEST_ATTRIBUTION + 3


def test_what_has_no_images_is_refused(tmp_path: Path) -> None:
    text = tmp_path / "text"
    text.write_text("no database")
    empty = tmp_path / "empty"
    sqlite3.connect(empty).close()
    for file, words in (
        (tmp_path / "nowhere", "no such folder or file"),
        (text, "file is not a database"),
        (empty, "no such table: metadata"),
        (mbtiles(tmp_path / "vector", {(0, 0, 0): b"x"}, format="pbf"), "tiles of format pbf; expected images: png"),
        (mbtiles(tmp_path / "none", {}), "has no tiles of zoom 0 to 24"),
        (mbtiles(tmp_path / "deep", {(99, 0, 0): PNG}), "has no tiles of zoom 0 to 24"),
    ):
        with pytest.raises(MonitorError, match=words):
            open_tiles(file)
