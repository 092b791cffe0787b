// The list of robots: a table whose rows outside the view do not exist. The server sorts, filters
// and cuts; the list asks for the window that it shows.

import { worstFirst } from "./alarms.js";
import * as format from "./format.js";

const ROWS_BEYOND = 4;
const WINDOW_BEYOND = 20;
const WINDOW_MOST = 200;
const ASK_AFTER_MS = 120;

const COLUMNS = ["level", "robot", "alarms", "battery", "left", "power", "forecast", "residual", "quality"];
const NUMBERS = new Set(["left", "power", "residual"]);

function element(tag, className, parent) {
  const made = document.createElement(tag);
  if (className) made.className = className;
  parent?.append(made);
  return made;
}

/** Writes only what changed: most cells of most frames are as before. */
function setText(node, text) {
  if (node.shown === text) return;
  node.shown = text;
  node.textContent = text;
}

function setClass(node, text) {
  if (node.shownClass === text) return;
  node.shownClass = text;
  node.className = text;
}

function setStyle(node, name, value) {
  node.shownStyle ??= {};
  if (node.shownStyle[name] === value) return;
  node.shownStyle[name] = value;
  node.style.setProperty(name, value);
}

const share = (part) => `${(Math.min(1, Math.max(0, part)) * 100).toFixed(1)}%`;

/** The next 1, 2 or 5 times a power of ten. */
export function niceAbove(value) {
  if (!(value > 0)) return 1;
  const power = 10 ** Math.floor(Math.log10(value));
  const step = [1, 2, 5, 10].find((factor) => factor * power >= value * 0.999) ?? 10;
  return step * power;
}

class Row {
  constructor(body) {
    this.tr = element("tr", "", body);
    this.cells = {};
    for (const name of COLUMNS) {
      const tag = name === "robot" ? "th" : "td";
      const cell = element(tag, `c-${name}${NUMBERS.has(name) ? " number" : ""}`, this.tr);
      if (tag === "th") cell.scope = "row";
      this.cells[name] = cell;
    }
    this.mark = element("span", "mark", this.cells.level);
    this.mark.ariaHidden = "true";
    this.level = element("span", "name", this.cells.level);
    this.id = element("span", "id", this.cells.robot);
    this.platform = element("span", "platform", this.cells.robot);
    this.brief = element("span", "brief", this.cells.robot);
    this.bar = element("span", "bar", this.cells.battery);
    this.barBound = element("i", "bound", this.bar);
    this.barFill = element("i", "fill", this.bar);
    this.soc = element("span", "value", this.cells.battery);
    this.socLo = element("span", "least", this.cells.battery);
    this.left = element("span", "value", this.cells.left);
    this.leftLo = element("span", "least", this.cells.left);
    this.scale = element("span", "scale", this.cells.forecast);
    this.band = element("i", "band", this.scale);
    this.next = element("i", "next", this.scale);
    this.read = element("i", "read", this.scale);
    this.forecast = element("span", "value", this.cells.forecast);
    this.interval = element("span", "least", this.cells.forecast);
  }

  show(robot, index, look) {
    const known = robot !== undefined;
    this.robot = known ? robot.robot : null;
    this.tr.ariaRowIndex = String(index + 2);
    const id = known ? `robot-${robot.robot}` : "";
    if (this.tr.id !== id) this.tr.id = id;
    const level = known ? format.levelName(robot.level) : "unknown";
    const classes = [level];
    if (known && robot.robot === look.active) classes.push("active");
    if (known && robot.robot === look.opened) classes.push("opened");
    if (!known) classes.push("loading");
    setClass(this.tr, classes.join(" "));
    this.tr.ariaSelected = String(known && robot.robot === look.opened);
    if (!known) {
      for (const node of [this.level, this.platform, this.brief, this.soc, this.socLo, this.left, this.leftLo,
        this.forecast, this.interval, this.cells.alarms, this.cells.power, this.cells.residual, this.cells.quality]) setText(node, "");
      setText(this.id, "…");
      this.bar.hidden = this.scale.hidden = true;
      return;
    }
    setClass(this.mark, `mark ${level}`);
    setText(this.level, robot.level ?? format.UNKNOWN);
    setText(this.id, String(robot.robot));
    setText(this.platform, robot.platform ?? "");
    const mark = (alarm) => (look.acknowledged.has(`${robot.robot} ${alarm}`) ? `${alarm}\u202f✓` : alarm);
    const alarms = worstFirst(robot.alarms ?? []).map(mark).join(", ");
    setText(this.cells.alarms, alarms);
    setText(this.brief, alarms || format.quality(robot));
    this.#battery(robot);
    this.#power(robot, look.scaleW(robot.platform));
    setText(this.cells.quality, `${format.quality(robot)} · ${format.age(format.readingAgeS(robot, look.agedS))}`);
  }

