/** What has happened, newest first: events of vehicles, phases, commands, answers; or the mission along time. */

import { clock } from "../format.js";
import { html, nothing, repeat } from "./lit.js";
import { missionList, timeline } from "./timeline.js";

const SHOWN = 150;
const SHORTEST_S = 300;
const LONGEST_S = 3600; // of the timeline of live vehicles
const FILTERS = { all: "All", commands: "Commands", vehicles: "Vehicles", timeline: "Timeline" };
const COMMANDS = new Set(["command", "answer"]);

export function events(context) {
  const { filter, act } = context;
  return html`<div class="heading"><h2>Events</h2>
      <div class="chips" role="group" aria-label="Which events">${Object.entries(FILTERS).map(([key, name]) => html`
        <button class="small" aria-pressed=${filter === key} @click=${() => act.filterEvents(key)}>${name}</button>`)}</div></div>
    ${filter === "timeline" ? alongTime(context) : list(context)}`;
}

function list({ store, filter }) {
  const shown = store.events.filter((event) => passes(event, filter, store)).slice(0, SHOWN);
  return html`${shown.length ? nothing : html`<p class="empty">Nothing yet.</p>`}
    <ol class="events">${repeat(shown, (event) => event.id, (event) => html`<li class=${event.kind}>
      <time>${clock(event.time_s)}</time>
      <span class="who">${event.vehicle_id === null ? (event.fleet ? "fleet" : "server") : event.vehicle_id}</span>
      <span><strong>${event.code}</strong> ${event.text}</span></li>`)}</ol>`;
}

/** Of live vehicles from the first event on, an hour at most. In a replay there is one above the slider, if it has room. */
function alongTime({ store, act, replaying, widthPx: { events: widthPx } }) {
  const { mission, snapshot } = store;
  if (!snapshot) return missionList(mission, 0);
  const nowS = snapshot.time_s;
  const { begin_s: beginS, end_s: endS } = snapshot.replay ?? { begin_s: liveBegin(mission, nowS), end_s: nowS };
  const onPlace = (timeS, text) => (snapshot.replay ? replaying.seek(timeS) : act.hint(text));
  return html`<div class="axis">${timeline({ mission, beginS, endS, nowS, widthPx: Math.max(0, widthPx - 24), onPlace })}
    <p class="quiet"><time>${clock(beginS)}</time><time>${clock(endS)}</time></p></div>
    ${missionList(mission, nowS)}`;
}

function liveBegin(mission, nowS) {
  const firstS = mission.events.at(-1)?.time_s ?? nowS;
  return Math.max(nowS - LONGEST_S, Math.min(firstS, nowS - SHORTEST_S));
}

function passes(event, filter, store) {
  if (event.fleet && event.fleet !== store.fleetName) return false; // without a fleet: of this server
  return filter === "all" || COMMANDS.has(event.kind) === (filter === "commands");
}
