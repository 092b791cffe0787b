// An alarm's card: what it means, what to check, which keys set it, how soon it is found, and who
// has acknowledged it.

import * as format from "./format.js";
import { personsName, tell } from "./person.js";

const dialog = document.getElementById("card");
const form = document.getElementById("acknowledge");
/** Those that compare a robot with its own level, which can be the new normal. */
const OF_LEVEL = ["LevelHigh", "LevelLow"];
const part = (name) => dialog.querySelector(`[data-card="${name}"]`);
/** Answers of the server by robot, each asked for once. */
const cards = new Map();

async function load(robot) {
  const answer = await fetch(`/api/v1/alarms/cards?robot=${robot}`);
  if (!answer.ok) throw new Error(`the server answered ${answer.status}`);
  return answer.json();
}

const withValue = (card) => (key, at) => (card.values?.[at] ? `${key} = ${card.values[at]}` : key);

async function show(alarm, robot, board) {
  showAcknowledged(alarm, robot, board);
  if (!cards.has(robot)) cards.set(robot, load(robot));
  part("alarm").textContent = alarm;
  part("robot").textContent = `of robot ${robot}`;
  const refused = (board.fleet?.refusals ?? []).find((each) => each.robot === robot && each.found);
  part("value").textContent = alarm === "OutOfRange" && refused
    ? `${format.count(refused.count)} samples refused, the last because ${refused.found}.` : "";
  try {
    const card = (await cards.get(robot)).find((each) => each.alarm === alarm);
    part("mark").className = `mark ${card?.level ?? "warn"}`;
    format.setSentence(part("meaning"), card?.meaning ?? "This server does not know it.");
    format.setSentence(part("check"), card?.check ?? "");
    part("keys").textContent = card?.keys.map(withValue(card)).join(", ") || "no key";
    part("found").textContent = card?.found_within ?? "";
  } catch (error) {
    cards.delete(robot);
    part("meaning").textContent = `What it means cannot be read: ${error.message}`;
    for (const name of ["check", "keys", "found"]) part(name).textContent = "";
  }
  if (!dialog.open) dialog.showModal();
}

/** Who has acknowledged the alarm, or a form to do so; neither of one that is not raised. */
function showAcknowledged(alarm, robot, board) {
  const raised = board.raised.find((each) => each.alarm === alarm && each.robot === robot);
  const by = raised?.acknowledged;
  part("by").textContent = by ? `Acknowledged by ${by.by} at ${format.timeOfDay(format.unixMs(by.at_unix_ns))}.` : "";
  part("answer").textContent = "";
  // No worker raised it.
  const [known, normal] = form.elements.as;
  [known.hidden, normal.hidden] = [Boolean(by), !OF_LEVEL.includes(alarm)];
  // The Enter key would press it even while it is hidden.
  known.disabled = known.hidden;
  form.hidden = !raised || (known.hidden && normal.hidden) || alarm === "Implausible";
  form.elements.by.value = personsName();
  Object.assign(form.dataset, { alarm, robot });
}

async function acknowledge(event) {
  event.preventDefault();
  const { alarm, robot } = form.dataset;
  const by = form.elements.by.value.trim();
  const isNormal = event.submitter?.value === "normal";
  const asked = { robot: Number(robot), alarm, by, new_normal: isNormal };
  const refused = await tell("/api/v1/alarms/acknowledge", asked, part("answer"));
  if (refused === null) dialog.close();
}

/** Opens the card of every alarm that is pressed. */
export function showCards(board) {
  form.addEventListener("submit", acknowledge);
  document.addEventListener("click", (event) => {
    const alarm = event.target.closest("button.alarm");
    if (alarm) show(alarm.textContent, Number(alarm.dataset.robot), board);
    // Beside the card: the dialog itself is pressed, nothing within it.
    else if (event.target === dialog) dialog.close();
  });
}
