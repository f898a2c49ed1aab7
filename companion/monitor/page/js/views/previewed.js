/** The last step before a formation or reference is sent: what its preview says, Send, Discard. */

import { metres, quantity } from "../format.js";
import { html, nothing } from "./lit.js";

export function previewed({ store, commanding }, name) {
  if (commanding.previewError) return html`<p class="previewed critical">${commanding.previewError}</p>`;
  const preview = store.preview;
  if (!preview || preview.name !== name) return nothing;
  return html`<div class="previewed">
    ${preview.refused ? html`<p class="critical">Refused: ${preview.refused}</p>` : html`<p>${summary(preview)}</p>`}
    <div class="row"><button data-action="send-${name}" class="primary" ?disabled=${Boolean(preview.refused)}
        @click=${() => commanding.sendPreviewed()}>Send</button>
      <button @click=${() => commanding.discard()}>Discard</button></div></div>`;
}

function summary(preview) {
  const parts = [];
  if (preview.smallest_separation_m !== null) parts.push(`smallest separation on the way ${metres(preview.smallest_separation_m)}`);
  if (preview.lasts_s !== null) parts.push(`lasts ${quantity(preview.lasts_s, 1, "s")}`);
  return parts.length ? `On the map: ${parts.join(", ")}.` : "Shown on the map.";
}
