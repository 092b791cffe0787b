// The operator's page: one stream of events from the server, drawn at most once per message.

import { AlarmsView } from "./alarms.js";
import * as address from "./address.js";
import { emptyBoard, take } from "./board.js";
import { showCards } from "./card.js";
import * as format from "./format.js";
import { RobotList } from "./list.js";
import { explainNames } from "./meaning.js";
import { BatteryForm } from "./person.js";
import { RobotView } from "./robot.js";
import { Stream } from "./stream.js";
import { WhatIf } from "./what_if.js";
import { WorkerView, sum } from "./worker.js";

const RATE_HZ = 5;
const HIDDEN_EVERY_MS = 2000;
const STALE_AFTER_MS = 3000;
/** A worker counts as stale after two ticks; here it is said once a reader could notice. */
const WORKER_STALE_AFTER_S = 1;
const SEARCH_AFTER_MS = 200;
const FOLLOW_AFTER_MS = 200;

const board = emptyBoard();
let state = address.read(location.search);
/** The connection: "connecting", "open" or "closed" with the reason and when it is tried again. */
let link = { state: "connecting" };
let messageAt = null;
let drawing = null;
/** Ends the questions of a tab that is not visible. */
let hidden = null;

const byId = (id) => document.getElementById(id);
const fleetField = (name) => document.querySelector(`[data-fleet="${name}"]`);

const list = new RobotList({
  open: (robot, focus) => go({ robot, view: "robots" }, { focus }),
  follow: (robot) => {
    clearTimeout(list.following);
    list.following = setTimeout(() => go({ robot }, { replace: true }), FOLLOW_AFTER_MS);
  },
  window: () => connect(),
});
const robotView = new RobotView({ close: () => closeRobot() });
const alarmsView = new AlarmsView();
const workerView = new WorkerView();
const whatIf = new WhatIf();
const batteryForm = new BatteryForm();
showCards(board);

const stream = new Stream({
  onMessage: (kind, message) => {
    if (kind !== "view" && kind !== "delta") return true;
    if (!take(board, kind, message)) return false;
    messageAt = performance.now();
    drawing ??= requestAnimationFrame(draw);
    return true;
  },
  onState: (name, detail) => {
    link = { state: name, ...detail };
    showStatus();
  },
});

function connect() {
  if (document.hidden) return;
  const { from, count } = list.window;
  const query = address.viewQuery(state, from, count);
  query.set("hz", String(RATE_HZ));
  stream.open(`/api/v1/stream?${query}`);
}

/**
 * A browser keeps few connections to one host: a tab that is not visible gives its stream back and
 * only asks for sums.
 */
function showOrHide() {
  hidden?.abort();
  hidden = null;
  if (!document.hidden) {
    connect();
    return;
  }
  stream.close();
  hidden = new AbortController();
  askWhileHidden(hidden.signal);
}

async function askWhileHidden(signal) {
  while (!signal.aborted) {
    await askForSums(signal);
    await new Promise((resolve) => setTimeout(resolve, HIDDEN_EVERY_MS));
  }
}

async function askForSums(signal) {
  const closed = (status, reason) => ({ state: "closed", status, reason, retryAt: performance.now() + HIDDEN_EVERY_MS });
  let next;
  try {
    const answer = await fetch("/api/v1/fleet", { cache: "no-store", signal });
    const fleet = answer.ok ? await answer.json() : null;
    if (signal.aborted) return;
    if (fleet !== null) {
      board.fleet = fleet;
      messageAt = performance.now();
    }
    next = fleet === null ? closed(answer.status, `the server answers ${answer.status}`) : { state: "open" };
  } catch {
    if (signal.aborted) return;
    next = closed(undefined, "no connection to the server");
  }
  link = next;
  if (board.fleet !== null) showTotals();
  showStatus();
}

/** Changes what is shown; the address follows, so that Back and a link work. */
function go(change, { replace = false, focus = false } = {}) {
  const before = state;
  state = { ...state, ...change };
  const url = address.write(state);
  if (url !== address.write(before)) history[replace ? "replaceState" : "pushState"](null, "", url);
  apply(before, focus);
}

function apply(before, focus = false) {
  const other = (keys) => keys.some((key) => String(before[key]) !== String(state[key]));
  const resorted = other(["sort", "descending", "search", "levels"]);
  if (resorted) list.reset();
  showControls();
  if (resorted || other(["robot"])) connect();
  draw();
  if (focus && state.robot !== null) byId("robot").focus({ preventScroll: true });
}

function closeRobot() {
  if (state.robot === null) return;
  clearTimeout(list.following);
  go({ robot: null });
  byId("grid").focus({ preventScroll: true });
}

