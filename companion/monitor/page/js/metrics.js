/** Measured update times: from the arrival of a snapshot to the painted frame. `companionMetrics` in the console. */

const KEPT = 600;

export class Metrics {
  constructor() {
    this.restart();
    this.firstPaintMs = null; // since the navigation to the page
    this._channel = new MessageChannel();
    this._channel.port1.onmessage = () => this._painted();
    this._pendingMs = null;
    globalThis.companionMetrics = this;
  }

  restart() {
    this._durationsMs = [];
    this.count = 0;
  }

  /** Called in an animation frame, after drawing. A message is handled after the frame has been painted. */
  drawn(arrivedMs) {
    this._pendingMs ??= arrivedMs;
    this._channel.port2.postMessage(null);
  }

  _painted() {
    if (this._pendingMs === null) return;
    const now = performance.now();
    performance.clearMeasures("snapshot"); // the browser would keep all of them
    performance.measure("snapshot", { start: this._pendingMs, end: now });
    this._durationsMs.push(now - this._pendingMs);
    if (this._durationsMs.length > KEPT) this._durationsMs.shift();
    this._pendingMs = null;
    this.firstPaintMs ??= now;
    this.count += 1;
  }

  _share(share) {
    const sorted = [...this._durationsMs].sort((a, b) => a - b);
    return sorted.length ? sorted[Math.min(sorted.length - 1, Math.floor(share * sorted.length))] : null;
  }

  get p50_ms() {
    return this._share(0.5);
  }

  get p95_ms() {
    return this._share(0.95);
  }

  get max_ms() {
    return this._share(1);
  }
}
