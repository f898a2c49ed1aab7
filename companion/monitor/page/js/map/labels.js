/** The texts beside the vehicles. None overlaps another one or a symbol: it is moved, or left out. */

import { age, metres } from "../format.js";
import { isFlying } from "../phases.js";

const LABELLED = 16; // of a larger fleet only selected and alarming vehicles have a text
const NEAR_RATIO = 1.15; // of separation_m: a smaller distance alarms
const SYMBOL_PX = 13;
const RING_PX = { leader: 17, selected: 22 };
const GAP_PX = [2, 1];
const NEW_GAP_PX = [6, 2]; // for a place that the text did not have in the frame before: it does not jump to and fro
const FIRST_PX = 26; // between the symbol and the middle of the text
const LINE_PX = 14;
const FAR_PX = [56, 84, 120, 160]; // of a text that must be seen, in a crowd
const FAR_DIRECTIONS = 16;
const MUST_BE_SEEN = 3; // ranks up to this one

export class Labels {
  constructor() {
    this._spots = new Map(); // of the last frame: key of a text -> the number of its place
  }

  /** `vehicles` are those shown, by id; `chosen` and `leaders` sets of ids; `sinceS` since the snapshot. */
  draw(pen, vehicles, { chosen, leaders, fleet, separationM, sinceS }) {
    const shown = [...vehicles.values()];
    const taken = cornerBoxes(pen.camera).concat(shown.flatMap((vehicle) => symbolBoxes(pen, vehicle, chosen, leaders)));
    const texts = shown.map((vehicle) => vehicleText(pen, vehicle, { chosen, leaders, few: shown.length <= LABELLED, sinceS }));
    texts.push(separationText(pen, fleet, vehicles, separationM));
    const before = this._spots;
    this._spots = new Map();
    for (const text of texts.filter(Boolean).sort((a, b) => a.rank - b.rank)) this._place(pen, text, taken, before.get(text.key));
  }

  _place(pen, { key, text, at, beside, rank, style }, taken, last) {
    const half = [pen.widthOf(text, style) / 2, style.size * 0.6];
    const near = beside(...at, half[0]);
    const places = rank <= MUST_BE_SEEN ? near.concat(farFrom(...at)) : near;
    const found = places.findIndex(([x, y], i) => {
      const box = boxAbout(x, y, half, i === last ? GAP_PX : NEW_GAP_PX);
      return isInView(pen.camera, x, y, half) && !taken.some((other) => overlap(box, other));
    });
    if (found < 0) return;
    const [x, y] = places[found];
    if (found >= near.length) pen.pixels([at, [x, y]], { colour: style.colour ?? "text", width: 1 });
    pen.text(text, x, y, style);
    taken.push(boxAbout(x, y, half));
    this._spots.set(key, found);
  }
}

/** Whether the two nearest vehicles are about as near as they may be. */
export function isNear(fleet, separationM) {
  return separationM !== null && fleet.smallest_separation_m < separationM * NEAR_RATIO;
}

/** The vehicles of the smallest separation, where both are seen. */
export function nearestPair(fleet, vehicles) {
  const found = (fleet?.smallest_separation_pair ?? []).map((id) => vehicles.get(id));
  return found.length === 2 && found.every((vehicle) => vehicle && !vehicle.silent) ? found : null;
}

function vehicleText(pen, vehicle, { chosen, leaders, few, sinceS }) {
  const { vehicle_id: id, silent, phase, position_enu_m: place } = vehicle;
  const alarms = silent || vehicle.flags.length > 0;
  if (!few && !alarms && !chosen.has(id)) return null;
  const height = isFlying(vehicle) ? ` ${metres(place[2], 1)}` : "";
  const text = silent ? `SILENT ${age(vehicle.age_s + sinceS)}` : `${phase}${height}`;
  const style = silent ? { colour: "critical", size: 12, weight: 700 } : { size: 11 };
  const rank = chosen.has(id) ? 0 : silent ? 1 : alarms ? 2 : leaders.has(id) ? 4 : 5;
  return { key: id, text, style, rank, at: pen.camera.project(place).slice(0, 2), beside: about };
}

function separationText(pen, fleet, vehicles, separationM) {
  const found = nearestPair(fleet, vehicles);
  if (!found) return null;
  const near = isNear(fleet, separationM);
  const [from, to] = found.map((vehicle) => pen.camera.project(vehicle.position_enu_m));
  return {
    key: "separation",
    text: metres(fleet.smallest_separation_m),
    style: { colour: near ? "critical" : "text", size: 12, weight: 700 },
    rank: near ? 3 : 6,
    at: [(from[0] + to[0]) / 2, (from[1] + to[1]) / 2],
    beside: (x, y) => [[x, y]],
  };
}

/** Places of a text about a symbol: below, above, beside, and farther away. */
function about(x, y, halfWidth) {
  const aside = FIRST_PX + halfWidth - 4;
  return [
    [x, y + FIRST_PX],
    [x, y - FIRST_PX - 2],
    [x + aside, y],
    [x - aside, y],
    [x, y + FIRST_PX + LINE_PX],
    [x, y - FIRST_PX - LINE_PX],
  ];
}

function farFrom(x, y) {
  const angles = Array.from({ length: FAR_DIRECTIONS }, (_, i) => Math.PI / 2 + (i * 2 * Math.PI) / FAR_DIRECTIONS);
  return FAR_PX.flatMap((far) => angles.map((angle) => [x + far * 1.3 * Math.cos(angle), y + far * Math.sin(angle)]));
}

/** What a symbol takes, with its star or triangle. */
function symbolBoxes(pen, vehicle, chosen, leaders) {
  const { vehicle_id: id, position_enu_m: place } = vehicle;
  const [x, y] = pen.camera.project(place);
  const leads = leaders.has(id);
  const reach = chosen.has(id) ? RING_PX.selected : leads ? RING_PX.leader : SYMBOL_PX;
  const boxes = [boxAbout(x, y, [reach, reach])];
  if (leads) boxes.push(boxAbout(x + 15, y - 15, [8, 8]));
  if (vehicle.flags.length && !vehicle.silent) boxes.push(boxAbout(x - 15, y - 15, [8, 8]));
  return boxes;
}

/** Scale bar, north, and below the buttons and the legend. */
function cornerBoxes({ width, height }) {
  return [[0, height - 40, 150, height], [width - 60, height - 70, width, height], [width - 62, 0, width, 240], [0, 0, 110, 36]];
}

/** [left, top, right, bottom] */
function boxAbout(x, y, [halfWidth, halfHeight], [gapX, gapY] = [0, 0]) {
  return [x - halfWidth - gapX, y - halfHeight - gapY, x + halfWidth + gapX, y + halfHeight + gapY];
}

function overlap(a, b) {
  return a[0] < b[2] && b[0] < a[2] && a[1] < b[3] && b[1] < a[3];
}

function isInView({ width, height }, x, y, [halfWidth, halfHeight]) {
  return x >= halfWidth && x <= width - halfWidth && y >= halfHeight && y <= height - halfHeight;
}
