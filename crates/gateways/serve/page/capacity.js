// The capacities learned of a robot's batteries, month by month: a line with its band, and words.

import { Fan, ticks } from "./fan.js";
import * as format from "./format.js";

const month = new Intl.DateTimeFormat("en", { month: "short", year: "numeric", timeZone: "UTC" });

/** Rows of what is saved: the month as text, Unix s, capacity, and its 95 % interval, J. */
export function rows(months) {
  return months.map(({ unix_s: unixS, capacity_j: joules, capacity_sd_j: sdJ }) => ({
    month: month.format(1000 * unixS), unixS, joules, loJ: Math.max(0, joules - 2 * sdJ), hiJ: joules + 2 * sdJ,
  }));
}

/** The line through the months and the outline of its band, from zero on. `null` for one month. */
export function fan(all) {
  if (all.length < 2) return null;
  const range = [0, Math.max(...all.map((row) => row.hiJ))];
  const points = (value) => all.map((row) => [row.unixS, row[value]]);
  const ends = [all[0], all.at(-1)];
  const wattHours = ticks(...range.map((joules) => joules / 3600));
  return {
    line: points("joules"),
    band: [...points("hiJ"), ...points("loJ").reverse()],
    x: { range: ends.map((row) => row.unixS), ticks: ends.map((row) => [row.unixS, row.month]) },
    y: { range, ticks: wattHours.map((wh) => [3600 * wh, format.energy(3600 * wh)]) },
    label: all.map((row) => `${row.month}: ${format.energy(row.joules)}`).join(", "),
  };
}

export class CapacityView {
  constructor(root) {
    this.figure = root.querySelector('[data-capacity="figure"]');
    this.fan = new Fan(root.querySelector('[data-capacity="fan"]'));
    this.table = root.querySelector('[data-capacity="rows"]');
  }

  show(months) {
    const all = rows(months);
    const drawn = fan(all);
    this.figure.hidden = all.length === 0;
    this.fan.box.hidden = drawn === null;
    if (drawn) this.fan.show(drawn);
    this.table.replaceChildren(...all.toReversed().map((row) => {
      const item = document.createElement("div");
      const text = `${format.energy(row.joules)} (${format.range(row.loJ, row.hiJ, format.energy)})`;
      for (const [kind, value] of [["dt", row.month], ["dd", text]]) {
        item.append(Object.assign(document.createElement(kind), { textContent: value }));
      }
      return item;
    }));
  }
}
