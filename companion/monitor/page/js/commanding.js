/** Commands of this page and their answers. */

import { command, hasToken, mayCommand, preview } from "./api.js";

const KEPT = 2;

export class Commanding {
  constructor(store, onChange, onPreviewed) {
    this._store = store;
    this._onChange = onChange;
    this._onPreviewed = onPreviewed;
    this._number = 0;
    this.sent = []; // newest first: {number, title, result: CommandResult or null, error}
    this.toSelected = false; // else to all vehicles
    this.previewing = false;
    this._previews = 0; // how many were asked for or discarded: an answer to an older one is not shown
    this.previewError = "";
    this.allowed = hasToken();
    this.abortError = ""; // why the last ABORT was not sent
  }

  /** An operator must see at once that a page commands nobody, as after a new start of the server. */
  async checkControl() {
    this.allowed = await mayCommand().catch(() => this.allowed);
    if (this.allowed) this.abortError = "";
    this._onChange();
  }

  /** The page had control; the server does not take its token any more. */
  get hasLostControl() {
    return hasToken() && !this.allowed;
  }

  async abort() {
    this.abortError = "";
    const { error } = await this.send("abort");
    this.abortError = error;
    this._onChange();
  }

  /** Ids for a CommandRequest, where none means all; null where a selection is meant and there is none. */
  get targets() {
    if (!this.toSelected) return [];
    const ids = [...this._store.selected].sort((a, b) => a - b);
    return ids.length ? ids : null;
  }

  async send(name, vehicleIds = [], content = {}) {
    const fleet = this._store.fleetName;
    const all = name === "reference" ? "the vehicles that may lead" : "all vehicles";
    const who = vehicleIds.length ? `vehicles ${vehicleIds.join(", ")}` : all;
    const entry = { number: (this._number += 1), title: `${name === "doctor" ? "check" : name}, ${who}`, result: null, error: "" };
    this.sent = [entry, ...this.sent].slice(0, KEPT);
    this._onChange();
    try {
      entry.result = await command({ fleet, name, vehicle_ids: vehicleIds, content });
      entry.error = entry.result.error || "";
    } catch (error) {
      entry.error = error.message;
    }
    this._onChange();
    return entry;
  }

  forgetAnswers() {
    this.sent = [];
    this._onChange();
  }

  /** Shows what a formation or reference would do. Nothing is sent to a vehicle. */
  async preview(name, content) {
    const store = this._store;
    const before = store.preview?.name === name ? { ...store.preview, pending: true } : null; // stays until the answer
    this.discard();
    const number = this._previews;
    store.preview = before;
    this.previewing = true;
    this._onChange();
    const [basis, referenceEnuM] = [store.flown, store.referenceEnuM];
    let shown = null;
    try {
      shown = { ...(await preview({ fleet: store.fleetName, name, vehicle_ids: [], content })), name, content, basis, referenceEnuM };
    } catch (error) {
      if (number === this._previews) this.previewError = error.message;
    }
    if (number !== this._previews) return;
    store.preview = shown;
    this.previewing = false;
    this._onChange();
    this._onPreviewed();
  }

  sendPreviewed() {
    const { name, content } = this._store.preview;
    return this.send(name, [], content);
  }

  discard() {
    this._previews += 1;
    this.previewing = false;
    this._store.preview = null;
    this.previewError = "";
    this._onChange();
  }
}
