/** Playing a recorded flight: its speed, and jumps to what happened in it. */

export const SPEEDS = [0.25, 0.5, 1, 2, 4, 8, 16];
const TOGETHER_S = 0.5; // what happens within this time is one place to jump to
const BACK_S = 1; // while it plays, the place that it has just passed is not the one before
const SHOWN_AFTER = 3; // snapshots after a message
const FINDINGS = new Set(["alarm"]);

export class Replaying {
  /** `send(message)` to the server; `tell(text)` to the operator. */
  constructor(store, send, tell) {
    this._store = store;
    this._send = send;
    this._tell = tell;
    this._last = 1; // speed before a pause
    this._asked = null; // {speed, number} and {timeS, number} until a snapshot shows them
    this._sought = null;
  }

  /** That of now, or before a pause. */
  get speed() {
    return this._present || this._last;
  }

  get paused() {
    return this._present === 0;
  }

  get _present() {
    if (this._isShown(this._asked)) this._asked = null;
    const speed = this._asked?.speed ?? this._store.snapshot.replay.speed;
    if (speed) this._last = speed;
    return speed;
  }

  /** While it is paused: for when it goes on. */
  setSpeed(speed) {
    if (this.paused) this._last = speed;
    else this._ask(speed);
    this._tell(`${speed} ×`);
  }

  toggle() {
    this._ask(this.paused ? this._last : 0);
  }

  _ask(speed) {
    this._asked = { speed, number: this._store.snapshot.number };
    this._send({ type: "speed", speed });
  }

  /** `by` 1: the next faster speed, -1: the next slower one. */
  change(by) {
    const others = SPEEDS.filter((speed) => (speed - this.speed) * by > 0);
    if (others.length) this.setSpeed(by > 0 ? others[0] : others.at(-1));
  }

  seek(timeS) {
    this._sought = { timeS, number: this._store.snapshot.number };
    this._send({ type: "seek", time_s: timeS });
  }

  /** To the next (`by` 1) or previous (-1) event, or to the next finding: an alarm that begins. */
  jump(by, onlyFindings) {
    const found = this._place(by, onlyFindings);
    const kind = onlyFindings ? "finding" : "event";
    if (!found) {
      this._tell(this._store.flight ? `No ${kind} ${by > 0 ? "after" : "before"} this time.` : "The events of the flight are being read.");
      return;
    }
    this.seek(found.time_s);
    this._tell(`${found.vehicle_id === null ? "" : `vehicle ${found.vehicle_id}: `}${found.code} ${found.text}`);
  }

  _place(by, onlyFindings) {
    const wanted = (event) => !onlyFindings || (FINDINGS.has(event.kind) && event.outcome !== "ended");
    const places = placesOf(this._store.mission.events.filter(wanted));
    const nowS = this._nowS();
    const backS = this.paused || this._sought ? TOGETHER_S : BACK_S * Math.max(1, this.speed);
    if (by > 0) return places.find((place) => place.time_s > nowS + TOGETHER_S / 10);
    return places.findLast((place) => place.time_s < nowS - backS);
  }

  /** Of the last jump, until it is shown. */
  _nowS() {
    if (this._isShown(this._sought)) this._sought = null;
    return this._sought?.timeS ?? this._store.snapshot.replay.now_s;
  }

  _isShown(asked) {
    return asked !== null && this._store.snapshot.number > asked.number + SHOWN_AFTER;
  }
}

/** The first of the events that come together. */
function placesOf(events) {
  const places = [];
  for (const event of [...events].sort((a, b) => a.time_s - b.time_s)) {
    if (!places.length || event.time_s - places.at(-1).time_s > TOGETHER_S) places.push(event);
  }
  return places;
}

/** Anywhere on the page, but not where a letter is written. */
export function watchReplayKeys(root, store, replaying) {
  const actions = {
    j: (event) => replaying.jump(-1, event.shiftKey),
    l: (event) => replaying.jump(1, event.shiftKey),
    k: () => replaying.toggle(),
    u: () => replaying.change(-1),
    o: () => replaying.change(1),
  };
  root.addEventListener("keydown", (event) => {
    const writing = event.target.closest?.("select, textarea, dialog[open], input:not([type=range])");
    if (!store.snapshot?.replay || writing || event.ctrlKey || event.altKey || event.metaKey) return;
    const action = actions[event.key.toLowerCase()];
    if (!action) return;
    event.preventDefault();
    action(event);
  });
}
