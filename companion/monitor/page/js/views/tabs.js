/** The panels that a narrow screen shows one at a time. */

import { html } from "./lit.js";

export function tabs({ store, current, act }) {
  const open = store.alarms.filter((alarm) => !alarm.acknowledged).length;
  const names = { vehicles: "Vehicles", alarms: open ? `Alarms ${open}` : "Alarms" };
  if (store.controls) names.control = "Control";
  Object.assign(names, { plots: "Plots", events: "Events" });
  return Object.entries(names).map(([key, name]) => html`<button aria-pressed=${current === key}
    @click=${() => act.tab(key)}>${name}</button>`);
}
