/** Another formation: a shape, the present slots scaled, or a slot for each vehicle. Preview first, then send. */

import { html, nothing } from "./lit.js";
import { previewed } from "./previewed.js";

const SHAPES = JSON.parse(document.getElementById("shapes").textContent);
const SCALED = "the present slots, scaled";
const FREE = "a slot for each vehicle";

let chosen = SHAPES[0];

export function formationForm({ store, commanding }) {
  const submit = (event) => {
    event.preventDefault();
    commanding.preview("formation", contentOf(new FormData(event.target)));
  };
  const edited = (event) => {
    if (event.target.name === "shape") {
      chosen = event.target.value;
      initials.clear();
    }
    if (store.preview?.name === "formation") commanding.discard();
  };
  return html`<details class="form"><summary>Formation</summary>
    <form @submit=${submit} @input=${edited}>
      <label>Slots <select name="shape">${[...SHAPES, SCALED, FREE].map((shape) => html`
        <option ?selected=${shape === chosen}>${shape}</option>`)}</select></label>
      ${SHAPES.includes(chosen) ? quantityInput("Spacing", "spacing_m", "m", 0.1, 1000, 3) : nothing}
      ${chosen === SCALED ? quantityInput("Factor", "scale", "×", 0.01, 100, 1.5) : nothing}
      ${chosen === FREE ? freeSlots(store) : html`${quantityInput("Heading", "heading_deg", "°", -360, 360, 0)}
        <p class="quiet">0° points east, 90° north</p>`}
      <button data-action="preview-formation" ?disabled=${commanding.previewing}>Preview</button>
    </form>
    ${previewed({ store, commanding }, "formation")}</details>`;
}

function quantityInput(title, name, unit, least, most, value) {
  return html`<label>${title} <span class="unit"><input name=${name} type="number" required step="any" min=${least} max=${most}
    value=${value}> ${unit}</span></label>`;
}

/** Offsets from the reference, at first those flown. */
function freeSlots(store) {
  return html`<p class="quiet">East, north, up of the reference, metres</p>
    <ul class="points">${store.vehicles.map((vehicle) => html`<li><strong>${vehicle.vehicle_id}</strong>
      ${vehicle.slot_offset_enu_m.map((offset, axis) => html`<input type="number" step="any" required min="-1000" max="1000"
        name="slot ${vehicle.vehicle_id} ${axis}" value=${initial(vehicle, axis, offset)}
        aria-label="Vehicle ${vehicle.vehicle_id}, ${["east", "north", "up"][axis]}, metres">`)}</li>`)}</ul>`;
}

const initials = new Map(); // what an operator edits does not move with later snapshots

function initial(vehicle, axis, offset) {
  const key = `${vehicle.fleet} ${vehicle.vehicle_id} ${axis}`;
  if (!initials.has(key)) initials.set(key, offset.toFixed(2));
  return initials.get(key);
}

function contentOf(data) {
  if (chosen === FREE) return { slots_enu_m: slotsOf(data) };
  const heading_deg = Number(data.get("heading_deg"));
  if (chosen === SCALED) return { scale: Number(data.get("scale")), heading_deg };
  return { shape: chosen, spacing_m: Number(data.get("spacing_m")), heading_deg };
}

function slotsOf(data) {
  const slots = {};
  for (const [name, value] of data) {
    const [kind, id, axis] = name.split(" ");
    if (kind === "slot") (slots[id] ??= [0, 0, 0])[Number(axis)] = Number(value);
  }
  return slots;
}