  #battery(robot) {
    const known = format.isKnown(robot.soc);
    this.bar.hidden = !known;
    setText(this.soc, format.percent(robot.soc));
    this.cells.battery.title = format.chargeHint(robot);
    setText(this.socLo, format.isKnown(robot.soc_lo) ? `≥\u202f${format.percent(robot.soc_lo)}` : "");
    if (known) {
      const lo = robot.soc_lo ?? robot.soc;
      setStyle(this.barFill, "inline-size", share(lo));
      setStyle(this.barBound, "inset-inline-start", share(lo));
      setStyle(this.barBound, "inline-size", share((robot.soc_hi ?? robot.soc) - lo));
    }
    setText(this.left, robot.charging === true ? "charging" : format.duration(robot.time_to_empty_s));
    setText(this.leftLo, format.isKnown(robot.time_to_empty_lo_s) && robot.charging !== true
      ? `≥\u202f${format.duration(robot.time_to_empty_lo_s)}` : "");
  }

  #power(robot, scaleW) {
    const { reading_w: reading, power_w: power, lo_w: lo, hi_w: hi } = robot;
    setText(this.cells.power, format.watts(reading, scaleW));
    setText(this.cells.residual, format.wattDifference(robot.residual_w));
    const banded = format.isKnown(lo) && format.isKnown(hi);
    setText(this.forecast, format.watts(power, scaleW));
    setText(this.interval, banded ? `${format.wattNumber(lo, scaleW)} – ${format.wattNumber(hi, scaleW)}` : "");
    this.scale.hidden = !format.isKnown(power) && !format.isKnown(reading);
    this.band.hidden = !banded;
    this.next.hidden = !format.isKnown(power);
    this.read.hidden = !format.isKnown(reading);
    if (banded) {
      setStyle(this.band, "inset-inline-start", share(lo / scaleW));
      setStyle(this.band, "inline-size", share((hi - Math.max(0, lo)) / scaleW));
    }
    if (format.isKnown(power)) setStyle(this.next, "inset-inline-start", share(power / scaleW));
    if (format.isKnown(reading)) setStyle(this.read, "inline-size", share(reading / scaleW));
  }
}

export class RobotList {
  #rows = [];
  #scalesW = new Map();
  #pendingIndex = null;
  #asking = null;

