/** Light, dark, or as the system: remembered in this browser. */

const KEY = "companion-theme";
export const CHOICES = ["system", "light", "dark"];
const dark = matchMedia("(prefers-color-scheme: dark)");

export class Theme {
  constructor(onChange) {
    this.choice = CHOICES.includes(localStorage.getItem(KEY)) ? localStorage.getItem(KEY) : "system";
    this._onChange = onChange;
    dark.addEventListener("change", () => this._apply());
    this._apply();
  }

  next() {
    this.choice = CHOICES[(CHOICES.indexOf(this.choice) + 1) % CHOICES.length];
    localStorage.setItem(KEY, this.choice);
    this._apply();
  }

  _apply() {
    const shown = this.choice === "system" ? (dark.matches ? "dark" : "light") : this.choice;
    document.documentElement.dataset.theme = shown;
    this.colours = coloursOf(getComputedStyle(document.documentElement));
    this._onChange();
  }
}

/** The style sheet's colours by name, for the canvas; each is read once. */
function coloursOf(style) {
  const read = (known, name) => (known[name] ??= style.getPropertyValue(`--${name}`).trim());
  return new Proxy({}, { get: read });
}
