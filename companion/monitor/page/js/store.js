/** What the page knows: the newest snapshot, what it has kept of earlier ones, and what the operator has chosen. */

import { get } from "./api.js";
import { Freshness } from "./freshness.js";
import { History } from "./history.js";
import { missionOf } from "./mission.js";
import { isFlying } from "./phases.js";
import { Trails } from "./trails.js";

const KEPT_EVENTS = 2000; // as many as the server keeps
const JUMP_S = 3; // a larger step in time is a seek: what came before belongs elsewhere
const FILE_AGAIN_MS = 5000; // homes change
const DESCRIBED_AFTER_MS = 2200; // after another reference its leader describes it: DESCRIBED_EVERY of core/report.py
const LOGS_AGAIN_MS = 10000;
const NO_FILE_AGAIN_MS = 60000; // without a fleet file the server answers 404
const HISTORY_AGAIN_MS = 5000; // a slow connection misses snapshots all the time

export class Store {
  constructor() {
    this.snapshot = null;
    this.arrivedMs = null; // of the snapshot
    this.refused = ""; // why the server sends this page nothing
    this.freshness = new Freshness();
    this.trails = new Trails();
    this.history = new History();
    this.events = []; // newest first
    this.armed = new Map(); // of each vehicle that waits for its take-off, when it was armed
    this.disarmed = new Map(); // of each that was armed and did not take off, when it was disarmed
    this.formed = new Set(); // those that fly and were in formation
    this.logs = null; // LogsView: the files of flights on the ground
    this._logsNextMs = 0; // when they are asked for again
    this.flight = null; // of a replay: what happened in all of it
    this.selected = new Set();
    this.preview = null; // of what has not been sent
    this.drawing = null; // {points, altitudeM, most, active, goes} while points are placed on the map; `active`: a click places one
    this.file = null; // FleetFileView
    this._fleetName = null;
    this._fileNextMs = 0; // when the file is asked for again
    this._reference = undefined; // flown when it was asked for
    this._historyAsked = false;
    this._historyNextMs = 0; // when it may be asked for again because of missed snapshots
    this._missed = true; // events that only the history has
    this._flightAsked = false;
    this._mission = { of: null }; // of these events
    this._led = {}; // who led when the page first saw this fleet
  }

  /** The chosen fleet; before any vehicle reports that which the page commands: ABORT is for it. */
  get fleetName() {
    return this._fleetName ?? this.snapshot?.fleets[0]?.name ?? (this.snapshot?.commands || null);
  }

  get fleet() {
    return this.snapshot?.fleets.find((fleet) => fleet.name === this.fleetName) ?? null;
  }

  get vehicles() {
    return this.snapshot?.vehicles.filter((vehicle) => vehicle.fleet === this.fleetName) ?? [];
  }

  /** Where the reference is now, as a leader reports it; null without one. */
  get referenceEnuM() {
    return this.vehicles.find((vehicle) => vehicle.reference_enu_m && !vehicle.silent)?.reference_enu_m ?? null;
  }

  /** Formation and reference of each vehicle: a preview is of a change of these. */
  get flown() {
    return this.vehicles.map((vehicle) => `${vehicle.vehicle_id} ${vehicle.formation} ${vehicle.reference.replace(/, target.*/, "")}`).join();
  }

  get alarms() {
    return this.snapshot?.alarms ?? [];
  }

  /** missionOf the shown fleet, with its `events`, newest first: in a replay those of the whole flight. */
  get mission() {
    const of = this.flight?.events ?? this.events;
    if (this._mission.of !== of || this._mission.fleet !== this.fleetName) {
      const events = of.filter((event) => event.fleet === this.fleetName);
      this._mission = { of, fleet: this.fleetName, events, ...missionOf(events, this._firstLeaders(events)) };
    }
    return this._mission;
  }

  /** Who led before the first change of leader, as far as that is known. */
  _firstLeaders(events) {
    if (this.flight) return this.flight.leader_ids[this.fleetName] ?? [];
    const changed = events.some((event) => event.kind === "leader" && event.time_s < this._led.timeS);
    return changed || this._led.fleet !== this.fleetName ? [] : this._led.ids;
  }

  /** Those that the page can command now. */
  get controls() {
    return Boolean(this.snapshot?.commands) && !this.snapshot.replay;
  }

