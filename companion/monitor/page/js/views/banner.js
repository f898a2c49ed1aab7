/** What must not be overlooked: a refused abort, a lost server or lost control, late data, a replay, keys held for an abort. */

import { age } from "../format.js";
import { html, nothing } from "./lit.js";

export function banner({ store, nowMs, abort, commanding }) {
  if (abort.keys) return html`<p class="abort-keys">Keep holding Shift+Escape: ABORT ${store.fleetName}</p>`;
  return html`${abortError(commanding)}${state(store, commanding, nowMs)}`;
}

/** Over the page: whatever moved the buttons would end a hold, or put another button under the pointer. */
export function hint(text) {
  return text ? html`<p>${text}</p>` : nothing;
}

function abortError({ abortError }) {
  return abortError ? html`<p class="abort-error"><strong>ABORT was not sent:</strong> ${abortError}</p>` : nothing;
}

function state(store, commanding, nowMs) {
  const lost = store.snapshot && store.freshness.lost(nowMs);
  if (store.refused && (lost || !store.snapshot)) return html`<p class="refused">${refusedText(store, nowMs)}</p>`;
  if (lost) return html`<p class="lost-server">${lostText(store.freshness, nowMs)}</p>`;
  if (!store.snapshot) return html`<p class="waiting">Waiting for the server.</p>`;
  if (store.controls && commanding.hasLostControl) {
    return html`<p class="no-control"><strong>No control:</strong> the server was started again. Open the URL that
      companion monitor --control has printed now. Until then this page commands no vehicle, ABORT included.</p>`;
  }
  if (store.snapshot.replay) return html`<p class="replayed">REPLAY of a recorded flight. Nothing here is live.</p>`;
  return nothing;
}

function refusedText({ snapshot, refused, freshness }, nowMs) {
  const old = snapshot ? html` Everything below is ${age(freshness.ageS(nowMs))} old.` : nothing;
  return html`<strong>This page gets no data:</strong> ${refused}. It tries again by itself.${old}`;
}

function lostText(freshness, nowMs) {
  const old = age(freshness.ageS(nowMs));
  const reason = freshness.lagS > 1 ? "Data arrives late" : "Server lost";
  return html`<strong>${reason}: everything below is ${old} old.</strong>
    Vehicles fly on by themselves. Check that companion monitor runs and that its network is up.`;
}
