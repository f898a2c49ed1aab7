/** Where a replay is: play, speed, and a slider over the whole flight. */

import { elapsed } from "../format.js";
import { html } from "./lit.js";

const SPEEDS = [0.5, 1, 2, 5, 10, 30];

let draggedS = null; // where the slider is held; snapshots do not move it meanwhile

export function replay({ store, act }) {
  const { begin_s: beginS, end_s: endS, now_s: nowS, speed } = store.snapshot.replay;
  const paused = speed === 0;
  const shownS = draggedS ?? nowS - beginS;
  const seek = (event) => {
    draggedS = Number(event.target.value);
    act.replay({ type: "seek", time_s: beginS + draggedS });
  };
  const release = () => (draggedS = null);
  const setSpeed = (value) => act.replay({ type: "speed", speed: value });
  return html`
    <button class="play" @click=${() => setSpeed(paused ? act.lastSpeed() : 0)}>${paused ? "▶ Play" : "❚❚ Pause"}</button>
    <label>Speed <select @change=${(event) => setSpeed(Number(event.target.value))}>
      ${SPEEDS.map((value) => html`<option value=${value} ?selected=${value === (paused ? act.lastSpeed() : speed)}>${value} ×</option>`)}
    </select></label>
    <span class="time">${elapsed(shownS)}</span>
    <input type="range" min="0" max=${Math.max(0.1, endS - beginS).toFixed(1)} step="0.1" .value=${shownS.toFixed(1)}
      aria-label="Time of the flight" aria-valuetext=${elapsed(shownS)} @input=${seek}
      @change=${release}>
    <span class="time">${elapsed(endS - beginS)}</span>`;
}
