/** Dividers between the panels, moved by pointer or arrow keys. The sizes are remembered in this browser. */

const KEY = "companion-sizes";
const STEP_PX = 16;
const LONG_STEP_PX = 64; // with Shift
const MOST_SHARE = 0.7; // of the page: a panel is never all of it

// `panel`: whose size it is, along `axis`; `grows`: 1 where that is larger farther right or down. The style sheet shows those of
// the present arrangement, and has the usual sizes.
const DIVIDERS = [
  { name: "control", panel: "control", axis: "width", grows: 1, leastPx: 240, label: "Width of the control panel" },
  { name: "side", panel: "side", axis: "width", grows: -1, leastPx: 300, label: "Width of the lists" },
  { name: "plots", panel: "plots", axis: "height", grows: -1, leastPx: 120, label: "Height of the plots" },
  { name: "map", panel: "map", axis: "height", grows: 1, leastPx: 120, label: "Height of the map" },
  { name: "panel", panel: "tabs", axis: "width", grows: -1, leastPx: 300, label: "Width of the panels" },
];

export class Dividers {
  constructor(main) {
    this._main = main;
    this._sizes = remembered();
    this._all = DIVIDERS.map((divider) => ({ ...divider, element: this._element(divider) }));
    for (const one of this._all) this._listen(one);
    new ResizeObserver(() => this._announce()).observe(main);
    this._apply();
  }

  get areUsual() {
    return !Object.keys(this._sizes).length;
  }

  /** The usual size of the panel of one divider, or of all. */
  reset(name = null) {
    if (name) delete this._sizes[name];
    else this._sizes = {};
    this._apply();
  }

  _element({ name, axis, label }) {
    const element = document.createElement("div");
    element.id = `divider-${name}`;
    element.className = `divider along-${axis}`;
    element.tabIndex = 0;
    element.role = "separator";
    element.ariaLabel = label;
    element.ariaOrientation = axis === "width" ? "vertical" : "horizontal";
    element.title = `${label}: drag, or arrow keys; double click or Enter for the usual size`;
    this._main.append(element);
    return element;
  }

  _listen(divider) {
    const { element, name, axis, grows } = divider;
    const at = (event) => (axis === "width" ? event.clientX : event.clientY);
    let begun = null;
    element.addEventListener("pointerdown", (event) => {
      element.setPointerCapture(event.pointerId);
      begun = { px: at(event), sizePx: this._sizePx(divider) };
    });
    element.addEventListener("pointermove", (event) => begun && this._resize(divider, begun.sizePx + grows * (at(event) - begun.px)));
    for (const end of ["pointerup", "pointercancel"]) element.addEventListener(end, () => (begun = null));
    element.addEventListener("dblclick", () => this.reset(name));
    element.addEventListener("keydown", (event) => {
      const [less, more] = axis === "width" ? ["ArrowLeft", "ArrowRight"] : ["ArrowUp", "ArrowDown"];
      const step = { [less]: -grows, [more]: grows }[event.key];
      if (step) this._resize(divider, this._sizePx(divider) + step * (event.shiftKey ? LONG_STEP_PX : STEP_PX));
      else if (event.key === "Enter") this.reset(name);
      else return;
      event.preventDefault();
    });
  }

  _sizePx({ panel, axis }) {
    return document.getElementById(panel).getBoundingClientRect()[axis];
  }

  _mostPx({ axis }) {
    return MOST_SHARE * this._main.getBoundingClientRect()[axis];
  }

  _resize(divider, sizePx) {
    this._sizes[divider.name] = Math.round(Math.max(divider.leastPx, Math.min(this._mostPx(divider), sizePx)));
    this._apply();
  }

  _apply() {
    for (const { name } of this._all) {
      const sizePx = this._sizes[name];
      if (sizePx) this._main.style.setProperty(`--${name}-size`, `${sizePx}px`);
      else this._main.style.removeProperty(`--${name}-size`);
    }
    localStorage.setItem(KEY, JSON.stringify(this._sizes));
    this._announce();
  }

  _announce() {
    for (const divider of this._all) {
      divider.element.ariaValueMin = divider.leastPx;
      divider.element.ariaValueMax = Math.round(this._mostPx(divider));
      divider.element.ariaValueNow = Math.round(this._sizePx(divider));
    }
  }
}

/** What another version, or a person, has left in the browser's storage may be anything. */
function remembered() {
  try {
    const sizes = Object.entries(JSON.parse(localStorage.getItem(KEY)) ?? {});
    return Object.fromEntries(sizes.filter(([name, sizePx]) => DIVIDERS.some((one) => one.name === name) && sizePx > 0));
  } catch {
    return {};
  }
}
