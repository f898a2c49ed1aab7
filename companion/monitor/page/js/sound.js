/** A tone for new alarms, repeated while a critical one is not acknowledged. Off until the operator switches it on. */

const REPEAT_MS = 5000;
const TONES = { critical: [880, 660, 880], warning: [660], info: [] };

export class AlarmSound {
  constructor() {
    this.on = false;
    this._known = new Set();
    this._soundedMs = 0;
  }

  /** Called from a click: browsers allow sound only then. */
  toggle() {
    this.on = !this.on;
    if (!this.on) return;
    this._context ??= new AudioContext();
    this._context.resume();
    this._play(TONES.warning);
  }

  /** With each snapshot. */
  update(alarms, nowMs) {
    const open = alarms.filter((alarm) => !alarm.acknowledged);
    const fresh = open.filter((alarm) => !this._known.has(alarm.id));
    this._known = new Set(open.map((alarm) => alarm.id));
    if (!this.on) return;
    const repeats = nowMs - this._soundedMs >= REPEAT_MS;
    const loudest = repeats && open.some(isCritical) ? "critical" : fresh.some(isCritical) ? "critical" : fresh[0]?.severity;
    if (!loudest) return;
    this._soundedMs = nowMs;
    this._play(TONES[loudest] ?? []);
  }

  /** A lost server is an alarm that only this page can give. */
  lost(nowMs) {
    if (!this.on || nowMs - this._soundedMs < REPEAT_MS) return;
    this._soundedMs = nowMs;
    this._play(TONES.critical);
  }

  _play(frequencies) {
    frequencies.forEach((frequency, i) => this._tone(frequency, this._context.currentTime + i * 0.18));
  }

  _tone(frequency, beginS) {
    const oscillator = this._context.createOscillator();
    const gain = this._context.createGain();
    oscillator.frequency.value = frequency;
    gain.gain.setValueAtTime(0.0001, beginS);
    gain.gain.exponentialRampToValueAtTime(0.25, beginS + 0.02);
    gain.gain.exponentialRampToValueAtTime(0.0001, beginS + 0.15);
    oscillator.connect(gain).connect(this._context.destination);
    oscillator.start(beginS);
    oscillator.stop(beginS + 0.16);
  }
}

function isCritical(alarm) {
  return alarm.severity === "critical";
}
