// Reports from a file: tables that can be read without scrolling sideways, and figures that are drawn at
// every width.

import assert from "node:assert/strict";
import { execFileSync } from "node:child_process";
import { mkdtempSync, rmSync } from "node:fs";
import { tmpdir } from "node:os";
import { join } from "node:path";
import { after, before, test } from "node:test";

import { axeFindings, launch, openPage } from "./browser.mjs";

const LAPTOP = { width: 1280, height: 800 };
const WIDTHS = [390, 900, 1400];
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

/** Panels without a canvas that shows several colours, and what is wider than its window. */
const undrawn = (page) => page.evaluate(() => {
  const found = [...document.querySelectorAll("html, figure, .panels > div")]
    .filter((box) => box.scrollWidth > box.clientWidth + 1)
    .map((box) => `${box.tagName} ${box.id} is ${box.scrollWidth} of ${box.clientWidth} px`);
  for (const figure of document.querySelectorAll("figure")) {
    const panels = [...figure.querySelectorAll(".panels > div")];
    if (!panels.length) found.push(`${figure.id} has no panel`);
    panels.forEach((panel, at) => {
      const canvas = panel.querySelector("canvas");
      const seen = new Set();
      if (canvas?.width) {
        const { data } = canvas.getContext("2d").getImageData(0, 0, canvas.width, canvas.height);
        for (let byte = 0; byte < data.length; byte += 4) {
          if (data[byte + 3] > 100) seen.add(data.slice(byte, byte + 3).join());
        }
      }
      if (seen.size < 3) found.push(`${figure.id}, panel ${at + 1}: ${seen.size} colours`);
    });
  }
  return found;
});

const reports = [
  ["of recordings with three models", () => {
    run(join(process.env.JOULEBUS_ROOT, "tools/walks/logs.sh"), "logs");
    const reading = ["--map", "time=stamp,voltage_V=battery_u,current_A=battery_i", "--current", "discharge-negative"];
    return ["logs", "--battery-wh", "20", ...reading, ...MODELS.flatMap((model) => ["--model", `builtin:${model}`])];
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

  test(`the figures of a report ${name} are drawn at ${WIDTHS.join(", ")} px, in light and dark, without a network`, async () => {
    for (const width of WIDTHS) {
      for (const colorScheme of ["light", "dark"]) {
        const page = await openPage(browser, "about:blank", { viewport: { width, height: 900 }, colorScheme });
        const asked = [];
        page.on("request", (request) => asked.push(request.url()));
        const url = `file://${join(folder, name, "report.html")}`;
        await page.goto(url);
        assert.deepEqual(await undrawn(page), []);
        assert.deepEqual(asked.map(decodeURI), [url]);
        assert.deepEqual(page.complaints, []);
        await page.context().close();
      }
    }
  });

  test(`a window that changes draws the figures of a report ${name} again`, async () => {
    const page = await openPage(browser, `file://${join(folder, name, "report.html")}`, { viewport: { width: 1400, height: 900 } });
    await page.setViewportSize({ width: 390, height: 844 });
    await page.waitForFunction(() => document.documentElement.scrollWidth <= innerWidth + 1);
    await page.emulateMedia({ colorScheme: "dark" });
    await page.mouse.move(200, 400);
    assert.deepEqual(await undrawn(page), []);
    assert.deepEqual(page.complaints, []);
    await page.context().close();
  });
}
