// The energy that a robot will draw if it goes on as it does: a fan of the mean power over each
// horizon, and its energy.

import * as format from "./format.js";

const SVG = "http://www.w3.org/2000/svg";
const WIDTH = 400;
const HEIGHT = 90;

/**
 * Rows of an outlook: horizon, energy and bounds in J, and their mean powers in W. What is unknown
 * is null.
 */
export function rows(outlook) {
  return outlook.horizon_s.map((horizonS, at) => {
    const [energy, lo, hi] = [outlook.energy_j[at], outlook.energy_lo_j[at], outlook.energy_hi_j[at]];
    const watts = (joules) => (format.isKnown(joules) ? joules / horizonS : null);
    return { horizonS, energy, lo, hi, watts: watts(energy), loW: watts(lo), hiW: watts(hi) };
  });
}

/**
 * Points of the fan in a box: those of the line, and the outline of the band. The horizons have
 * equal distances.
 */
export function fan(all, width, height) {
  const known = all.filter((row) => format.isKnown(row.watts));
  if (known.length === 0) return { line: [], band: [] };
  const values = known.flatMap((row) => [row.watts, row.loW, row.hiW]).filter(format.isKnown);
  const [least, most] = [Math.min(0, ...values), Math.max(...values, 1e-9)];
  const x = (at) => (width * (at + 0.5)) / all.length;
  const y = (watts) => height * (1 - (watts - least) / (most - least));
  const points = (value) => all.flatMap((row, at) => (format.isKnown(row[value]) ? [[x(at), y(row[value])]] : []));
  return { line: points("watts"), band: [...points("hiW"), ...points("loW").reverse()] };
}

const text = (points) => points.map((point) => point.map((value) => value.toFixed(1)).join(",")).join(" ");

export class OutlookView {
  constructor(root) {
    this.box = root.querySelector('[data-outlook="fan"]');
    this.table = root.querySelector('[data-outlook="rows"]');
    const shape = (kind) => document.createElementNS(SVG, kind);
    this.svg = shape("svg");
    this.svg.setAttribute("viewBox", `0 0 ${WIDTH} ${HEIGHT}`);
    this.svg.setAttribute("preserveAspectRatio", "none");
    this.svg.setAttribute("aria-hidden", "true");
    [this.band, this.line] = [shape("polygon"), shape("polyline")];
    this.svg.append(this.band, this.line);
    this.box.append(this.svg);
    this.clear();
  }

  show(outlook) {
    const all = rows(outlook);
    const { line, band } = fan(all, WIDTH, HEIGHT);
    this.line.setAttribute("points", text(line));
    this.band.setAttribute("points", text(band));
    this.table.replaceChildren(...all.map((row) => {
      const item = document.createElement("div");
      for (const [kind, value] of [
        ["dt", format.duration(row.horizonS)], ["dd", format.energy(row.energy)],
        ["dd", format.range(row.lo, row.hi, format.energy)],
      ]) {
        item.append(Object.assign(document.createElement(kind), { textContent: value }));
      }
      item.lastChild.className = "bound";
      return item;
    }));
    this.box.ariaLabel = all.map((row) => `${format.duration(row.horizonS)}: ${format.energy(row.energy)}`).join(", ");
  }

  clear() {
    this.line.removeAttribute("points");
    this.band.removeAttribute("points");
    this.table.replaceChildren();
    this.box.ariaLabel = "no values yet";
  }
}
