/** Another formation: a shape, the present slots scaled, or a slot for each vehicle. Preview first, then send. */

import { html, nothing } from "./lit.js";
import { previewed } from "./previewed.js";

const SHAPES = JSON.parse(document.getElementById("shapes").textContent);
const SCALED = "the present slots, scaled";
const FREE = "a slot for each vehicle";
const SLOT = "slot "; // begins the name of an input

let chosen = SHAPES[0];
let entered = { spacing_m: "3", scale: "1.5", heading_deg: "0" };
let slots = new Map(); // as texts: what an operator edits does not move with later snapshots

/** What the form has, for the map: slots that are dragged there, and undo. */
export const formationState = {
  copy: () => ({ chosen, entered, slots: new Map(slots) }),
  restore(before) {
    ({ chosen, entered, slots } = before);
  },
  forgetSlots() {
    slots = new Map();
  },
  /** A slot for each vehicle, by id. */
  setSlots(slotsEnuM) {
    chosen = FREE;
    slots = new Map(Object.entries(slotsEnuM).flatMap(([id, slot]) => slot.map((offset, axis) => [`${id} ${axis}`, offset.toFixed(2)])));
  },
};

export function formationForm({ store, commanding, planning }) {
  const submit = (event) => {
    event.preventDefault();
    commanding.preview("formation", contentOf(new FormData(event.target)));
  };
  const changed = ({ target: { name, value } }) => {
    if (name in entered) entered = { ...entered, [name]: value };
    else if (name.startsWith(SLOT)) slots.set(name.slice(SLOT.length), value);
  };
  const edited = (event) => {
    if (event.target.name === "shape") {
      chosen = event.target.value;
      slots = new Map();
    }
    if (store.preview?.name === "formation") planning.cancel();
  };
  return html`<details class="form"><summary>Formation</summary>
    <form data-form="formation" @submit=${submit} @input=${edited} @change=${changed}>
      <label>Slots <select name="shape">${[...SHAPES, SCALED, FREE].map((shape) => html`
        <option .selected=${shape === chosen}>${shape}</option>`)}</select></label>
      ${SHAPES.includes(chosen) ? quantityInput("Spacing", "spacing_m", "m", 0.1, 1000) : nothing}
      ${chosen === SCALED ? quantityInput("Factor", "scale", "×", 0.01, 100) : nothing}
      ${chosen === FREE ? freeSlots(store) : html`${quantityInput("Heading", "heading_deg", "°", -360, 360)}
        <p class="quiet">0° points east, 90° north</p>`}
      <button data-action="preview-formation" ?disabled=${commanding.previewing}>Preview</button>
    </form>
    ${previewed({ store, commanding, planning }, "formation")}</details>`;
}

function quantityInput(title, name, unit, least, most) {
  return html`<label>${title} <span class="unit"><input name=${name} type="number" required step="any" min=${least} max=${most}
    .value=${entered[name]}> ${unit}</span></label>`;
}

/** Offsets from the reference, at first those flown. */
function freeSlots(store) {
  return html`<p class="quiet">East, north, up of the reference, metres</p>
    <ul class="points">${store.vehicles.map((vehicle) => html`<li><strong>${vehicle.vehicle_id}</strong>
      ${vehicle.slot_offset_enu_m.map((offset, axis) => html`<input type="number" step="any" required min="-1000" max="1000"
        name="${SLOT}${vehicle.vehicle_id} ${axis}" .value=${initial(vehicle, axis, offset)}
        aria-label="Vehicle ${vehicle.vehicle_id}, ${["east", "north", "up"][axis]}, metres">`)}</li>`)}</ul>`;
}

function initial(vehicle, axis, offset) {
  const key = `${vehicle.vehicle_id} ${axis}`;
  if (!slots.has(key)) slots.set(key, offset.toFixed(2));
  return slots.get(key);
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
    if (!name.startsWith(SLOT)) continue;
    const [id, axis] = name.slice(SLOT.length).split(" ");
    (slots[id] ??= [0, 0, 0])[Number(axis)] = Number(value);
  }
  return slots;
}
