// A small form that asks what a plan of the robot costs: the server answers as `joulebus ask` does.

import * as format from "./format.js";

/** The question that a form's values state. */
export function question(robot, values) {
  if (values.plan === "idle") return { robot, idle_s: Number(values.idle_s) };
  const end = { x_m: Number(values.length_m), y_m: 0, speed_mps: Number(values.speed_mps) };
  const asked = { robot, path: [{ x_m: 0, y_m: 0 }, end] };
  if (values.back) asked.return = "dock";
  return asked;
}

const caveatNames = {
  beyond_horizon: "longer than the model's errors are known for",
  no_reading: "the robot has no fresh reading",
  state_outside_training: "the robot is outside the training data",
};

function caveats(list) {
  const texts = Object.entries(caveatNames).filter(([name]) => list?.[name]).map(([, text]) => text);
  if (list?.alarms?.length > 0) texts.push(`alarms cast doubt on its readings: ${list.alarms.join(" and ")}`);
  if (list?.steps_outside_training > 0) texts.push(`${format.count(list.steps_outside_training)} steps outside the training data`);
  return texts.join("; ");
}

/** The answer in words: pairs of a name and a text. */
export function answerFacts(answer) {
  const { energy: used, left } = answer;
  const facts = [["Verdict", answer.reason ? `${answer.verdict}: ${answer.reason}` : answer.verdict]];
  facts.push(["Takes", format.duration(answer.duration_s)]);
  if (used) facts.push(["Energy", `${format.energy(used.mean_j)} (${format.range(used.lo_j, used.hi_j, format.energy)})`]);
  if (left) facts.push(["Left", `${format.energy(left.mean_j)} (${format.range(left.lo_j, left.hi_j, format.energy)})`]);
  if (left) facts.push(["Probability", format.isKnown(answer.probability) ? format.percent(answer.probability, 1) : "unknown"]);
  if (format.isKnown(answer.turn_back_s)) facts.push(["Turn back within", format.duration(answer.turn_back_s)]);
  const weak = caveats(answer.caveats);
  if (weak) facts.push(["Note", weak]);
  return facts;
}

export class WhatIf {
  constructor() {
    this.root = document.getElementById("what-if");
    this.output = this.root.querySelector('[data-what-if="answer"]');
    this.form = this.root.querySelector("form");
    this.form.addEventListener("submit", (event) => {
      event.preventDefault();
      this.#ask();
    });
  }

  open(robot) {
    if (this.robot === robot) return;
    this.robot = robot;
    this.output.replaceChildren();
  }

  async #ask() {
    const robot = this.robot;
    const values = Object.fromEntries(new FormData(this.form));
    this.#say("Asking");
    try {
      const reply = await fetch("/api/v1/what_if", {
        method: "POST",
        headers: { "Content-Type": "application/json" },
        body: JSON.stringify(question(robot, values)),
      });
      const body = await reply.json();
      if (robot !== this.robot) return;
      if (!reply.ok) this.#say(body.error ?? reply.statusText);
      else this.#show(body.answers[0]);
    } catch {
      if (robot === this.robot) this.#say("No answer: no connection to the server.");
    }
  }

  #say(text) {
    const note = document.createElement("p");
    note.className = "note";
    note.textContent = text;
    this.output.replaceChildren(note);
  }

  #show(answer) {
    const list = document.createElement("dl");
    list.className = "facts";
    for (const [name, text] of answerFacts(answer)) {
      const box = document.createElement("div");
      const term = document.createElement("dt");
      const value = document.createElement("dd");
      term.textContent = name;
      value.textContent = text;
      if (name === "Verdict") value.className = `verdict ${answer.verdict}`;
      box.append(term, value);
      list.append(box);
    }
    this.output.replaceChildren(list);
  }
}
