/** Keys and gestures. */

import { html, nothing } from "./lit.js";

const MAP_KEYS = [
  ["Arrow keys", "move the map"],
  ["Shift + arrow keys", "rotate and tilt"],
  ["+ and −", "zoom"],
  ["F", "show the whole fleet and follow it"],
  ["3", "from above or 3-D"],
  ["N", "north up"],
  ["Ctrl + Z", "take back the last point, or the last drag of a point or slot"],
];

const REPLAY_KEYS = [
  ["K", "play, pause"],
  ["J and L", "previous and next event"],
  ["Shift + J and L", "previous and next finding: an alarm that begins"],
  ["U and O", "slower, faster"],
];

export function help({ controls, replays, dividers, close }) {
  return html`<h2 id="help-title">Keys and gestures</h2>
    ${controls ? html`<p class="critical"><kbd>Shift</kbd> + <kbd>Escape</kbd>, both held for half a second: ABORT of all
      vehicles of the fleet, from anywhere on the page. On the ground they disarm, in the air they stop in their autopilots'
      hold mode.</p>
      <p>Buttons with a bar below their name act when they are held for a second, by finger, mouse, Space or Enter.</p>` : nothing}
    <dl>${MAP_KEYS.map(([keys, text]) => html`<div><dt>${keys}</dt><dd>${text}</dd></div>`)}</dl>
    <p>The keys work while the map has the focus. With the mouse: drag to move, Shift or the right button to rotate and tilt,
      the wheel to zoom. With fingers: one moves, two zoom and rotate.</p>
    ${replays ? html`<p>In the replay, anywhere on the page:</p>
      <dl>${REPLAY_KEYS.map(([keys, text]) => html`<div><dt>${keys}</dt><dd>${text}</dd></div>`)}</dl>` : nothing}
    <p>A click selects a vehicle, with Shift several.</p>
    <p>The lines between panels are dragged, or moved by arrow keys, with Shift in longer steps; a double click or Enter gives
      the usual size.</p>
    <button id="usual-sizes" ?disabled=${dividers.areUsual} @click=${() => dividers.reset()}>Usual sizes of all panels</button>
    <button @click=${close}>Close</button>`;
}
