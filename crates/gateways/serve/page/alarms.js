// Alarms: those raised now with their age, and the last changes with their duration.

import * as format from "./format.js";

const RAISED_SHOWN = 100;
/** Changes within this time may be one line, if more robots than these have them. */
const TOGETHER_MS = 1000;
const APART_UP_TO = 3;
const SAY_EVERY_MS = 2500;
const SAID_AT_ONCE = 3;

/** The level that an alarm means; the others warn. */
const LEVELS = {
  NoData: "stale", OfflineCharging: "ok",
  OutOfRange: "error", StuckSensor: "error", CannotReturn: "error", BatteryCritical: "error",
};

const RANKS = ["error", "stale", "warn", "ok"];
const rank = (alarm) => RANKS.indexOf(LEVELS[alarm] ?? "warn");

/** Names of alarms, the worst first, otherwise as they came. */
export const worstFirst = (alarms) => alarms.toSorted((a, b) => rank(a) - rank(b));

/**
 * Makes a list show these entries: each a list of [class, text, address or robot of an alarm, or
 * nothing]; what is equal stays.
 */
function fill(list, entries) {
  while (list.children.length > entries.length) list.lastElementChild.remove();
  entries.forEach((parts, at) => {
    const old = list.children[at];
    const shape = parts.map(([className, , href]) => `${className} ${href ?? ""}`).join("|");
    if (old?.shape !== shape) {
      const made = item(parts, shape);
      if (old) old.replaceWith(made);
      else list.append(made);
    } else parts.forEach(([, text], place) => setText(old.children[place], text));
  });
}

function setText(node, text) {
  if (node.textContent !== text) node.textContent = text;
}

function item(parts, shape) {
  const li = document.createElement("li");
  li.shape = shape;
  for (const [className, text, href] of parts) {
    const isAlarm = className === "alarm";
    const node = document.createElement(isAlarm ? "button" : href ? "a" : "span");
    node.className = className;
    if (isAlarm) {
      node.title = "What it means and what to check";
      node.dataset.robot = href;
    }
    node.textContent = text;
    if (href && !isAlarm) node.href = href;
    li.append(node);
  }
  return li;
}

const link = (robot) => `/?robot=${robot}`;

const robotPart = (named, robot) => (named ? [["robot", `Robot ${robot}`, link(robot)]] : []);

export function raisedItems(list, raised, nowMs, named = true) {
  const sorted = raised.toSorted((a, b) => rank(a.alarm) - rank(b.alarm));
  const entries = sorted.slice(0, RAISED_SHOWN).map(({ robot, alarm, since_unix_ns: since, acknowledged }) => {
    const sinceMs = format.unixMs(since);
    const age = sinceMs === null ? "" : `for ${format.duration(Math.max(0, Math.floor((nowMs - sinceMs) / 1000)))}`;
    return [[`mark ${LEVELS[alarm] ?? "warn"}`, ""], ...robotPart(named, robot), ["alarm", alarm, robot],
      ...(acknowledged ? [["by", `acknowledged by ${acknowledged.by}`]] : []), ["age", age]];
  });
  const more = raised.length - entries.length;
  if (more > 0) entries.push([["none", `and ${format.count(more)} more`]]);
  if (entries.length === 0 && named) entries.push([["none", "None. An alarm names the robot, and its card says what to check."]]);
  fill(list, entries);
}

/** Changes that many robots have at once, as when their source ends, are one: with `robots`. */
export function together(changes) {
  const groups = [];
  for (const change of changes) {
    const [first] = groups.at(-1) ?? [];
    const apartMs = first ? Math.abs(format.unixMs(first.at_unix_ns) - format.unixMs(change.at_unix_ns)) : Infinity;
    if (apartMs < TOGETHER_MS && first.alarm === change.alarm && first.change === change.change) groups.at(-1).push(change);
    else groups.push([change]);
  }
  return groups.flatMap((group) => (group.length > APART_UP_TO ? [{ ...group[0], robots: group.length }] : group));
}

export function changeItems(list, changes, named = true) {
  const entries = together(changes).slice(0, RAISED_SHOWN).map((change) => {
    const at = format.unixMs(change.at_unix_ns);
    const raised = format.unixMs(change.raised_unix_ns);
    const isEnd = change.change === "cleared" || change.change === "left";
    const by = change.acknowledged && !isEnd ? ` by ${change.acknowledged.by}` : "";
    const lasted = isEnd && at !== null && raised !== null
      ? ` after ${format.duration((at - raised) / 1000)}` : "";
    return [["at", format.timeOfDay(at)], ...(change.robots ? [["robot", `${format.count(change.robots)} robots`]] : robotPart(named, change.robot)),
      ["alarm", change.alarm, change.robot],
      [`change ${change.change}`, `${change.change}${by}${lasted}`]];
  });
  if (entries.length === 0) entries.push([["none", "None since this page's server started. joulebus alarms FILE lists those of a capture."]]);
  fill(list, entries);
}

export class AlarmsView {
  #unsaid = [];
  #saying = null;
  #last = undefined;

  constructor() {
    this.raised = document.getElementById("raised");
    this.changes = document.getElementById("changes");
    this.announcer = document.getElementById("announcer");
  }

  update(board, nowMs) {
    raisedItems(this.raised, board.raised, nowMs);
    changeItems(this.changes, board.changes);
  }

  /** Tells a screen reader of changes since the last call, a few at a time. */
  announce(changes) {
    const key = (change) => change && `${change.at_unix_ns} ${change.robot} ${change.alarm} ${change.change}`;
    const known = this.#last;
    this.#last = key(changes[0]) ?? null;
    if (known === undefined || known === this.#last) return;
    for (const change of changes) {
      if (key(change) === known) break;
      this.#unsaid.push(change);
    }
    this.#saying ??= setTimeout(() => this.#say(), 300);
  }

  #say() {
    const texts = this.#unsaid.slice(0, SAID_AT_ONCE).map((c) => `Robot ${c.robot}: ${c.alarm} ${c.change}`);
    const more = this.#unsaid.length - texts.length;
    if (more > 0) texts.push(`and ${more} more changes`);
    this.announcer.textContent = texts.join(". ");
    this.#unsaid = [];
    this.#saying = setTimeout(() => {
      this.#saying = null;
      if (this.#unsaid.length > 0) this.#say();
    }, SAY_EVERY_MS);
  }
}
