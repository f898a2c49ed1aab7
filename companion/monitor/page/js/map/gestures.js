/** Mouse, touch and keys of the map: they move the camera, and report clicks. */

const CLICK_PX = 6;
const KEY_PAN_PX = 60;
const KEY_TURN = Math.PI / 24;

/**
 * One finger or the left button moves; Shift, Ctrl or the right button rotates and tilts; two fingers zoom, rotate and
 * move. `on.moved()` after the camera has changed, `on.clicked(x, y, event)`, `on.key(key)` for all other keys,
 * `on.grabbed(x, y, event)` gives what a pointer can drag there, or null: then `on.dragged(it, x, y)` and `on.dropped(it)`.
 * `on.hovered([x, y])` with the pointer over the map, and with null when it leaves.
 */
export function listen(canvas, camera, on) {
  const pointers = new Map();
  let travelled = 0;
  let held = null; // what is dragged
  const within = (event) => {
    const box = canvas.getBoundingClientRect();
    return [event.clientX - box.left, event.clientY - box.top];
  };
  const drop = () => {
    if (held) on.dropped(held);
    held = null;
  };

  const move = (event) => {
    const before = pointers.get(event.pointerId);
    if (!before) return;
    const after = [event.clientX, event.clientY];
    const [dx, dy] = [after[0] - before[0], after[1] - before[1]];
    travelled += Math.hypot(dx, dy);
    if (held) {
      pointers.set(event.pointerId, after);
      if (travelled > CLICK_PX) on.dragged(held, ...within(event));
      return;
    }
    if (pointers.size === 2) pinch(canvas, camera, pointers, event.pointerId, after);
    else if (travelled > CLICK_PX && turns(event)) camera.rotate(dx * 0.008, -dy * 0.008);
    else if (travelled > CLICK_PX) camera.panPixels(dx, dy);
    pointers.set(event.pointerId, after);
    if (travelled > CLICK_PX) {
      canvas.classList.add("dragging");
      on.moved();
    }
  };

  const end = (event) => {
    if (!pointers.delete(event.pointerId)) return;
    const dragged = held && travelled > CLICK_PX;
    drop();
    if (pointers.size || dragged) return;
    canvas.classList.remove("dragging");
    if (event.type === "pointerup" && event.button === 0 && travelled <= CLICK_PX) {
      on.clicked(...within(event), event);
    }
  };

  canvas.addEventListener("pointerdown", (event) => {
    if (pointers.size === 0) {
      travelled = 0;
      held = event.button === 0 && !turns(event) ? on.grabbed(...within(event), event) : null;
    } else drop(); // a second finger: from now on they move the map
    pointers.set(event.pointerId, [event.clientX, event.clientY]);
    canvas.setPointerCapture(event.pointerId);
  });
  canvas.addEventListener("pointermove", (event) => {
    on.hovered(within(event));
    move(event);
  });
  canvas.addEventListener("pointerleave", () => on.hovered(null));
  canvas.addEventListener("pointerup", end);
  canvas.addEventListener("pointercancel", end);
  canvas.addEventListener("contextmenu", (event) => event.preventDefault());
  canvas.addEventListener(
    "wheel",
    (event) => {
      event.preventDefault();
      camera.zoom(Math.exp(-event.deltaY * 0.0015), ...within(event));
      on.moved();
    },
    { passive: false },
  );
  canvas.addEventListener("keydown", (event) => {
    if (event.ctrlKey || event.metaKey || event.altKey) return;
    if (keyMoves(camera, event)) on.moved();
    else if (!on.key(event.key)) return;
    event.preventDefault();
  });
}

function turns(event) {
  return event.shiftKey || event.ctrlKey || (event.buttons & 2) !== 0;
}

/** What two fingers have done since the last event: the one that moved, about the other one. */
function pinch(canvas, camera, pointers, movedId, after) {
  const before = pointers.get(movedId);
  const [, other] = [...pointers].find(([id]) => id !== movedId);
  const box = canvas.getBoundingClientRect();
  const [from, to] = [before, after].map(([x, y]) => [x - other[0], y - other[1]]);
  const factor = Math.hypot(...to) / Math.max(1, Math.hypot(...from));
  camera.rotate(Math.atan2(from[1], from[0]) - Math.atan2(to[1], to[0]), 0);
  camera.panPixels((after[0] - before[0]) / 2, (after[1] - before[1]) / 2);
  camera.zoom(factor, (after[0] + other[0]) / 2 - box.left, (after[1] + other[1]) / 2 - box.top);
}

function keyMoves(camera, event) {
  const direction = { ArrowLeft: [1, 0], ArrowRight: [-1, 0], ArrowUp: [0, 1], ArrowDown: [0, -1] }[event.key];
  if (direction && event.shiftKey) camera.rotate(direction[0] * KEY_TURN, direction[1] * KEY_TURN);
  else if (direction) camera.panPixels(direction[0] * KEY_PAN_PX, direction[1] * KEY_PAN_PX);
  else if (event.key === "+" || event.key === "=") camera.zoom(1.25);
  else if (event.key === "-") camera.zoom(0.8);
  else return false;
  return true;
}
