/** What must not be overlooked: a lost server, late data, a replay, keys that are held for an abort. */

import { age } from "../format.js";
import { html, nothing } from "./lit.js";

export function banner({ store, nowMs, abort, hint }) {
  if (abort.keys) return html`<p class="abort-keys">Keep holding Shift+Escape: ABORT ${store.fleetName}</p>`;
  const lost = store.snapshot && store.freshness.lost(nowMs);
  if (lost) return html`<p class="lost-server">${lostText(store.freshness, nowMs)}</p>`;
  if (!store.snapshot) return html`<p class="waiting">Waiting for the server.</p>`;
  if (hint) return html`<p class="waiting">${hint}</p>`;
  if (store.snapshot.replay) return html`<p class="replayed">REPLAY of a recorded flight. Nothing here is live.</p>`;
  return nothing;
}

function lostText(freshness, nowMs) {
  const old = age(freshness.ageS(nowMs));
  const reason = freshness.lagS > 1 ? "Data arrives late" : "Server lost";
  return html`<strong>${reason}: everything below is ${old} old.</strong>
    Vehicles fly on by themselves. Check that companion monitor runs and that its network is up.`;
}
