/** What each vehicle has answered to the last commands. */

import { quantity } from "../format.js";
import { html, nothing, repeat } from "./lit.js";
import { prose } from "./prose.js";

const MARK = { accepted: "✓", ready: "✓", "ready, with warnings": "▲", refused: "✗", "not ready": "✗", missing: "?", "not sent": "–" };
const GOOD = new Set(["accepted", "ready", "ready, with warnings"]);

export function answers(sent) {
  if (!sent.length) return nothing;
  return html`<div class="answers" aria-live="polite"><h2>Answers</h2>
    ${repeat(sent, (entry) => entry.number, entry)}</div>`;
}

function entry({ title, result, error }) {
  return html`<div class="answer"><p><strong>${title}</strong>${result || error ? nothing : html` <span class="quiet">sent, waiting …</span>`}</p>
    ${error ? html`<p class="critical">${error}</p>` : nothing}
    ${result ? html`<ul>${result.answers.map((answer) => html`<li class=${answer.kind.replaceAll(/\W+/g, "-")}>
      <span class="mark" aria-hidden="true">${MARK[answer.kind] ?? "·"}</span>
      <span><strong>${answer.vehicle_id}</strong> ${answer.kind} <span class="quiet">${answer.after_ms === null ? "" : quantity(answer.after_ms, 0, "ms")}</span>
        ${GOOD.has(answer.kind) ? nothing : html`<br><strong>${answer.code}</strong>`} ${answer.text}</span></li>`)}</ul>
      ${result.advice ? html`<p class="advice">${prose(result.advice)}</p>` : nothing}` : nothing}</div>`;
}