  chooseFleet(name) {
    this._fleetName = name;
    this.selected.clear();
    this.preview = null;
    this.drawing = null;
    this.file = null;
    this._fileNextMs = 0;
    this.history.clear();
    this.loadHistory();
  }

  accept(snapshot, nowMs) {
    const before = this.snapshot;
    const restarted = before && snapshot.number < before.number; // the server numbers events from 1 again
    const jumped = before && Math.abs(snapshot.time_s - before.time_s) > JUMP_S;
    this._missed ||= before !== null && snapshot.number > before.number + 1;
    this.snapshot = snapshot;
    this.arrivedMs = nowMs;
    this.freshness.accept(snapshot, nowMs);
    if (restarted) [this.flight, this._flightAsked] = [null, false];
    if (restarted || jumped) this._forget();
    else if (this._missed && nowMs >= this._historyNextMs) {
      this._historyNextMs = nowMs + HISTORY_AGAIN_MS;
      this.loadHistory();
    }
    if (snapshot.replay && !this._flightAsked) this._loadFlight();
    if (this._led.fleet !== this.fleetName) {
      this._led = { fleet: this.fleetName, ids: this.fleet?.leader_ids ?? [], timeS: snapshot.time_s };
      this._mission.of = null;
    }
    this.trails.accept(snapshot);
    this._acceptArmed();
    this.history.accept(snapshot.time_s, this.fleet, this.vehicles);
    this._addEvents(snapshot.events);
  }

  _acceptArmed() {
    for (const vehicle of this.vehicles) {
      const { vehicle_id: id, phase, silent } = vehicle;
      if (silent) continue;
      if (!isFlying(vehicle)) this.formed.delete(id);
      else if (phase !== "takeoff" && phase !== "hold") this.formed.add(id);
      if (phase !== "observe") this.disarmed.delete(id);
      if (phase === "armed") this.armed.set(id, this.armed.get(id) ?? this.snapshot.time_s);
      else if (this.armed.delete(id) && phase === "observe") this.disarmed.set(id, this.snapshot.time_s);
    }
  }

  select(id, several) {
    const only = !several;
    const was = this.selected.has(id);
    if (only) this.selected.clear();
    if (id === null) return;
    if (was && several) this.selected.delete(id);
    else this.selected.add(id);
  }

  /** Past points and events. Without them the plots begin now. */
  async loadHistory() {
    if (this._historyAsked || this.fleetName === null) return;
    this._historyAsked = true;
    this._missed = false;
    const history = await get("history").catch(() => null);
    this._historyAsked = false;
    this._missed ||= history === null;
    if (!history) return;
    this.history.load(history.points.filter((point) => point.fleet === this.fleetName));
    this._addEvents(history.events);
  }

  /** Again from time to time: some are still written. */
  async refreshLogs(nowMs) {
    if (nowMs < this._logsNextMs) return;
    this._logsNextMs = nowMs + LOGS_AGAIN_MS;
    this.logs = await get("logs").catch(() => this.logs);
  }

  async _loadFlight() {
    this._flightAsked = true;
    const flight = await get("flight").catch(() => null);
    this.flight = flight && { ...flight, events: flight.events.toReversed() };
  }

  /** The fleet file, again from time to time because of the homes. Calls `onFile(file)`. */
  async refreshFile(nowMs, onFile) {
    const name = this.fleetName;
    const reference = this.vehicles.find((vehicle) => vehicle.reference_enu_m)?.reference;
    const changed = reference !== this._reference;
    if (name === null || (nowMs < this._fileNextMs && !changed)) return;
    this._fileNextMs = nowMs + (changed ? DESCRIBED_AFTER_MS : FILE_AGAIN_MS);
    this._reference = reference;
    const file = await get(`fleets/${encodeURIComponent(name)}`).catch(() => null);
    if (name !== this.fleetName) return;
    if (!file) {
      this._fileNextMs = nowMs + NO_FILE_AGAIN_MS;
      return;
    }
    this.file = file;
    onFile(file);
  }

  _addEvents(events) {
    if (!events.length) return;
    const known = new Set(this.events.map((event) => event.id));
    const fresh = events.filter((event) => !known.has(event.id));
    this.events = [...fresh, ...this.events].sort((a, b) => b.id - a.id).slice(0, KEPT_EVENTS);
  }

  _forget() {
    this.trails.clear();
    this.history.clear();
    this.armed.clear();
    this.disarmed.clear();
    this.formed.clear();
    this.events = [];
    this._led = {};
    this.loadHistory();
  }
}
