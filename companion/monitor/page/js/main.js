/** Start of the page: connects the parts and draws a frame where something has changed. */

import { acknowledge, readToken } from "./api.js";
import { Commanding } from "./commanding.js";
import { Dividers } from "./dividers.js";
import { watchAbortKeys, watchHolds } from "./hold.js";
import { LiveConnection } from "./live.js";
import { FleetMap } from "./map/map.js";
import { Metrics } from "./metrics.js";
import { PANELS } from "./panels.js";
import { Planning } from "./planning.js";
import { Replaying, watchReplayKeys } from "./replaying.js";
import { AlarmSound } from "./sound.js";
import { Store } from "./store.js";
import { Theme } from "./theme.js";
import { banner, hint } from "./views/banner.js";
import { bar } from "./views/bar.js";
import { figures } from "./views/figures.js";
import { help } from "./views/help.js";
import { render } from "./views/lit.js";
import { legend, mapNote, mapTools } from "./views/map_tools.js";
import { Plots } from "./views/plots.js";
import { replay } from "./views/replay.js";
import { watchSight } from "./views/sight.js";
import { tabs } from "./views/tabs.js";

const ABORT_HOLD_S = 0.5;
const HINT_MS = 4000;
const TICK_MS = 200; // ages count up also without snapshots
const PANELS_MS = 240; // between two updates of lists and plots by snapshots: people read no faster

const at = (id) => document.getElementById(id);
const store = new Store();
const sound = new AlarmSound();
const metrics = new Metrics();
const abort = { keys: false };
const page = { tab: "vehicles", filter: "all", hint: "" };
const widthPx = { events: 0, replay: 0 }; // of what has a timeline
let frame = null; // the requested animation frame
let panelsFrame = null; // likewise, of the panels
let panelsMs = -Infinity; // when they were drawn
let arrivedMs = null; // of the oldest snapshot that is not painted yet

const theme = new Theme(schedule);
const commanding = new Commanding(store, schedule, showPreviewed);
const planning = new Planning(store, commanding, { changed: schedule, hint: (text) => act.hint(text), preview: previewForm });
const map = new FleetMap({ canvas: at("scene"), cursor: at("map-cursor"), note: at("map-note") }, store, planning, {
  changed: schedule,
  selected: (id, several) => act.select(id, several),
});
const dividers = new Dividers(document.querySelector("main"));
const plots = new Plots(at("plots"), store);
const watchRows = watchSight(at("vehicles"), schedule);

const act = {
  select(id, several) {
    store.select(id, several);
    if (!store.selected.size) commanding.toSelected = false;
    schedule();
  },
  chooseFleet(name) {
    planning.leave();
    store.chooseFleet(name);
    map.fit();
  },
  tab(name) {
    page.tab = name;
    if (name === "alarms") at("alarms").scrollTop = 0;
    showTab();
    schedule();
  },
  filterEvents(filter) {
    page.filter = filter;
    schedule();
  },
  acknowledge: (id) => acknowledge(id).catch((error) => act.hint(`Not acknowledged: ${error.message}`)),
  sound() {
    sound.toggle();
    schedule();
  },
  theme: () => theme.next(),
  help: () => at("help").showModal(),
  hint(text) {
    page.hint = text;
    schedule();
    clearTimeout(page.hintTimer);
    page.hintTimer = setTimeout(() => act.hint(""), text ? HINT_MS : 2 ** 30);
  },
  target(toSelected) {
    commanding.toSelected = toSelected;
    schedule();
  },
  abort() {
    if (!store.controls) return;
    act.tab("control");
    commanding.abort();
  },
};

const live = new LiveConnection(
  (snapshot, nowMs) => {
    const isFirst = store.snapshot === null; // the panels of the page that was loaded are empty
    store.accept(snapshot, nowMs);
    planning.check();
    sound.update(snapshot.alarms, nowMs);
    arrivedMs ??= nowMs;
    store.refreshFile(nowMs, (file) => file.tiles && map.probeTiles(file));
    if (store.selected.size) store.refreshLogs(nowMs);
    scheduleMap();
    if (isFirst || nowMs - panelsMs >= PANELS_MS) schedulePanels();
  },
  () => {
    store.refused = "";
    store.loadHistory();
    commanding.checkControl();
  },
  (reason) => {
    store.refused = reason;
    schedule();
  },
);

const replaying = new Replaying(store, (message) => live.send(message), (text) => act.hint(text));

/** All of the page: after an action of the operator. */
function schedule() {
  scheduleMap();
  schedulePanels();
}

function scheduleMap() {
  frame ??= requestAnimationFrame(drawMap);
}

