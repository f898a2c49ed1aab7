/** The buttons of the phase commands: which one comes next, and which the vehicles would refuse. They decide, not the page. */

import { isFlying } from "../phases.js";
import { html, nothing } from "./lit.js";

// Those with a hold time change what the vehicles do in a way that an accidental touch must not.
const ACTIONS = [
  { name: "doctor", title: "Check", text: "checks before flight; sends no command" },
  { name: "arm", title: "Arm", hold: 1, text: "prepares, then arms" },
  { name: "takeoff", title: "Take off", hold: 1, text: "climbs vertically, then the autopilot's hold" },
  { name: "form", title: "Form", hold: 1, text: "from hold into the formation" },
  { name: "hold", title: "Hold", text: "from formation into the autopilot's hold" },
  { name: "land", title: "Land", hold: 1, text: "vertically, at the present position" },
  { name: "return", title: "Return", hold: 1, text: "to each vehicle's home and down, by the autopilot" },
  { name: "disarm", title: "Disarm", hold: 1, text: "on the ground" },
  { name: "take", title: "Take command", text: "from another operator" },
];
// Of each command the phases that allow it, and whether that is on the ground: RULES of companion/types/flight.py.
const RULES = JSON.parse(document.getElementById("phase-rules").textContent);
const ON_THE_WAY = ["arm", "takeoff", "form"];
const DISARM_S = 10; // PX4's COM_DISARM_PRFLT and ArduCopter's DISARM_DELAY by default
const SAID_S = 60;

export function actions({ store, commanding, nowMs, act }) {
  const ids = commanding.targets;
  const meant = store.vehicles.filter((vehicle) => !ids?.length || ids.includes(vehicle.vehicle_id));
  const vehicles = meant.filter((vehicle) => !vehicle.silent);
  const next = nextOf(meant, store.formed);
  return html`<div class="actions">${ACTIONS.map((action) => button(action, { vehicles, next, commanding, act }))}</div>
    <p class="next-step" role="status">${step(next, vehicles, store, nowMs)}</p>`;
}

/**
 * The command that takes them on together: the first one of arm, takeoff and form that a vehicle waits for. None where
 * something went wrong: one is missing or in trouble in the air, some have landed, or they have left the formation.
 */
function nextOf(vehicles, formed) {
  const flying = vehicles.filter((vehicle) => isFlying(vehicle) || (vehicle.silent && vehicle.armed));
  if (flying.some(({ silent, flags }) => silent || flags.some(({ severity }) => severity === "critical"))) return null;
  const next = ON_THE_WAY.find((name) => vehicles.some((vehicle) => !vehicle.silent && accepts(name, vehicle)));
  if (next === "arm" && flying.length) return null;
  return next === "form" && vehicles.every(({ vehicle_id: id, phase }) => phase !== "hold" || formed.has(id)) ? null : (next ?? null);
}

function accepts(name, { phase, landed }) {
  const rule = RULES[name];
  const known = landed === "on_ground" || landed === "in_air";
  return !rule || (rule.phases.includes(phase) && (!known || (landed === "on_ground") === rule.on_ground));
}

/** Why the vehicle would refuse this command, as far as its report says; "" where it would not. */
function refusal(name, vehicle) {
  if (!accepts(name, vehicle)) return `${vehicle.vehicle_id} is in ${vehicle.phase}`;
  return name === "return" && vehicle.refuses_return ? `${vehicle.vehicle_id}: ${vehicle.refuses_return}` : "";
}

function button(action, { vehicles, next, commanding, act }) {
  const reasons = vehicles.map((vehicle) => refusal(action.name, vehicle)).filter(Boolean);
  const refused = vehicles.length > 0 && reasons.length === vehicles.length;
  const title = `${action.text}${action.hold ? "; hold for a second" : ""}${reasons.length ? `. Not possible: ${reasons.join(", ")}` : ""}`;
  const state = action.name === next ? "next" : refused ? "refused" : "";
  const send = () => commanding.send(action.name, commanding.targets);
  const early = () => act.hint(`Hold "${action.title}" for a second.`);
  const off = commanding.targets === null;
  return action.hold
    ? html`<button class=${state} data-action=${action.name} data-hold=${action.hold} ?disabled=${off} title=${title}
        aria-description=${title} @held=${send} @released=${early}>${action.title}</button>`
    : html`<button class=${state} data-action=${action.name} ?disabled=${off} title=${title} @click=${send}>${action.title}</button>`;
}

function step(next, vehicles, store, nowMs) {
  const timeS = store.snapshot.time_s + (store.freshness.ageS(nowMs) ?? 0);
  const armed = vehicles.filter((vehicle) => store.armed.has(vehicle.vehicle_id)).map((vehicle) => store.armed.get(vehicle.vehicle_id));
  if (armed.length && next === "takeoff") {
    const leftS = Math.max(0, Math.ceil(Math.min(...armed) + DISARM_S - timeS));
    return html`Next: <strong>Take off</strong>${leftS ? html` within <strong>${leftS} s</strong>` : " now"}: autopilots disarm some ${DISARM_S} s
      after they were armed.`;
  }
  const again = vehicles.filter((vehicle) => timeS - (store.disarmed.get(vehicle.vehicle_id) ?? -Infinity) < SAID_S);
  if (again.length) {
    return html`<strong class="warning">${again.length === 1 ? "Vehicle" : "Vehicles"} ${again.map((vehicle) => vehicle.vehicle_id).join(", ")} disarmed again</strong>: no take-off
      within some ${DISARM_S} s after arming.${next === "arm" ? html` Next: <strong>Arm</strong>.` : nothing}`;
  }
  return next ? html`Next: <strong>${ACTIONS.find((action) => action.name === next).title}</strong>.` : nothing;
}
