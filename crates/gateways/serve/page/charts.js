// The three charts of a robot, drawn by uPlot. Times are seconds before now.

import * as format from "./format.js";

/* global uPlot */

const color = (name) => getComputedStyle(document.documentElement).getPropertyValue(name).trim();

const axis = (name) => ({
  stroke: () => color("--soft"),
  font: "11px system-ui, sans-serif",
  grid: { stroke: () => color("--line"), width: 1 },
  ticks: { show: false },
  ...name,
});

function options(width, height, series, extra) {
  return {
    width, height,
    padding: [8, 16, 0, 0],
    legend: { show: false },
    cursor: { y: false, drag: { x: false, y: false }, points: { size: 6 } },
    scales: { x: { time: false }, y: extra.scale ?? {} },
    axes: [
      axis({ size: 22, space: 60, values: (_, splits) => splits.map((s) => (s === 0 ? "now" : `${format.fixed(s, 0)}\u202fs`)) }),
      axis({ size: 46, space: extra.space ?? 22, values: (_, splits) => splits.map((v) => format.fixed(v, extra.decimals(splits))) }),
    ],
    series: [{}, ...series],
    bands: extra.bands ?? [],
    hooks: { setCursor: [(plot) => extra.readout(plot.data, plot.cursor.idx)] },
  };
}

/** Decimals that tell neighbouring ticks apart. */
function tickDecimals(splits) {
  const step = splits.length > 1 ? Math.abs(splits[1] - splits[0]) : 1;
  const whole = (decimals) => Math.abs(step * 10 ** decimals - Math.round(step * 10 ** decimals)) < 1e-6;
  return [0, 1, 2, 3].find(whole) ?? 4;
}

/** At least `least` of range, so that noise of a resting robot does not fill the chart. */
function padded(least) {
  return {
    range: (_, lo, hi) => {
      if (!format.isKnown(lo) || !format.isKnown(hi)) return [0, 1];
      const spare = Math.max(0.06 * (hi - lo), (least - (hi - lo)) / 2);
      return [lo - spare, hi + spare];
    },
  };
}

function symmetric(least) {
  return {
    range: (_, lo, hi) => {
      const most = Math.max(least, Math.abs(lo ?? 0), Math.abs(hi ?? 0)) * 1.08;
      return [-most, most];
    },
  };
}

const line = (name, width = 1.5) => ({ stroke: () => color(name), width, points: { show: false }, spanGaps: false });

const dots = (name) => ({
  stroke: () => color(name), paths: () => null, points: { show: true, size: 3.5, width: 0, fill: () => color(name) },
});

const KINDS = {
  power: {
    keys: ["lo_w", "hi_w", "power_w", "reading_w"],
    series: () => [line("--band-line", 0), line("--band-line", 0), line("--forecast"), dots("--reading")],
    extra: { scale: padded(0.2), decimals: tickDecimals, bands: [{ series: [2, 1], fill: () => color("--band") }] },
    text: ([, lo, hi, power, reading], at) =>
      `read ${format.watts(reading[at])}, forecast ${format.watts(power[at])}` +
      (format.isKnown(lo[at]) ? ` (${format.wattNumber(lo[at])} – ${format.wattNumber(hi[at])})` : ""),
  },
  residual: {
    keys: ["residual_w"],
    series: () => [{ ...line("--reading", 1.2) }],
    extra: { space: 15, scale: symmetric(0.05), decimals: tickDecimals },
    text: ([, residual], at) => format.wattDifference(residual[at]),
  },
  soc: {
    keys: ["soc"],
    series: () => [line("--forecast", 2)],
    extra: { space: 15, scale: { range: (_, lo, hi) => [Math.max(0, Math.floor((lo ?? 0) - 1)), Math.min(100, Math.ceil((hi ?? 100) + 1))] }, decimals: tickDecimals },
    text: ([, soc], at) => format.percent(format.isKnown(soc[at]) ? soc[at] / 100 : null, 1),
  },
};

/** Index of the newest point that has a value in any series, or null. */
function newest(data) {
  for (let at = data[0].length - 1; at >= 0; at -= 1) {
    if (data.slice(1).some((values) => format.isKnown(values[at]))) return at;
  }
  return null;
}

class Chart {
  constructor(name, root) {
    this.name = name;
    this.kind = KINDS[name];
    this.box = root.querySelector(`[data-chart="${name}"]`);
    this.output = root.querySelector(`[data-chart="${name}-readout"]`);
    new ResizeObserver(() => this.#fit()).observe(this.box);
  }

  #size() {
    return [Math.max(120, this.box.clientWidth), Math.max(60, this.box.clientHeight)];
  }

  #fit() {
    if (!this.plot || this.box.clientWidth === 0) return;
    const [width, height] = this.#size();
    if (width !== this.plot.width || height !== this.plot.height) this.plot.setSize({ width, height });
  }

  show(history) {
    const times = history[this.kind.keys[0]].map((_, at, all) => (at - all.length + 1) * history.step_s);
    const factor = this.name === "soc" ? 100 : 1;
    const data = [times, ...this.kind.keys.map((key) =>
      history[key].map((value) => (format.isKnown(value) ? value * factor : null)))];
    if (this.plot) this.plot.setData(data);
    else if (this.box.clientWidth > 0) this.#make(data);
    if (this.plot?.cursor.idx == null) this.#readout(data, null);
    const at = newest(data);
    this.box.ariaLabel = at === null ? "no values yet" : `last two minutes; newest: ${this.kind.text(data, at)}`;
  }

  #make(data) {
    const extra = { ...this.kind.extra, readout: (shown, at) => this.#readout(shown, at) };
    this.plot = new uPlot(options(...this.#size(), this.kind.series(), extra), data, this.box);
  }

  /** Values under the pointer, or the newest. */
  #readout(data, at) {
    const place = at ?? newest(data);
    if (place === null) this.output.textContent = "";
    else this.output.textContent = (at ?? null) === null ? this.kind.text(data, place)
      : `${format.fixed(data[0][place], 1)}\u202fs: ${this.kind.text(data, place)}`;
  }

  clear() {
    this.plot?.setData([[], ...this.kind.keys.map(() => [])]);
    this.output.textContent = "";
    this.box.ariaLabel = "no values yet";
  }

  redraw() {
    this.plot?.redraw(false, true);
  }
}

export class Charts {
  constructor(root) {
    this.charts = Object.keys(KINDS).map((name) => new Chart(name, root));
    matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => {
      for (const chart of this.charts) chart.redraw();
    });
  }

  show(history) {
    for (const chart of this.charts) chart.show(history);
  }

  /** Of another robot: nothing until its history is here. */
  clear() {
    for (const chart of this.charts) chart.clear();
  }
}
