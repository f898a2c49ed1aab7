/** A change that is worked out on the map before it is sent: points of a reference, slots of a formation, where to go. */

import { formationState } from "./views/formation_form.js";
import { kindOf, WAYPOINTS } from "./views/reference_form.js";

const DEFAULT_ALTITUDE_M = 4;
const MOST_STEPS = 50;

export class Planning {
  /** `on.changed()`; `on.hint(text)`; `on.preview(name)` asks the vehicles again for what the form of this name has. */
  constructor(store, commanding, on) {
    this._store = store;
    this._commanding = commanding;
    this._on = on;
    this._steps = []; // what was before each step, for undo
    this._altitudeM = null;
    this._takesAccepted = false; // of the next answer
  }

  get canUndo() {
    return this._steps.length > 0;
  }

  /** Whether something is being worked out: then the view of the map stays. */
  get isActive() {
    return Boolean(this._store.drawing) || this.canUndo;
  }

  get altitudeM() {
    const present = this._store.referenceEnuM?.[2] ?? DEFAULT_ALTITUDE_M;
    return this._store.drawing?.altitudeM ?? this._altitudeM ?? Math.round(present * 10) / 10;
  }

  setAltitude(altitudeM) {
    this._altitudeM = altitudeM;
    if (this._store.drawing) this._store.drawing = { ...this._store.drawing, altitudeM };
    this._on.changed();
  }

  /** Begins to place points on the map, or pauses that. */
  place(most) {
    const { drawing } = this._store;
    const active = !drawing?.active || drawing.goes;
    this._store.drawing = { points: [], altitudeM: this.altitudeM, ...drawing, most, active, goes: false };
    this._on.changed();
  }

  get canGo() {
    return this._leader()?.phase === "formation";
  }

  /** The next click on the map is where the reference is to end. */
  go() {
    const began = this._store.drawing?.goes;
    this.cancel();
    const altitudeM = this._store.referenceEnuM?.[2];
    if (!began && this.canGo) this._store.drawing = { points: [], altitudeM, most: 1, active: true, goes: true };
    this._on.changed();
  }

  /** A click while points are placed. */
  clicked(point) {
    const { most, points, goes, altitudeM } = this._store.drawing;
    this._keep();
    if (goes) {
      const here = this._store.referenceEnuM ?? point;
      this._store.drawing = { points: [rounded(here), rounded(point)], altitudeM, most: WAYPOINTS.most, active: false, goes: false };
      kindOf(WAYPOINTS);
      this._takesAccepted = true;
      this._on.preview("reference");
      return;
    }
    this._store.drawing.points = most === 1 ? [rounded(point)] : [...points, rounded(point)].slice(0, most);
    this._commanding.discard();
  }

  setCoordinate(index, axis, value) {
    if (!Number.isFinite(value)) return;
    this._keep();
    this._setPoint(index, this._store.drawing.points[index].map((old, j) => (j === axis ? value : old)));
    this._commanding.discard();
  }

  /** Once after each `Go to`: it asks for no speed, so that the vehicles' own is taken where that of the form is refused. */
  takesAccepted() {
    const takes = this._takesAccepted;
    this._takesAccepted = false;
    return takes;
  }

  /** Those of a preview, with `path` in it. The slots go with the reference, as the fleet does. */
  paths() {
    const { preview } = this._store;
    const by = this._shift();
    return (preview?.paths ?? []).map((path) => ({
      vehicle_id: path.vehicle_id, from_enu_m: plus(path.from_enu_m, by), to_enu_m: plus(path.to_enu_m, by), path,
    }));
  }

  /** What can be dragged on the map: `at`, ENU in metres. */
  handles() {
    const { preview, drawing } = this._store;
    if (this._commanding.previewing) return []; // its answer would take their place
    const points = (drawing?.points ?? []).map((at, index) => ({ at, index }));
    const paths = preview?.name === "formation" ? this.paths() : [];
    return [...points, ...paths.map(({ to_enu_m: at, path }) => ({ at, path, from: path.to_enu_m }))];
  }

  drag(handle, point) {
    if (!this._isThere(handle)) return;
    if (!handle.moved) this._keep();
    handle.moved = true;
    if (handle.path) handle.path.to_enu_m = minus(point, this._shift());
    else this._setPoint(handle.index, rounded(point));
    if (this._store.preview) this._store.preview.pending = true;
    this._on.changed();
  }

  /** The end of a drag: the vehicles are asked again where they were asked before. */
  drop(handle) {
    if (!handle.moved || !this._isThere(handle)) return;
    const { preview } = this._store;
    if (handle.path) {
      formationState.setSlots(movedSlots(preview, handle));
      this._on.preview("formation");
    } else if (preview) this._on.preview("reference");
    else this._on.changed();
  }

  undo() {
    const before = this._steps.pop();
    if (!before) return;
    this._store.drawing = before.drawing;
    formationState.restore(before.formation);
    if (before.previewed) this._on.preview(before.previewed);
    else this._commanding.discard();
  }

  /** Without the points, the preview and the steps. */
  cancel() {
    this._store.drawing = null;
    this._steps = [];
    this._commanding.discard();
  }

  send() {
    const sent = this._commanding.sendPreviewed();
    this.cancel();
    return sent;
  }

  /** Another fleet is shown. */
  leave() {
    this.cancel();
    this._altitudeM = null;
    formationState.forgetSlots();
  }

  /** A preview of slots or of a reference that are not flown any more says nothing. */
  check() {
    if (!this._store.preview || this._store.preview.basis === this._store.flown) return;
    this.cancel();
    this._on.hint("The fleet flies another formation or reference now: preview again.");
  }

  _leader() {
    return this._store.vehicles.find((vehicle) => vehicle.reference_enu_m && !vehicle.silent);
  }

  /** How far the reference has gone since the preview. */
  _shift() {
    const [then, now] = [this._store.preview?.referenceEnuM, this._store.referenceEnuM];
    return then && now ? minus(now, then) : [0, 0, 0];
  }

  /** What is dragged may be gone by now, as the preview that it is of. */
  _isThere({ path, index }) {
    return path ? Boolean(this._store.preview?.paths.includes(path)) : index < (this._store.drawing?.points.length ?? 0);
  }

  _setPoint(index, point) {
    this._store.drawing.points = this._store.drawing.points.map((old, i) => (i === index ? point : old));
  }

  _keep() {
    const { drawing, preview } = this._store;
    const step = { drawing: drawing && { ...drawing }, formation: formationState.copy(), previewed: preview?.name };
    this._steps = [...this._steps, step].slice(-MOST_STEPS);
  }
}

/** The slots of a previewed formation, with that of the dragged vehicle moved: in the formation's own frame. */
function movedSlots({ slots_enu_m: slots, heading_rad: heading }, { path, from }) {
  const [dx, dy] = minus(path.to_enu_m, from);
  const [c, s] = [Math.cos(heading), Math.sin(heading)];
  const [x, y, z] = slots[path.vehicle_id];
  return { ...slots, [path.vehicle_id]: rounded([x + c * dx + s * dy, y - s * dx + c * dy, z]) };
}

function plus(a, b) {
  return a.map((value, axis) => value + b[axis]);
}

function minus(a, b) {
  return a.map((value, axis) => value - b[axis]);
}

function rounded(point) {
  return point.map((value) => Math.round(value * 100) / 100);
}
