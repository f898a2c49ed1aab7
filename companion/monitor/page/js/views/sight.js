/** Which rows of the list are in sight. The others are updated once a second: a long list costs little more than a short one. */

const HIDDEN_PERIOD_MS = 1000;
const EARLY = "150px"; // a row is in sight before it is seen

const hidden = new Map(); // id of a vehicle out of sight -> when its row is due

/** Whether the row of a vehicle need not be updated now. */
export function outOfSight(id, nowMs) {
  const dueMs = hidden.get(id);
  if (dueMs === undefined) return false;
  if (nowMs < dueMs) return true;
  hidden.set(id, nowMs + HIDDEN_PERIOD_MS);
  return false;
}

/** Watches the rows below an element that scrolls. `onSeen()` when rows come into sight. */
export function watchSight(list, onSeen) {
  const observer = new IntersectionObserver((entries) => {
    for (const { target, isIntersecting } of entries) {
      const id = Number(target.dataset.id);
      if (isIntersecting) hidden.delete(id);
      else if (!hidden.has(id)) hidden.set(id, 0);
    }
    onSeen();
  }, { root: list, rootMargin: EARLY });
  const watched = new Map(); // row -> the id it had
  return () => {
    for (const row of list.querySelectorAll("tbody.vehicle")) {
      if (watched.get(row) === row.dataset.id) continue;
      watched.set(row, row.dataset.id);
      observer.observe(row);
    }
    for (const row of watched.keys()) if (!row.isConnected) forget(row);
  };

  function forget(row) {
    observer.unobserve(row);
    hidden.delete(Number(watched.get(row)));
    watched.delete(row);
  }
}
