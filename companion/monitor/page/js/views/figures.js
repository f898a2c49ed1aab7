/** Figures of the whole fleet. */

import { age, idList, known, metres, NONE, number, pair, percent, quantity } from "../format.js";
import { html, nothing } from "./lit.js";

const STEADY_M_S = 0.02;
const CALM_M_S2 = 0.1;
const GRAVITY_M_S2 = 9.81;
const LOW_BATTERY_PERCENT = 25;

/** What an operator looks at first; the figures of the law are one click deeper. */
export function figures({ store }) {
  const { fleet, vehicles, file } = store;
  const reporting = vehicles.filter((vehicle) => !vehicle.silent).length;
  const expected = fleet ? fleet.vehicle_ids.length + fleet.missing_ids.length : vehicles.length;
  const near = known(fleet?.smallest_separation_m) && file && fleet.smallest_separation_m < file.separation_m;
  const battery = fleet?.battery_lowest;
  return html`
    ${figure("Reporting", store.snapshot ? `${reporting} of ${expected}` : NONE, "", reporting < expected ? "critical" : "")}
    ${figure("Separation", metres(fleet?.smallest_separation_m), separationNote(fleet, file), near ? "critical" : "")}
    ${figure("Trend", trend(fleet?.separation_trend_m_s), trendNote(fleet?.separation_trend_m_s))}
    ${figure("Leader", idList(fleet?.leader_ids), "", fleet && !fleet.leader_ids.length ? "warning" : "")}
    ${figure("Lowest battery", percent(battery?.percent), batteryNote(battery), battery?.percent < LOW_BATTERY_PERCENT ? "warning" : "")}
    ${figure("Wind", wind(fleet?.wind_acceleration_enu_m_s2), lean(fleet?.wind_acceleration_enu_m_s2))}
    ${figure("Position error", metres(fleet?.position_error_worst_m), "largest, 1σ")}
    ${figure("Oldest data", age(fleet?.data_age_worst_s), "", fleet?.data_age_worst_s > 1 ? "warning" : "")}
    <details class="law"><summary>Law</summary><div>
      ${figure("λ min", number(fleet?.lambda_min, 3), "of G")}
      ${figure("Settling", quantity(fleet?.settling_s, 1, "s"), "to a tenth")}
      ${figure("Link margin", metres(fleet?.link_margin_m, 1), marginNote(fleet, file))}
    </div></details>`;
}

/** Which link, or why there is none with a margin. */
function marginNote(fleet, file) {
  if (fleet?.link_margin_pair) return pair(fleet.link_margin_pair);
  if (!file) return "needs the fleet file";
  return file.range_m === null ? "edges: no range" : "none in formation";
}

function batteryNote(battery) {
  if (!battery) return "";
  const left = known(battery.left_min) ? `, ${number(battery.left_min, 0)} min left` : "";
  return `vehicle ${battery.vehicle_id}${left}`;
}

const WINDS = ["E", "NE", "N", "NW", "W", "SW", "S", "SE"];

/** Its push on a vehicle, and where it comes from. */
function wind(accelerationEnu) {
  if (!accelerationEnu) return NONE;
  const [east, north] = accelerationEnu;
  const size = Math.hypot(east, north);
  const text = quantity(size, 1, "m/s²");
  if (size < CALM_M_S2) return text;
  const from = Math.round(Math.atan2(-north, -east) / (Math.PI / 4));
  return `${text} ${WINDS[(from + 8) % 8]}`;
}

/** By how much a vehicle leans to stay in place in it. */
function lean(accelerationEnu) {
  if (!accelerationEnu) return "mean push";
  const angleDeg = (Math.atan2(Math.hypot(accelerationEnu[0], accelerationEnu[1]), GRAVITY_M_S2) * 180) / Math.PI;
  return `mean push, a lean of ${number(angleDeg, 0)}°`;
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
