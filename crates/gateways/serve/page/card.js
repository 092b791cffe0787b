// An alarm's card: what it means, what to check, which keys set it, how soon it is found.

const dialog = document.getElementById("card");
const part = (name) => dialog.querySelector(`[data-card="${name}"]`);
/** The answer of the server, asked for once. */
let cards = null;

async function load() {
  const answer = await fetch("/api/v1/alarms/cards");
  if (!answer.ok) throw new Error(`the server answered ${answer.status}`);
  return answer.json();
}

async function show(alarm) {
  cards ??= load();
  part("alarm").textContent = alarm;
  try {
    const card = (await cards).find((each) => each.alarm === alarm);
    part("mark").className = `mark ${card?.level ?? "warn"}`;
    part("meaning").textContent = card?.meaning ?? "This server does not know it.";
    part("check").textContent = card?.check ?? "";
    part("keys").textContent = card?.keys.join(", ") || "no key";
    part("found").textContent = card?.found_within ?? "";
  } catch (error) {
    cards = null;
    part("meaning").textContent = `What it means cannot be read: ${error.message}`;
    for (const name of ["check", "keys", "found"]) part(name).textContent = "";
  }
  if (!dialog.open) dialog.showModal();
}

/** Opens the card of every alarm that is pressed. */
export function showCards() {
  document.addEventListener("click", (event) => {
    const alarm = event.target.closest("button.alarm");
    if (alarm) show(alarm.textContent);
    // Beside the card: the dialog itself is pressed, nothing within it.
    else if (event.target === dialog) dialog.close();
  });
}
