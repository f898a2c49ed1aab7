/** The way of each vehicle in the last minute. */

const KEPT_S = 60;
const STEP_S = 0.4;

export class Trails {
  constructor() {
    this._of = new Map();
  }

  clear() {
    this._of.clear();
  }

  /** Positions of silent vehicles are old, and are not drawn as new ones. */
  accept(snapshot) {
    for (const vehicle of snapshot.vehicles) {
      if (vehicle.silent || vehicle.data_age_s === null) continue;
      const key = `${vehicle.fleet}/${vehicle.vehicle_id}`;
      let trail = this._of.get(key);
      if (!trail) this._of.set(key, (trail = []));
      const last = trail.at(-1);
      if (last && snapshot.time_s - last.timeS < STEP_S) continue;
      trail.push({ timeS: snapshot.time_s, position: vehicle.position_enu_m });
      while (trail[0].timeS < snapshot.time_s - KEPT_S) trail.shift();
    }
  }

  /** Points {timeS, position}, oldest first. */
  of(vehicle) {
    return this._of.get(`${vehicle.fleet}/${vehicle.vehicle_id}`) ?? [];
  }
}
