"""A local map below the fleet, from the real server."""

from __future__ import annotations

import re
import sqlite3
from collections.abc import Iterator
from contextlib import closing, contextmanager
from math import asinh, pi, radians, tan
from pathlib import Path
from socket import SOCK_STREAM
from typing import TYPE_CHECKING

import numpy as np
import pytest
from matplotlib.image import imsave

from companion.config.planned_flight import DEFAULT_ORIGIN
from page_server import until_shown
from processes import free_port, running

if TYPE_CHECKING:
    from conftest import OpenPage

CORNER = "[...document.getElementById('scene').getContext('2d').getImageData(3, 3, 1, 1).data.slice(0, 3)]"
ORANGE = [255, 128, 0]
ZOOM = 17


@contextmanager
def monitored(folder: Path, *options: str, longitude_deg: float = DEFAULT_ORIGIN.longitude_deg) -> Iterator[str]:
    """The URL of the page of three vehicles in formation about an origin of this longitude."""
    port, page_port = free_port(SOCK_STREAM), free_port(SOCK_STREAM)
    fleet_file = folder / "fleet.yaml"
    with running(
        "tests.bench.monitor_load", "--vehicles", "3", "--port", str(port), "--write-fleet", str(fleet_file)
    ) as load:
        assert load.stdout
        assert load.stdout.readline()
        text = re.sub(r"longitude_deg: *[-.0-9]+", f"longitude_deg: {longitude_deg}", fleet_file.read_text())
        fleet_file.write_text(text)
        listening = ("--connect", f"tcp/127.0.0.1:{port}", "--listen", f"127.0.0.1:{page_port}")
        with running("companion", "monitor", "--fleet-file", str(fleet_file), *listening, *options) as monitor:
            assert monitor.stdout
            found = next(found for line in monitor.stdout if (found := re.search(r"http://\S+", line)))
            yield found[0]


def tile_at(latitude_deg: float, longitude_deg: float, zoom: int) -> tuple[int, int]:
    """Column and row of the tile with this place, as OpenStreetMap counts them."""
    latitude, count = radians(latitude_deg), 2**zoom
    return int((longitude_deg + 180.0) / 360.0 * count), int((1.0 - asinh(tan(latitude)) / pi) / 2.0 * count)


def make_mbtiles(tmp_path: Path) -> Path:
    """The tiles of `make_tiles` in one file, with an attribution."""
    file = tmp_path / "field.mbtiles"
    with closing(sqlite3.connect(file)) as database, database:
        database.execute("CREATE TABLE metadata (name text, value text)")
        database.execute(
            "CREATE TABLE tiles (zoom_level integer, tile_column integer, tile_row integer, tile_data blob)"
        )
        values = [("format", "png"), ("attribution", '<a href="https://example.org">&copy; Field survey</a>')]
        database.executemany("INSERT INTO metadata VALUES (?, ?)", values)
        for tile in make_tiles(tmp_path).glob("*/*/*.png"):
            x, y = int(tile.parent.name), 2**ZOOM - 1 - int(tile.stem)  # rows from the south
            database.execute("INSERT INTO tiles VALUES (?, ?, ?, ?)", (ZOOM, x, y, tile.read_bytes()))
    return file


def make_tiles(tmp_path: Path, longitude_deg: float = DEFAULT_ORIGIN.longitude_deg) -> Path:
    """Orange tiles of zoom 17 about the origin of the fleet: some 600 m of them."""
    column, row = tile_at(DEFAULT_ORIGIN.latitude_deg, longitude_deg, ZOOM)
    for x in range(column - 1, column + 2):
        folder = tmp_path / "tiles" / str(ZOOM) / str(x % 2**ZOOM)
        folder.mkdir(parents=True)
        for y in range(row - 1, row + 2):
            imsave(folder / f"{y}.png", np.full((256, 256, 3), ORANGE, dtype=np.uint8))
    return tmp_path / "tiles"


# Just east of the 180th meridian the corner of the view is west of it.
@pytest.mark.parametrize("longitude_deg", [DEFAULT_ORIGIN.longitude_deg, -179.99999])
def test_tiles_of_a_folder_are_drawn_below_the_fleet(open_page: OpenPage, tmp_path: Path, longitude_deg: float) -> None:
    tiles = make_tiles(tmp_path, longitude_deg)
    with monitored(tmp_path, "--tiles", str(tiles), longitude_deg=longitude_deg) as url:
        page = open_page(url)
        until_shown(page, lambda: page.evaluate(CORNER) == ORANGE)


def test_tiles_of_a_file_are_drawn_with_their_attribution(open_page: OpenPage, tmp_path: Path) -> None:
    with monitored(tmp_path, "--tiles", str(make_mbtiles(tmp_path))) as url:
        page = open_page(url)
        until_shown(page, lambda: page.evaluate(CORNER) == ORANGE)
        until_shown(page, lambda: page.locator("#map-attribution").inner_text() == "© Field survey")


def test_without_a_folder_no_tile_is_asked_for(open_page: OpenPage, tmp_path: Path) -> None:
    with monitored(tmp_path) as url:
        page = open_page(url)
        asked: list[str] = []
        page.on("request", lambda request: asked.append(request.url))
        page.reload()
        until_shown(page, "globalThis.companionMetrics?.count > 20")
        assert any("/api/v1/fleets/" in path for path in asked)
        assert not any("/tiles/" in path for path in asked)
