/** Colour and dashes of a vehicle by its id, as in all figures: the server sends its table (companion/types/vehicle_looks.py). */

const LOOKS = JSON.parse(document.getElementById("vehicle-looks").textContent);

/** The name of its colour in the style sheet; "on-" before it: of text on that colour. */
export function colourOf(id) {
  return `vehicle-${((id - 1) % LOOKS.colours) + 1}`;
}

/** For a line of this width. */
export function dashOf(id, width) {
  return LOOKS.dashes[(id - 1) % LOOKS.dashes.length].map((length) => length * width);
}
