/** Another reference: its points are placed on the map, then preview, then send. */

import { vector } from "../format.js";
import { html, nothing } from "./lit.js";
import { previewed } from "./previewed.js";

// What the server knows of each kind: its title, the key and the name of its position, how many of them, and its inputs.
const KINDS = JSON.parse(document.getElementById("reference-forms").textContent);

export const WAYPOINTS = KINDS.find(({ kind }) => kind === "waypoints");

let chosen = KINDS[0];
const entered = new Map(); // of each kind what was changed in its inputs, by name: they keep nothing of another kind

/** The form has this kind from now on, with its defaults. */
export function kindOf(kind) {
  chosen = kind;
  entered.delete(kind.kind);
}

export function referenceForm({ store, commanding, planning }) {
  const points = store.drawing?.points ?? [];
  const choose = (event) => {
    chosen = KINDS.find(({ kind }) => kind === event.target.value);
    planning.cancel();
  };
  const submit = (event) => {
    event.preventDefault();
    commanding.preview("reference", contentOf(new FormData(event.target), points));
  };
  const changed = ({ target: { name, type, value, checked } }) => {
    if (!chosen.inputs.some((input) => input.name === name)) return;
    entered.set(chosen.kind, { ...entered.get(chosen.kind), [name]: type === "checkbox" ? checked : value });
  };
  const edited = () => store.preview?.name === "reference" && commanding.discard();
  return html`<details class="form"><summary>Reference</summary>
    <form data-form="reference" @submit=${submit} @input=${edited} @change=${changed}>
      <label>Kind <select name="kind" @change=${choose}>${KINDS.map(({ kind, title }) => html`
        <option value=${kind} .selected=${kind === chosen.kind}>${title}</option>`)}</select></label>
      <label>Altitude <span class="unit"><input name="altitude_m" type="number" step="any" min="-1000" max="1000" required
        .value=${String(planning.altitudeM)} @change=${(event) => planning.setAltitude(Number(event.target.value))}> m</span></label>
      ${chosen.inputs.map(inputOf)}
      ${placing(store, points, planning)}
      <button data-action="preview-reference" ?disabled=${commanding.previewing || !points.length}>Preview</button>
    </form>
    ${previewed({ store, commanding, planning }, "reference")}</details>`;
}

function inputOf({ name, title, type, value: initial, unit, min, max, pattern }) {
  const value = entered.get(chosen.kind)?.[name] ?? initial;
  if (type === "checkbox") return html`<label class="check"><input type="checkbox" name=${name} .checked=${value === true}> ${title}</label>`;
  if (type === "text") return html`<label>${title} <input name=${name} .value=${value} required pattern=${pattern}></label>`;
  return html`<label>${title} <span class="unit"><input name=${name} type="number" step="any"
    required min=${min} max=${max} .value=${String(value)}> ${unit}</span></label>`;
}

function placing(store, points, planning) {
  const what = chosen.most > 1 ? "points" : chosen.place;
  return html`<div class="row">
      <button type="button" data-action="place" aria-pressed=${Boolean(store.drawing?.active)}
        @click=${() => planning.place(chosen.most)}>Place ${what} on the map</button>
      ${points.length ? html`<button type="button" @click=${() => planning.cancel()}>Clear</button>` : nothing}</div>
    <ol class="points">${points.map((point, i) => html`<li>${["E", "N", "U"].map((axis, j) => html`
      <label>${axis} <input type="number" step="any" aria-label="Point ${i + 1}, ${axis}, metres" .value=${point[j].toFixed(2)}
        @change=${(event) => planning.setCoordinate(i, j, Number(event.target.value))}></label>`)}</li>`)}</ol>
    ${points.length ? html`<p class="unseen" aria-live="polite">${points.length === 1 ? "1 point" : `${points.length} points`}, the last at ${vector(points.at(-1), 1)} metres</p>` : nothing}`;
}

function contentOf(data, points) {
  const content = { kind: chosen.kind, [chosen.position]: chosen.most > 1 ? points : points[0] };
  for (const { name, type } of chosen.inputs) {
    if (type === "number") content[name] = Number(data.get(name));
    else if (type === "text") content[name] = data.get(name);
    else if (data.get(name)) content[name] = true;
  }
  return content;
}
