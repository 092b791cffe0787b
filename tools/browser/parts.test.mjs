// The page's parts that need no browser.

import assert from "node:assert/strict";
import test from "node:test";

import { together } from "./page/alarms.js";
import * as address from "./page/address.js";
import { emptyBoard, take } from "./page/board.js";
import * as capacity from "./page/capacity.js";
import * as format from "./page/format.js";
import { niceAbove } from "./page/list.js";
import { fan, rows } from "./page/outlook.js";
import { parseEvent } from "./page/stream.js";
import { ticks } from "./page/fan.js";
import { along, points, question } from "./page/what_if.js";

const plain = (text) => text.replaceAll("\u202f", " ").replaceAll("\u2212", "-");

test("what is unknown is a dash, whatever its unit", () => {
  const writers = [format.watts, format.wattDifference, format.energy, format.percent, format.duration, format.latency,
    format.age, format.count, format.timeOfDay];
  for (const write of writers) {
    for (const unknown of [null, undefined, NaN, Infinity, "7"]) assert.equal(write(unknown), "–", write.name);
  }
  assert.equal(format.range(null, 3, format.watts), "");
});

test("numbers carry their unit and sensible digits", () => {
  const cases = [
    [format.watts(3.567), "3.57 W"], [format.watts(-0.001), "0.00 W"], [format.watts(312.4), "312 W"],
    [format.watts(31.24), "31.2 W"], [format.watts(38_700), "38.7 kW"], [format.watts(3.5, 300), "4 W"],
    [format.wattDifference(0.0123), "+0.012 W"], [format.wattDifference(-0.5), "-0.500 W"],
    [format.energy(42.87), "42.9 J"], [format.energy(999), "999 J"], [format.energy(7200), "2.00 Wh"],
    [format.percent(0.625, 1), "62.5 %"], [format.duration(59.4), "59 s"], [format.duration(150), "2.5 min"],
    [format.duration(3600), "60 min"], [format.duration(36_001), "10.0 h"], [format.latency(0.00021), "210 µs"],
    [format.latency(0.0334), "33.4 ms"], [format.age(0.0131), "13 ms"], [format.count(1234567), "1 234 567"],
    [format.range(3.46, 3.72, format.watts), "3.46 – 3.72 W"], [format.range(900, 7200, format.energy), "900 J – 2.00 Wh"],
  ];
  for (const [found, expected] of cases) assert.equal(plain(found), expected);
});

test("changes of many robots at once are one line, and few stay apart", () => {
  const change = (robot, ms, alarm = "NoData") => ({ robot, alarm, change: "raised", at_unix_ns: ms * 1e6 });
  const many = [9, 8, 7, 6].map((robot, at) => change(robot, 5000 - at));
  const few = [5, 4, 3].map((robot) => change(robot, 3500));
  const shown = together([change(1, 9000), ...many, ...few, change(2, 3500, "StuckSensor")]);
  assert.deepEqual(shown.map(({ robot, robots }) => [robot, robots]),
    [[1, undefined], [9, 4], [5, undefined], [4, undefined], [3, undefined], [2, undefined]]);
});

test("the fan has a point for each horizon and a band as far as there are bounds", () => {
  const outlook = {
    horizon_s: [1, 10, 60, 300], energy_j: [4, 40, 240, 1200], energy_lo_j: [3, 30, null, null], energy_hi_j: [5, 50, null, null],
  };
  const all = rows(outlook);
  assert.deepEqual(all[1], { horizonS: 10, energy: 40, lo: 30, hi: 50, watts: 4, loW: 3, hiW: 5 });
  const { line, band, x, y } = fan(all);
  assert.deepEqual(line, [[0, 4], [1, 4], [2, 4], [3, 4]]);
  assert.deepEqual(band, [[0, 5], [1, 5], [1, 3], [0, 3]]);
  assert.deepEqual([x.ticks.map(([at]) => at), y.ticks.map(([watts]) => watts), y.range], [[0, 1, 2, 3], [0, 2, 4], [0, 5]]);
  const unknown = { ...outlook, energy_j: [null, null, null, null] };
  assert.deepEqual(fan(rows(unknown)), null);
});

