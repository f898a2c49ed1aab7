/**
 * Fleet frame (ENU, metres) to canvas (pixels). The view from above and 3-D are one parallel projection: lengths of the
 * same direction have one scale everywhere, so that the scale bar is right in both.
 */

const LARGEST_TILT = (80 * Math.PI) / 180;
const LEAST_SCALE = 0.02; // px/m
const LARGEST_SCALE = 400;
const IN_3D = { tilt: (58 * Math.PI) / 180, azimuth: (-25 * Math.PI) / 180 };

export class Camera {
  constructor() {
    this.centre = [0, 0, 0];
    this.scale = 20; // px/m
    this.azimuth = 0; // direction of the upper edge, clockwise from north
    this.tilt = 0; // 0 from above
    this.width = 1;
    this.height = 1;
  }

  get is3d() {
    return this.tilt > 0.02;
  }

  /** Canvas x, y, and the depth: farther is larger. */
  project([x, y, z]) {
    const [u, v, w] = this._turned(x, y, z);
    const up = v * Math.cos(this.tilt) + w * Math.sin(this.tilt);
    const depth = v * Math.sin(this.tilt) - w * Math.cos(this.tilt);
    return [this.width / 2 + u * this.scale, this.height / 2 - up * this.scale, depth];
  }

  /** The point of the level plane at altitude `z` that is seen at canvas x, y. */
  unproject(px, py, z) {
    const u = (px - this.width / 2) / this.scale;
    const up = (this.height / 2 - py) / this.scale;
    const v = (up - (z - this.centre[2]) * Math.sin(this.tilt)) / Math.cos(this.tilt);
    const [c, s] = [Math.cos(this.azimuth), Math.sin(this.azimuth)];
    return [this.centre[0] + u * c + v * s, this.centre[1] - u * s + v * c, z];
  }

  panPixels(dx, dy) {
    const [x, y] = this.unproject(this.width / 2 - dx, this.height / 2 - dy, this.centre[2]);
    this.centre = [x, y, this.centre[2]];
  }

  /** The point under canvas x, y stays there. */
  zoom(factor, px = this.width / 2, py = this.height / 2) {
    const before = this.unproject(px, py, this.centre[2]);
    this.scale = clamp(this.scale * factor, LEAST_SCALE, LARGEST_SCALE);
    const after = this.unproject(px, py, this.centre[2]);
    this.centre = this.centre.map((value, i) => value + before[i] - after[i]);
  }

  rotate(byAzimuth, byTilt) {
    this.azimuth = Math.atan2(Math.sin(this.azimuth + byAzimuth), Math.cos(this.azimuth + byAzimuth));
    this.tilt = clamp(this.tilt + byTilt, 0, LARGEST_TILT);
  }

  toggle3d() {
    const next = this.is3d ? { tilt: 0, azimuth: 0 } : IN_3D;
    Object.assign(this, next);
  }

  northUp() {
    this.azimuth = 0;
  }

  /** The scale with which `fit` shows these points. */
  fittingScale(points, marginPx) {
    const probe = Object.assign(new Camera(), this);
    probe.fit(points, marginPx);
    return probe.scale;
  }

  /** All points in view, with a margin in pixels. */
  fit(points, marginPx) {
    if (!points.length) return;
    const box = [0, 1, 2].map((i) => extent(points.map((point) => point[i])));
    this.centre = box.map(([low, high]) => (low + high) / 2);
    const seen = points.map((point) => this._turned(...point));
    const ups = seen.map(([, v, w]) => v * Math.cos(this.tilt) + w * Math.sin(this.tilt));
    const [uLow, uHigh] = extent(seen.map(([u]) => u));
    const [upLow, upHigh] = extent(ups);
    const room = (size) => Math.max(40, size - 2 * marginPx);
    const scale = Math.min(room(this.width) / Math.max(uHigh - uLow, 3), room(this.height) / Math.max(upHigh - upLow, 3));
    this.scale = clamp(scale, LEAST_SCALE, LARGEST_SCALE);
    const [dx, dy] = [((uLow + uHigh) / 2) * this.scale, ((upLow + upHigh) / 2) * this.scale];
    this.panPixels(-dx, dy);
  }

  /** Whether all points are inside the canvas by at least this margin. */
  shows(points, marginPx) {
    const seen = points.map((point) => this.project(point));
    const [left, right] = extent(seen.map(([x]) => x));
    const [top, bottom] = extent(seen.map(([, y]) => y));
    return left >= marginPx && top >= marginPx && right <= this.width - marginPx && bottom <= this.height - marginPx;
  }

  _turned(x, y, z) {
    const [dx, dy] = [x - this.centre[0], y - this.centre[1]];
    const [c, s] = [Math.cos(this.azimuth), Math.sin(this.azimuth)];
    return [dx * c - dy * s, dx * s + dy * c, z - this.centre[2]];
  }
}

function extent(values) {
  return [Math.min(...values), Math.max(...values)];
}

function clamp(value, low, high) {
  return Math.min(high, Math.max(low, value));
}
