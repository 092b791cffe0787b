// Reports in a window of a laptop: tables that can be read without scrolling sideways.

import assert from "node:assert/strict";
import { execFileSync } from "node:child_process";
import { mkdtempSync, rmSync } from "node:fs";
import { tmpdir } from "node:os";
import { join } from "node:path";
import { after, before, test } from "node:test";

import { axeFindings, launch, openPage } from "./browser.mjs";

const LAPTOP = { width: 1280, height: 800 };
const MODELS = ["gternal-sim", "gternal-sim-power", "gternal-sim-freshness"];

let browser, folder;
before(async () => {
  browser = await launch();
  folder = mkdtempSync(join(tmpdir(), "joulebus-report-"));
});
after(async () => {
  await browser?.close();
  rmSync(folder, { recursive: true, force: true });
});

const run = (program, ...args) => execFileSync(program, args, { cwd: folder, stdio: ["ignore", "ignore", "inherit"] });

/** Figures and tables that are wider than what shows them, and the page if it scrolls sideways. */
const overflowing = (page) => page.evaluate(() => {
  const wider = [...document.querySelectorAll("html, .scroll, figure, td, th")].filter((box) => box.scrollWidth > box.clientWidth + 1);
  const beyond = [...document.querySelectorAll("table")].filter((table) => {
    const { left, right } = table.getBoundingClientRect();
    return left < 0 || right > document.documentElement.clientWidth;
  });
  const named = (box) => `${box.tagName} ${box.scrollWidth} of ${box.clientWidth} px: ${box.textContent.trim().slice(0, 80)}`;
  return [...wider, ...beyond].map(named);
});

/** Texts of a table that cover each other. */
const overlapping = (page) => page.evaluate(() => {
  const found = [];
  for (const row of document.querySelectorAll("tr")) {
    const cells = [...row.cells].filter((cell) => cell.textContent.trim()).map((cell) => {
      const range = document.createRange();
      range.selectNodeContents(cell);
      return [range.getBoundingClientRect(), cell.textContent];
    });
    for (let at = 1; at < cells.length; at += 1) {
      if (cells[at - 1][0].right > cells[at][0].left + 1) found.push(`${cells[at - 1][1]} | ${cells[at][1]}`);
    }
  }
  return found;
});

const reports = [
  ["of recordings with three models", () => {
    run(join(process.env.JOULEBUS_ROOT, "tools/walks/logs.sh"), "logs");
    const reading = ["--map", "time=stamp,voltage_V=battery_u,current_A=battery_i", "--current", "discharge-negative"];
    return ["logs", ...reading, ...MODELS.flatMap((model) => ["--model", `builtin:${model}`])];
  }],
  ["of simulated robots beside the paper", () => ["--simulated", "--draws", "2", "--samples", "300", "--max-epochs", "1"]],
];

for (const [name, prepare] of reports) {
  test(`no table of a report ${name} is wider than a window of ${LAPTOP.width} px`, async () => {
    run(join(process.env.JOULEBUS_BIN, "joulebus-lab"), "report", ...prepare(), "--out", name);
    for (const colorScheme of ["light", "dark"]) {
      const page = await openPage(browser, `file://${join(folder, name, "report.html")}`, { viewport: LAPTOP, colorScheme });
      assert.ok((await page.locator("table").count()) >= 3, "a report has tables");
      assert.deepEqual(await overflowing(page), []);
      assert.deepEqual(await overlapping(page), []);
      assert.deepEqual(await axeFindings(page), []);
      assert.deepEqual(page.complaints, []);
      await page.context().close();
    }
  });
}
