/** The upper bar: fleet, whether the data is live, alarms, sound, theme, help, ABORT. */

import { clock } from "../format.js";
import { html, nothing } from "./lit.js";

const THEMES = { system: "Theme: system", light: "Theme: light", dark: "Theme: dark" };

export function bar({ store, nowMs, theme, sound, abort, act }) {
  const { snapshot } = store;
  const open = store.alarms.filter((alarm) => !alarm.acknowledged);
  return html`
    <div class="bar-left">
      <h1>${fleetChoice(store, act)}</h1>
      ${liveness(store, nowMs)}
      <span class="clock" title="Time of the shown data">${clock(snapshot?.time_s)}</span>
      <span class="links">${links(snapshot)}</span>
      ${snapshot?.commands ? html`<span class="operator">operator ${snapshot.operator}</span>` : nothing}
      ${holders(store)}
    </div>
    <div class="bar-right">
      <button class="alarm-count ${worst(open)}" @click=${() => act.tab("alarms")}
        aria-label="${open.length} alarms not acknowledged">${open.length} ${open.length === 1 ? "alarm" : "alarms"}</button>
      <button aria-pressed=${sound.on} @click=${act.sound}>${sound.on ? "Sound on" : "Sound off"}</button>
      <button class="theme-choice" @click=${act.theme}>${THEMES[theme.choice]}</button>
      <button @click=${act.help}>Help</button>
      ${store.controls ? abortButton(store, abort, act) : nothing}
    </div>`;
}

/** Usable also without snapshots: a request may reach a server whose stream is broken. */
function abortButton(store, abort, act) {
  return html`<button id="abort" class=${abort.keys ? "holding" : ""} data-hold="0.5" @held=${act.abort}
    @released=${() => act.hint("Hold ABORT for half a second.")}
    aria-label="Abort all vehicles of ${store.fleetName}: hold for half a second, or hold Shift and Escape"
    title="Hold for half a second, or hold Shift+Escape">ABORT ${store.fleetName}</button>`;
}

function fleetChoice(store, act) {
  const fleets = store.snapshot?.fleets ?? [];
  if (fleets.length < 2) return store.fleetName ?? "No fleet";
  return html`<select aria-label="Fleet" @change=${(event) => act.chooseFleet(event.target.value)}>
    ${fleets.map(({ name }) => html`<option value=${name} .selected=${name === store.fleetName}>${name}</option>`)}
  </select>`;
}

function liveness(store, nowMs) {
  const lost = store.freshness.lost(nowMs);
  if (lost) return html`<span class="live lost">${store.snapshot ? "LOST" : "connecting"}</span>`;
  return store.snapshot.replay
    ? html`<span class="live replayed">REPLAY</span>`
    : html`<span class="live now">LIVE</span>`;
}

/** Who commands, where it is not the operator of this page: the vehicles would refuse what this page sends. */
function holders({ vehicles, snapshot }) {
  const heard = vehicles.filter((vehicle) => !vehicle.silent);
  const own = snapshot?.commands ? snapshot.operator : null;
  const names = [...new Set(heard.map((vehicle) => vehicle.holder))].filter((name) => name && name !== own).sort();
  if (!names.length) return nothing;
  const held = names.map((name) => {
    const ids = heard.filter((vehicle) => vehicle.holder === name).map((vehicle) => vehicle.vehicle_id);
    return ids.length === heard.length ? `${name} commands` : `${name} commands ${ids.join(", ")}`;
  });
  return own === null ? html`<span class="operator">${held.join(", ")}</span>`
    : html`<strong class="holder warning" title="Take command, among the buttons, takes it over">${held.join(", ")}</strong>`;
}

function links(snapshot) {
  if (!snapshot || snapshot.replay) return nothing;
  const [up, down] = [snapshot.connected.length, snapshot.unreachable.length];
  if (!down) return `${up} ${up === 1 ? "link" : "links"}`;
  return html`<strong class="warning" title="Not reached: ${snapshot.unreachable.join(", ")}">${up} of ${up + down} links</strong>`;
}

function worst(alarms) {
  return ["critical", "warning"].find((severity) => alarms.some((alarm) => alarm.severity === severity)) ?? "none";
}