/** The panel of commands may be longer than its place: what a preview says, and its `Send`, come into sight. */
function showPreviewed() {
  drawPanels();
  if (planning.takesAccepted()) document.querySelector("[data-action=use-instead]")?.click();
  document.querySelector(".previewed")?.scrollIntoView({ block: "nearest" });
}

/** What the map has changed goes into its form, and with the form to the vehicles. */
function previewForm(name) {
  act.tab("control");
  drawPanels();
  if (store.freshness.lost(performance.now())) {
    act.hint("No live data: the vehicles cannot be asked.");
    return;
  }
  const form = document.querySelector(`form[data-form="${name}"]`);
  form.closest("details").open = true;
  form.requestSubmit();
}

/** In a frame after that of the map, which does not wait for them. */
function schedulePanels() {
  panelsFrame ??= requestAnimationFrame(() => {
    panelsFrame = requestAnimationFrame(drawPanels);
  });
}

/** On a narrow screen the panels of the other tabs are out of sight. */
function showTab() {
  for (const { id, beside } of PANELS) at(id).classList.toggle("other", (beside ?? id) !== page.tab);
}

function contextAt(nowMs) {
  return { store, nowMs, theme, sound, abort, act, commanding, planning, replaying, widthPx, filter: page.filter };
}

function drawMap() {
  frame = null;
  const nowMs = performance.now();
  document.body.classList.toggle("lost", store.freshness.lost(nowMs));
  document.body.classList.toggle("replaying", Boolean(store.snapshot?.replay));
  const context = contextAt(nowMs);
  render(bar(context), at("bar"));
  render(banner(context), at("banner"));
  render(figures(context), at("figures")); // the separation is that on the map
  render(hint(page.hint), at("hint"));
  map.draw(theme.colours, nowMs);
  at("scene").classList.toggle("drawing", Boolean(store.drawing?.active));
  if (arrivedMs !== null) metrics.drawn(arrivedMs);
  arrivedMs = null;
}

function drawPanels() {
  panelsFrame = null;
  panelsMs = performance.now();
  const context = contextAt(panelsMs);
  const { controls, snapshot } = store;
  const panels = PANELS.filter(({ shown }) => !shown || shown(store));
  if (!panels.some(({ id }) => id === page.tab)) act.tab("vehicles");
  for (const panel of PANELS) at(panel.id).hidden = !panels.includes(panel);
  at("replay").hidden = !snapshot?.replay;
  at("skip-control").hidden = at("control").hidden;
  if (snapshot?.replay) render(replay(context), at("replay"));
  render(tabs({ panels, store, current: page.tab, act }), at("tabs"));
  for (const { id, view } of panels) if (view) render(view(context), at(id));
  watchRows();
  render(mapTools({ map, planning, store, commanding }), at("map-tools"));
  render(help({ controls, replays: Boolean(snapshot?.replay), dividers, close: () => at("help").close() }), at("help"));
  render(mapNote({ store, planning }), at("map-note"));
  at("map-attribution").textContent = map.attribution;
  plots.update(theme.colours, document.documentElement.dataset.theme);
  if (store.arrivedMs !== null) metrics.drawn(store.arrivedMs);
}

/** Once a second without snapshots as well: ages, the banner, the sound of a lost server. */
function tick() {
  const nowMs = performance.now();
  if (!store.freshness.lost(nowMs)) return;
  if (store.snapshot) sound.lost(nowMs);
  schedule();
}

window.addEventListener("hashchange", () => {
  readToken();
  commanding.checkControl();
});
watchHolds(document);
document.addEventListener("keydown", (event) => {
  const undoes = event.key.toLowerCase() === "z" && (event.ctrlKey || event.metaKey) && !event.shiftKey;
  if (!undoes || event.target.matches("input")) return;
  event.preventDefault(); // the browser would take back what was typed last, in any form
  if (planning.canUndo) planning.undo();
  else if (store.preview) act.hint("Nothing was placed or dragged: there is nothing to take back.");
});
watchAbortKeys(
  ABORT_HOLD_S,
  (held) => {
    abort.keys = held && store.controls;
    schedule();
  },
  () => act.abort(),
);
watchReplayKeys(document, store, replaying);
const sizes = new ResizeObserver((entries) => {
  for (const { target, contentRect } of entries) widthPx[target.id] = contentRect.width;
  schedulePanels();
});
at("skip-control").addEventListener("click", () => act.tab("control"));
for (const id of Object.keys(widthPx)) sizes.observe(at(id));
render(legend(), at("map-legend"));
showTab();
setInterval(tick, TICK_MS);
schedule();
