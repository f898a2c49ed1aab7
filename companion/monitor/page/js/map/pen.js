/** Drawing in metres: a canvas context with a camera and the colours of the theme. */

const OUTLINE_PX = 3; // both sides together
const OUTLINE_ALPHA = 0.75;
const BARE = new Set(["grid", "edge"]); // without one: seen on any tiles, or not needed there

export class Pen {
  constructor(context, camera, colours) {
    this.context = context;
    this.camera = camera;
    this.colours = colours;
    this.overTiles = false; // then lines have an outline as texts do: tiles may have any colour
  }

  /** A line through points of the fleet frame. */
  line(points, style) {
    this._path(points);
    this._stroke(style);
  }

  polygon(points, { fill, fillAlpha = 1, ...style }) {
    this._path(points);
    this.context.closePath();
    if (fill) {
      this.context.globalAlpha = fillAlpha;
      this.context.fillStyle = this.colours[fill];
      this.context.fill();
    }
    this._stroke(style);
  }

  /** A level circle. */
  circle(centre, radiusM, style) {
    const [x, y] = this.camera.project(centre);
    const radius = radiusM * this.camera.scale;
    this.context.beginPath();
    this.context.ellipse(x, y, radius, radius * Math.cos(this.camera.tilt), 0, 0, 2 * Math.PI);
    this._stroke(style);
  }

  /** A line between points of the canvas. */
  pixels(points, style) {
    this.context.beginPath();
    points.forEach(([x, y], i) => (i ? this.context.lineTo(x, y) : this.context.moveTo(x, y)));
    this._stroke(style);
  }

  /** With an outline in the colour of the map, so that lines behind it do not disturb. */
  text(text, x, y, { colour = "text", size = 12, weight = 400, align = "center", bare = false } = {}) {
    const context = this.context;
    context.font = fontOf(size, weight);
    context.textAlign = align;
    context.textBaseline = "middle";
    if (!bare) {
      context.lineWidth = 3;
      context.lineJoin = "round";
      context.strokeStyle = this.colours.map;
      context.strokeText(text, x, y);
    }
    context.fillStyle = this.colours[colour];
    context.fillText(text, x, y);
  }

  widthOf(text, { size = 12, weight = 400 }) {
    this.context.font = fontOf(size, weight);
    return this.context.measureText(text).width;
  }

  _path(points) {
    this.context.beginPath();
    for (let i = 0; i < points.length; i += 1) {
      const [x, y] = this.camera.project(points[i]);
      if (i) this.context.lineTo(x, y);
      else this.context.moveTo(x, y);
    }
  }

  _stroke({ colour, width = 1, dash = [], alpha = 1 }) {
    const context = this.context;
    if (!colour) {
      context.globalAlpha = 1;
      return;
    }
    if (this.overTiles && !BARE.has(colour)) {
      context.globalAlpha = alpha * OUTLINE_ALPHA;
      context.strokeStyle = this.colours.map;
      context.lineWidth = width + OUTLINE_PX;
      context.stroke();
    }
    context.globalAlpha = alpha;
    context.strokeStyle = this.colours[colour];
    context.lineWidth = width;
    context.setLineDash(dash);
    context.stroke();
    context.setLineDash([]);
    context.globalAlpha = 1;
  }
}

function fontOf(size, weight) {
  return `${weight} ${size}px system-ui, "Liberation Sans", "DejaVu Sans", sans-serif`;
}
