/** Tiles of a local map, if the server has some: /tiles/Z/X/Y.png, about the origin of the fleet. */

const PROBED_ZOOMS = [17, 15, 19, 13]; // where there are tiles at the origin, one of these answers
const MAGNIFIED = 3; // levels that a tile may be magnified
const TILE_PX = 256;
const KEPT = 300;
const WGS84_A_M = 6378137;
const WGS84_E2 = 6.69437999014e-3;
const RADIAN = Math.PI / 180;

export class Tiles {
  constructor(onLoad) {
    this._onLoad = onLoad;
    this._images = new Map();
    this._origin = null;
    this.found = false;
  }

  /** Once for each fleet file: are there tiles at its origin? */
  async probe({ origin, tiles }) {
    if (this._origin && String(this._origin) === String(origin)) return;
    this._origin = origin;
    this._metres = metresPerDegree(origin[0]);
    this.found = false;
    const { least_zoom: least, most_zoom: most } = tiles;
    this._zooms = [least, most];
    this._attribution = tiles.attribution;
    const probed = PROBED_ZOOMS.filter((zoom) => zoom >= least && zoom <= most);
    for (const zoom of probed.length ? probed : [most]) {
      const [x, y] = this._tileAt([0, 0], zoom);
      const response = await fetch(path(zoom, Math.floor(x), Math.floor(y)), { method: "HEAD" }).catch(() => null);
      if (response?.ok) {
        this.found = true;
        this._onLoad();
        return;
      }
    }
  }

  /** To whom the map belongs, while it is shown. */
  get attribution() {
    return this.found ? this._attribution : "";
  }

  draw(pen) {
    if (!this.found) return;
    const { camera, context } = pen;
    const zoom = this._zoomFor(camera.scale);
    const corners = [[0, 0], [camera.width, 0], [0, camera.height], [camera.width, camera.height]];
    const tiles = corners.map(([px, py]) => this._tileAt(camera.unproject(px, py, 0), zoom));
    const [xs, ys] = [0, 1].map((i) => tiles.map((tile) => Math.floor(tile[i])));
    const [x0, x1, y0, y1] = [Math.min(...xs), Math.max(...xs), Math.min(...ys), Math.max(...ys)];
    if ((x1 - x0 + 1) * (y1 - y0 + 1) > KEPT / 2) return;
    context.save();
    for (let x = x0; x <= x1; x += 1) for (let y = y0; y <= y1; y += 1) this._drawTile(pen, zoom, x, y);
    context.restore();
    pen.overTiles = true;
  }

  /** A tile that is missing is drawn from the tile above it, magnified. */
  _drawTile(pen, zoom, x, y) {
    for (let up = 0; up <= MAGNIFIED && zoom - up >= this._zooms[0]; up += 1) {
      const image = this._image(zoom - up, x >> up, y >> up);
      if (!image.ready) continue;
      const size = TILE_PX >> up;
      const within = (1 << up) - 1; // of the larger tile, also west of column 0
      const [left, top] = [(x & within) * size, (y & within) * size];
      const corner = (dx, dy) => pen.camera.project([...this._positionOf(x + dx, y + dy, zoom), 0]);
      const [[ax, ay], [bx, by], [cx, cy]] = [corner(0, 0), corner(1, 0), corner(0, 1)];
      const ratio = devicePixelRatio;
      const scaled = [(bx - ax) / size, (by - ay) / size, (cx - ax) / size, (cy - ay) / size, ax, ay];
      pen.context.setTransform(...scaled.map((value) => value * ratio));
      pen.context.drawImage(image.element, left, top, size, size, 0, 0, size, size);
      return;
    }
  }

  _image(zoom, x, y) {
    const key = path(zoom, x, y);
    let image = this._images.get(key);
    if (!image) {
      if (this._images.size > KEPT) this._images.delete(this._images.keys().next().value);
      image = { element: new Image(), ready: false };
      image.element.onload = () => {
        image.ready = true;
        this._onLoad();
      };
      image.element.src = key;
      this._images.set(key, image);
    }
    return image;
  }

  _zoomFor(scale) {
    const metresPerTile = (zoom) => (2 * Math.PI * WGS84_A_M * Math.cos(this._origin[0] * RADIAN)) / 2 ** zoom;
    const [least, most] = this._zooms;
    for (let zoom = least; zoom < most; zoom += 1) if (metresPerTile(zoom) * scale <= TILE_PX * 1.4) return zoom;
    return most;
  }

  _tileAt([east, north], zoom) {
    const longitude = this._origin[1] + east / this._metres.east;
    const latitude = (this._origin[0] + north / this._metres.north) * RADIAN;
    const scale = 2 ** zoom;
    return [((longitude + 180) / 360) * scale, ((1 - Math.asinh(Math.tan(latitude)) / Math.PI) / 2) * scale];
  }

  _positionOf(x, y, zoom) {
    const scale = 2 ** zoom;
    const longitude = (x / scale) * 360 - 180;
    const latitude = Math.atan(Math.sinh(Math.PI * (1 - (2 * y) / scale))) / RADIAN;
    return [(longitude - this._origin[1]) * this._metres.east, (latitude - this._origin[0]) * this._metres.north];
  }
}

/** Columns are counted round the globe: the one east of the last is the first. */
function path(zoom, x, y) {
  const count = 2 ** zoom;
  return `tiles/${zoom}/${((x % count) + count) % count}/${y}.png`;
}

/** On the WGS84 ellipsoid, as companion/geometry/frames.py. */
export function metresPerDegree(latitude) {
  const root = Math.sqrt(1 - WGS84_E2 * Math.sin(latitude * RADIAN) ** 2);
  return {
    north: ((WGS84_A_M * (1 - WGS84_E2)) / root ** 3) * RADIAN,
    east: (WGS84_A_M / root) * Math.cos(latitude * RADIAN) * RADIAN,
  };
}
