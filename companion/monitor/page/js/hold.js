/** Hold to confirm: buttons with `data-hold`, in seconds, and keys act only when they are held for that time. */

/**
 * A held button gets the event `held`; one that was let go too early, `released`. Its class `holding` runs the bar in the
 * style sheet. Works for mouse, touch, Space and Enter.
 */
export function watchHolds(root) {
  let button = null;
  let timer = null;
  const end = (completed) => {
    if (!button) return;
    const ended = button;
    clearTimeout(timer);
    button = null;
    ended.classList.remove("holding");
    const usable = ended.isConnected && !ended.matches(":disabled"); // also by its fieldset
    if (usable) ended.dispatchEvent(new Event(completed ? "held" : "released"));
  };
  const begin = (event) => {
    const target = event.target.closest?.("button[data-hold]");
    if (!target || target.matches(":disabled") || button) return;
    button = target;
    target.classList.add("holding");
    timer = setTimeout(() => end(true), Number(target.dataset.hold) * 1000);
  };
  root.addEventListener("pointerdown", (event) => event.button === 0 && begin(event));
  root.addEventListener("pointerup", () => end(false));
  root.addEventListener("pointercancel", () => end(false));
  root.addEventListener("pointerout", (event) => button && !button.contains(event.relatedTarget) && end(false));
  root.addEventListener("contextmenu", (event) => event.target.closest?.("[data-hold]") && event.preventDefault());
  root.addEventListener("focusout", (event) => event.target === button && end(false));
  root.addEventListener("keydown", (event) => {
    if (event.key !== " " && event.key !== "Enter") return;
    if (event.target.closest?.("button[data-hold]")) event.preventDefault();
    if (!event.repeat) begin(event);
  });
  root.addEventListener("keyup", (event) => (event.key === " " || event.key === "Enter") && end(false));
  addEventListener("blur", () => end(false));
}

/** Shift+Escape, held: `onHold(true)` at its begin, `onHold(false)` at its end, then `act()` if it was long enough. */
export function watchAbortKeys(seconds, onHold, act) {
  let timer = null;
  const end = () => {
    if (timer === null) return;
    clearTimeout(timer);
    timer = null;
    onHold(false);
  };
  const completed = () => {
    end();
    act();
  };
  const pressed = (event) => {
    if (event.key !== "Escape" || !event.shiftKey) return;
    event.preventDefault();
    if (event.repeat || timer !== null) return;
    timer = setTimeout(completed, seconds * 1000);
    onHold(true);
  };
  document.addEventListener("keydown", pressed, { capture: true });
  document.addEventListener("keyup", (event) => ["Escape", "Shift"].includes(event.key) && end(), { capture: true });
  addEventListener("blur", end);
}
