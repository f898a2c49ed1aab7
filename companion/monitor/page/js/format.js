/** Values as text, with units. What is not known is a dash, never an old or invented number. */

export const NONE = "–";
const GAP = "\u00a0"; // number and unit stay on one line

export function known(value) {
  return typeof value === "number" && Number.isFinite(value);
}

export function number(value, digits) {
  return known(value) ? value.toFixed(digits).replace(/^-(0(\.0*)?)$/, "$1").replace("-", "−") : NONE;
}

export function quantity(value, digits, unit) {
  return known(value) ? number(value, digits) + GAP + unit : NONE;
}

export const metres = (value, digits = 2) => quantity(value, digits, "m");
export const percent = (value) => quantity(value, 0, "%");

/** 240 ms, 3.2 s, 4 min 05 s. */
export function age(seconds) {
  if (!known(seconds)) return NONE;
  if (seconds < 0.9995) return quantity(Math.max(0, seconds) * 1000, 0, "ms");
  if (seconds < 99.95) return quantity(seconds, 1, "s");
  const whole = Math.floor(seconds);
  const minutes = Math.floor(whole / 60);
  if (minutes < 60) return `${minutes}${GAP}min${GAP}${pad(whole % 60)}${GAP}s`;
  return `${Math.floor(minutes / 60)}${GAP}h${GAP}${pad(minutes % 60)}${GAP}min`;
}

/** Unix time as the local time of day. */
export function clock(timeS) {
  if (!known(timeS)) return NONE;
  const date = new Date(timeS * 1000);
  return [date.getHours(), date.getMinutes(), date.getSeconds()].map(pad).join(":");
}

/** Seconds since the begin of a flight: 03:07. */
export function elapsed(seconds) {
  const whole = Math.max(0, Math.floor(seconds));
  return `${pad(Math.floor(whole / 60))}:${pad(whole % 60)}`;
}

export function vector(values, digits = 1) {
  return Array.isArray(values) ? values.map((value) => number(value, digits)).join(", ") : NONE;
}

export function idList(ids) {
  return ids && ids.length ? [...ids].join(", ") : NONE;
}

export function pair(ids) {
  return ids ? `${ids[0]} and ${ids[1]}` : "";
}

function pad(whole) {
  return String(whole).padStart(2, "0");
}
