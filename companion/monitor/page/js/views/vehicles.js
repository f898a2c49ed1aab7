/** The list of vehicles: one row each, below it what is wrong. */

import { age, number } from "../format.js";
import { html, noChange, nothing, repeat } from "./lit.js";
import { outOfSight } from "./sight.js";
import { symbol } from "./symbol.js";

const LOW_BATTERY_PERCENT = 25;
const OLD_DATA_S = 1;
const THIS_COMPUTER = /\/(127\.|localhost|\[::1\])/; // in an endpoint
const MOST_ENDPOINTS = 5; // of those that are not reached

export function vehicles({ store, nowMs, act }) {
  const sinceS = store.freshness.ageS(nowMs) ?? 0;
  return html`
    <div class="heading"><h2>Vehicles</h2>${selectionButtons(store, act)}</div>
    <table class="fleet">
      <thead><tr>
        <th scope="col">id</th><th scope="col">phase</th><th scope="col" class="mode">mode</th>
        <th scope="col" class="n battery">battery %</th><th scope="col" class="n">altitude m</th><th scope="col" class="n error">error m</th>
        <th scope="col" class="n">nearest m</th><th scope="col" class="n">age</th>
      </tr></thead>
      ${repeat(store.vehicles, (vehicle) => vehicle.vehicle_id, (vehicle) =>
        outOfSight(vehicle.vehicle_id, nowMs) ? noChange : rows(vehicle, store, sinceS, act))}
      ${store.vehicles.length ? missing(store.fleet?.missing_ids ?? []) : nothing}
    </table>
    ${store.vehicles.length ? nothing : none(store)}`;
}

/** Why there is no vehicle, and what starts some. */
function none({ snapshot }) {
  if (!snapshot || snapshot.replay) return html`<p class="empty">No vehicle has reported yet.</p>`;
  const { connected, unreachable } = snapshot;
  const here = unreachable.every((endpoint) => THIS_COMPUTER.test(endpoint));
  const more = unreachable.length - MOST_ENDPOINTS;
  return html`<div class="empty"><p>No vehicle has reported yet.</p>
    ${connected.length ? html`<p>Connected to ${connected.join(", ")}; its first report is awaited.</p>` : nothing}
    ${unreachable.length ? html`<p>Not reached:</p>
      <ul>${unreachable.slice(0, MOST_ENDPOINTS).map((one) => html`<li>${one}</li>`)}
        ${more > 0 ? html`<li>and ${more} more</li>` : nothing}</ul>` : nothing}
    ${connected.length ? nothing : html`<p>On each vehicle <code>companion agent --config VEHICLE.yaml</code> starts an agent${
      here ? html`, <code>sitl fleet platoon</code> on this computer the simulated fleet platoon` : nothing}. The page connects by itself.</p>`}</div>`;
}

function selectionButtons(store, act) {
  if (!store.selected.size) return html`<span class="quiet">click selects, Shift adds</span>`;
  return html`<button class="small" @click=${() => act.select(null, false)}>Select none</button>`;
}

function rows(vehicle, store, sinceS, act) {
  const id = vehicle.vehicle_id;
  const selected = store.selected.has(id);
  const leader = store.fleet?.leader_ids.includes(id);
  const ageS = vehicle.age_s + sinceS;
  return html`<tbody class="vehicle ${vehicle.silent ? "silent" : ""} ${selected ? "selected" : ""}" data-id=${id}
      @click=${(event) => act.select(id, event.shiftKey || event.ctrlKey || event.metaKey)}>
    <tr>
      <th scope="row"><button class="pick" aria-pressed=${selected}
        aria-label="Vehicle ${id}${leader ? ", leader" : ""}">${symbol(vehicle)}<span>${id}</span>${
        leader ? html`<span class="leader" title="leader">★</span>` : nothing}</button></th>
      <td>${vehicle.silent ? html`<strong class="critical">SILENT</strong>` : vehicle.phase}</td>
      <td class="mode">${vehicle.mode}${vehicle.armed ? nothing : html`<span class="quiet"> disarmed</span>`}</td>
      <td class="n battery ${vehicle.battery_percent < LOW_BATTERY_PERCENT && vehicle.battery_percent !== null ? "warning" : ""}"
        >${number(vehicle.battery_percent, 0)}</td>
      <td class="n">${number(vehicle.data_age_s > OLD_DATA_S && !vehicle.silent ? null : vehicle.position_enu_m?.[2], 1)}</td>
      <td class="n error">${number(vehicle.error_to_slot_m, 2)}</td>
      <td class="n ${nearness(vehicle.nearest)}">${number(vehicle.nearest?.distance_m, 2)}</td>
      <td class="n ${vehicle.silent ? "critical" : vehicle.data_age_s > OLD_DATA_S ? "warning" : ""}"
        >${age(vehicle.silent ? ageS : vehicle.data_age_s)}</td>
    </tr>
    ${note(vehicle, ageS)}
  </tbody>`;
}

/** Vehicles of the fleet file that never reported. */
function missing(ids) {
  return ids.map((id) => html`<tbody class="vehicle silent" data-missing=${id}>
    <tr><th scope="row">${id}</th><td colspan="4" class="warning">no report yet</td><td class="error"></td><td class="battery"></td><td class="mode"></td></tr></tbody>`);
}

function note(vehicle, ageS) {
  if (vehicle.silent) {
    return html`<tr class="note critical"><td colspan="5">no report for ${age(ageS)}; the values are those of before</td><td class="error"></td><td class="battery"></td><td class="mode"></td></tr>`;
  }
  if (!vehicle.flags.length) return nothing;
  const severity = vehicle.flags.some((flag) => flag.severity === "critical") ? "critical" : "warning";
  const texts = vehicle.flags.map((flag) => `${flag.code}: ${flag.text}. Agent: ${flag.action}. ${flag.advice.replaceAll("`", "")}`);
  return html`<tr class="note ${severity}"><td colspan="5">${texts.join(" ")}</td><td class="error"></td><td class="battery"></td><td class="mode"></td></tr>`;
}

function nearness(nearest) {
  if (!nearest) return "";
  if (nearest.distance_m < nearest.required_m) return "critical";
  return nearest.changed_m_s2 > 0 ? "warning" : "";
}