test("capacities are in words from the first month on, and a line from the second", () => {
  const day = (text) => Date.parse(text) / 1000;
  const months = [["2026-08-20", 36_000, 1_800], ["2026-09-21", 32_400, 18_000]].map(([date, joules, sdJ]) => (
    { unix_s: day(date), capacity_j: joules, capacity_sd_j: sdJ }));
  const all = capacity.rows(months);
  assert.deepEqual(all.map((row) => [row.month, row.joules, row.loJ, row.hiJ]),
    [["Aug 2026", 36_000, 32_400, 39_600], ["Sep 2026", 32_400, 0, 68_400]]);
  const { line, band, x, y } = capacity.fan(all);
  assert.deepEqual(line.map(([, joules]) => joules), [36_000, 32_400]);
  assert.deepEqual(band.map(([, joules]) => joules), [39_600, 68_400, 0, 32_400]);
  assert.deepEqual([x.range, y.range], [months.map((month) => month.unix_s), [0, 68_400]]);
  assert.equal(capacity.fan(all.slice(1)), null);
});

test("an unknown charge has a hint, once the robot's energy is counted", () => {
  const cases = [
    [{}, /^$/],
    [{ metered_s: 3, soc: null, soc_measured: null }, /capacity_wh/],
    [{ metered_s: 3, soc: null, soc_measured: false }, /^charge unknown: .*state_of_charge/],
    [{ metered_s: 3, soc: 0.4, soc_measured: false }, /^$/],
  ];
  for (const [robot, hint] of cases) assert.match(format.chargeHint(robot), hint);
});

test("the address holds the whole state and forgives nonsense", () => {
  for (const search of ["?robot=7&sort=soc&descending=1&search=stuck&level=error,stale", "?view=worker", ""]) {
    const state = address.read(search);
    assert.deepEqual(address.read(address.write(state).slice(1)), state);
  }
  const state = address.read("?robot=-1&sort=__proto__&level=bad,warn&view=x&descending=yes&search=" + "x".repeat(500));
  assert.deepEqual({ ...state, search: state.search.length },
    { view: "robots", robot: null, sort: "urgency", descending: false, search: 100, levels: ["warn"] });
});

const view = () => ({
  seq: 1,
  fleet: { tick: 1, worker: { state: "alive" } },
  robots: { total: 3, matched: 3, from: 0, robots: [{ robot: 5, power_w: 1, alarms: [] }, { robot: 2, power_w: 2, alarms: [] }] },
  robot: null,
  alarms: { raised: [], changes: [] },
});

test("deltas change what they name and nothing else", () => {
  const board = emptyBoard();
  assert.ok(take(board, "view", view()));
  assert.ok(take(board, "delta", { seq: 2, fleet: { tick: 2 }, robots: { total: 3, matched: 3, from: 0, rows: { 5: { power_w: null } } } }));
  assert.deepEqual(board.rows.get(5), { robot: 5, power_w: null, alarms: [] });
  assert.deepEqual(board.rows.get(2), { robot: 2, power_w: 2, alarms: [] });
  assert.deepEqual(board.fleet, { tick: 2, worker: { state: "alive" } });
  const raised = [{ robot: 9, alarm: "NoData", since_unix_ns: 1 }];
  const order = { order: [9, 5], rows: { 9: { robot: 9, power_w: 9, alarms: ["NoData"] } } };
  assert.ok(take(board, "delta", { seq: 3, robots: order, alarms: { raised, changes: [{ robot: 9 }] } }));
  assert.deepEqual([...board.rows.keys()].sort(), [5, 9]);
  assert.deepEqual(board.order, [9, 5]);
  assert.deepEqual(board.raised, raised);
  assert.equal(board.matched, 3);
});

test("a delta that does not continue is refused, and a view starts anew", () => {
  const board = emptyBoard();
  assert.ok(!take(board, "delta", { seq: 1 }));
  take(board, "view", view());
  assert.ok(!take(board, "delta", { seq: 3 }));
  assert.ok(take(board, "view", { ...view(), seq: 1 }));
  assert.ok(take(board, "delta", { seq: 2 }));
});

