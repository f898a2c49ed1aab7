/** Commands to the fleet, only with `companion monitor --control`. */

import { html, nothing } from "./lit.js";
import { actions } from "./actions.js";
import { answers } from "./answers.js";
import { formationForm } from "./formation_form.js";
import { referenceForm } from "./reference_form.js";

const WITHOUT_DATA = "No control without live data. ABORT is still sent if the server can be reached.";
const WITHOUT_VEHICLES = "No vehicle reports yet, so none can be commanded. ABORT is still sent to all.";

export function control({ store, commanding, planning, nowMs, act }) {
  if (!commanding.allowed) {
    const why = commanding.hasLostControl ? "The token of this page is not the server's" : "This page was opened without the token";
    return html`<div class="heading"><h2>Control</h2></div><p class="empty">${why}: open the URL that
      companion monitor --control has printed, with its part after #.</p>`;
  }
  const lost = store.freshness.lost(nowMs);
  const off = lost || !store.vehicles.length;
  return html`<div class="heading"><h2>Control</h2></div>
    <fieldset ?disabled=${off}>
      <legend class="unseen">Commands</legend>
      ${targets(store, commanding, act)}
      ${actions({ store, commanding, nowMs, act })}
      ${leader(store, commanding, act)}
    </fieldset>
    ${off ? html`<p class="empty ${lost ? "critical" : ""}">${lost ? WITHOUT_DATA : WITHOUT_VEHICLES}</p>` : nothing}
    ${answers({ sent: commanding.sent, close: () => commanding.forgetAnswers() })}
    <fieldset ?disabled=${off}>
      <legend class="unseen">Changes of the formation</legend>
      ${formationForm({ store, commanding, planning })}
      ${referenceForm({ store, commanding, planning })}
    </fieldset>`;
}

function targets(store, commanding, act) {
  const selected = [...store.selected].sort((a, b) => a - b);
  const choice = (toSelected, text) => html`<label><input type="radio" name="targets" .checked=${commanding.toSelected === toSelected}
    @change=${() => act.target(toSelected)}> ${text}</label>`;
  return html`<div class="targets" role="radiogroup" aria-label="Which vehicles get the command">
    ${choice(false, html`all <strong>${store.vehicles.length}</strong> of ${store.fleetName}`)}
    ${choice(true, selected.length ? html`selected: <strong>${selected.join(", ")}</strong>` : "selected: none")}</div>`;
}

/** The selected vehicles become leaders: select them in the list or on the map. */
function leader(store, commanding, act) {
  const ids = [...store.selected].sort((a, b) => a - b);
  const may = (id) => store.file?.members.find((member) => member.vehicle_id === id)?.may_lead ?? true;
  const barred = ids.filter((id) => !may(id));
  const text = ids.length ? `Make ${ids.join(", ")} leader` : "Make leader";
  const reason = !ids.length
    ? "Select the new leader in the list or on the map."
    : barred.length ? `${barred.join(", ")} may not lead: may_lead in the fleet file` : "all other vehicles follow";
  return html`<div class="leader-choice"><button data-action="leader" data-hold="1" ?disabled=${!ids.length || barred.length > 0}
      @held=${() => commanding.send("leader", [], { leader_ids: ids })}
      @released=${() => act.hint(`Hold "${text}" for a second.`)}>${text}</button>
    <span class="quiet">${reason}</span></div>`;
}