  /** @param on open(robot), window(from, count) */
  constructor(on) {
    this.on = on;
    this.table = document.getElementById("grid");
    this.scroller = document.getElementById("scroller");
    this.empty = document.getElementById("empty");
    this.body = this.table.tBodies[0];
    this.above = element("tr", "space", this.body);
    this.below = element("tr", "space", this.body);
    for (const space of [this.above, this.below]) space.ariaHidden = "true";
    this.active = null;
    this.window = { from: 0, count: 60 };
    this.scroller.addEventListener("scroll", () => this.render(), { passive: true });
    new ResizeObserver(() => this.measure()).observe(this.scroller);
    this.body.addEventListener("click", (event) => this.#click(event));
    this.table.addEventListener("keydown", (event) => this.#key(event));
  }

  /** Another sort or search: from the top. */
  reset() {
    this.scroller.scrollTop = 0;
    this.active = null;
    this.#pendingIndex = null;
    this.window = { ...this.window, from: 0 };
  }

  /** @param agedS how old the newest frame is where it should be newer, s */
  update(board, state, agedS) {
    this.agedS = agedS;
    this.board = board;
    this.state = state;
    if (this.#pendingIndex !== null) this.#activate(this.#pendingIndex);
    this.render();
  }

  measure() {
    const style = getComputedStyle(this.table);
    this.rowHeight = Number.parseFloat(style.getPropertyValue("--row")) || 34;
    this.render();
  }

  render() {
    if (!this.board || !this.rowHeight) return;
    const { board } = this;
    const head = this.table.tHead.offsetHeight;
    const height = Math.max(0, this.scroller.clientHeight - head);
    const first = Math.max(0, Math.floor(this.scroller.scrollTop / this.rowHeight) - ROWS_BEYOND);
    const last = Math.min(board.matched, first + Math.ceil(height / this.rowHeight) + 2 * ROWS_BEYOND);
    const count = Math.max(0, last - first);
    while (this.#rows.length < count) {
      const row = new Row(this.body);
      this.#rows.push(row);
      this.below.before(row.tr);
    }
    while (this.#rows.length > count) this.#rows.pop().tr.remove();
    setStyle(this.above, "block-size", `${first * this.rowHeight}px`);
    setStyle(this.below, "block-size", `${(board.matched - last) * this.rowHeight}px`);
    this.table.ariaRowCount = String(board.matched + 1);
    this.#rescale();
    const acknowledged = new Set(board.raised.filter((each) => each.acknowledged).map((each) => `${each.robot} ${each.alarm}`));
    const look = {
      acknowledged,
      active: this.active, opened: this.state.robot, agedS: this.agedS, scaleW: (platform) => this.#scalesW.get(platform) ?? 1,
    };
    for (let place = 0; place < count; place += 1) {
      const index = first + place;
      this.#rows[place].show(board.rows.get(board.order[index - board.from]), index, look);
    }
    this.#describeActive();
    this.empty.hidden = board.matched > 0 || board.fleet === null;
    this.#ask(first, last);
  }

  /** One scale of power per platform, which only widens: bars must not jump. */
  #rescale() {
    for (const robot of this.board.rows.values()) {
      const most = Math.max(robot.hi_w ?? 0, robot.reading_w ?? 0, robot.power_w ?? 0);
      const scaleW = this.#scalesW.get(robot.platform) ?? 0;
      if (most > scaleW) this.#scalesW.set(robot.platform, niceAbove(most));
    }
  }

  /** Asks for another window when rows are shown that this one lacks. */
  #ask(first, last) {
    const { from, count } = this.window;
    if (first >= from && last <= from + count) return;
    const start = Math.max(0, Math.floor((first - WINDOW_BEYOND) / 10) * 10);
    const most = Math.min(WINDOW_MOST, Math.ceil((last - start + WINDOW_BEYOND) / 10) * 10);
    this.window = { from: start, count: most };
    clearTimeout(this.#asking);
    this.#asking = setTimeout(() => this.on.window(), ASK_AFTER_MS);
  }

  #describeActive() {
    const id = `robot-${this.active}`;
    if (this.active !== null && this.#rows.some((row) => row.robot === this.active)) {
      this.table.setAttribute("aria-activedescendant", id);
    } else this.table.removeAttribute("aria-activedescendant");
  }

  #click(event) {
    const tr = event.target.closest("tr");
    const row = this.#rows.find((candidate) => candidate.tr === tr);
    if (!row || row.robot === null) return;
    this.active = row.robot;
    this.on.open(row.robot);
  }

  #indexOfActive() {
    const place = this.board.order.indexOf(this.active);
    return this.active === null || place < 0 ? null : this.board.from + place;
  }

  #key(event) {
    if (!this.board || event.altKey || event.ctrlKey || event.metaKey || event.target !== this.table) return;
    if (event.key === "Enter" || event.key === " ") {
      if (this.active === null) return;
      event.preventDefault();
      this.on.open(this.active, true);
      return;
    }
    const page = Math.max(1, Math.floor(this.scroller.clientHeight / this.rowHeight) - 2);
    const steps = { ArrowDown: 1, ArrowUp: -1, PageDown: page, PageUp: -page, Home: -Infinity, End: Infinity };
    const step = steps[event.key];
    if (step === undefined) return;
    event.preventDefault();
    const top = Math.floor(this.scroller.scrollTop / this.rowHeight);
    const at = this.#pendingIndex ?? this.#indexOfActive() ?? top - Math.sign(step);
    this.#activate(Math.min(this.board.matched - 1, Math.max(0, at + step)));
    this.render();
  }

  /** Makes the row the active one; if it has not been sent yet, once it is. */
  #activate(index) {
    if (index < 0 || this.board.matched === 0) return;
    this.#reveal(index);
    const robot = this.board.order[index - this.board.from];
    this.#pendingIndex = robot === undefined ? index : null;
    if (robot === undefined) return;
    this.active = robot;
    if (this.state.robot !== null && this.state.robot !== robot) this.on.follow(robot);
  }

  #reveal(index) {
    const head = this.table.tHead.offsetHeight;
    const top = index * this.rowHeight;
    const bottom = top + this.rowHeight + head;
    if (top < this.scroller.scrollTop) this.scroller.scrollTop = top;
    else if (bottom > this.scroller.scrollTop + this.scroller.clientHeight) {
      this.scroller.scrollTop = bottom - this.scroller.clientHeight;
    }
  }
}
