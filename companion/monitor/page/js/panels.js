/** The panels beside the map. A further one is its view, an entry here, and its section in index.html. */

import { alarms } from "./views/alarms.js";
import { control } from "./views/control.js";
import { details } from "./views/details.js";
import { events } from "./views/events.js";
import { vehicles } from "./views/vehicles.js";

// A narrow screen shows one tab at a time: `title` is that of the tab, `beside` the panel whose tab it shares. The plots draw
// themselves. `shown`: whether there is anything to show.
export const PANELS = [
  { id: "vehicles", title: () => "Vehicles", view: vehicles },
  { id: "details", beside: "vehicles", view: details },
  { id: "alarms", title: alarmsTitle, view: alarms },
  { id: "control", title: () => "Control", view: control, shown: (store) => store.controls },
  { id: "plots", title: () => "Plots" },
  { id: "events", title: () => "Events", view: events },
];

function alarmsTitle(store) {
  const open = store.alarms.filter((alarm) => !alarm.acknowledged).length;
  return open ? `Alarms ${open}` : "Alarms";
}
