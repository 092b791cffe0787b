// One robot: what it draws against what was forecast, what its battery holds, what was learned, its
// alarms.

import { changeItems, raisedItems } from "./alarms.js";
import { CapacityView } from "./capacity.js";
import { Charts } from "./charts.js";
import * as format from "./format.js";
import { OutlookView } from "./outlook.js";

const HISTORY_EVERY_MS = 1000;
/** The stream that has the robot takes a moment. */
const MISSING_AFTER_MS = 2000;

const { range } = format;
const seconds = (ns) => (format.isKnown(ns) ? ns * 1e-9 : null);
const yes = (value, text, other) => (value === null || value === undefined ? format.UNKNOWN : value ? text : other);
const number = (value, decimals) => format.fixed(value, decimals) ?? format.UNKNOWN;

/** Text of each field of the view. */
const FIELDS = {
  level: (r) => r.level ?? "unknown",
  platform: (r) => r.platform ?? "",
  soc: (r) => format.percent(r.soc, 1),
  "soc-bound": (r) => range(r.soc_lo, r.soc_hi, (share) => format.percent(share)),
  left: (r) => (r.charging === true ? "charging" : format.duration(r.time_to_empty_s)),
  "left-bound": (r) => (r.charging === true ? "" : range(r.time_to_empty_lo_s, r.time_to_empty_hi_s, format.duration)),
  reading: (r) => format.watts(r.reading_w),
  "reading-age": (r, aged) => {
    const ageS = format.readingAgeS(r, aged);
    return ageS === null ? "" : `${format.age(ageS)} old`;
  },
  forecast: (r) => format.watts(r.power_w),
  band: (r) => range(r.lo_w, r.hi_w, (w) => format.watts(w, r.hi_w)),
  drawn: (r) => format.energy(r.drawn_j),
  "mean-power": (r) => format.watts(r.mean_power_w),
  usable: (r) => format.energy(r.usable_j),
  "usable-lo": (r) => format.energy(r.usable_lo_j),
  capacity: (r) => (format.isKnown(r.capacity_j)
    ? `${format.energy(r.capacity_j)} ±\u202f${format.energy(2 * r.capacity_sd_j)}` : format.UNKNOWN),
  "to-full": (r) => format.duration(r.time_to_full_s),
  "to-80": (r) => format.duration(r.time_to_80_s),
  metered: (r) => format.duration(r.metered_s),
  unmetered: (r) => format.duration(r.unmetered_s),
  charging: (r) => yes(r.charging, "charging", "not charging"),
  measured: (r) => yes(r.soc_measured, "yes", "no, counted"),
  quality: (r) => format.quality(r),
  residual: (r) => format.wattDifference(r.residual_w),
  bias: (r) => format.wattDifference(r.bias_w),
  mae: (r) => format.wattDifference(r.mae_w).replace("+", ""),
  "persistence-mae": (r) => format.wattDifference(r.persistence_mae_w).replace("+", ""),
  r2: (r) => number(r.r2, 3),
  coverage: (r) => format.percent(r.coverage, 1),
  scored: (r) => format.count(r.scored),
  "w-last": (r) => format.percent(r.learned?.weight_last, 1),
  "w-network": (r) => format.percent(r.learned?.weight_network, 1),
  "w-stack": (r) => format.percent(r.learned?.weight_stack, 1),
};

export class RobotView {
  #fetching = null;
  #shownHistory = null;

  /** @param on close() */
  constructor(on) {
    this.root = document.getElementById("robot");
    this.title = document.getElementById("robot-title");
    this.fields = new Map(Object.keys(FIELDS).map((name) => [name, this.root.querySelector(`[data-robot="${name}"]`)]));
    this.part = (name) => this.root.querySelector(`[data-robot="${name}"]`);
    this.charts = new Charts(this.root);
    this.outlook = new OutlookView(this.root);
    this.capacity = new CapacityView(this.root);
    for (const kind of ["last", "network", "stack"]) {
      const share = document.createElement("i");
      share.className = `w-${kind}`;
      this.part("weights").append(share);
    }
    document.getElementById("close").addEventListener("click", () => on.close());
  }

