// The energy that a robot will draw if it goes on as it does: a fan of the mean power over each
// horizon, and its energy.

import { Fan, ticks } from "./fan.js";
import * as format from "./format.js";

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
 * The fan's line, the outline of its band, and its axes. The horizons have equal distances. `null` if
 * no power is known.
 */
export function fan(all) {
  const values = all.flatMap((row) => [row.watts, row.loW, row.hiW]).filter(format.isKnown);
  if (!all.some((row) => format.isKnown(row.watts))) return null;
  const range = [Math.min(0, ...values), Math.max(...values, 1e-9)];
  const points = (value) => all.flatMap((row, at) => (format.isKnown(row[value]) ? [[at, row[value]]] : []));
  return {
    line: points("watts"),
    band: [...points("hiW"), ...points("loW").reverse()],
    x: { range: [-0.5, all.length - 0.5], ticks: all.map((row, at) => [at, format.duration(row.horizonS)]) },
    y: { range, ticks: ticks(...range).map((watts) => [watts, format.watts(watts)]) },
    label: all.map((row) => `${format.duration(row.horizonS)}: ${format.energy(row.energy)}`).join(", "),
  };
}

export class OutlookView {
  constructor(root) {
    this.fan = new Fan(root.querySelector('[data-outlook="fan"]'));
    this.table = root.querySelector('[data-outlook="rows"]');
  }

  show(outlook) {
    const all = rows(outlook);
    const drawn = fan(all);
    if (drawn) this.fan.show(drawn);
    else this.fan.clear("no values yet");
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
  }

  clear() {
    this.fan.clear("no values yet");
    this.table.replaceChildren();
  }
}
