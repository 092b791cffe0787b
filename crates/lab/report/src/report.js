// Draws the figures of a report by uPlot, from the report's data in the page.

"use strict";

/* global uPlot */

(() => {
  const report = JSON.parse(document.getElementById("data").textContent);
  const isDark = matchMedia("(prefers-color-scheme: dark)");
  // The same hues on a dark ground.
  const DARK = {
    "#1B1F24": "#E6E9ED", "#6E7781": "#9AA4AF", "#0072B2": "#4FA8E0", "#E69F00": "#F0B429",
    "#009E73": "#2CC397", "#D55E00": "#F08030", "#AA4499": "#D07BC2", "#56B4E9": "#8CCFF5",
  };
  const tone = (hex, alpha = "") => ((isDark.matches && DARK[hex]) || hex) + alpha;
  const style = (name) => getComputedStyle(document.documentElement).getPropertyValue(name).trim();
  const isKnown = (value) => Number.isFinite(value);
  const kindOf = (mark) => (typeof mark === "string" ? [mark] : Object.entries(mark)[0]);
  /** Share of a category that its marks take. */
  const TAKEN = 0.78;

  const shown = (value) => {
    const size = Math.abs(value);
    if (size !== 0 && (size < 1e-4 || size >= 1e7)) return value.toExponential(2).replace("-", "−");
    return value.toLocaleString("en", { maximumSignificantDigits: 5 }).replace("-", "−");
  };

  /** The numbers that a mark needs room for, on x and on y. */
  function extent([kind, data]) {
    switch (kind) {
      case "line": return [data.points.map((p) => p[0]), data.points.map((p) => p[1])];
      case "points": return [data.map((p) => p[0]), data.map((p) => p[1])];
      case "band": return [data.map((p) => p[0]), data.flatMap((p) => [p[1], p[2]])];
      case "columns": return [data.edges, [0, ...data.heights]];
      case "tiles": return [data.x_edges, data.y_edges];
      case "stripe": return [data, []];
      case "rule": return data.direction === "up" ? [[data.at], []] : [[], [data.at]];
      case "bars": return [[0, ...data.values.flatMap((v) => [v.value, v.low, v.high])], []];
      case "dots": return [data.values.flatMap((v) => [v.value, v.low, v.high]), []];
      default: return [[], []];
    }
  }

  /** Ends of an axis, or null without a number. */
  function ends(axis, values) {
    if (axis.scale.names) return axis.scale.names.length ? [-0.6, axis.scale.names.length - 0.4] : null;
    if (axis.limits) return axis.limits;
    let [low, high] = [Infinity, -Infinity];
    for (const value of [...values, axis.includes]) {
      if (!isKnown(value)) continue;
      low = Math.min(low, value);
      high = Math.max(high, value);
    }
    if (low > high) return null;
    if (low === high) return [low - (Math.abs(low) / 10 || 1), high + (Math.abs(high) / 10 || 1)];
    const room = (high - low) * 0.04;
    // Bars start at zero, and so does time.
    return [low === 0 ? 0 : low - room, high === 0 ? 0 : high + room];
  }

  /** Lines, dots and bands as series of uPlot, over all their x. */
  function seriesOf(layers) {
    const [tables, series, bands] = [[], [{}], []];
    const add = (x, columns, options) => {
      const order = x.map((_, at) => at).filter((at) => isKnown(x[at])).sort((a, b) => x[a] - x[b]);
      tables.push([x, ...columns].map((values) => order.map((at) => values[at])));
      options.forEach((one) => series.push(one));
    };
    for (const { label, colour, mark } of layers) {
      const [kind, data] = kindOf(mark);
      const stroke = () => tone(colour);
      const none = { show: false };
      if (kind === "line") {
        // A gap has no x: it takes that of the point before it.
        let before = null;
        const x = data.points.map((p) => (before = p[0] ?? before));
        add(x, [data.points.map((p) => p[1])],
          [{ label, stroke, width: 1.4, dash: data.dashed ? [5, 4] : undefined, points: none }]);
      } else if (kind === "points") {
        add(data.map((p) => p[0]), [data.map((p) => p[1])],
          [{ label, stroke, paths: () => null, points: { show: true, size: 6, width: 0, fill: stroke } }]);
      } else if (kind === "band") {
        const side = { stroke, width: 0, points: none };
        add(data.map((p) => p[0]), [data.map((p) => p[1]), data.map((p) => p[2])], [side, side]);
        bands.push({ series: [series.length - 1, series.length - 2], fill: () => tone(colour, "38") });
      }
    }
    if (!tables.length) return { data: [[0], [null]], series: [{}, { show: false }], bands };
    return { data: uPlot.join(tables, tables.map((table) => table.map(() => 1))), series, bands };
  }

  /** What uPlot has no series for, in device pixels. */
  function draw(plot, { mark, colour }) {
    const [kind, data] = kindOf(mark);
    const { ctx, bbox: { left, top, width, height } } = plot;
    const x = (value) => plot.valToPos(value, "x", true);
    const y = (value) => plot.valToPos(value, "y", true);
    const pixel = devicePixelRatio;
    const stroke = (points, dash = []) => {
      ctx.strokeStyle = tone(colour);
      ctx.lineWidth = 1.2 * pixel;
      ctx.setLineDash(dash.map((length) => length * pixel));
      ctx.beginPath();
      points.forEach(([px, py], at) => (at ? ctx.lineTo(px, py) : ctx.moveTo(px, py)));
      ctx.stroke();
    };
    ctx.save();
    ctx.beginPath();
    ctx.rect(left, top, width, height);
    ctx.clip();
    if (kind === "stripe") {
      ctx.fillStyle = tone(colour, "38");
      ctx.fillRect(x(data[0]), top, x(data[1]) - x(data[0]), height);
    } else if (kind === "rule") {
      if (data.direction === "up") stroke([[x(data.at), top], [x(data.at), top + height]], [5, 4]);
      else stroke([[left, y(data.at)], [left + width, y(data.at)]], [5, 4]);
    } else if (kind === "diagonal") {
      const at = [Math.min(plot.scales.x.min, plot.scales.y.min), Math.max(plot.scales.x.max, plot.scales.y.max)];
      stroke(at.map((value) => [x(value), y(value)]), [5, 4]);
    } else if (kind === "columns") {
      ctx.fillStyle = tone(colour, "99");
      data.heights.forEach((value, at) => {
        const from = x(data.edges[at]);
        ctx.fillRect(from, y(value), x(data.edges[at + 1]) - from, y(0) - y(value));
      });
    } else if (kind === "tiles") {
      const columns = data.x_edges.length - 1;
      const most = Math.log1p(Math.max(...data.counts));
      data.counts.forEach((count, at) => {
        if (!count) return;
        const [column, row] = [at % columns, Math.floor(at / columns)];
        const share = Math.round(40 + 215 * (Math.log1p(count) / most));
        ctx.fillStyle = tone(colour, share.toString(16).padStart(2, "0"));
        const [from, below] = [x(data.x_edges[column]), y(data.y_edges[row])];
        ctx.fillRect(from, below, x(data.x_edges[column + 1]) - from, y(data.y_edges[row + 1]) - below);
      });
    } else if (kind === "bars" || kind === "dots") {
      const [slot, slots] = data.slot;
      const thick = (TAKEN / Math.max(1, slots)) * Math.abs(y(1) - y(0));
      data.values.forEach(({ value, low, high }, category) => {
        if (!isKnown(value)) return;
        const middle = y(category) + (slot - (slots - 1) / 2) * thick;
        ctx.fillStyle = tone(colour);
        if (kind === "bars") ctx.fillRect(x(0), middle - 0.4 * thick, x(value) - x(0), 0.8 * thick);
        else {
          ctx.beginPath();
          ctx.arc(x(value), middle, 4 * pixel, 0, 2 * Math.PI);
          ctx.fill();
        }
        if (!isKnown(low) || !isKnown(high)) return;
        ctx.strokeStyle = kind === "bars" ? style("--ink") : tone(colour);
        ctx.lineWidth = 1.5 * pixel;
        ctx.setLineDash([]);
        ctx.beginPath();
        ctx.moveTo(x(low), middle);
        ctx.lineTo(x(high), middle);
        ctx.stroke();
      });
    }
    ctx.restore();
  }

  const FONT = "11px system-ui, sans-serif";

  function axisOf({ label, scale }, isUp, width) {
    const common = {
      label: label || undefined, labelSize: 18, labelFont: FONT, font: FONT,
      stroke: () => style("--soft"), grid: { stroke: () => style("--line"), width: 1 }, ticks: { show: false },
    };
    if (!scale.names) {
      const values = (_, splits) => splits.map((value) => (value === null ? null : shown(value)));
      return { ...common, values, size: isUp ? 52 : 24, space: isUp ? 28 : 60 };
    }
    // A name takes at most a third of the panel.
    const longest = Math.max(...scale.names.map((name) => name.length));
    const size = Math.min(12 + 6 * longest, width / 3);
    const letters = Math.max(3, Math.floor((size - 12) / 6));
    const [begin, end] = [Math.ceil((letters - 1) / 2), Math.floor((letters - 1) / 2)];
    const short = (name) => (name.length > letters ? `${name.slice(0, begin)}…${name.slice(-end)}` : name);
    return { ...common, size, splits: () => scale.names.map((_, at) => at), values: () => scale.names.map(short) };
  }

  function show(box, panel, height) {
    if (panel.title) box.append(Object.assign(document.createElement("h3"), { textContent: panel.title }));
    const named = panel.layers.filter((layer) => layer.label);
    const legend = box.appendChild(Object.assign(document.createElement("p"), { className: "legend" }));
    for (const layer of named) {
      const entry = legend.appendChild(document.createElement("span"));
      const swatch = entry.appendChild(document.createElement("i"));
      const isPale = ["band", "stripe", "columns"].includes(kindOf(layer.mark)[0]);
      const paint = () => (swatch.style.background = tone(layer.colour, isPale ? "66" : ""));
      paint();
      isDark.addEventListener("change", paint);
      entry.append(layer.label);
    }
    const found = panel.layers.map((layer) => extent(kindOf(layer.mark)));
    const [x, y] = [0, 1].map((way) => ends(way ? panel.y : panel.x, found.flatMap((one) => one[way])));
    if (!x || !y) {
      box.append(Object.assign(document.createElement("p"), { textContent: "no data" }));
      return;
    }
    const stage = box.appendChild(document.createElement("div"));
    const readout = Object.assign(document.createElement("p"), { className: "readout", textContent: "\u00a0" });
    box.append(readout);
    const { data, series, bands } = seriesOf(panel.layers);
    const told = (plot) => {
      const at = plot.cursor.idx;
      const values = series.flatMap(({ label }, one) =>
        label && isKnown(plot.data[one][at]) ? [`${label} ${shown(plot.data[one][at])}`] : []);
      const where = at == null ? "" : `${panel.x.label} ${shown(plot.data[0][at])}: `;
      readout.textContent = values.length ? where + values.join(", ") : "\u00a0";
    };
    const scale = (range, dir = 1) => ({ time: false, auto: false, range, dir });
    const below = panel.layers.filter(({ mark }) => ["stripe", "columns", "tiles", "bars"].includes(kindOf(mark)[0]));
    const above = panel.layers.filter(({ mark }) => ["rule", "diagonal", "dots"].includes(kindOf(mark)[0]));
    let plot;
    const make = () => {
      plot?.destroy();
      const width = box.clientWidth;
      plot = new uPlot({
        width, height,
        padding: [8, 12, 0, 0],
        legend: { show: false },
        cursor: { y: false, drag: { x: false, y: false } },
        scales: { x: scale(x), y: scale(y, panel.y.scale.names ? -1 : 1) },
        axes: [axisOf(panel.x, false, width), axisOf(panel.y, true, width)],
        series, bands,
        hooks: {
          drawAxes: [(one) => below.forEach((layer) => draw(one, layer))],
          draw: [(one) => above.forEach((layer) => draw(one, layer))],
          setCursor: [told],
        },
      }, data, stage);
    };
    make();
    let wide = box.clientWidth;
    new ResizeObserver(() => {
      if (box.clientWidth === wide || !box.clientWidth) return;
      wide = box.clientWidth;
      make();
    }).observe(box);
    isDark.addEventListener("change", make);
  }

  const parts = report.sections.flatMap((section) => section.parts);
  for (const { figure } of parts) {
    if (!figure) continue;
    const panels = document.getElementById(figure.name).querySelector(".panels");
    for (const panel of figure.panels) {
      const box = panels.appendChild(document.createElement("div"));
      box.role = "img";
      box.ariaLabel = [panel.title || figure.title, `${panel.y.label} by ${panel.x.label}`].join(": ");
      show(box, panel, figure.panel_height_px);
    }
  }
})();
