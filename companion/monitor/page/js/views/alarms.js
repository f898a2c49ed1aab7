/** The list of alarms: not acknowledged ones first, then those that last, then by severity, then the newest. */

import { age, clock } from "../format.js";
import { html, nothing, repeat } from "./lit.js";
import { prose } from "./prose.js";

const RANK = { critical: 0, warning: 1, info: 2 };
const MARK = { critical: "■", warning: "▲", info: "●" };

export function alarms({ store, act }) {
  const sorted = [...store.alarms].sort(byUrgency);
  const open = sorted.filter((alarm) => !alarm.acknowledged);
  return html`<div class="heading"><h2>Alarms</h2>
      ${open.length > 1 ? html`<button class="small" @click=${() => open.forEach((alarm) => act.acknowledge(alarm.id))}>
        Acknowledge all ${open.length}</button>` : nothing}</div>
    ${sorted.length || !store.snapshot ? nothing : html`<p class="empty">No alarms.</p>`}
    <ul class="alarms">${repeat(sorted, (alarm) => alarm.id, (alarm) => row(alarm, store, act))}</ul>`;
}

function row(alarm, store, act) {
  const { snapshot } = store;
  const ended = alarm.until_s !== null;
  const vehicle = snapshot.fleets.length > 1 ? `${alarm.fleet}, vehicle` : "vehicle";
  const subject = alarm.vehicle_id === null ? alarm.fleet : `${vehicle} ${alarm.vehicle_id}`;
  const when = ended
    ? `${clock(alarm.since_s)} to ${clock(alarm.until_s)}, ended`
    : `since ${clock(alarm.since_s)}, ${age(snapshot.time_s - alarm.since_s)}`;
  const times = alarm.times > 1 ? `; ${alarm.times} times since ${clock(alarm.first_s)}` : "";
  return html`<li class="${alarm.severity} ${alarm.acknowledged ? "acknowledged" : ""} ${ended ? "ended" : ""}"
      data-alarm=${alarm.id}>
    <span class="mark" role="img" aria-label=${alarm.severity}>${MARK[alarm.severity] ?? "●"}</span>
    <div><p><strong>${subject}: ${alarm.code}</strong> ${alarm.text}</p>
      <p class="when">${when}${times}${alarm.advice ? html`. <span class="advice">${prose(alarm.advice)}</span>` : nothing}</p></div>
    ${alarm.acknowledged
      ? html`<span class="quiet">acknowledged</span>`
      : html`<button class="small" @click=${() => act.acknowledge(alarm.id)} aria-label="Acknowledge ${subject} ${alarm.code}">Acknowledge</button>`}
  </li>`;
}

function byUrgency(a, b) {
  const ended = (alarm) => Number(alarm.until_s !== null);
  return a.acknowledged - b.acknowledged || ended(a) - ended(b) || RANK[a.severity] - RANK[b.severity] || b.since_s - a.since_s;
}
