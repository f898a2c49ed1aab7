/** The vehicles on the map: symbol by phase in the vehicle's colour, heading by velocity, leader, selection, safety distance, silence. */

import { isFlying, groupOf } from "../phases.js";
import { colourOf } from "../vehicle_look.js";
import { isNear, nearestPair } from "./labels.js";

const SHAPES = new Map();
const MOVES_M_S = 0.15; // slower ones have no heading
const PREDICTED_S = 1; // length of the heading line
const MANY = 16; // of a larger fleet, trails are short

export function drawVehicle(pen, vehicle, { selected, leader }) {
  const [x, y] = pen.camera.project(vehicle.position_enu_m);
  if (pen.camera.is3d) drawStem(pen, vehicle, x, y);
  if (!vehicle.silent) drawHeading(pen, vehicle, x, y);
  drawSymbol(pen, vehicle, x, y);
  if (leader) drawRing(pen, x, y, 16.5, { colour: "text", width: 2 });
  if (selected) drawRing(pen, x, y, 21, { colour: "accent", width: 3, dash: [7, 4] });
  if (leader) pen.text("★", x + 15, y - 15, { size: 14, weight: 700 });
  if (vehicle.flags.length && !vehicle.silent) drawMark(pen, x - 15, y - 15, vehicle.flags);
}

/** Circles of half the distance: two that touch are at separation_m. */
export function drawSafetyDistance(pen, vehicle, separationM) {
  if (!isFlying(vehicle) && !vehicle.silent) return;
  pen.circle(vehicle.position_enu_m, separationM / 2, { colour: "quiet", dash: [2, 3], alpha: 0.9 });
}

/** A line between two vehicles that are about as near as they may be. */
export function drawSmallestSeparation(pen, fleet, vehicles, separationM) {
  const pair = nearestPair(fleet, vehicles);
  if (!pair || !isNear(fleet, separationM)) return;
  pen.pixels(pair.map((vehicle) => pen.camera.project(vehicle.position_enu_m)), { colour: "critical", width: 2, dash: [3, 3] });
}

/** [from, to, opacity] in seconds of age. */
export function trailBands(vehicleCount) {
  return vehicleCount > MANY ? [[15, 0, 0.7]] : [[60, 30, 0.25], [30, 12, 0.5], [12, 0, 0.85]];
}

/** Paler where it is older. `bands`: trailBands(...). */
export function drawTrail(pen, id, trail, nowS, bands) {
  for (const [fromS, toS, alpha] of bands) {
    const points = trail.filter(({ timeS }) => nowS - timeS <= fromS + 0.6 && nowS - timeS >= toS - 0.6);
    if (points.length > 1) pen.line(points.map(({ position }) => position), { colour: colourOf(id), width: 1.4, alpha });
  }
}

function drawSymbol(pen, vehicle, x, y) {
  const group = groupOf(vehicle);
  const { context, colours } = pen;
  const colour = colours[vehicle.silent ? "critical" : colourOf(vehicle.vehicle_id)];
  const filled = group.filled && !vehicle.silent;
  context.save();
  context.translate(x, y);
  context.fillStyle = filled ? colour : colours.panel;
  context.fill(shapeOf(group));
  context.setLineDash(vehicle.silent ? [3, 3] : []);
  context.strokeStyle = colour;
  context.lineWidth = 2.2;
  context.stroke(shapeOf(group));
  context.restore();
  if (vehicle.silent) {
    pen.pixels([[x - 12, y - 12], [x + 12, y + 12]], { colour: "critical", width: 2 });
    pen.pixels([[x - 12, y + 12], [x + 12, y - 12]], { colour: "critical", width: 2 });
  }
  const ink = filled ? `on-${colourOf(vehicle.vehicle_id)}` : "text";
  pen.text(String(vehicle.vehicle_id), x, y + 0.5, { colour: ink, size: 12, weight: 700, bare: !vehicle.silent });
}

function shapeOf(group) {
  if (!SHAPES.has(group.shape)) SHAPES.set(group.shape, new Path2D(group.shape));
  return SHAPES.get(group.shape);
}

function drawHeading(pen, vehicle, x, y) {
  const velocity = vehicle.velocity_enu_m_s;
  const speed = Math.hypot(velocity[0], velocity[1]);
  if (!isFlying(vehicle) || speed < MOVES_M_S) return;
  const ahead = vehicle.position_enu_m.map((value, i) => value + velocity[i] * PREDICTED_S);
  const [ax, ay] = pen.camera.project(ahead);
  const length = Math.max(1, Math.hypot(ax - x, ay - y));
  const [dx, dy] = [(ax - x) / length, (ay - y) / length];
  const reach = Math.max(length, 24);
  const tip = [x + dx * reach, y + dy * reach];
  pen.pixels([[x, y], tip], { colour: "text", width: 2 });
  const wing = (side) => [tip[0] - dx * 7 - side * dy * 4.5, tip[1] - dy * 7 + side * dx * 4.5];
  pen.pixels([wing(1), tip, wing(-1)], { colour: "text", width: 2 });
}

/** From the vehicle down to its point on the ground. */
function drawStem(pen, vehicle, x, y) {
  const [east, north] = vehicle.position_enu_m;
  const [gx, gy] = pen.camera.project([east, north, 0]);
  pen.pixels([[x, y], [gx, gy]], { colour: "quiet", width: 1, alpha: 0.7 });
  pen.circle([east, north, 0], 3 / pen.camera.scale, { colour: "quiet", width: 2 });
}

function drawRing(pen, x, y, radius, style) {
  const points = Array.from({ length: 33 }, (_, i) => (i * Math.PI) / 16);
  pen.pixels(points.map((angle) => [x + radius * Math.cos(angle), y + radius * Math.sin(angle)]), style);
}

function drawMark(pen, x, y, flags) {
  const colour = flags.some((flag) => flag.severity === "critical") ? "critical" : "warning";
  pen.text("▲", x, y, { colour, size: 16 });
  pen.text("!", x, y + 1, { colour: "panel", size: 10, weight: 700, bare: true });
}
