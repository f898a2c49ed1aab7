/** The last step before a formation or reference is sent: what the vehicles say to it, then Send, or what they would accept. */

import { metres, quantity } from "../format.js";
import { html, nothing } from "./lit.js";

const UNITS = [["_m_s2", " m/s²"], ["_m_s", " m/s"], ["_m", " m"], ["_s", " s"]]; // by the end of a key

export function previewed({ store, commanding, planning }, name) {
  if (commanding.previewError) return html`<p class="previewed critical">${commanding.previewError}</p>`;
  const preview = store.preview;
  if (!preview || preview.name !== name) return nothing;
  if (preview.pending) return html`<div class="previewed"><p class="quiet">${commanding.previewing ? "Asking the vehicles …" : "Let go to ask the vehicles."}</p></div>`;
  return html`<div class="previewed">
    ${preview.refused ? html`<p class="critical">Refused: ${preview.refused}</p>` : html`<p>${summary(preview)}</p>`}
    ${preview.warning ? html`<p class="warning">${preview.warning}</p>` : nothing}
    <div class="row">${preview.refused ? instead(preview, commanding) : html`<button data-action="send-${name}" class="primary"
        @click=${() => planning.send()}>Send</button>`}
      <button @click=${() => (name === "formation" ? planning.cancel() : commanding.discard())}>Discard</button></div></div>`;
}

/** The accepted values go into the form, and are previewed. */
function instead(preview, commanding) {
  const values = Object.entries(preview.instead);
  if (!values.length) return nothing;
  const use = (event) => {
    const { elements } = event.target.closest("details").querySelector("form");
    for (const [key, value] of values) {
      if (!elements[key]) continue;
      elements[key].value = String(value);
      elements[key].dispatchEvent(new Event("change", { bubbles: true }));
    }
    commanding.preview(preview.name, { ...preview.content, ...preview.instead });
  };
  return html`<button data-action="use-instead" class="primary" @click=${use}>Use ${values.map(withUnit).join(" and ")}</button>`;
}

function withUnit([key, value]) {
  const unit = UNITS.find(([end]) => key.endsWith(end))?.[1];
  return unit ? `${value}${unit}` : `${key} ${value}`;
}

function summary(preview) {
  const parts = [];
  if (preview.smallest_separation_m !== null) parts.push(`smallest separation on the way ${metres(preview.smallest_separation_m)}`);
  if (preview.lasts_s !== null) parts.push(`lasts ${quantity(preview.lasts_s, 1, "s")}`);
  const shown = parts.length ? `On the map: ${parts.join(", ")}.` : "Shown on the map.";
  return `${said(preview.answers)} ${shown}`;
}

function said(answers) {
  if (!answers.length) return "";
  const missing = answers.filter(({ kind }) => kind !== "accepted").map(({ vehicle_id }) => vehicle_id);
  if (missing.length) return `No reply of ${missing.join(", ")}; the others would accept it.`;
  return answers.length === 1 ? "The vehicle would accept it." : `All ${answers.length} vehicles asked would accept it.`;
}
