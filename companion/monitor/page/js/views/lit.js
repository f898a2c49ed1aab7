/** The parts of lit-html that the views use. It escapes every text that it is given. */

export { html, noChange, nothing, render, svg } from "../../vendor/lit-html/lit-html.js";
export { repeat } from "../../vendor/lit-html/directives/repeat.js";
