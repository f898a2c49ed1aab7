/** The mission along time: one lane each for commands, leader, formation and alarms. */

import { clock } from "../format.js";
import { answerText, hasSucceeded } from "../mission.js";
import { colourOf } from "../vehicle_look.js";
import { html, nothing, svg } from "./lit.js";

const LANES = ["Command", "Leader", "Formation", "Alarm"];
const LANE_PX = 20;
const NAMES_PX = 68;
const RIGHT_PX = 10;
const [LETTER_PX, CAPITAL_PX] = [6.6, 8.2];
const TOUCH_PX = 12;
const SIGN_PX = 14;
const MARKS = new Map([[true, ["✓", "good"]], [false, ["✗", "critical"]], [null, ["·", "text"]]]);

/** `mission`: missionOf(...); `nowS` is shown, what is later is pale. `onPlace(timeS, text)`: a click, with what is there. */
export function timeline({ mission, beginS, endS, nowS, widthPx, onPlace }) {
  const innerPx = Math.max(50, widthPx - NAMES_PX - RIGHT_PX);
  const x = (timeS) => NAMES_PX + (innerPx * (Math.min(Math.max(timeS, beginS), endS) - beginS)) / Math.max(0.1, endS - beginS);
  const pale = (timeS) => (timeS > nowS ? "later" : "");
  const right = NAMES_PX + innerPx;
  const height = LANES.length * LANE_PX;
  const place = (event) => {
    const box = event.currentTarget.getBoundingClientRect();
    const [px, lane] = [event.clientX - box.left, Math.floor((event.clientY - box.top) / LANE_PX)];
    const found = nearest(lanes(mission)[lane] ?? [], px, x);
    if (px >= NAMES_PX) onPlace(found?.timeS ?? beginS + ((px - NAMES_PX) / innerPx) * (endS - beginS), found ? described(found) : "");
  };
  return html`<svg class="timeline" role="img" aria-label=${summary(mission)} width=${widthPx} height=${height} @click=${place}>
    ${LANES.map((name, i) => svg`<line class="lane" x1="0" x2=${widthPx} y1=${(i + 1) * LANE_PX - 0.5} y2=${(i + 1) * LANE_PX - 0.5}></line>
      <text class="lane-name" x="0" y=${i * LANE_PX + 14}>${name}</text>`)}
    ${spans(mission.leaders, LANE_PX, x, right, (one) => [one.ids.join(", "), colourOf(one.ids[0])], pale)}
    ${spans(mission.formations, 2 * LANE_PX, x, right, (one) => [one.name, null], pale)}
    ${mission.references.map((one) => svg`<path class="reference ${pale(one.timeS)}"
      d="M${x(one.timeS)} ${2 * LANE_PX + 3}l5 7l-5 7l-5-7Z"><title>${described(one)}</title></path>`)}
    ${signs(mission.commands, 0, x, right, (one) => [...MARKS.get(hasSucceeded(one)), one.name], pale)}
    ${signs(mission.alarms, 3 * LANE_PX, x, right, (one) => ["▲", "critical", one.code], pale)}
    <line class="now" x1=${x(nowS)} x2=${x(nowS)} y1="0" y2=${height}></line>
  </svg>`;
}

/** The same as text, newest first. */
export function missionList(mission, nowS) {
  const all = lanes(mission).flat().filter((one) => Number.isFinite(one.timeS)).sort((a, b) => b.timeS - a.timeS);
  return html`<ol class="mission">${all.map((one) => html`<li class=${one.timeS > nowS ? "later" : ""}>
    <time>${clock(one.timeS)}</time><span>${described(one, false)}</span></li>`)}</ol>
    ${all.length ? nothing : html`<p class="empty">No command, no change of leader or formation, no alarm yet.</p>`}`;
}

function lanes({ commands, leaders, formations, references, alarms }) {
  return [commands, leaders, [...formations, ...references], alarms];
}

function described(one, withTime = true) {
  const time = withTime && Number.isFinite(one.timeS) ? `${clock(one.timeS)} ` : "";
  if (one.answers) {
    const to = one.ids.length ? ` to ${one.ids.join(", ")}` : "";
    return `${time}${one.text}${to}: ${answerText(one)}`;
  }
  if (one.ids) return `${time}leader ${one.ids.join(", ")}: ${one.text}`;
  return `${time}${one.text}`;
}

function summary(mission) {
  const counts = lanes(mission).map((lane, i) => `${LANES[i].toLowerCase()}: ${lane.length}`);
  return `Timeline. ${counts.join(", ")}. Events and commands have the same as text.`;
}

function nearest(lane, px, x) {
  const apart = (one) => Math.abs(x(one.timeS) - px);
  const found = [...lane].sort((a, b) => apart(a) - apart(b))[0];
  return found && apart(found) <= TOUCH_PX ? found : null;
}

/** Signs, with a name where there is room for it up to the next one; where they crowd, a line, and refusals keep their sign. */
function signs(items, top, x, right, look, pale) {
  const shown = new Set();
  const isFree = (one) => [...shown].every((other) => Math.abs(x(other.timeS) - x(one.timeS)) >= SIGN_PX);
  const refusedFirst = [...items].sort((a, b) => (hasSucceeded(b) === false) - (hasSucceeded(a) === false));
  for (const one of refusedFirst) if (isFree(one)) shown.add(one);
  return items.map((one, i) => {
    const [sign, colour, name] = look(one);
    const at = x(one.timeS);
    const roomPx = (i + 1 < items.length ? x(items[i + 1].timeS) - SIGN_PX / 2 : right) - at - 9;
    return svg`<g class="sign ${pale(one.timeS)}"><title>${described(one)}</title>
      ${shown.has(one) ? svg`<text x=${at} y=${top + 14} text-anchor="middle" fill=${`var(--${colour})`}>${sign}</text>`
        : svg`<line x1=${at} x2=${at} y1=${top + 4} y2=${top + 16} stroke=${`var(--${colour})`}></line>`}
      ${shown.has(one) && roomPx >= widthOf(name) ? svg`<text x=${at + 9} y=${top + 14}>${name}</text>` : nothing}</g>`;
  });
}

/** At most, in pixels. */
function widthOf(text) {
  return [...text].reduce((sum, letter) => sum + (/[A-Z_]/.test(letter) ? CAPITAL_PX : LETTER_PX), 0);
}

/** From one change to the next. */
function spans(changes, top, x, right, look, pale) {
  return changes.map((one, i) => {
    const from = x(one.timeS);
    const until = i + 1 < changes.length ? x(changes[i + 1].timeS) : right;
    const [name, colour] = look(one);
    const [fill, ink] = colour ? [`var(--${colour})`, `var(--on-${colour})`] : ["var(--raised)", "var(--text)"];
    const seen = until - from - 8 >= widthOf(name);
    return svg`<g class="span ${pale(one.timeS)}"><title>${described(one)}</title>
      <rect x=${from} y=${top + 2} width=${Math.max(2, until - from - 1)} height=${LANE_PX - 5} fill=${fill}></rect>
      ${seen ? svg`<text x=${from + 5} y=${top + 14} fill=${ink}>${name}</text>` : nothing}</g>`;
  });
}
