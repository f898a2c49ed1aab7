/** The map: one canvas, its camera, and what it draws in which order. */

import { number } from "../format.js";
import { Camera } from "./camera.js";
import { listen } from "./gestures.js";
import { drawFence, drawGrid, drawHomes, drawNorth, drawObstacles, drawOrigin, drawScaleBar } from "./ground.js";
import { drawEdges, drawSlot } from "./links.js";
import { Labels } from "./labels.js";
import { Pen } from "./pen.js";
import { drawPoints, drawPreview, drawReference } from "./plan.js";
import { metresPerDegree, Tiles } from "./tiles.js";
import { drawSafetyDistance, drawSmallestSeparation, drawTrail, drawVehicle, trailBands } from "./vehicles.js";

const TOUCH_PX = 26; // how near to a vehicle a click selects it
const HANDLE_PX = 14; // likewise, of what the mouse drags
const MARGIN_PX = 104;
const LEAST_MARGIN_PX = 76; // the buttons with half a vehicle are that wide
const MOST_EMPTY = 2; // it is shown larger where it would be by this factor
const NOTE_TOP_PX = 8; // as in the style sheet
const NOTE_BOTTOM_PX = 24; // above an attribution
const NARROW_PX = 520;
const NOTE_APART_PX = 14;

export class FleetMap {
  /** `on.changed()` asks for a frame; `on.selected(id, several)`. */
  constructor({ canvas, cursor, note }, store, planning, on) {
    this._canvas = canvas;
    this._cursor = cursor;
    this._note = note;
    this._store = store;
    this._planning = planning;
    this._on = on;
    this._context = canvas.getContext("2d", { alpha: false });
    this.camera = new Camera();
    this._labels = new Labels();
    this.follows = true; // until the operator moves the map
    this._tiles = new Tiles(on.changed);
    this._resized = true;
    new ResizeObserver(() => {
      this._resized = true;
      on.changed();
    }).observe(canvas);
    listen(canvas, this.camera, {
      moved: () => {
        this.follows = false;
        on.changed();
      },
      clicked: (x, y, event) => this._clicked(x, y, event),
      grabbed: (x, y, event) => this._handleAt(x, y, event.pointerType === "mouse" ? HANDLE_PX : TOUCH_PX),
      dragged: (handle, x, y) => planning.drag(handle, this.camera.unproject(x, y, handle.at[2])),
      dropped: (handle) => planning.drop(handle),
      key: (key) => this._key(key),
      hovered: (at) => this._hovered(at),
    });
  }

  fit() {
    this.follows = true;
    this._fitTo(this._placed(), MARGIN_PX);
    this._on.changed();
  }

  toggle3d() {
    this.camera.toggle3d();
    this.fit();
  }

  northUp() {
    this.camera.northUp();
    this._on.changed();
  }

  zoom(factor) {
    this.follows = false;
    this.camera.zoom(factor);
    this._on.changed();
  }

  probeTiles(file) {
    this._tiles.probe(file);
  }

  get attribution() {
    return this._tiles.attribution;
  }

  draw(colours, nowMs) {
    if (this._resized) this._resize();
    const { camera, _store: store } = this;
    const shown = this._shown();
    const placed = this._placed();
    if (this._refits && placed.length && !this._suits(placed)) this._fitTo(placed, MARGIN_PX);
    const pen = new Pen(this._context, camera, colours);
    const ratio = devicePixelRatio;
    this._context.setTransform(ratio, 0, 0, ratio, 0, 0);
    this._context.fillStyle = colours.map;
    this._context.fillRect(0, 0, camera.width, camera.height);
    this._tiles.draw(pen);
    drawGrid(pen);
    drawOrigin(pen);
    this._drawPlace(pen, shown);
    const leaders = [...shown.values()].filter((vehicle) => vehicle.reference_enu_m && !vehicle.silent);
    drawReference(pen, store.file?.reference_enu_m ?? [], leaders);
    this._drawFleet(pen, shown, nowMs);
    const points = store.drawing?.points ?? [];
    if (store.preview) drawPreview(pen, store.preview, this._planning.paths(), points);
    drawPoints(pen, points);
    drawScaleBar(pen);
    drawNorth(pen);
    this._placeNote(placed.map((point) => camera.project(point)));
  }

  /** The note of what is placed leaves the upper edge, or the lower one, where it covers something; not below the pointer. */
  _placeNote(pointsPx) {
    const note = this._note;
    if (!note.childElementCount || note.matches(":hover, :focus-within")) return;
    const { offsetWidth, offsetHeight } = note;
    const left = note.getBoundingClientRect().left - this._canvas.getBoundingClientRect().left;
    const covers = (top) => pointsPx.some(([x, y]) =>
      x > left - NOTE_APART_PX && x < left + offsetWidth + NOTE_APART_PX && y > top - NOTE_APART_PX && y < top + offsetHeight + NOTE_APART_PX);
    const places = [NOTE_TOP_PX, this.camera.height - (this.camera.width > NARROW_PX ? NOTE_BOTTOM_PX : NOTE_TOP_PX) - offsetHeight];
    const isLow = note.classList.contains("low");
    if (covers(places[Number(isLow)]) && !covers(places[Number(!isLow)])) note.classList.toggle("low");
  }

  _drawPlace(pen, shown) {
    const file = this._store.file;
    if (!file) return;
    drawFence(pen, file);
    drawObstacles(pen, file);
    drawHomes(pen, file, new Set(shown.keys()));
  }

