/** Flight phases on the map and in the list. Each group has its own shape; the colour is that of the vehicle. */

const SQUARE = "M-9-9H9V9H-9Z";
const TRIANGLE_UP = "M0-13L13 9H-13Z";
const TRIANGLE_DOWN = "M0 13L13-9H-13Z";
const HEXAGON = "M-6-10H6L12 0L6 10H-6L-12 0Z";
const CIRCLE = "M-11 0a11 11 0 1 0 22 0a11 11 0 1 0-22 0Z";
const DIAMOND = "M0-13L13 0L0 13L-13 0Z";

const GROUND = { name: "ground", shape: SQUARE, filled: false, text: "on the ground: observe, prepare, ready" };
const ARMED = { name: "armed", shape: SQUARE, filled: true, text: "arm, armed" };
const TAKEOFF = { name: "takeoff", shape: TRIANGLE_UP, filled: true, text: "takeoff" };
const HOLD = { name: "hold", shape: HEXAGON, filled: false, text: "hold, release" };
const FORMATION = { name: "formation", shape: CIRCLE, filled: true, text: "engage, formation" };
const LAND = { name: "land", shape: TRIANGLE_DOWN, filled: true, text: "land" };
const OTHER = { name: "other", shape: CIRCLE, filled: false, text: "in the air, not by its agent: observe" };
const RETURN = { name: "return", shape: DIAMOND, filled: true, text: "return" };

export const GROUPS = [GROUND, ARMED, TAKEOFF, HOLD, FORMATION, LAND, RETURN, OTHER];

const GROUP_OF = new Map([
  ["observe", GROUND],
  ["prepare", GROUND],
  ["ready", GROUND],
  ["arm", ARMED],
  ["armed", ARMED],
  ["takeoff", TAKEOFF],
  ["hold", HOLD],
  ["release", HOLD],
  ["engage", FORMATION],
  ["formation", FORMATION],
  ["land", LAND],
  ["return", RETURN],
]);

/** An unknown phase is drawn as one on the ground: hollow and grey. */
export function groupOf(vehicle) {
  return isFlownByOther(vehicle) ? OTHER : (GROUP_OF.get(vehicle.phase) ?? GROUND);
}

const FLYING = new Set(["takeoff", "hold", "release", "engage", "formation", "land", "return"]);

/** Whether it is in the air: by its agent, its pilot or its autopilot. */
export function isFlying(vehicle) {
  return FLYING.has(vehicle.phase) || isFlownByOther(vehicle);
}

/** After a take-over by its pilot, or a start of its agent in the air. */
function isFlownByOther({ phase, armed, landed }) {
  return phase === "observe" && armed && landed !== "on_ground" && landed !== "undefined";
}
