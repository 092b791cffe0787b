// What a person states of a robot: the worker takes it, and the browser keeps the person's name.

const NAME = "joulebus.name";

export const personsName = () => localStorage.getItem(NAME) ?? "";

/** Sends a statement, and shows in `output` what comes of it. Returns why it was refused, or null. */
export async function tell(path, asked, output) {
  localStorage.setItem(NAME, asked.by);
  output.textContent = "Asking the worker";
  let refused = null;
  try {
    const reply = await fetch(path, {
      method: "POST",
      headers: { "Content-Type": "application/json" },
      body: JSON.stringify(asked),
    });
    if (!reply.ok) refused = (await reply.json()).error ?? reply.statusText;
  } catch {
    refused = "No answer: no connection to the server.";
  }
  output.textContent = refused ?? "";
  return refused;
}

/** The form that states a robot's battery: full, exchanged, or measured. */
export class BatteryForm {
  constructor() {
    const root = document.getElementById("battery");
    this.form = root.querySelector("form");
    this.answer = root.querySelector('[data-battery="answer"]');
    this.form.addEventListener("submit", (event) => {
      event.preventDefault();
      this.#state(event.submitter.value);
    });
    // Enter would press the first button, which states a full battery.
    this.form.addEventListener("keydown", (event) => {
      if (event.key !== "Enter" || event.target.tagName !== "INPUT") return;
      event.preventDefault();
      if (event.target.name !== "charge") return;
      this.form.requestSubmit(this.form.querySelector("[value=charge]"));
    });
  }

  open(robot) {
    if (this.robot === robot) return;
    this.robot = robot;
    this.answer.textContent = "";
    this.form.elements.by.value = personsName();
  }

  async #state(as) {
    const robot = this.robot;
    const by = this.form.elements.by.value.trim();
    const asked = { robot, by, [as]: as === "charge" ? Number(this.form.elements.charge.value) / 100 : true };
    const refused = await tell("/api/v1/battery", asked, this.answer);
    if (this.robot !== robot) this.answer.textContent = "";
    else if (refused === null) this.answer.textContent = "The worker counts from there.";
  }
}
