/** The logs of a vehicle: what this computer has, for download, and how to fetch what only the vehicle has. */

import { clock, number } from "../format.js";
import { html, nothing } from "./lit.js";

const MOST = 8;
const KINDS = { recording: "recording", MAVLink: "MAVLink (.tlog)", autopilot: "log of the autopilot" };

export function logs({ logs }, id) {
  if (!logs) return nothing;
  const own = logs.files.filter((file) => file.vehicle_id === id);
  const ground = logs.files.filter((file) => file.vehicle_id === null);
  return html`<section class="logs" aria-label="Logs of vehicle ${id}"><h3>Logs</h3>
    ${files(own)}${files(ground)}
    ${own.length + ground.length ? nothing : html`<p>${logs.has_folder ? "None on the ground yet." : "The monitor has none: it needs --record or --replay."}</p>`}
    <p>From the vehicle, after its flight: the log of its autopilot, on board and with its agent stopped, by
      <code>companion logs --config /etc/companion/vehicle-${id}.yaml --get last</code>, its recordings by
      <code>scp 'HOST:/var/lib/companion/recordings/vehicle_${id}_*' .</code></p></section>`;
}

function files(all) {
  if (!all.length) return nothing;
  return html`<ul>${all.slice(0, MOST).map((file) => html`<li><a href="api/v1/logs/${file.id}" download=${file.name}>${file.name}</a>
    <span class="quiet">${file.vehicle_id === null ? "ground, all vehicles" : KINDS[file.kind]}, ${size(file.bytes)}, ${day(file.written_s)}</span></li>`)}
    ${all.length > MOST ? html`<li class="quiet">and ${all.length - MOST} older ones</li>` : nothing}</ul>`;
}

function size(bytes) {
  return bytes < 1e6 ? `${number(bytes / 1e3, 0)}\u00a0kB` : `${number(bytes / 1e6, 1)}\u00a0MB`;
}

/** 2026-05-03 14:07:09, local. */
function day(timeS) {
  const date = new Date(timeS * 1000);
  const parts = [date.getFullYear(), date.getMonth() + 1, date.getDate()];
  return `${parts.map((part) => String(part).padStart(2, "0")).join("-")} ${clock(timeS)}`;
}