test("history of alarms is bounded", () => {
  const board = emptyBoard();
  take(board, "view", view());
  for (let seq = 2; seq < 400; seq += 1) take(board, "delta", { seq, alarms: { changes: [{ robot: seq }] } });
  assert.equal(board.changes.length, 200);
  assert.equal(board.changes[0].robot, 399);
});

test("events are read as the standard says; comments are none", () => {
  assert.deepEqual(parseEvent('event: delta\ndata: {"seq":\ndata: 1}'), { kind: "delta", data: '{"seq":\n1}' });
  assert.deepEqual(parseEvent("data:x"), { kind: "message", data: "x" });
  assert.equal(parseEvent(": keep-alive"), null);
});

test("a scale of power ends at 1, 2 or 5 times a power of ten", () => {
  for (const [most, end] of [[0.7, 1], [1, 1], [1.1, 2], [4.9, 5], [5.1, 10], [312, 500], [0, 1], [NaN, 1]]) {
    assert.equal(niceAbove(most), end);
  }
});

test("the form asks what it shows", () => {
  assert.deepEqual(question(7, { plan: "idle", idle_s: "60" }), { robot: 7, idle_s: 60 });
  assert.deepEqual(question(7, { plan: "drive", length_m: "2", speed_mps: "0.2", back: "on" }),
    { robot: 7, path: [{ x_m: 0, y_m: 0 }, { x_m: 2, y_m: 0, speed_mps: 0.2 }], return: "dock" });
  assert.deepEqual(question(7, { plan: "path", path: "0 0\n2 1" }), { robot: 7, path: [{ x_m: 0, y_m: 0 }, { x_m: 2, y_m: 1 }] });
});

test("a pasted path has lines of numbers or the columns of a path file", () => {
  const [dock, end] = [{ x_m: 0, y_m: 0 }, { x_m: 2, y_m: -1.5 }];
  for (const pasted of ["0,0\n2,-1.5", "0 0\r\n\r\n2  -1.5\n", "0;0\n2;-1.5", "x_m,y_m\n0,0\n2,-1.5"]) {
    assert.deepEqual(points(pasted), [dock, end], pasted);
  }
  assert.deepEqual(points("y_m,x_m,dwell_s\n0,0,\n-1.5,2,30"), [dock, { ...end, dwell_s: 30 }]);
  for (const [pasted, said] of [
    ["", "two points"], ["0,0", "two points"], ["0,0\n1,one", "y_m of point 2"], ["x_m,z_m\n0,0\n1,1", "“z_m”"],
    ["x_m,y_m\n0,0,0\n1,1", "Point 1 has 3"],
  ]) {
    assert.throws(() => points(pasted), (error) => error.message.includes(said), pasted);
  }
});

test("a trip is drawn as its charge, or as its energy where the charge is unknown", () => {
  const energy = (mean_j) => ({ mean_j, lo_j: 0.9 * mean_j, hi_j: 1.2 * mean_j });
  const moments = [1, 2].map((at) => ({ time_s: 60 * at, energy: energy(100 * at), charge: [1 - 0.1 * at, 1 - 0.2 * at, 1] }));
  assert.deepEqual(along(moments).line.map(([time, percent]) => [time, Math.round(percent)]), [[60, 90], [120, 80]]);
  assert.equal(along(moments).band.length, 4);
  const unknown = moments.map((moment) => ({ ...moment, charge: null }));
  assert.deepEqual(along(unknown).line, [[60, 100], [120, 200]]);
  assert.deepEqual(along(unknown).y.range, [0, 240]);
  for (const none of [undefined, [], [{ time_s: 1, energy: null, charge: null }]]) assert.equal(along(none), null);
  assert.deepEqual([ticks(0, 100, 2), ticks(-3, 7), ticks(0, 0), ticks(0, NaN)], [[0, 50, 100], [0, 5], [], []]);
});
