/** Which lines the plots have: every vehicle of a small fleet; of a large one its range, median, and the selected vehicles. */

import { colourOf, dashOf } from "../vehicle_look.js";

const SMALL_FLEET = 8;
const SHARES = { smallest: 0, median: 0.5, largest: 1 };

/** {label, stroke, width, dash, id or share} of each line. */
export function seriesFor(store, colours) {
  const ids = store.vehicles.map((vehicle) => vehicle.vehicle_id);
  const line = (id) => {
    const width = store.selected.has(id) ? 3 : 1.5;
    return { label: String(id), id, stroke: colours[colourOf(id)], width, dash: dashOf(id, width) };
  };
  if (ids.length <= SMALL_FLEET) return ids.map(line);
  const shares = Object.entries(SHARES).map(([label, share]) => ({
    label,
    share,
    stroke: colours.quiet,
    width: share === 0.5 ? 2 : 1.2,
    dash: share === 0.5 ? [] : [4, 3],
  }));
  const chosen = ids.filter((id) => store.selected.has(id)).slice(0, SMALL_FLEET);
  return [...shares, ...chosen.map(line)];
}

/** The data of one plot as uPlot wants it: times, then one array for each line. */
export function columns(points, plot, lines, file) {
  const values = lines.map((line) =>
    points.map((point) => (line.id === undefined ? shareOf(point, plot.key, line.share) : point.of.get(line.id)?.[plot.key] ?? null)),
  );
  const limits = plot.separation ? [points.map((point) => point.separationM), points.map(() => file?.separation_m ?? null)] : [];
  return [points.map((point) => point.timeS), ...values, ...limits];
}

/** Sorted once for each point, then kept with it. */
function shareOf(point, key, share) {
  point.sorted ??= {};
  const sorted = (point.sorted[key] ??= valuesOf(point, key));
  return sorted.length ? sorted[Math.round(share * (sorted.length - 1))] : null;
}

function valuesOf(point, key) {
  const values = [...point.of.values()].map((sample) => sample[key]);
  return values.filter((value) => value !== null).sort((a, b) => a - b);
}