function showControls() {
  document.body.dataset.view = state.view;
  document.body.dataset.opened = String(state.robot !== null);
  for (const anchor of document.querySelectorAll("nav a")) {
    if (anchor.dataset.view === state.view) anchor.setAttribute("aria-current", "page");
    else anchor.removeAttribute("aria-current");
  }
  if (document.activeElement !== byId("search")) byId("search").value = state.search;
  byId("sort").value = state.sort;
  for (const button of document.querySelectorAll("[data-level]")) {
    button.ariaPressed = String(state.levels.includes(button.dataset.level));
  }
  for (const head of document.querySelectorAll("th[data-sort]")) {
    if (head.dataset.sort === state.sort) head.ariaSort = state.descending ? "descending" : "ascending";
    else head.removeAttribute("aria-sort");
  }
  robotView.open(state.robot);
  whatIf.open(state.robot);
  batteryForm.open(state.robot);
}

/** The server's time now, from its last message and this page's clock. */
function serverNowMs() {
  const sentMs = format.unixMs(board.fleet?.now_unix_ns);
  return sentMs === null || messageAt === null ? Date.now() : sentMs + (performance.now() - messageAt);
}

/** Age of the newest frame. */
const frameAgeS = () => (board.fleet.worker.age_s ?? 0) + (performance.now() - messageAt) / 1000;

function draw() {
  if (drawing !== null) cancelAnimationFrame(drawing);
  drawing = null;
  showStatus();
  if (board.fleet === null) return;
  showTotals();
  const aged = document.body.dataset.aged === "true" ? frameAgeS() : 0;
  list.update(board, state, aged);
  const nowMs = serverNowMs();
  if (shown("worker")) workerView.update(board.fleet);
  alarmsView.announce(board.changes);
  if (shown("alarms")) alarmsView.update(board, nowMs);
  if (shown("robot")) robotView.update(board, nowMs, aged);
}

/** Hidden panels cost nothing. */
const shown = (id) => byId(id).offsetParent !== null;

function showTotals() {
  const { fleet } = board;
  const { totals } = fleet;
  const texts = {
    name: fleet.fleet,
    ok: format.count(totals.ok), warn: format.count(totals.warn),
    error: format.count(totals.error), stale: format.count(totals.stale),
    robots: format.count(totals.robots),
    power: format.watts(totals.power_w), drawn: format.energy(totals.drawn_j),
    alarms: format.count(totals.alarms), "alarms-badge": format.count(totals.alarms),
    "tick-p99": format.latency(fleet.tick_s?.p99), "latency-p99": format.latency(fleet.latency_s?.p99),
    dropped: format.count(sum(fleet.samples_dropped)),
  };
  for (const [name, text] of Object.entries(texts)) {
    const node = fleetField(name);
    if (node.textContent !== text) node.textContent = text;
  }
  fleetField("alarms-badge").hidden = !(totals.alarms > 0);
  fleetField("dropped").classList.toggle("bad", sum(fleet.samples_dropped) > 0);
  fleetField("alarms").classList.toggle("bad", totals.alarms > 0);
  const filtered = state.search !== "" || state.levels.length > 0;
  const matched = filtered ? `${format.count(board.matched)} of ${format.count(board.total)}` : "";
  if (byId("matched").textContent !== matched) byId("matched").textContent = matched;
  byId("empty").textContent = filtered ? "No robot matches. Escape in the search field clears it." : noRobots(fleet);
}

/** What to do where no robot is listed. */
function noRobots(fleet) {
  const refused = fleet.refusals?.[0];
  if (refused) return `No robot yet: samples are refused (${refused.reason}). ${refused.found ? `${refused.found}. ` : ""}${refused.remedy}.`;
  if (fleet.worker.state !== "alive") return "No robots: no worker runs. Start one with: joulebus run --config FILE";
  return "No robots yet: no source publishes. Start your controller or a bridge, or simulated robots with: joulebus publish sim --config FILE";
}

/**
 * Alarms, what is wrong with worker or connection, and the fleet: what a tab shows that is not
 * visible.
 */
function showTitle(state, text) {
  const alarms = board.fleet?.totals.alarms ?? 0;
  const parts = [state === "gone" || state === "stale" ? text : "", board.fleet?.fleet ?? "", "joulebus"];
  const title = `${alarms > 0 ? `(${alarms}) ` : ""}${parts.filter((part) => part !== "").join(" – ")}`;
  if (document.title !== title) document.title = title;
}

/**
 * What the connection and the worker are like now: state, short text, and the sentence for the
 * banner.
 */
function condition() {
  const silentMs = messageAt === null ? Infinity : performance.now() - messageAt;
  const old = messageAt === null ? "" : ` The values are those of ${format.duration(Math.floor(silentMs / 1000))} ago.`;
  if (link.state === "closed") {
    if (link.status === 401) return { state: "gone", text: "Locked", banner: `The server asks for its token: open this address with ?token=… once. ${link.reason}` };
    const wait = Math.max(0, Math.ceil((link.retryAt - performance.now()) / 1000));
    const next = wait > 0 ? `next try in ${wait}\u202fs` : "trying again";
    return { state: "gone", text: "Disconnected", banner: `Disconnected: ${link.reason}; ${next}.${old}` };
  }
  if (messageAt === null) return { state: "connecting", text: "Connecting", banner: "" };
  return workerCondition(board.fleet.worker, silentMs, old);
}

