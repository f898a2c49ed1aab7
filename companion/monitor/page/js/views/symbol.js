/** The symbol of a phase in the colour of a vehicle, as on the map; without an id in that of text. */

import { groupOf } from "../phases.js";
import { colourOf } from "../vehicle_look.js";
import { html } from "./lit.js";

export function symbol(vehicle) {
  const { vehicle_id: id = null, silent = false } = vehicle;
  const group = groupOf(vehicle);
  const colour = `var(--${id === null ? "text" : colourOf(id)})`;
  return html`<svg class="symbol ${silent ? "silent" : ""} ${group.filled ? "filled" : "hollow"}"
    viewBox="-15 -15 30 30" width="18" height="18" aria-hidden="true"><path d=${group.shape} fill=${colour} stroke=${colour}></path></svg>`;
}
