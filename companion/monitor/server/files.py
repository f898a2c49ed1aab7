"""Files that the server hands out: the page, and map tiles of a folder. No path of a request is ever joined to a folder."""

from __future__ import annotations

import asyncio
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from hashlib import sha256
from pathlib import Path

from aiohttp import web

from companion import monitor
from companion.monitor.server.access import error

PAGE = Path(monitor.__file__).parent / "page"
TYPES = {
    ".html": "text/html",
    ".css": "text/css",
    ".js": "text/javascript",
    ".mjs": "text/javascript",
    ".json": "application/json",
    ".webmanifest": "application/manifest+json",
    ".svg": "image/svg+xml",
    ".png": "image/png",
    ".ico": "image/x-icon",
    ".woff2": "font/woff2",
    ".txt": "text/plain",
}
PRELOADS = b"<!-- preloads -->"  # in index.html
DEEPEST_ZOOM = 24
TILE_AGE_S = 86400


@dataclass(frozen=True, slots=True)
class PageFile:
    """A file of the page as it is sent."""

    body: bytes
    content_type: str
    tag: str  # differs where the content does


def page_files(folder: Path = PAGE) -> Mapping[str, PageFile]:
    """The files of the page by their path below it, of known types; read once at the start."""
    files = [file for file in sorted(folder.rglob("*")) if file.is_file() and file.suffix in TYPES]
    bodies = {file.relative_to(folder).as_posix(): file.read_bytes() for file in files}
    bodies["index.html"] = bodies["index.html"].replace(PRELOADS, _preloads(bodies))
    return {path: PageFile(body, TYPES[Path(path).suffix], sha256(body).hexdigest()) for path, body in bodies.items()}


def _preloads(paths: Iterable[str]) -> bytes:
    """The browser asks for all modules at once; without this it finds the imports of a module when it has loaded that one."""
    return "".join(f'<link rel="modulepreload" href="{path}">' for path in paths if path.endswith(".js")).encode()


async def page_file(request: web.Request, files: Mapping[str, PageFile]) -> web.StreamResponse:
    """A file of the page; / is index.html."""
    file = files.get(request.match_info.get("path", "") or "index.html")
    if file is None:
        return error(404, f"{request.path[:200]}: no such file of the page")
    if any(known.value == file.tag for known in request.if_none_match or ()):
        return web.Response(status=304)
    charset = "utf-8" if file.content_type.startswith("text/") else None
    response = web.Response(body=file.body, content_type=file.content_type, charset=charset)
    response.headers["Cache-Control"] = "no-cache"
    response.etag = file.tag
    return response


def _is_below(folder: Path, file: Path) -> bool:
    """Whether there is such a file in the folder; a link may lead anywhere."""
    return file.is_file() and file.resolve().is_relative_to(folder.resolve())


async def tile(request: web.Request, folder: Path | None) -> web.StreamResponse:
    """A map tile FOLDER/Z/X/Y.png."""
    z, x, y = (int(request.match_info[name]) for name in ("z", "x", "y"))
    if folder is None or z > DEEPEST_ZOOM or x >= 1 << z or y >= 1 << z:
        return error(404, "no such tile")
    file = folder / str(z) / str(x) / f"{y}.png"
    if not await asyncio.to_thread(_is_below, folder, file):  # a folder on a slow disk delays no snapshot
        return error(404, "no such tile")
    return web.FileResponse(file, headers={"Cache-Control": f"max-age={TILE_AGE_S}", "Content-Type": "image/png"})
