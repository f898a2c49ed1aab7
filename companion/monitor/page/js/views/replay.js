/** Where a replay is: play, speed, jumps, and a slider over the whole flight below its timeline. */

import { elapsed } from "../format.js";
import { SPEEDS } from "../replaying.js";
import { html } from "./lit.js";
import { timeline } from "./timeline.js";

let draggedS = null; // where the slider is held; snapshots do not move it meanwhile

export function replay({ store, replaying, widthPx: { replay: widthPx } }) {
  const { begin_s: beginS, end_s: endS, now_s: nowS } = store.snapshot.replay;
  const { speed, paused } = replaying;
  const shownS = draggedS ?? nowS - beginS;
  const seek = (event) => {
    draggedS = Number(event.target.value);
    replaying.seek(beginS + draggedS);
  };
  const release = () => (draggedS = null);
  const speeds = SPEEDS.includes(speed) ? SPEEDS : [...SPEEDS, speed];
  return html`
    ${timeline({ mission: store.mission, beginS, endS, nowS, widthPx, onPlace: (timeS) => replaying.seek(timeS) })}
    <button class="play" title="K" @click=${() => replaying.toggle()}>${paused ? "▶ Play" : "❚❚ Pause"}</button>
    <label>Speed <select title="U slower, O faster" @change=${(event) => replaying.setSpeed(Number(event.target.value))}>
      ${speeds.map((value) => html`<option value=${value} .selected=${value === speed}>${value} ×</option>`)}
    </select></label>
    ${jumps("event", replaying, false)}${jumps("finding", replaying, true)}
    <span class="time">${elapsed(shownS)}</span>
    <input type="range" min="0" max=${Math.max(0.1, endS - beginS).toFixed(1)} step="0.1" .value=${shownS.toFixed(1)}
      aria-label="Time of the flight" aria-valuetext=${elapsed(shownS)} @input=${seek}
      @change=${release}>
    <span class="time">${elapsed(endS - beginS)}</span>`;
}

function jumps(kind, replaying, onlyFindings) {
  const key = onlyFindings ? "Shift+" : "";
  return html`<span class="jumps" role="group" aria-label="Jump to a ${kind}">
    <button aria-label="Previous ${kind}" title="Previous ${kind}: ${key}J" @click=${() => replaying.jump(-1, onlyFindings)}>◀</button>
    ${kind}
    <button aria-label="Next ${kind}" title="Next ${kind}: ${key}L" @click=${() => replaying.jump(1, onlyFindings)}>▶</button></span>`;
}
