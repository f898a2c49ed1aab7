/** What has happened, newest first: events of vehicles, phases, commands, answers. */

import { clock } from "../format.js";
import { html, nothing, repeat } from "./lit.js";

const SHOWN = 150;
const FILTERS = { all: "All", commands: "Commands", vehicles: "Vehicles" };
const COMMANDS = new Set(["command", "answer"]);

export function events({ store, filter, act }) {
  const shown = store.events.filter((event) => passes(event, filter, store)).slice(0, SHOWN);
  return html`<div class="heading"><h2>Events and commands</h2>
      <div class="chips" role="group" aria-label="Which events">${Object.entries(FILTERS).map(([key, name]) => html`
        <button class="small" aria-pressed=${filter === key} @click=${() => act.filterEvents(key)}>${name}</button>`)}</div></div>
    ${shown.length ? nothing : html`<p class="empty">Nothing yet.</p>`}
    <ol class="events">${repeat(shown, (event) => event.id, (event) => html`<li class=${event.kind}>
      <time>${clock(event.time_s)}</time>
      <span class="who">${event.vehicle_id === null ? (event.fleet ? "fleet" : "server") : event.vehicle_id}</span>
      <span><strong>${event.code}</strong> ${event.text}</span></li>`)}</ol>`;
}

function passes(event, filter, store) {
  if (event.fleet && event.fleet !== store.fleetName) return false; // without a fleet: of this server
  return filter === "all" || COMMANDS.has(event.kind) === (filter === "commands");
}
