// A small form that asks what a plan of the robot costs: the server answers as `joulebus ask` does.

import { Fan, ticks } from "./fan.js";
import * as format from "./format.js";

const COLUMNS = ["x_m", "y_m", "speed_mps", "dwell_s", "load_w", "time_s"];

/**
 * The points of a pasted path: lines of numbers, or a path file of `joulebus ask --path` with its
 * header. Cells may be divided by commas, semicolons, tabs or spaces.
 */
export function points(pasted) {
  const lines = pasted.split("\n").map((line) => line.trim()).filter((line) => line);
  const cells = (line) => (/[,;\t]/.test(line) ? line.split(/[,;\t]/) : line.split(/ +/)).map((cell) => cell.trim());
  const hasHeader = lines.length > 0 && /[a-z_]{3}/i.test(lines[0]);
  const names = hasHeader ? cells(lines[0]) : COLUMNS;
  const unknown = names.find((name) => !COLUMNS.includes(name));
  if (unknown !== undefined) throw new Error(`“${unknown}” is no column: allowed are ${COLUMNS.join(", ")}`);
  const path = lines.slice(hasHeader ? 1 : 0).map((line, at) => {
    const values = cells(line);
    if (values.length > names.length) throw new Error(`Point ${at + 1} has ${values.length} values: allowed are ${names.length}`);
    const given = values.flatMap((cell, column) => (cell === "" ? [] : [[names[column], Number(cell)]]));
    const wrong = given.find(([, value]) => !Number.isFinite(value));
    if (wrong) throw new Error(`${wrong[0]} of point ${at + 1} is no number`);
    return Object.fromEntries(given);
  });
  if (path.length < 2) throw new Error("A path has at least two points, one a line: x and y in m");
  return path;
}

/** The question that a form's values state. */
export function question(robot, values) {
  if (values.plan === "idle") return { robot, idle_s: Number(values.idle_s) };
  const end = { x_m: Number(values.length_m), y_m: 0, speed_mps: Number(values.speed_mps) };
  const path = values.plan === "path" ? points(values.path) : [{ x_m: 0, y_m: 0 }, end];
  const asked = { robot, path };
  if (values.back) asked.return = "dock";
  return asked;
}

/**
 * The charge along a trip, or the energy so far if the charge is unknown: for [`Fan.show`]. `null`
 * if neither is known.
 */
export function along(moments) {
  const last = moments?.at(-1);
  const hasCharge = moments?.every((moment) => moment.charge);
  if (!last?.energy) return null;
  const percent = (moment) => moment.charge.map((share) => 100 * share);
  const values = moments.map((moment) => {
    const [mean, lo, hi] = hasCharge ? percent(moment) : [moment.energy.mean_j, moment.energy.lo_j, moment.energy.hi_j];
    return { time: moment.time_s, mean, lo, hi };
  });
  const range = hasCharge ? [0, 100] : [Math.min(0, ...values.map((row) => row.lo)), Math.max(...values.map((row) => row.hi), 1e-9)];
  const text = (value) => (hasCharge ? `${value}\u202f%` : format.energy(value));
  return {
    line: values.map((row) => [row.time, row.mean]),
    band: [...values.map((row) => [row.time, row.hi]), ...values.map((row) => [row.time, row.lo]).reverse()],
    x: { range: [0, last.time_s], ticks: ticks(0, last.time_s, 4).map((time) => [time, time === 0 ? "now" : format.duration(time)]) },
    y: { range, ticks: ticks(...range, 2).map((value) => [value, text(value)]) },
    label: `${hasCharge ? "charge" : "energy"} at the end ${text(Number(values.at(-1).mean.toPrecision(3)))}`,
  };
}

const caveatNames = {
  beyond_horizon: "longer than the model's errors are known for",
  no_reading: "the robot has no fresh reading",
  state_outside_training: "the robot is outside the training data",
  late_s: "the robot cannot keep the path's times",
};

