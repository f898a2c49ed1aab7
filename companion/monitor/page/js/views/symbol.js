/** The symbol of a phase, as on the map. */

import { groupOf } from "../phases.js";
import { html } from "./lit.js";

export function symbol(phase, silent = false) {
  const group = groupOf(phase);
  return html`<svg class="symbol ${silent ? "silent" : group.name} ${group.filled ? "filled" : "hollow"}"
    viewBox="-15 -15 30 30" width="18" height="18" aria-hidden="true"><path d=${group.shape}></path></svg>`;
}
