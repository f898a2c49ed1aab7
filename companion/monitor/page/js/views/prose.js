/** A text of the explanations: what is in backticks is code. */
import { html } from "./lit.js";

export const prose = (text) => text.split("`").map((part, i) => (i % 2 ? html`<code>${part}</code>` : part));
