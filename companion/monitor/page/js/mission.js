/** The mission along time, from the events: commands with their answers, who led, which formation was flown, alarms. */

const TOGETHER_S = 3; // what one command, or one change, is in several vehicles
const GOOD = "accepted";

/** `events` in any order, of one fleet. Each part of the result is in rising order of time. */
export function missionOf(events, leaderIds = []) {
  const sorted = [...events].sort((a, b) => a.time_s - b.time_s || a.id - b.id);
  const of = (kind) => sorted.filter((event) => event.kind === kind);
  return {
    commands: commandsOf(sorted),
    leaders: leadersOf(of("leader"), leaderIds),
    formations: formationsOf(grouped(of("formation"))),
    references: grouped(sorted.filter((event) => event.code === "REFERENCE_CHANGED")).map(([first]) => ({ timeS: first.time_s, text: first.text })),
    alarms: of("alarm").filter((event) => event.outcome !== "ended").map(alarm),
  };
}

/** Whether all vehicles that answered accepted, whether one did not; null without an answer. */
export function hasSucceeded(command) {
  return command.answers?.size ? [...command.answers.keys()].every((outcome) => outcome === GOOD) : null;
}

/** "accepted by 1, 2; refused by 3: it is not armed". */
export function answerText(command) {
  const parts = [...command.answers].map(([outcome, { ids, texts }]) => {
    const by = ids.length ? ` by ${ids.join(", ")}` : "";
    return `${outcome}${by}${outcome === GOOD ? "" : `: ${[...texts].join("; ")}`}`;
  });
  return parts.join("; ") || "no answer";
}

function commandsOf(sorted) {
  const found = [];
  const byCommand = new Map();
  for (const event of sorted) {
    if (event.kind === "command") byCommand.set(event.command, given(found, event, event.code, event.text));
    else if (event.kind === "answer") {
      // The ground does not hear the commands of other operators, but their answers.
      const command = byCommand.get(event.command) ?? given(found, event, "command", `${event.operator}: command`);
      byCommand.set(event.command, command);
      answered(command, event);
    }
  }
  return found;
}

/** One command may be to several vehicles. */
function given(found, event, name, text) {
  const last = found.findLast((command) => command.operator === event.operator && command.name === name);
  const same = event.vehicle_id !== null && last && event.time_s - last.timeS < TOGETHER_S ? last : null;
  const command = same ?? { timeS: event.time_s, operator: event.operator, name, text, ids: [], answers: new Map() };
  if (!same) found.push(command);
  addTo(command.ids, event.vehicle_id);
  return command;
}

function answered(command, { outcome, vehicle_id: id, text }) {
  const same = command.answers.get(outcome) ?? { ids: [], texts: new Set() };
  command.answers.set(outcome, same);
  addTo(same.ids, id);
  same.texts.add(text.replace(/^[^:]*: /, ""));
}

/** Groups of what came within TOGETHER_S of the first of a group with the same text. */
function grouped(events) {
  const groups = [];
  for (const event of events) {
    const group = groups.findLast(([first]) => first.text === event.text && event.time_s - first.time_s < TOGETHER_S);
    if (group) group.push(event);
    else groups.push([event]);
  }
  return groups;
}

function leadersOf(events, leaderIds) {
  const changes = leaderIds.length ? [{ timeS: -Infinity, ids: [...leaderIds], text: "leads from the begin" }] : [];
  for (const event of events) {
    const last = changes.at(-1);
    if (last && event.time_s - last.timeS < TOGETHER_S) last.ids.push(event.vehicle_id);
    else changes.push({ timeS: event.time_s, ids: [event.vehicle_id], text: event.text });
  }
  return changes;
}

function alarm({ time_s: timeS, vehicle_id: id, code, text }) {
  return { timeS, id, code, text: `${id === null ? "" : `vehicle ${id}: `}${code} ${text}` };
}

/** The text of a change is "formation 1 -> 2": before the first one, 1 was flown. */
function formationsOf(groups) {
  const changes = groups.map(([{ time_s: timeS, text }]) => ({ timeS, text, ends: text.replace("formation ", "").split(" -> ") }));
  const named = changes.map(({ timeS, text, ends }) => ({ timeS, text, name: ends.at(-1) }));
  return changes.length ? [{ timeS: -Infinity, text: `formation ${changes[0].ends[0]}`, name: changes[0].ends[0] }, ...named] : [];
}

function addTo(ids, id) {
  if (id === null || ids.includes(id)) return;
  ids.push(id);
  ids.sort((a, b) => a - b);
}
