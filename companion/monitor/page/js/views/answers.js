/** What each vehicle has answered to the last commands. */

import { quantity } from "../format.js";
import { html, nothing, repeat } from "./lit.js";
import { prose } from "./prose.js";

const MARK = { accepted: "✓", ready: "✓", "ready, with warnings": "▲", refused: "✗", "not ready": "✗", missing: "?", "not sent": "–" };
const GOOD = new Set(["accepted", "ready", "ready, with warnings"]);

export function answers({ sent, close }) {
  if (!sent.length) return nothing;
  return html`<div class="answers" aria-live="polite"><h2 class="unseen">Answers</h2>
    <button class="small" data-action="close-answers" @click=${close}>Close</button>
    ${repeat(sent, (entry) => entry.number, entry)}</div>`;
}

/** [answer, its vehicles, the longest time], refusals first: the panel has room for few lines. */
function alike(answers) {
  const found = new Map();
  for (const answer of answers) {
    const key = `${answer.kind} ${answer.code} ${answer.text}`;
    const [, ids, afterMs] = found.get(key) ?? [answer, [], null];
    found.set(key, [answer, [...ids, answer.vehicle_id], answer.after_ms === null ? afterMs : Math.max(afterMs ?? 0, answer.after_ms)]);
  }
  return [...found.values()].sort(([a], [b]) => GOOD.has(a.kind) - GOOD.has(b.kind));
}

function entry({ title, result, error }) {
  return html`<div class="answer"><p><strong>${title}</strong>${result || error ? nothing : html` <span class="quiet">sent, waiting …</span>`}</p>
    ${error ? html`<p class="critical">${error}</p>` : nothing}
    ${result ? html`<ul>${alike(result.answers).map(([answer, ids, afterMs]) => html`<li class=${answer.kind.replaceAll(/\W+/g, "-")}>
      <span class="mark" aria-hidden="true">${MARK[answer.kind] ?? "·"}</span>
      <span><strong>${ids.join(", ")}</strong> ${answer.kind} <span class="quiet">${afterMs === null ? "" : quantity(afterMs, 0, "ms")}</span>
        ${GOOD.has(answer.kind) ? nothing : html`<br><strong>${answer.code}</strong>`} ${answer.text}</span></li>`)}</ul>
      ${result.advice ? html`<p class="advice">${prose(result.advice)}</p>` : nothing}` : nothing}</div>`;
}
