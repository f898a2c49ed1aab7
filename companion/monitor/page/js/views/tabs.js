/** The panels that a narrow screen shows one at a time. */

import { html } from "./lit.js";

export function tabs({ panels, store, current, act }) {
  return panels.filter(({ title }) => title).map(({ id, title }) => html`<button aria-pressed=${current === id}
    @click=${() => act.tab(id)}>${title(store)}</button>`);
}