const limitNames = {
  measured_velocities: "the model was trained on measured velocities, not on commands",
  no_velocities: "the model does not know what moving costs",
  drive_power: "the energy is that of the drives alone",
};

const quantities = {
  velocity: "v in m/s",
  angular_velocity: "ω in rad/s",
  acceleration: "v·dv/dt in m²/s³",
  angular_acceleration: "ω·dω/dt in rad²/s³",
  velocity_change: "|dv/dt| in m/s²",
  angular_velocity_change: "|dω/dt| in rad/s²",
  together: "distance of v and ω together",
};

/** Which quantity lies outside, its value, its known range, and the speed that would do. */
function outside(found) {
  if (!found) return "";
  const number = (value) => Number(value.toPrecision(3)).toString();
  const speed = found.inside_at_mps ? `, inside at ${number(0.995 * found.inside_at_mps)} m/s` : "";
  const [lowest, highest] = found.known.map(number);
  return ` (${quantities[found.quantity] ?? found.quantity}: ${number(found.value)}, known from ${lowest} to ${highest}${speed})`;
}

function caveats(list) {
  const texts = Object.entries(caveatNames).filter(([name]) => list?.[name]).map(([, text]) => text);
  if (list?.alarms?.length > 0) texts.push(`alarms cast doubt on its readings: ${list.alarms.join(" and ")}`);
  if (list?.steps_outside_training > 0) texts.push(`${format.count(list.steps_outside_training)} steps outside the training data${outside(list.outside)}`);
  texts.push(...(list?.limits ?? []).map((limit) => limitNames[limit] ?? limit));
  return texts.join("; ");
}

/** The answer in words: pairs of a name and a text. */
export function answerFacts(answer) {
  const { energy: used, left } = answer;
  const facts = [["Verdict", answer.reason ? `${answer.verdict}: ${answer.reason}` : answer.verdict]];
  facts.push(["Takes", format.duration(answer.duration_s)]);
  if (used) facts.push(["Energy", `${format.energy(used.mean_j)} (${format.range(used.lo_j, used.hi_j, format.energy)})`]);
  if (left) facts.push(["Left", `${format.energy(left.mean_j)} (at least ${format.energy(left.lo_j)})`]);
  if (left) facts.push(["Probability", format.isKnown(answer.probability) ? format.percent(answer.probability, 1) : "unknown"]);
  // With a yes there is no such time: the whole path can be driven.
  if (format.isKnown(answer.turn_back_s)) facts.push(["Turn back within", `${format.duration(answer.turn_back_s)}, for a sure way back`]);
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
    let asked;
    try {
      asked = question(robot, values);
    } catch (error) {
      return this.#say(error.message);
    }
    try {
      const reply = await fetch("/api/v1/what_if", {
        method: "POST",
        headers: { "Content-Type": "application/json" },
        body: JSON.stringify(asked),
      });
      const body = await reply.json();
      if (robot !== this.robot) return;
      if (!reply.ok) this.#say(body.error ?? reply.statusText);
      else this.#show(body.answers[0], body.path);
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

  #show(answer, cut) {
    const list = document.createElement("dl");
    list.className = "facts";
    const facts = answerFacts(answer);
    if (cut) facts.push(["Path", `${format.count(cut.points)} points, driven as ${format.count(cut.lines)} straight lines within ${format.fixed(100 * cut.within_m, 1)}\u202fcm`]);
    for (const [name, text] of facts) {
      const box = document.createElement("div");
      const term = document.createElement("dt");
      const value = document.createElement("dd");
      term.textContent = name;
      value.textContent = text;
      if (name === "Verdict") value.className = `verdict ${answer.verdict}`;
      box.append(term, value);
      list.append(box);
    }
    const drawn = along(answer.along);
    const box = document.createElement("div");
    if (drawn) new Fan(box).show(drawn);
    this.output.replaceChildren(list, ...(drawn ? [box] : []));
  }
}
