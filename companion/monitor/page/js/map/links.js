/** Slots and interaction edges. */

const FRESH_S = 0.3;
const ASIDE_PX = 3; // the two directions of an edge run side by side

export function drawSlot(pen, vehicle) {
  if (!vehicle.slot_position_enu_m || vehicle.silent) return;
  const [x, y] = pen.camera.project(vehicle.slot_position_enu_m);
  pen.line([vehicle.position_enu_m, vehicle.slot_position_enu_m], { colour: "quiet", width: 1, dash: [2, 2] });
  const corners = [[-9, 0], [0, -9], [9, 0], [0, 9], [-9, 0]].map(([dx, dy]) => [x + dx, y + dy]);
  pen.pixels(corners, { colour: "quiet", width: 1.5 });
}

/** Who uses whom, with the weight as width: along the right side of the way from the neighbour to its user. */
export function drawEdges(pen, vehicles) {
  for (const vehicle of vehicles.values()) {
    if (vehicle.silent) continue;
    for (const neighbour of vehicle.neighbours) {
      const other = vehicles.get(neighbour.vehicle_id);
      if (other) drawEdge(pen, other, vehicle, neighbour);
    }
  }
}

function drawEdge(pen, from, to, neighbour) {
  const [x0, y0] = pen.camera.project(from.position_enu_m);
  const [x1, y1] = pen.camera.project(to.position_enu_m);
  const length = Math.max(1, Math.hypot(x1 - x0, y1 - y0));
  const [sx, sy] = [(-(y1 - y0) / length) * ASIDE_PX, ((x1 - x0) / length) * ASIDE_PX];
  const late = neighbour.age_s === null || neighbour.age_s > FRESH_S;
  pen.pixels([[x0 + sx, y0 + sy], [x1 + sx, y1 + sy]], {
    colour: late ? "warning" : "edge",
    width: neighbour.weight === null ? 1 : 0.6 + 4.4 * Math.max(0, Math.min(1, neighbour.weight)),
    dash: late ? [6, 6] : [],
    alpha: 0.8,
  });
}
