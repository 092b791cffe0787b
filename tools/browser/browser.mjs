// Headless Chromium, and what the tests read from the page.

import { readFileSync } from "node:fs";
import { fileURLToPath } from "node:url";

import { chromium } from "playwright-core";

import { PATIENCE_MS } from "./programs.mjs";

export const WIDE = { width: 1440, height: 900 };
export const PHONE = { width: 390, height: 844 };

const AXE = readFileSync(fileURLToPath(import.meta.resolve("axe-core/axe.min.js")), "utf8");

export async function launch() {
  const root = process.getuid?.() === 0;
  return chromium.launch({ executablePath: process.env.CHROMIUM, args: root ? ["--no-sandbox"] : [] });
}

/** A page of its own whose complaints are collected: console errors, CSP violations, exceptions. */
export async function openPage(browser, url, { viewport = WIDE, colorScheme = "light", expected = [], hasTouch = false } = {}) {
  const context = await browser.newContext({ viewport, colorScheme, hasTouch, isMobile: hasTouch });
  const page = await context.newPage();
  page.setDefaultTimeout(PATIENCE_MS);
  page.complaints = [];
  page.on("pageerror", (error) => page.complaints.push(error.stack ?? String(error)));
  page.on("console", (message) => {
    const text = message.text();
    if (message.type() === "error" && !expected.some((pattern) => pattern.test(text))) page.complaints.push(text);
  });
  await page.goto(url);
  return page;
}

export async function live(page) {
  await page.waitForFunction(() => document.querySelector("[data-status]").textContent === "Live");
}

/** What the list shows now, and the tick that the same frame belongs to. */
export const shownRows = (page) => page.evaluate(() => {
  const text = (row, selector) => row.querySelector(selector)?.textContent ?? "";
  const rows = [...document.querySelectorAll("#grid tbody tr[id^='robot-']")].map((row) => [
    Number(row.id.slice("robot-".length)),
    {
      level: text(row, ".c-level .name"),
      alarms: text(row, ".c-alarms"),
      soc: text(row, ".c-battery .value"),
      socLo: text(row, ".c-battery .least"),
      left: text(row, ".c-left .value"),
      power: text(row, ".c-power"),
      forecast: text(row, ".c-forecast .value"),
      interval: text(row, ".c-forecast .least"),
      residual: text(row, ".c-residual"),
      quality: text(row, ".c-quality").split(" · ")[0],
    },
  ]);
  const tick = Number(document.querySelector("[data-worker='tick']").textContent.replace(/\D/g, ""));
  return { tick, rows: Object.fromEntries(rows) };
});

/** Serious and critical findings of axe. */
export async function axeFindings(page) {
  await page.evaluate(AXE);
  const found = await page.evaluate(async () => {
    const { violations } = await globalThis.axe.run();
    return violations.map(({ id, impact, nodes }) => ({ id, impact, html: nodes.map((node) => node.html.slice(0, 160)) }));
  });
  return found.filter(({ impact }) => impact === "serious" || impact === "critical");
}

/** Processor time of the page's main thread and of its process over some seconds, as shares of one processor. */
export async function processorShare(page, seconds) {
  const session = await page.context().newCDPSession(page);
  await session.send("Performance.enable", { timeDomain: "threadTicks" });
  const read = async () => {
    const { metrics } = await session.send("Performance.getMetrics");
    return Object.fromEntries(metrics.map(({ name, value }) => [name, value]));
  };
  const before = await read();
  const began = performance.now();
  await page.waitForTimeout(seconds * 1000);
  const after = await read();
  const elapsed = (performance.now() - began) / 1000;
  const share = (name) => (after[name] - before[name]) / elapsed;
  await session.detach();
  return { thread: share("TaskDuration"), process: share("ProcessTime") };
}
