// The worker's health: how long ticks take, what was dropped, how old forecasts are when they
// arrive.

import * as format from "./format.js";

const TICK_BARS = [["last", "last"], ["p50", "p50"], ["p99", "p99"], ["max", "max"]];

const FIELDS = {
  period: (f) => (format.isKnown(f.period_s) ? `of ${format.latency(f.period_s)}` : ""),
  tick: (f) => format.count(f.tick),
  skipped: (f) => format.count(f.ticks_skipped),
  late: (f) => format.count(f.ticks_late),
  missed: (f) => format.count(f.frames_missed),
  p50: (f) => format.latency(f.latency_s?.p50),
  p99: (f) => format.latency(f.latency_s?.p99),
  p999: (f) => format.latency(f.latency_s?.p999),
  max: (f) => format.latency(f.latency_s?.max),
};

function setText(node, text) {
  if (node.textContent !== text) node.textContent = text;
}

/** Replaces a definition list's entries where they changed. */
function fillFacts(list, entries) {
  const key = JSON.stringify(entries);
  if (list.filled === key) return;
  list.filled = key;
  list.replaceChildren(...entries.map(([name, text, className]) => {
    const box = document.createElement("div");
    const term = document.createElement("dt");
    const value = document.createElement("dd");
    term.textContent = name;
    value.textContent = text;
    if (className) value.className = className;
    box.append(term, value);
    return box;
  }));
}

const counted = (object) => Object.entries(object ?? {}).sort(([, a], [, b]) => b - a);
export const sum = (object) => Object.values(object ?? {}).reduce((all, count) => all + count, 0);

export class WorkerView {
  constructor() {
    this.root = document.getElementById("worker");
    this.fields = Object.keys(FIELDS).map((name) => [name, this.root.querySelector(`[data-worker="${name}"]`)]);
    this.state = this.root.querySelector('[data-worker="state"]');
    this.facts = (name) => document.getElementById(name);
    this.histogram = document.getElementById("histogram");
    this.bars = document.getElementById("tick-bars");
    this.#makeBars();
  }

  #makeBars() {
    for (const [, label] of TICK_BARS) {
      const box = document.createElement("div");
      const term = document.createElement("dt");
      const value = document.createElement("dd");
      const bar = document.createElement("i");
      const text = document.createElement("span");
      term.textContent = label;
      value.append(bar, text);
      box.append(term, value);
      this.bars.append(box);
    }
  }

  /** The worker's state, which may change while nothing is received. */
  say(state, text) {
    setText(this.state, text);
    this.root.dataset.state = state;
  }

  update(fleet) {
    for (const [name, node] of this.fields) setText(node, FIELDS[name](fleet));
    TICK_BARS.forEach(([name], at) => this.#bar(this.bars.children[at], fleet.tick_s?.[name], fleet.period_s));
    this.#histogram(fleet.latency_s);
    const ahead = (fleet.ahead ?? []).filter((scores) => scores.compared > 0);
    const none = [["Compared", "none yet: open a robot"]];
    fillFacts(this.facts("ahead"), ahead.length === 0 ? none : ahead.map((scores) => [
      `Error over ${format.duration(scores.horizon_s)}`,
      `${format.percent(scores.error, 1)} (last reading ${format.percent(scores.last_reading_error, 1)}, ` +
        `mean of 5\u202fs ${format.percent(scores.mean_5s_error, 1)}); ${format.percent(scores.coverage)} inside`,
    ]));
    fillFacts(this.facts("samples"), [
      ["Accepted", format.count(fleet.samples_accepted)],
      ...counted(fleet.samples_dropped).map(([reason, count]) => [`Dropped: ${reason}`, format.count(count), "bad"]),
      ...(sum(fleet.samples_dropped) === 0 ? [["Dropped", "0"]] : []),
    ]);
    fillFacts(this.facts("refused"), (fleet.refusals ?? []).map(({ robot, reason, count, found, remedy }) => [
      `Robot ${robot}: ${reason}`, `${format.count(count)} refused. ${found ? `${found}: ` : ""}${remedy}`, "bad"]));
    fillFacts(this.facts("questions"), [
      ["Answered", format.count(fleet.questions_answered)],
      ...counted(fleet.questions_refused).map(([reason, count]) => [`Refused: ${reason}`, format.count(count)]),
    ]);
    fillFacts(this.facts("processes"), this.#processes(fleet));
  }

  #processes(fleet) {
    const recorders = fleet.recorders === null || fleet.recorders === undefined ? format.UNKNOWN
      : fleet.recorders.map(({ name, pid }) => (pid ? `${name} (pid ${pid})` : name)).join(", ") || "none";
    return [
      ["Worker", fleet.worker?.pid ? `pid ${fleet.worker.pid}` : format.UNKNOWN],
      ["Model", fleet.model_hash ?? format.UNKNOWN],
      ...(fleet.model_fit ?? []).map((sentence) => ["Does it fit?", sentence]),
      ...(fleet.model_warnings ?? []).map((warning) => ["Model", warning, "bad"]),
      ["Recorder", recorders],
    ];
  }

  #bar(box, value, period) {
    const [bar, text] = box.lastElementChild.children;
    const share = format.isKnown(value) && period > 0 ? value / period : 0;
    bar.style.setProperty("inline-size", `${(Math.min(1, share) * 100).toFixed(1)}%`);
    bar.className = share > 1 ? "over" : "";
    setText(text, format.latency(value));
  }

  /** Bars of equal width, one per bucket between the first and the last that is not empty. */
  #histogram(latency) {
    const all = latency?.histogram ?? [];
    const key = JSON.stringify(all);
    if (this.histogram.filled === key) return;
    this.histogram.filled = key;
    const filled = all.map(([, count], at) => (count > 0 ? at : -1)).filter((at) => at >= 0);
    const shown = filled.length > 0 ? all.slice(filled[0], filled.at(-1) + 1) : [];
    const most = Math.max(1, ...shown.map(([, count]) => count));
    this.histogram.replaceChildren(...shown.map(([upper, count]) => {
      const bar = document.createElement("i");
      // The root shows the rare slow ones beside the many fast ones.
      bar.style.setProperty("block-size", `${count === 0 ? 0 : Math.max(3, Math.sqrt(count / most) * 100)}%`);
      bar.title = `up to ${upper === null ? "any" : format.latency(upper)}: ${format.count(count)}`;
      return bar;
    }));
    const ends = [shown[0]?.[0], shown.at(-1)?.[0]].map((upper) => (format.isKnown(upper) ? format.latency(upper) : "more"));
    this.histogram.dataset.first = shown.length > 0 ? `≤\u202f${ends[0]}` : "";
    this.histogram.dataset.last = shown.length > 1 ? `≤\u202f${ends[1]}` : "";
    this.histogram.ariaLabel = shown.length === 0 ? "no frames yet"
      : `Histogram of latencies: half up to ${format.latency(latency.p50)}, 99 % up to ${format.latency(latency.p99)}`;
  }
}
