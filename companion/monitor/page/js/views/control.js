/** Commands to the fleet, only with `companion monitor --control`. */

import { html, nothing } from "./lit.js";
import { answers } from "./answers.js";
import { formationForm } from "./formation_form.js";
import { referenceForm } from "./reference_form.js";

// Those with a hold time change what the vehicles do in a way that an accidental touch must not.
const ACTIONS = [
  { name: "doctor", title: "Check", text: "checks before flight; sends no command" },
  { name: "arm", title: "Arm", hold: 1, text: "prepares, then arms" },
  { name: "takeoff", title: "Take off", hold: 1, text: "climbs vertically, then the autopilot's hold" },
  { name: "form", title: "Form", hold: 1, text: "from hold into the formation" },
  { name: "hold", title: "Hold", text: "from formation into the autopilot's hold" },
  { name: "land", title: "Land", hold: 1, text: "vertically, at the present position" },
  { name: "return", title: "Return", hold: 1, text: "to each vehicle's home and down, by the autopilot" },
  { name: "disarm", title: "Disarm", hold: 1, text: "on the ground" },
  { name: "take", title: "Take command", text: "from another operator" },
];

export function control({ store, commanding, nowMs, act }) {
  if (!commanding.allowed) {
    const why = commanding.hasLostControl ? "The token of this page is not the server's" : "This page was opened without the token";
    return html`<div class="heading"><h2>Control</h2></div><p class="empty">${why}: open the URL that
      companion monitor --control has printed, with its part after #.</p>`;
  }
  const lost = store.freshness.lost(nowMs);
  return html`<div class="heading"><h2>Control</h2></div>
    <fieldset ?disabled=${lost}>
      <legend class="unseen">Commands</legend>
      ${targets(store, commanding, act)}
      <div class="actions">${ACTIONS.map((action) => actionButton(action, commanding, act))}</div>
      ${leader(store, commanding, act)}
    </fieldset>
    ${lost ? html`<p class="empty critical">No control without live data. ABORT is still sent if the server can be reached.</p>` : nothing}
    ${answers(commanding.sent)}
    <fieldset ?disabled=${lost}>
      <legend class="unseen">Changes of the formation</legend>
      ${formationForm({ store, commanding })}
      ${referenceForm({ store, commanding, act })}
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

function actionButton(action, commanding, act) {
  const ids = commanding.targets;
  const send = () => commanding.send(action.name, commanding.targets);
  const early = () => act.hint(`Hold "${action.title}" for a second.`);
  const title = action.hold ? `${action.text}; hold for a second` : action.text;
  return action.hold
    ? html`<button data-action=${action.name} data-hold=${action.hold} ?disabled=${ids === null} title=${title}
        aria-description=${title} @held=${send} @released=${early}>${action.title}</button>`
    : html`<button data-action=${action.name} ?disabled=${ids === null} title=${title} @click=${send}>${action.title}</button>`;
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