  _drawFleet(pen, shown, nowMs) {
    const store = this._store;
    const vehicles = [...shown.values()];
    const separationM = store.file?.separation_m ?? null;
    const bands = trailBands(vehicles.length);
    for (const vehicle of vehicles) drawTrail(pen, vehicle.vehicle_id, store.trails.of(vehicle), store.snapshot.time_s, bands);
    drawEdges(pen, shown);
    for (const vehicle of vehicles) drawSlot(pen, vehicle);
    if (separationM !== null) for (const vehicle of vehicles) drawSafetyDistance(pen, vehicle, separationM);
    const { fleet, selected: chosen } = store;
    const leaders = new Set(fleet?.leader_ids ?? []);
    const foremost = (v) => Number(chosen.has(v.vehicle_id) || v.silent || v.flags.length > 0);
    const depth = (v) => pen.camera.project(v.position_enu_m)[2];
    if (fleet) drawSmallestSeparation(pen, fleet, shown, separationM);
    for (const vehicle of vehicles.sort((a, b) => foremost(a) - foremost(b) || depth(b) - depth(a))) {
      const id = vehicle.vehicle_id;
      drawVehicle(pen, vehicle, { selected: chosen.has(id), leader: leaders.has(id) });
    }
    this._labels.draw(pen, shown, { chosen, leaders, fleet, separationM, sinceS: store.freshness.ageS(nowMs) ?? 0 });
  }

  /** Vehicles with a position, by id. */
  _shown() {
    return new Map(this._store.vehicles.filter((v) => v.data_age_s !== null).map((v) => [v.vehicle_id, v]));
  }

  _placed() {
    const vehicles = [...this._shown().values()];
    const points = vehicles.map((vehicle) => vehicle.position_enu_m);
    const slots = vehicles.map((vehicle) => vehicle.slot_position_enu_m).filter(Boolean);
    const planned = this._planning.paths().map((path) => path.to_enu_m);
    const ground = this.camera.is3d ? points.map(([x, y]) => [x, y, 0]) : [];
    const placing = this._store.drawing?.points ?? [];
    return [...points, ...slots, ...planned, ...placing, ...(this._store.preview?.track_enu_m ?? []), ...ground];
  }

  _fitTo(points, marginPx) {
    this.camera.fit(points, this._margin(marginPx, 5));
  }

  /** Not more than this part of the map. */
  _margin(marginPx, part) {
    return Math.min(marginPx, this.camera.width / part, this.camera.height / part);
  }

  /** Whether the points are in view, and not far too small, as after the preview of a wide formation. */
  _suits(points) {
    const { camera } = this;
    if (!camera.shows(points, this._margin(LEAST_MARGIN_PX, 6))) return false;
    return camera.fittingScale(points, this._margin(MARGIN_PX, 5)) < camera.scale * MOST_EMPTY;
  }

  /** In the frame that draws: a canvas that gets a size is empty. */
  _resize() {
    this._resized = false;
    const { clientWidth, clientHeight } = this._canvas;
    if (!clientWidth || !clientHeight) return;
    this._canvas.width = Math.round(clientWidth * devicePixelRatio);
    this._canvas.height = Math.round(clientHeight * devicePixelRatio);
    this.camera.width = clientWidth;
    this.camera.height = clientHeight;
    if (this._refits) this._fitTo(this._placed(), MARGIN_PX);
  }

  /** What is placed on the map, and dragged there, must not move away below the pointer. */
  get _refits() {
    return this.follows && !this._planning.isActive;
  }

  _handleAt(x, y, reachPx) {
    const distance = ({ at }) => {
      const [hx, hy] = this.camera.project(at);
      return Math.hypot(hx - x, hy - y);
    };
    const near = this._planning.handles().filter((handle) => distance(handle) <= reachPx);
    return near.sort((a, b) => distance(a) - distance(b))[0] ?? null;
  }

  _hovered(at) {
    this._cursor.textContent = at ? this._groundAt(...at) : "";
    this._canvas.classList.toggle("on-handle", Boolean(at && this._handleAt(...at, HANDLE_PX)));
  }

  _clicked(x, y, event) {
    if (this._store.drawing?.active) {
      this._planning.clicked(this.camera.unproject(x, y, this._store.drawing.altitudeM));
      return;
    }
    let nearest = null;
    for (const vehicle of this._shown().values()) {
      const [vx, vy] = this.camera.project(vehicle.position_enu_m);
      const distance = Math.hypot(vx - x, vy - y);
      if (distance <= TOUCH_PX && (!nearest || distance < nearest.distance)) nearest = { id: vehicle.vehicle_id, distance };
    }
    this._on.selected(nearest?.id ?? null, event.shiftKey || event.ctrlKey || event.metaKey);
  }

  /** The place on the ground under the pointer, as text; latitude and longitude where the fleet file is known. */
  _groundAt(px, py) {
    const [x, y] = this.camera.unproject(px, py, 0);
    const place = `${number(x, 1)} m east, ${number(y, 1)} m north`;
    const origin = this._store.file?.origin;
    if (!origin) return place;
    const { east, north } = metresPerDegree(origin[0]);
    return `${place}; ${(origin[0] + y / north).toFixed(7)}, ${(origin[1] + x / east).toFixed(7)}`;
  }

  _key(key) {
    const action = { f: () => this.fit(), 3: () => this.toggle3d(), n: () => this.northUp() }[key.toLowerCase()];
    action?.();
    return Boolean(action);
  }
}
