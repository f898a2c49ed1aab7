/** How old the shown data is: since the last snapshot, and by how much snapshots arrive late. */

const LOST_AFTER_S = 1;
const SNAPSHOT_PERIOD_S = 0.1;

/**
 * A slow network can deliver old snapshots in time, one after another. They lag when both clocks of the snapshots say
 * so: their time, which a clock step on the server moves, and their number, which a busy server raises more slowly.
 */
export class Freshness {
  constructor() {
    this.arrivedMs = null;
    this.lagS = 0; // compared with the quickest snapshot
    this._leastByTime = Infinity;
    this._leastByNumber = Infinity;
    this._number = 0;
  }

  accept(snapshot, nowMs) {
    this.arrivedMs = nowMs;
    if (snapshot.number < this._number) this._leastByNumber = Infinity; // the server has started again
    this._number = snapshot.number;
    const byTime = nowMs / 1000 - snapshot.time_s;
    const byNumber = nowMs / 1000 - snapshot.number * SNAPSHOT_PERIOD_S;
    this._leastByTime = Math.min(this._leastByTime, byTime);
    this._leastByNumber = Math.min(this._leastByNumber, byNumber);
    const replayed = Boolean(snapshot.replay); // its time runs at any speed
    this.lagS = replayed ? 0 : Math.min(byTime - this._leastByTime, byNumber - this._leastByNumber);
  }

  /** Seconds since what is shown was true, as far as this page can know; null before the first snapshot. */
  ageS(nowMs) {
    return this.arrivedMs === null ? null : (nowMs - this.arrivedMs) / 1000 + this.lagS;
  }

  lost(nowMs) {
    const ageS = this.ageS(nowMs);
    return ageS === null || ageS > LOST_AFTER_S;
  }
}
