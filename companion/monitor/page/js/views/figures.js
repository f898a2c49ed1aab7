/** Figures of the whole fleet. */

import { age, idList, known, metres, number, pair, quantity } from "../format.js";
import { html, nothing } from "./lit.js";

const STEADY_M_S = 0.02;

export function figures({ store }) {
  const { fleet, vehicles, file } = store;
  const reporting = vehicles.filter((vehicle) => !vehicle.silent).length;
  const expected = fleet ? fleet.vehicle_ids.length + fleet.missing_ids.length : vehicles.length;
  const near = known(fleet?.smallest_separation_m) && file && fleet.smallest_separation_m < file.separation_m;
  return html`
    ${figure("Reporting", `${reporting} of ${expected}`, "", reporting < expected ? "critical" : "")}
    ${figure("Separation", metres(fleet?.smallest_separation_m), separationNote(fleet, file), near ? "critical" : "")}
    ${figure("Trend", trend(fleet?.separation_trend_m_s), trendNote(fleet?.separation_trend_m_s))}
    ${figure("Leader", idList(fleet?.leader_ids), "", fleet && !fleet.leader_ids.length ? "warning" : "")}
    ${figure("λ min", number(fleet?.lambda_min, 3), "of G")}
    ${figure("Settling", quantity(fleet?.settling_s, 1, "s"), "to a tenth")}
    ${figure("Link margin", metres(fleet?.link_margin_m, 1), pair(fleet?.link_margin_pair))}
    ${figure("Oldest data", age(fleet?.data_age_worst_s), "", fleet?.data_age_worst_s > 1 ? "warning" : "")}`;
}

function figure(name, value, note, state = "") {
  return html`<div class="figure ${state}"><span class="name">${name}</span>
    <span class="value">${value}</span>${note ? html`<span class="note">${note}</span>` : nothing}</div>`;
}

function separationNote(fleet, file) {
  const limit = file ? `limit ${metres(file.separation_m, 1)}` : "";
  const unheard = fleet?.smallest_separation_unheard ? `${fleet.smallest_separation_pair[1]} does not report` : "";
  return [pair(fleet?.smallest_separation_pair), unheard, limit].filter(Boolean).join(", ");
}

/** The sign as an arrow and a term, too. */
function trend(metresPerSecond) {
  if (!known(metresPerSecond)) return number(metresPerSecond, 2);
  const size = quantity(Math.abs(metresPerSecond), 2, "m/s");
  if (Math.abs(metresPerSecond) < STEADY_M_S) return "steady";
  return metresPerSecond < 0 ? `▼ ${size}` : `▲ ${size}`;
}

function trendNote(metresPerSecond) {
  if (!known(metresPerSecond) || Math.abs(metresPerSecond) < STEADY_M_S) return "over 5 s";
  return metresPerSecond < 0 ? "closing, over 5 s" : "opening, over 5 s";
}
