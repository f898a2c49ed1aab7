/** The last ten minutes for the plots: fetched once, then continued from the snapshots. */

const KEPT_S = 600;
const STEP_S = 0.5;
const OLD_DATA_S = 1; // an older position is none of now

export class History {
  constructor() {
    this.points = [];
  }

  clear() {
    this.points = [];
  }

  /** Points of `GET /api/v1/history`, before what the page has seen itself. */
  load(points) {
    const first = this.points[0]?.timeS ?? Infinity;
    const earlier = points.filter((point) => point.time_s < first);
    this.points = [...earlier.map(unpacked), ...this.points];
  }

  /** `fleet` and `vehicles` are those shown. */
  accept(timeS, fleet, vehicles) {
    const last = this.points.at(-1);
    if (last && timeS - last.timeS < STEP_S) return;
    const present = vehicles.filter((vehicle) => !vehicle.silent);
    const of = new Map(present.map((vehicle) => [vehicle.vehicle_id, sampleOf(vehicle)]));
    this.points.push({ timeS, separationM: fleet?.smallest_separation_m ?? null, of });
    while (this.points[0].timeS < timeS - KEPT_S) this.points.shift();
  }
}

function sampleOf(vehicle) {
  return {
    altitudeM: vehicle.data_age_s !== null && vehicle.data_age_s <= OLD_DATA_S ? vehicle.position_enu_m[2] : null,
    errorM: vehicle.error_to_slot_m,
    lateMs: vehicle.timing.late_p99_ms,
    nearestM: vehicle.nearest?.distance_m ?? null,
  };
}

/** A HistoryPoint of the API; its vehicles are arrays. */
function unpacked(point) {
  const of = new Map(
    point.vehicles.map(([id, altitudeM, errorM, , lateMs, nearestM]) => [id, { altitudeM, errorM, lateMs, nearestM }]),
  );
  return { timeS: point.time_s, separationM: point.smallest_separation_m, of };
}
