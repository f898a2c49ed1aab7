/** Everything about one selected vehicle. */

import { age, idList, known, metres, number, percent, quantity, vector, NONE } from "../format.js";
import { html, nothing } from "./lit.js";
import { prose } from "./prose.js";
import { logs } from "./logs.js";
import { symbol } from "./symbol.js";

export function details({ store, nowMs }) {
  const id = [...store.selected].at(-1);
  const vehicle = store.vehicles.find((candidate) => candidate.vehicle_id === id);
  if (!vehicle) return html`<p class="empty">Select a vehicle in the list or on the map: all its values appear here.</p>`;
  const ageS = vehicle.age_s + (store.freshness.ageS(nowMs) ?? 0);
  return html`<div class="heading"><h2>${symbol(vehicle)} Vehicle ${id}, ${vehicle.role}</h2>
      ${vehicle.silent ? html`<strong class="critical">SILENT for ${age(ageS)}: old values</strong>` : nothing}</div>
    ${problems(vehicle)}
    <dl class=${vehicle.silent ? "old" : ""}>${fields(vehicle, ageS).map(([name, value]) => field(name, value))}</dl>
    ${neighbours(vehicle)}
    ${logs(store, id)}`;
}

function field(name, value) {
  return html`<div><dt>${name}</dt><dd>${value || NONE}</dd></div>`;
}

function fields(vehicle, ageS) {
  return [...state(vehicle), ...formation(vehicle), ...link(vehicle, ageS), ...timing(vehicle)];
}

function state(vehicle) {
  const [horizontal, vertical] = vehicle.position_error_m ?? [null, null];
  return [
    ["Phase", vehicle.phase],
    ["Mode", `${vehicle.mode}, ${vehicle.armed ? "armed" : "disarmed"}`],
    ["Landed", vehicle.landed.replaceAll("_", " ")],
    ["Battery", percent(vehicle.battery_percent)],
    ["Position ENU (m)", vector(vehicle.position_enu_m, 2)],
    ["Velocity (m/s)", vector(vehicle.velocity_enu_m_s, 2)],
    ["1σ level, height (m)", known(horizontal) ? `${number(horizontal, 2)}, ${number(vertical, 2)}` : NONE],
    ["Wind (m/s²)", vector(vehicle.wind_acceleration_enu_m_s2, 2)],
    ["Hover thrust", number(vehicle.hover_thrust_norm, 3)],
  ];
}

function formation(vehicle) {
  const { nearest } = vehicle;
  const near = nearest ? `${nearest.name}, ${metres(nearest.distance_m)}` : NONE;
  return [
    ["Error to slot", metres(vehicle.error_to_slot_m)],
    ["Nearest", near],
    ["Required distance", metres(nearest?.required_m)],
    ["Filter changes", quantity(nearest?.changed_m_s2, 2, "m/s²")],
    ["PrC", String(vehicle.prc)],
    ["Leader", vehicle.leader_id === null ? "none" : `${vehicle.leader_id}, beacon ${age(vehicle.leader_beacon_age_s)}`],
    ["Epoch", String(vehicle.epoch)],
    ["Law", vehicle.law],
    ["Formation", vehicle.formation],
    ["Reference", vehicle.reference],
    ["Reference at (m)", vector(vehicle.reference_enu_m, 2)],
    ["Slot offset (m)", vector(vehicle.slot_offset_enu_m, 2)],
  ];
}

function link(vehicle, ageS) {
  const { network } = vehicle;
  const admission = known(network.admission) ? `, admission list ${network.admission}` : "";
  return [
    ["Last report", `${age(ageS)}, ${quantity(vehicle.report_rate_hz, 1, "Hz")}`],
    ["Age of position", age(vehicle.data_age_s)],
    ["Fresh peers", idList(vehicle.peers)],
    ["Security", `${network.security}${admission}`],
    ["Command held by", vehicle.holder],
    ["Rejected messages", String(vehicle.rejected)],
    ["Last event", vehicle.last_event],
  ];
}

function timing(vehicle) {
  const { timing } = vehicle;
  return [
    ["Agent rate", `${quantity(timing.rate_hz, 1, "Hz")}, ${timing.missed} missed`],
    ["Late p50, p99, max (ms)", vector([timing.late_p50_ms, timing.late_p99_ms, timing.late_max_ms], 2)],
    ["To command p50, p99 (ms)", vector([timing.telemetry_to_command_p50_ms, timing.telemetry_to_command_p99_ms])],
    ["Processor, memory", `${quantity(timing.cpu_percent, 0, "%")}, ${quantity(timing.memory_mb, 0, "MB")}`],
  ];
}

function problems(vehicle) {
  const lacks = [...vehicle.lacks.map((text) => ["Not ready", text])];
  if (vehicle.refuses_return) lacks.push(["Refuses return", vehicle.refuses_return]);
  if (!vehicle.flags.length && !lacks.length) return nothing;
  return html`<ul class="problems">
    ${vehicle.flags.map((flag) => html`<li class=${flag.severity}><strong>${flag.code}</strong> ${flag.text}.
      Agent: ${flag.action}. <em>${prose(flag.advice)}</em></li>`)}
    ${lacks.map(([name, text]) => html`<li class="info"><strong>${name}</strong> ${text}</li>`)}
  </ul>`;
}

function neighbours(vehicle) {
  if (!vehicle.neighbours.length) return nothing;
  return html`<table class="neighbours"><caption>Neighbours that the law uses</caption>
    <thead><tr><th scope="col">id</th><th scope="col" class="n">weight</th><th scope="col" class="n">age</th></tr></thead>
    <tbody>${vehicle.neighbours.map((neighbour) => html`<tr><th scope="row">${neighbour.vehicle_id}</th>
      <td class="n">${number(neighbour.weight, 3)}</td><td class="n">${age(neighbour.age_s)}</td></tr>`)}</tbody></table>`;
}
