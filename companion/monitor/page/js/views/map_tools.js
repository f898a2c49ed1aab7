/** Buttons on the map, and the meaning of its symbols. */

import { GROUPS } from "../phases.js";
import { html, nothing } from "./lit.js";
import { symbol } from "./symbol.js";

const PHASES = { ground: "ready", armed: "armed", takeoff: "takeoff", hold: "hold", formation: "formation", land: "land", return: "return", other: "observe" };

export function mapTools({ map, planning, store, commanding }) {
  return html`
    <button @click=${() => map.toggle3d()} aria-pressed=${map.camera.is3d} title="Key 3">3-D</button>
    <button @click=${() => map.fit()} aria-pressed=${map.follows} title="Show all, and follow: key F">Fit</button>
    <button @click=${() => map.zoom(1.4)} aria-label="Zoom in" title="Key +">+</button>
    <button @click=${() => map.zoom(1 / 1.4)} aria-label="Zoom out" title="Key -">−</button>
    ${Math.abs(map.camera.azimuth) > 0.01 ? html`<button @click=${() => map.northUp()} title="Key N">North</button>` : nothing}
    ${store.controls && commanding.allowed ? html`<button data-action="go" ?disabled=${!planning.canGo} aria-pressed=${Boolean(store.drawing?.goes)}
      title=${planning.canGo ? "The whole fleet goes to a place on the map: click it, then see the preview" : "No fleet in formation"}
      @click=${() => planning.go()}>Go to</button>` : nothing}`;
}

/** What is being worked out on the map, with the way back. */
export function mapNote({ store, planning }) {
  if (!planning.isActive) return nothing;
  return html`<span role="status">${noteOf(store.drawing)}</span>
    <button data-action="undo" ?disabled=${!planning.canUndo} title="Ctrl+Z" @click=${() => planning.undo()}>Undo</button>
    <button data-action="cancel" @click=${() => planning.cancel()}>Cancel</button>`;
}

function noteOf(drawing) {
  if (!drawing) return "Drag the slots.";
  if (drawing.goes) return "Click where the fleet is to go.";
  if (!drawing.active) return "Drag the points.";
  return drawing.most === 1 ? "Click a point on the map." : "Click the points on the map, in order.";
}

export function legend() {
  return html`<details><summary>Symbols</summary><ul>
    ${GROUPS.map((group) => html`<li>${symbol({ phase: PHASES[group.name], armed: true, landed: "in_air" })} ${group.text}</li>`)}
    <li>${symbol({ phase: "ready", silent: true })} silent, where it last was</li>
    <li><span class="key">★</span> leader, with a ring</li>
    <li><span class="key">◇</span> slot</li>
    <li><span class="key">→</span> where it will be in 1 s</li>
    <li><span class="key">━</span> weight of a neighbour</li>
    <li><span class="key">┅</span> neighbour with old data</li>
    <li><span class="key">○R</span> the reference now, on its line</li>
    <li><span class="key">1 m</span> smallest separation: a height counts half</li>
    <li><span class="key">◌</span> circles touch at separation_m</li>
  </ul></details>`;
}
