// Writes what tools/grafana.sh checks: `node write.mjs DASHBOARD.json FOLDER`.
//   FOLDER/dashboard.ts  the dashboard as a literal, with the type that each panel must have
//   FOLDER/rules.yml     its queries as rules of Prometheus, with values in place of Grafana's variables
import { readFileSync, writeFileSync } from "node:fs";
import { join } from "node:path";

const TYPES = { row: "Row", bargauge: "BarGauge", stat: "Stat", "state-timeline": "StateTimeline", timeseries: "TimeSeries" };
const VALUES = { $__range: "1h", $__rate_interval: "1m", $fleet: "lab|hall", $robot: "1|2" };

const [, , file, folder] = process.argv;
const { panels, ...rest } = JSON.parse(readFileSync(file, "utf8"));
const fail = (why) => {
  console.error(`${file}: ${why}`);
  process.exit(1);
};

const literals = panels.map((panel, at) => {
  const type = TYPES[panel.type] ?? fail(`tools/grafana/types.ts has no type for a panel of kind ${panel.type}`);
  return `const p${at} = ${JSON.stringify(panel)} satisfies ${type}; // ${panel.title}`;
});
const whole = `{ ...${JSON.stringify(rest)}, panels: [${panels.map((_, at) => `p${at}`)}] } satisfies Whole`;
const imported = `import type { ${[...Object.values(TYPES), "Whole"].join(", ")} } from "./types.js";`;
writeFileSync(join(folder, "dashboard.ts"), [imported, ...literals, `export const dashboard = ${whole};`, ""].join("\n"));

// What no type says: ids differ, panels do not overlap and stay within 24 columns, every query is of the data source that is chosen.
const ids = panels.map(({ id }) => id);
if (new Set(ids).size !== ids.length) fail("two panels have one id");
const taken = new Map();
for (const { title, gridPos: { x, y, w, h } } of panels) {
  if (x + w > 24) fail(`${title} is wider than the page`);
  for (let column = x; column < x + w; column += 1) {
    for (let row = y; row < y + h; row += 1) {
      const place = `${column},${row}`;
      if (taken.has(place)) fail(`${title} lies over ${taken.get(place)}`);
      taken.set(place, title);
    }
  }
}
const names = rest.templating.list.map(({ name }) => name);
const queries = panels.flatMap(({ title, datasource, targets = [] }) => targets.map((target) => ({ title, datasource, ...target })));
const rules = queries.map(({ title, expr, refId, datasource }, at) => {
  if (datasource.uid !== "${datasource}") fail(`${title} ${refId} names the data source ${datasource.uid}`);
  for (const [variable] of expr.matchAll(/\$\w+/g)) {
    if (!(variable in VALUES)) fail(`${title} ${refId} has an unknown variable ${variable}`);
    if (!variable.startsWith("$__") && !names.includes(variable.slice(1))) fail(`no variable ${variable} is declared`);
  }
  const replaced = expr.replace(/\$\w+/g, (variable) => VALUES[variable]);
  return `  - record: query:${at}\n    expr: ${JSON.stringify(replaced)}\n`;
});
writeFileSync(join(folder, "rules.yml"), `groups:\n- name: dashboard\n  rules:\n${rules.join("")}`);
console.log(`${file}: ${panels.length} panels, ${queries.length} queries`);
