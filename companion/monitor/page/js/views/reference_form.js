/** Another reference: its points are placed on the map, then preview, then send. */

import { vector } from "../format.js";
import { html, nothing } from "./lit.js";
import { previewed } from "./previewed.js";

const METRES = { unit: "m", min: 0.01, max: 1000 };
const SECONDS = { unit: "s", min: 1, max: 3600 };
const SPEED = { name: "max_speed_m_s", title: "Speed", unit: "m/s", min: 0.01, max: 100, value: 2 };
const PERIOD = { ...SECONDS, name: "period_s", title: "Period", value: 40 };

// `points`: the key of the placed point, or points. `most` of them.
const KINDS = {
  point: { title: "Point", points: "point_enu_m", most: 1, fields: [] },
  waypoints: {
    title: "Waypoints",
    points: "points_enu_m",
    most: 200,
    fields: [SPEED, { ...SECONDS, name: "wait_s", title: "Stop at each", min: 0, value: 0 }],
  },
  circle: {
    title: "Circle",
    points: "centre_enu_m",
    most: 1,
    fields: [{ ...METRES, name: "radius_m", title: "Radius", value: 6 }, PERIOD],
    clockwise: true,
  },
  figure_8: {
    title: "Figure 8",
    points: "centre_enu_m",
    most: 1,
    fields: [
      { ...METRES, name: "width_m", title: "Width, east", value: 16 },
      { ...METRES, name: "height_m", title: "Height, north", value: 8 },
      PERIOD,
    ],
  },
  target: { title: "Follow a target", points: "start_enu_m", most: 1, fields: [{ ...SPEED, value: 3 }], target: true },
};

let kind = "point";

export function referenceForm({ store, commanding, act }) {
  const chosen = KINDS[kind];
  const points = store.drawing?.points ?? [];
  const choose = (event) => {
    kind = event.target.value;
    act.stopDrawing();
    commanding.discard();
  };
  const submit = (event) => {
    event.preventDefault();
    commanding.preview("reference", contentOf(chosen, new FormData(event.target), points));
  };
  const edited = () => store.preview?.name === "reference" && commanding.discard();
  return html`<details class="form"><summary>Reference</summary>
    <form @submit=${submit} @input=${edited}>
      <label>Kind <select name="kind" @change=${choose}>${Object.entries(KINDS).map(([key, { title }]) => html`
        <option value=${key} ?selected=${key === kind}>${title}</option>`)}</select></label>
      <label>Altitude <span class="unit"><input name="altitude_m" type="number" step="any" min="-1000" max="1000" required
        .value=${String(store.drawing?.altitudeM ?? act.altitude())} @change=${(event) => act.setAltitude(Number(event.target.value))}> m</span></label>
      ${chosen.fields.map((field) => html`<label>${field.title} <span class="unit"><input name=${field.name} type="number" step="any"
        required min=${field.min} max=${field.max} value=${field.value}> ${field.unit}</span></label>`)}
      ${chosen.clockwise ? html`<label class="check"><input type="checkbox" name="clockwise"> clockwise</label>` : nothing}
      ${chosen.target ? html`<label>Target <input name="name" value="main" required maxlength="40" pattern="[a-z0-9][a-z0-9_\\-]*"></label>` : nothing}
      ${placing(chosen, store, points, act)}
      <button data-action="preview-reference" ?disabled=${commanding.previewing || !points.length}>Preview</button>
    </form>
    ${previewed({ store, commanding }, "reference")}</details>`;
}

function placing(chosen, store, points, act) {
  const what = chosen.most > 1 ? "points" : { circle: "centre", figure_8: "centre", target: "start" }[kind] ?? "point";
  return html`<div class="row">
      <button type="button" data-action="place" aria-pressed=${Boolean(store.drawing?.active)}
        @click=${() => act.draw(chosen.most)}>Place ${what} on the map</button>
      ${points.length ? html`<button type="button" @click=${() => act.stopDrawing()}>Clear</button>` : nothing}</div>
    <ol class="points">${points.map((point, i) => html`<li>${["E", "N", "U"].map((axis, j) => html`
      <label>${axis} <input type="number" step="any" aria-label="Point ${i + 1}, ${axis}, metres" .value=${point[j].toFixed(2)}
        @change=${(event) => act.movePoint(i, j, Number(event.target.value))}></label>`)}</li>`)}</ol>
    ${points.length ? html`<p class="unseen" aria-live="polite">${points.length} points, the last at ${vector(points.at(-1), 1)} metres</p>` : nothing}`;
}

function contentOf(chosen, data, points) {
  const content = { kind, [chosen.points]: chosen.most > 1 ? points : points[0] };
  for (const { name } of chosen.fields) content[name] = Number(data.get(name));
  if (chosen.clockwise && data.get("clockwise")) content.clockwise = true;
  if (chosen.target) content.name = data.get("name");
  return content;
}