  /** Shows the robot of this id, or closes the view with null. */
  open(id) {
    if (this.id === id) return;
    this.id = id;
    this.root.hidden = id === null;
    clearTimeout(this.#fetching);
    this.#shownHistory = null;
    if (id === null) return;
    this.title.textContent = `Robot ${id}`;
    this.openedAt = performance.now();
    for (const node of this.fields.values()) node.textContent = "";
    this.charts.clear();
    this.outlook.clear();
    this.capacity.show([]);
    this.#loadHistory(id);
    this.#loadCapacity(id);
  }

  /** @param agedS how old the newest frame is where it should be newer, s */
  update(board, nowMs, agedS) {
    if (this.id === null || this.id === undefined) return;
    const robot = board.robot?.robot === this.id ? board.robot : board.rows.get(this.id) ?? null;
    this.part("missing").hidden = robot !== null || performance.now() - this.openedAt < MISSING_AFTER_MS;
    if (robot === null) return;
    for (const [name, node] of this.fields) {
      const text = FIELDS[name](robot, agedS);
      if (node.textContent !== text) node.textContent = text;
    }
    this.part("mark").className = `mark ${format.levelName(robot.level)}`;
    this.part("soc-figure").hidden = !format.isKnown(robot.soc);
    const refused = (board.fleet?.refusals ?? []).find((each) => each.robot === this.id && each.found);
    const hint = refused ? `Samples are refused: ${refused.found}. Remedy: ${refused.remedy}.` : format.chargeHint(robot);
    format.setSentence(this.part("no-charge"), hint);
    this.part("no-charge").hidden = hint === "";
    this.#weights(robot.learned);
    raisedItems(this.part("alarms"), board.raised.filter((alarm) => alarm.robot === this.id), nowMs, false);
    changeItems(this.part("changes"), board.changes.filter((change) => change.robot === this.id), false);
  }

  #weights(learned) {
    const box = this.part("weights");
    box.hidden = !learned;
    if (!learned) return;
    const weights = [learned.weight_last, learned.weight_network, learned.weight_stack];
    [...box.children].forEach((share, at) => share.style.setProperty("flex-grow", String(Math.max(0, weights[at] ?? 0))));
    const text = ["last reading", "network", "stack of both"].map((name, at) => `${name} ${format.percent(weights[at])}`);
    box.ariaLabel = `Share of each forecaster: ${text.join(", ")}`;
  }

  /** Once: it changes with a whole drive. */
  async #loadCapacity(id) {
    try {
      const answer = await fetch(`/api/v1/robots/${id}/capacity`, { cache: "no-store" });
      const found = answer.ok ? await answer.json() : null;
      if (found !== null && this.id === id) this.capacity.show(found.months);
    } catch {
      // As below.
    }
  }

  async #loadHistory(id) {
    try {
      if (!document.hidden) {
        const answer = await fetch(`/api/v1/robots/${id}/history`, { cache: "no-store" });
        if (answer.ok && this.id === id) this.#showHistory(await answer.json());
        const outlook = await fetch(`/api/v1/robots/${id}/outlook`, { cache: "no-store" });
        const found = outlook.ok ? await outlook.json() : null;
        if (found !== null && this.id === id) this.outlook.show(found);
      }
    } catch {
      // The stream says that the server is gone; the charts keep what they show.
    }
    if (this.id === id) this.#fetching = setTimeout(() => this.#loadHistory(id), HISTORY_EVERY_MS);
  }

  #showHistory(history) {
    if (history.robot !== this.id || history.end_unix_ns === this.#shownHistory) return;
    this.#shownHistory = history.end_unix_ns;
    this.charts.show(history);
  }
}