function workerCondition(worker, silentMs, old) {
  const ageS = frameAgeS();
  const since = format.timeOfDay(serverNowMs() - ageS * 1000);
  const reason = worker.reason ? `: ${worker.reason.replace(/\.$/, "")}.` : ".";
  const lasting = `Last frame at ${since}, ${format.duration(Math.floor(ageS))} ago; the values are those.`;
  if (worker.state === "gone") return { state: "gone", text: "Worker gone", banner: `The worker is gone${reason} ${lasting}` };
  if (worker.state === "waiting") return { state: "stale", text: "Waiting for a worker", banner: `No worker yet${reason}` };
  if (worker.state === "stale" && ageS >= WORKER_STALE_AFTER_S) return { state: "stale", text: "Stale", banner: `The worker sends nothing${reason} ${lasting}` };
  // Browsers let a tab that is not visible ask once a minute.
  if (silentMs > STALE_AFTER_MS && !document.hidden) return { state: "stale", text: "Stale", banner: `Nothing from the server.${old}` };
  return { state: "live", text: "Live", banner: "" };
}

function showStatus() {
  const { state: name, text, banner } = condition();
  const status = byId("status");
  if (status.dataset.state !== name) status.dataset.state = name;
  const label = status.querySelector("[data-status]");
  if (label.textContent !== text) label.textContent = text;
  showBanner(name, text, banner);
  showTitle(name, text);
  document.body.dataset.aged = String(name === "gone" || name === "stale");
  if (board.fleet) workerView.say(board.fleet.worker.state, banner || "Alive");
}

/** The banner's seconds are for the eye; a screen reader hears each condition once. */
function showBanner(name, text, banner) {
  const node = byId("banner");
  node.hidden = banner === "";
  if (node.dataset.said !== text) {
    node.dataset.said = text;
    byId("spoken").textContent = banner === "" && name === "live" ? "Live" : banner;
  }
  if (node.textContent !== banner) node.textContent = banner;
}

function toggleLevel(level) {
  const levels = state.levels.includes(level) ? state.levels.filter((other) => other !== level) : [...state.levels, level];
  go({ levels, view: "robots" }, { replace: true });
}

/** A header: that order; once more: the other way round; a third time: by urgency. */
function sortBy(key) {
  if (state.sort !== key) go({ sort: key, descending: false }, { replace: true });
  else if (!state.descending) go({ descending: true }, { replace: true });
  else go({ sort: "urgency", descending: false }, { replace: true });
}

function listen() {
  const search = byId("search");
  let typing = null;
  search.addEventListener("input", () => {
    clearTimeout(typing);
    typing = setTimeout(() => go({ search: search.value.trim() }, { replace: true }), SEARCH_AFTER_MS);
  });
  byId("tools").addEventListener("submit", (event) => {
    event.preventDefault();
    byId("grid").focus();
  });
  byId("sort").addEventListener("change", (event) => go({ sort: event.target.value, descending: false }, { replace: true }));
  for (const button of document.querySelectorAll("[data-level]")) {
    button.addEventListener("click", () => toggleLevel(button.dataset.level));
  }
  for (const head of document.querySelectorAll("th[data-sort]")) {
    head.firstElementChild.addEventListener("click", () => sortBy(head.dataset.sort));
  }
  document.addEventListener("click", followLink);
  document.addEventListener("keydown", key);
  addEventListener("popstate", () => {
    const before = state;
    state = address.read(location.search);
    apply(before);
  });
  document.addEventListener("visibilitychange", showOrHide);
}

/** Links to this page change what is shown; with a modifier they open as links do. */
function followLink(event) {
  const anchor = event.target.closest?.("a[href^='/']");
  if (!anchor || event.defaultPrevented || event.ctrlKey || event.metaKey || event.shiftKey) return;
  event.preventDefault();
  const { view, robot } = address.read(anchor.search);
  if (anchor.hasAttribute("data-home")) go({ ...address.read("") });
  else go({ view, robot }, { focus: robot !== null });
}

function key(event) {
  const typing = event.target.closest?.("input, select, textarea");
  if (event.key === "/" && !typing && !event.ctrlKey && !event.metaKey) {
    event.preventDefault();
    go({ view: "robots" });
    byId("search").focus();
    byId("search").select();
  } else if (event.key === "Escape") escape(event, typing);
}

/** Escape takes one step back: the search, then the robot, then another view. */
function escape(event, typing) {
  if (typing === byId("search")) {
    event.preventDefault();
    typing.value = "";
    go({ search: "" }, { replace: true });
    byId("grid").focus();
  } else if (state.robot !== null) closeRobot();
  else if (state.view !== "robots") go({ view: "robots" });
}

listen();
explainNames();
showControls();
list.measure();
showOrHide();
setInterval(() => (document.body.dataset.aged === "true" ? draw() : showStatus()), 500);
