// The operator's page with the real programs, in a real browser.

import assert from "node:assert/strict";
import { readdirSync, readFileSync } from "node:fs";
import { join } from "node:path";
import { after, before, describe, test } from "node:test";

import { PHONE, WIDE, axeFindings, launch, live, openPage, processorShare, shownRows } from "./browser.mjs";
import { worstFirst } from "./page/alarms.js";
import * as format from "./page/format.js";
import { Fleet, sleep, until } from "./programs.mjs";

const ROOT = process.env.JOULEBUS_ROOT;
/** What the browser says of a server that is away, and of streams that a new address cuts off. */
const ABORTED = [/net::ERR_ABORTED/];
const LOST = [/Failed to load resource: net::ERR_/, /ERR_CONNECTION_REFUSED/];
/** And of one that has too much to do: it asks to be asked again. */
const BUSY = [/responded with a status of 503/];

let browser;
before(async () => {
  browser = await launch();
});
after(() => browser?.close());

async function withPage(url, options, use) {
  const page = await openPage(browser, url, options);
  try {
    await use(page);
    assert.deepEqual(page.complaints, [], "the browser's console");
  } finally {
    await page.context().close();
  }
}

/** Texts of a row from a robot's record: forecasts are of the tick, the rest of it or of the one before. */
function expectedRow(robot) {
  return {
    forecast: {
      power: format.watts(robot.reading_w),
      forecast: format.watts(robot.power_w),
      interval: robot.lo_w === null ? "" : `${format.wattNumber(robot.lo_w)} – ${format.wattNumber(robot.hi_w)}`,
      quality: format.quality(robot),
    },
    rest: {
      level: robot.level ?? "–",
      alarms: worstFirst(robot.alarms).join(", "),
      soc: format.percent(robot.soc),
      socLo: robot.soc_lo === null ? "" : `≥\u202f${format.percent(robot.soc_lo)}`,
      left: robot.charging === true ? "charging" : format.duration(robot.time_to_empty_s),
      residual: format.wattDifference(robot.residual_w),
    },
  };
}

function compareFrame(shown, frame, previous) {
  const find = (where, id) => where?.robots.find((robot) => robot.robot === id);
  for (const [id, row] of Object.entries(shown.rows)) {
    const robot = find(frame, Number(id));
    assert.ok(robot, `robot ${id} is on the page, but not in tick ${frame.tick}`);
    const now = expectedRow(robot);
    const before = find(previous, Number(id));
    for (const [name, text] of Object.entries(now.forecast)) {
      assert.equal(row[name], text, `${name} of robot ${id} at tick ${frame.tick}`);
    }
    for (const [name, text] of Object.entries(now.rest)) {
      const accepted = before ? [text, expectedRow(before).rest[name]] : [text];
      // Acknowledged alarms have a mark.
      assert.ok(accepted.includes(row[name].replace(/\s*✓/gu, "")), `${name} of robot ${id} at tick ${frame.tick}: ${row[name]}, not ${accepted}`);
    }
  }
}

describe("a fleet of 20 robots", () => {
  let fleet, worker, server, watch;
  const FAULTY = 7;

  before(async () => {
    fleet = new Fleet("page", 20);
    worker = await fleet.worker();
    server = await fleet.serve();
    watch = fleet.watch();
    fleet.publish("--robots", String(FAULTY), "--name", "before");
    fleet.publish("--first-robot", String(FAULTY + 1), "--robots", String(19 - FAULTY), "--name", "behind");
  });
  after(() => fleet?.close());

  test("an alarm is on the page, in the list, among the raised, in the title and for screen readers", async () => {
    await withPage(server.url, {}, async (page) => {
      await live(page);
      // What is raised before the page is there is not announced, and an announcement is followed by the next.
      await page.evaluate(() => {
        globalThis.announced = [];
        const announcer = document.getElementById("announcer");
        const hear = () => globalThis.announced.push(announcer.textContent);
        new MutationObserver(hear).observe(announcer, { childList: true, characterData: true, subtree: true });
      });
      fleet.publish("--first-robot", String(FAULTY), "--robots", "1", "--fault", `${FAULTY}=stuck@8`, "--name", "faulty");
      const onPage = page.locator(`#robot-${FAULTY} .c-alarms`, { hasText: "StuckSensor" }).waitFor().then(() => performance.now());
      const inWatch = until(`joulebus watch to show StuckSensor of robot ${FAULTY}`, () => {
        return watch.newest?.robots.find((robot) => robot.robot === FAULTY)?.alarms.includes("StuckSensor");
      }).then(() => performance.now());
      const [pageMs, watchMs] = await Promise.all([onPage, inWatch]);
      console.log(`alarm on the page ${((pageMs - watchMs) / 1000).toFixed(2)} s after joulebus watch (both ± 0.05 s)`);
      await page.locator("#raised li", { hasText: `Robot ${FAULTY}` }).filter({ hasText: "StuckSensor" }).waitFor();
      await page.locator("#changes li", { hasText: `Robot ${FAULTY}` }).filter({ hasText: "raised" }).first().waitFor();
      await page.waitForFunction(() => /^\(\d+\)/.test(document.title));
      await page.waitForFunction(() => globalThis.announced.some((text) => text.includes("StuckSensor raised")));
      // Sorted by urgency.
      await page.waitForFunction((id) => document.querySelector("#grid tbody tr[id]")?.id === `robot-${id}`, FAULTY);
    });
  });

  test("an alarm that is pressed says what it means, by mouse and by keyboard", async () => {
    await withPage(`${server.url}/?view=alarms`, {}, async (page) => {
      await live(page);
      const cards = await (await fetch(`${server.url}/api/v1/alarms/cards`)).json();
      const expected = cards.find((card) => card.alarm === "StuckSensor");
      const dialog = page.locator("#card");
      const alarm = page.locator("#raised button.alarm", { hasText: "StuckSensor" }).first();
      await alarm.click();
      await dialog.getByText(expected.meaning.replaceAll("`", "")).waitFor();
      assert.equal(await page.locator("[data-card='check']").innerText(), expected.check.replaceAll("`", ""));
      assert.match(await page.locator("[data-card='robot']").innerText(), /of robot \d+/);
      const keys = await page.locator("[data-card='keys']").innerText();
      assert.match(keys, /^platform\.stuck_after_s = 10\.0 s, /, "each key with its value");
      assert.deepEqual(await axeFindings(page), []);
      await page.keyboard.press("Escape");
      await dialog.waitFor({ state: "hidden" });
      await alarm.focus();
      await page.keyboard.press("Enter");
      await dialog.getByText(expected.meaning).waitFor();
      await dialog.getByRole("button", { name: "Close" }).click();
      await dialog.waitFor({ state: "hidden" });
    });
  });

  test("a column says what it means, under the pointer and with the focus, and stops at Escape", async () => {
    await withPage(server.url, {}, async (page) => {
      await live(page);
      const tip = page.locator("#meaning");
      const heads = page.locator("#grid thead th");
      for (let at = 0; at < await heads.count(); at += 1) {
        const named = heads.nth(at).locator("xpath=descendant-or-self::*[@data-meaning]");
        // A narrow list leaves columns out.
        if (!(await named.isVisible())) continue;
        const meaning = await named.getAttribute("data-meaning");
        assert.ok(meaning.length > 20, meaning);
        for (const reach of ["hover", "focus"]) {
          await named[reach]();
          // A pointer elsewhere takes nothing from the focus.
          if (reach === "focus") await page.mouse.move(500, 500);
          await tip.waitFor({ timeout: 10_000 });
          assert.equal(await tip.textContent(), meaning);
          const box = await tip.boundingBox();
          assert.ok(box.x >= 0 && box.x + box.width <= WIDE.width && box.y > 0, JSON.stringify(box));
          assert.equal(await named.getAttribute("aria-describedby"), "meaning");
          await page.keyboard.press("Escape");
          assert.equal(await tip.isVisible(), false);
          await page.mouse.move(700, 700);
        }
      }
      await page.locator("[data-fleet='dropped']").locator("xpath=preceding-sibling::dt").hover();
      assert.match(await tip.textContent(), /did not take/);
    });
  });

  test("an alarm is acknowledged on its card, by a name that is asked for once", async () => {
    await withPage(`${server.url}/?view=alarms`, {}, async (page) => {
      await live(page);
      const dialog = page.locator("#card");
      const entry = page.locator("#raised li", { hasText: "StuckSensor" }).first();
      await entry.locator("button.alarm").click();
      await dialog.getByLabel("Your name").fill("ann");
      assert.deepEqual(await axeFindings(page), []);
      // Only of an alarm of the robot's own level.
      assert.equal(await dialog.getByRole("button", { name: "New normal" }).isVisible(), false);
      await dialog.getByRole("button", { name: "Acknowledge" }).click();
      await dialog.waitFor({ state: "hidden" });
      await entry.getByText("acknowledged by ann").waitFor();
      await page.locator("#changes li", { hasText: "acknowledged by ann" }).first().waitFor();
      assert.deepEqual(await axeFindings(page), []);
      const { raised } = await (await fetch(`${server.url}/api/v1/alarms`)).json();
      assert.equal(raised.find((each) => each.alarm === "StuckSensor").acknowledged.by, "ann");
      await entry.locator("button.alarm").click();
      await dialog.getByText(/^Acknowledged by ann at /).waitFor();
      assert.equal(await dialog.getByRole("button", { name: "Acknowledge" }).isVisible(), false);
      assert.equal(await dialog.locator("input").inputValue(), "ann");
    });
  });

  test("a robot's battery is stated from its panel, and a refusal is shown", async () => {
    await withPage(`${server.url}/?robot=7`, {}, async (page) => {
      await live(page);
      const panel = page.locator("#battery");
      await panel.locator("summary").click();
      await panel.getByLabel("Your name").fill("ann");
      assert.deepEqual(await axeFindings(page), []);
      const charge = async () => (await (await fetch(`${server.url}/api/v1/robots/7`)).json()).soc;
      await panel.getByLabel("Measured charge in percent").fill("40");
      await panel.getByRole("button", { name: "It was measured" }).click();
      await panel.getByText("The worker counts from there.").waitFor();
      await until("a charge near 40 %", async () => Math.abs((await charge()) - 0.4) < 0.1);
      await panel.getByRole("button", { name: "It is full" }).click();
      await until("a full battery", async () => (await charge()) > 0.9);
      // A name that is none, though the browser has sent it.
      await panel.getByLabel("Your name").fill(" ");
      await panel.getByRole("button", { name: "It was exchanged" }).click();
      const status = panel.locator("[role='status']");
      await until("the refusal", async () => /name/.test(await status.textContent()));
      page.complaints = page.complaints.filter((text) => !/status of 4/.test(text));
    });
  });

  test("the values are those of joulebus watch, tick by tick", async () => {
    await withPage(server.url, { viewport: { width: 1920, height: 1080 } }, async (page) => {
      await live(page);
      let compared = 0;
      await until("ten ticks that both have shown", async () => {
        const shown = await shownRows(page);
        await sleep(300);
        const frame = watch.frames.get(shown.tick);
        const previous = watch.frames.get(shown.tick - 1);
        // Without the tick before, as where the worker had no time for it, what is of that one is not known.
        if (!frame || !previous || Object.keys(shown.rows).length === 0) return false;
        assert.equal(Object.keys(shown.rows).length, 20);
        compareFrame(shown, frame, previous);
        compared += 1;
        return compared >= 10;
      });
    });
  });

  test("joulebus watch --once, the API and the page know the same robots, alarms and levels", async () => {
    await until("an instant without a change of a level", async () => {
      const frame = await fleet.once();
      const answer = await (await fetch(`${server.url}/api/v1/robots?count=200&sort=robot`)).json();
      const brief = ({ robot, level, alarms }) => ({ robot, level, alarms });
      const same = JSON.stringify(answer.robots.map(brief)) === JSON.stringify(frame.robots.map(brief));
      const keys = Object.keys(frame.robots[0]).filter((key) => !(key in answer.robots[0]));
      assert.deepEqual(keys, [], "keys of watch that the API lacks");
      return same;
    });
  });

  test("the keyboard reaches everything, and the address says what is shown", async () => {
    await withPage(server.url, {}, async (page) => {
      await live(page);
      await page.keyboard.press("/");
      assert.equal(await page.evaluate(() => document.activeElement.id), "search");
      await page.keyboard.type("stuck");
      await page.waitForFunction(() => document.querySelectorAll("#grid tbody tr[id]").length === 1);
      await page.keyboard.press("Enter");
      assert.equal(await page.evaluate(() => document.activeElement.id), "grid");
      await page.keyboard.press("ArrowDown");
      await page.keyboard.press("Enter");
      await page.locator("#robot-title", { hasText: `Robot ${FAULTY}` }).waitFor();
      assert.equal(await page.evaluate(() => document.activeElement.id), "robot");
      assert.equal(new URL(page.url()).search, `?robot=${FAULTY}&search=stuck`);
      await page.locator("[data-robot='level']", { hasText: "error" }).waitFor();
      await page.keyboard.press("Escape");
      await page.locator("#robot").waitFor({ state: "hidden" });
      assert.equal(await page.evaluate(() => document.activeElement.id), "grid");
      await page.keyboard.press("/");
      await page.keyboard.press("Escape");
      await page.waitForFunction(() => document.querySelectorAll("#grid tbody tr[id]").length === 20);
      assert.equal(new URL(page.url()).search, "");
      await page.keyboard.press("End");
      await page.waitForFunction(() => document.getElementById("grid").getAttribute("aria-activedescendant"));
      const marked = await page.evaluate(() => {
        const active = document.getElementById(document.getElementById("grid").getAttribute("aria-activedescendant"));
        return { last: active.ariaRowIndex === document.getElementById("grid").ariaRowCount, shadow: getComputedStyle(active.cells[1]).boxShadow };
      });
      assert.ok(marked.last && marked.shadow !== "none", JSON.stringify(marked));
      for (const key of ["soc", "soc", "soc"]) {
        await page.locator(`th[data-sort="${key}"] button`).focus();
        await page.keyboard.press("Enter");
      }
      assert.equal(await page.locator("th[aria-sort]").count(), 0, "the third press restores urgency");
    });
  });

  test("a link shows the same again, and Back goes back", async () => {
    await withPage(`${server.url}/?robot=3&sort=robot&descending=1&level=ok,error`, {}, async (page) => {
      await live(page);
      await page.locator("[data-robot='reading']", { hasText: "W" }).waitFor();
      assert.equal(await page.locator("#robot-title").innerText(), "Robot 3");
      assert.equal(await page.locator("th[aria-sort]").getAttribute("aria-sort"), "descending");
      const ids = await page.locator("#grid tbody tr[id]").evaluateAll((rows) => rows.map((row) => Number(row.id.slice(6))));
      assert.deepEqual(ids, ids.toSorted((a, b) => b - a));
      await page.locator("#grid tbody tr[id]").first().click();
      await page.waitForFunction(() => document.getElementById("robot-title").textContent !== "Robot 3");
      await page.goBack();
      await page.locator("#robot-title", { hasText: "Robot 3" }).waitFor();
    });
  });

  test("a robot's charts, budget and weights are those of its record; a plan is answered", async () => {
    await withPage(`${server.url}/?robot=4`, { expected: BUSY }, async (page) => {
      await live(page);
      await page.waitForFunction(() => document.querySelectorAll("#robot .chart canvas").length === 3);
      await page.waitForFunction(() => document.querySelector("[data-chart='power']").ariaLabel?.includes("read "));
      await page.waitForFunction(() => document.querySelector("[data-outlook='fan'] polyline")?.points.length === 4);
      const ahead = await page.locator("[data-outlook='rows'] > div").allInnerTexts();
      assert.ok(ahead.length === 4 && ahead.every((text) => /[\d.]+\u202f(J|Wh)/.test(text)), ahead.join("; "));
      const frame = await fleet.once();
      const robot = frame.robots.find((candidate) => candidate.robot === 4);
      const drawn = await page.locator("[data-robot='drawn']").innerText();
      assert.match(drawn, /^[\d.]+\u202f(J|Wh)$/);
      const joules = Number.parseFloat(drawn) * (drawn.endsWith("Wh") ? 3600 : 1);
      assert.ok(Math.abs(joules - robot.drawn_j) < 0.2 * robot.drawn_j, `${drawn}, but watch says ${robot.drawn_j} J`);
      const weights = await page.locator(".weight-key dd").allInnerTexts();
      const sum = weights.reduce((all, text) => all + Number.parseFloat(text), 0);
      assert.ok(Math.abs(sum - 100) < 1, `weights ${weights}`);
      await page.locator("#what-if summary").click();
      await until("an answer", async () => {
        await page.locator("#what-if button").click();
        await page.waitForFunction(() => {
          const said = document.querySelector("[data-what-if='answer']").textContent;
          return said !== "" && said !== "Asking";
        });
        return (await page.locator("#what-if .verdict").count()) > 0;
      });
      assert.match(await page.locator("#what-if .verdict").innerText(), /^(yes|tight|no|unknown)/);
    });
  });

  for (const colorScheme of ["light", "dark"]) {
    test(`axe finds nothing serious in ${colorScheme}, wide and on a phone, and a phone does not scroll sideways`, async () => {
      for (const viewport of [WIDE, PHONE]) {
        await withPage(server.url, { viewport, colorScheme, expected: ABORTED }, async (page) => {
          for (const view of ["/", `/?robot=${FAULTY}`, "/?view=alarms", "/?view=worker"]) {
            await page.goto(server.url + view);
            await live(page);
            await page.waitForFunction(() => document.querySelectorAll("#grid tbody tr[id]").length > 0 || document.getElementById("robots").offsetParent === null);
            assert.deepEqual(await axeFindings(page), [], `${view} ${viewport.width}`);
            const over = await page.evaluate(() => document.documentElement.scrollWidth - innerWidth);
            assert.ok(over <= 0, `${view} is ${over} px wider than ${viewport.width} px`);
          }
        });
      }
    });
  }

  test("a screen reader hears a robot's level on a phone", async () => {
    await withPage(server.url, { viewport: PHONE }, async (page) => {
      await live(page);
      const row = page.locator(`#robot-${FAULTY}`);
      await row.locator(".brief", { hasText: "StuckSensor" }).waitFor();
      assert.match(await row.locator(".c-level").ariaSnapshot(), /error/);
    });
  });

  test("every file of the page is served from memory, under a policy that admits nothing from elsewhere", async () => {
    const folder = join(ROOT, "crates/gateways/serve/page");
    const files = readdirSync(folder, { recursive: true, withFileTypes: true }).filter((entry) => entry.isFile());
    assert.ok(files.length > 10);
    for (const file of files) {
      const path = join(file.parentPath ?? file.path, file.name);
      const answer = await fetch(server.url + path.slice(folder.length));
      assert.equal(answer.status, 200, path);
      assert.ok(readFileSync(path).equals(Buffer.from(await answer.arrayBuffer())), `${path} is not what is served`);
    }
    const policy = (await fetch(server.url)).headers.get("content-security-policy");
    assert.match(policy, /default-src 'self'/);
    assert.doesNotMatch(policy, /unsafe|\*|https?:/);
  });

  test("every metric that the dashboard and the alert rules name exists", async () => {
    const metrics = await (await fetch(`${server.url}/metrics`)).text();
    const exposed = new Set([...metrics.matchAll(/^# TYPE (\S+) (\S+)$/gm)].flatMap(([, name, kind]) =>
      kind === "histogram" ? [`${name}_bucket`, `${name}_sum`, `${name}_count`] : [name]));
    let named = 0;
    for (const file of ["configs/grafana/joulebus.json", "configs/prometheus/joulebus.rules.yml"]) {
      for (const [name] of readFileSync(join(ROOT, file), "utf8").matchAll(/\bjoulebus_[a-z_]+\b(?=[{[\s,)])/g)) {
        assert.ok(exposed.has(name), `${file} names ${name}; the server has ${[...exposed].join(" ")}`);
        named += 1;
      }
    }
    assert.ok(named > 30);
  });

  test("a tab that is not visible asks every two seconds, and its title tells of a worker and a server that are gone", async () => {
    await withPage(server.url, { expected: LOST }, async (page) => {
      await live(page);
      await page.evaluate(() => {
        globalThis.isHidden = false;
        Object.defineProperty(document, "hidden", { configurable: true, get: () => globalThis.isHidden });
        globalThis.setHidden = (value) => {
          globalThis.isHidden = value;
          document.dispatchEvent(new Event("visibilitychange"));
        };
        globalThis.askedMs = [];
        const { fetch } = globalThis;
        globalThis.fetch = (url, ...more) => {
          if (url === "/api/v1/fleet") globalThis.askedMs.push(performance.now());
          return fetch(url, ...more);
        };
        for (let turn = 0; turn < 5; turn += 1) {
          globalThis.setHidden(true);
          globalThis.setHidden(false);
        }
        globalThis.askedMs = [];
        globalThis.setHidden(true);
      });
      await page.waitForFunction(() => globalThis.askedMs.length >= 4);
      const askedMs = await page.evaluate(() => globalThis.askedMs);
      const pausesMs = askedMs.slice(1).map((at, place) => at - askedMs[place]);
      // A timer may be late, and is never early.
      assert.ok(pausesMs.every((pause) => pause > 1_900), String(pausesMs));
      await worker.stop("SIGKILL");
      await page.waitForFunction(() => document.title.includes("Worker gone"));
      await server.stop("SIGKILL");
      await page.waitForFunction(() => document.title.includes("Disconnected"));
      server = await fleet.serve(server.port);
      worker = await fleet.worker();
      await page.waitForFunction(() => /^(\(\d+\) )?page – joulebus$/.test(document.title));
      await page.evaluate(() => globalThis.setHidden(false));
      await live(page);
    });
  });

  test("a killed worker is gone on the page, with the last values kept, and back without a reload", async () => {
    await withPage(server.url, {}, async (page) => {
      await live(page);
      await page.waitForFunction(() => document.querySelectorAll("#grid tbody tr[id]").length === 20);
      await page.evaluate(() => (globalThis.loadedOnce = true));
      const killed = performance.now();
      await worker.stop("SIGKILL");
      await page.locator("[data-status]", { hasText: "Worker gone" }).waitFor();
      console.log(`gone on the page ${((performance.now() - killed) / 1000).toFixed(2)} s after SIGKILL`);
      await page.locator("#banner", { hasText: "The worker is gone" }).waitFor();
      assert.match(await page.locator("#banner").innerText(), /Last frame at \d\d:\d\d:\d\d/);
      assert.equal(await page.evaluate(() => document.body.dataset.aged), "true");
      assert.equal(await page.locator("#grid tbody tr[id]").count(), 20, "the last values stay");
      assert.deepEqual(await axeFindings(page), []);
      const began = performance.now();
      worker = await fleet.worker();
      await live(page);
      console.log(`live again ${((performance.now() - began) / 1000).toFixed(2)} s after the new worker was started`);
      await page.locator("#banner").waitFor({ state: "hidden" });
      assert.ok(await page.evaluate(() => globalThis.loadedOnce), "without a reload");
    });
  });

  test("the page reconnects when the server is back", async () => {
    await withPage(server.url, { expected: LOST }, async (page) => {
      await live(page);
      await page.evaluate(() => (globalThis.loadedOnce = true));
      await server.stop("SIGKILL");
      await page.locator("[data-status]", { hasText: "Disconnected" }).waitFor();
      await page.locator("#banner", { hasText: "next try" }).waitFor();
      assert.equal(await page.evaluate(() => document.body.dataset.aged), "true");
      server = await fleet.serve(server.port);
      await live(page);
      assert.ok(await page.evaluate(() => globalThis.loadedOnce), "without a reload");
    });
  });
});

describe("a fleet of 10,000 robots", () => {
  const ROBOTS = 10_000;
  let fleet, server;

  before(async () => {
    fleet = new Fleet("page10k", ROBOTS);
    await fleet.worker();
    server = await fleet.serve();
    fleet.publish("--robots", String(ROBOTS), "--rate", "1");
  });
  after(() => fleet?.close());

  test("the list scrolls to its end with as many rows as fit", async () => {
    await withPage(`${server.url}/?sort=robot`, {}, async (page) => {
      await page.waitForFunction((count) => document.getElementById("grid").ariaRowCount === String(count + 1), ROBOTS);
      const most = Math.ceil(WIDE.height / 34) + 12;
      for (const share of [0.3, 0.71, 1, 0]) {
        await page.evaluate((part) => {
          const box = document.getElementById("scroller");
          box.scrollTop = part * (box.scrollHeight - box.clientHeight);
        }, share);
        const wanted = Math.round(share * ROBOTS);
        await page.waitForFunction(({ wanted: id, most: limit }) => {
          const rows = [...document.querySelectorAll("#grid tbody tr[id^='robot-']")];
          const ids = rows.map((row) => Number(row.id.slice(6)));
          return rows.length > 10 && rows.length <= limit && ids.every((robot, at) => at === 0 || robot === ids[at - 1] + 1)
            && ids[0] <= id && ids.at(-1) >= Math.min(id, 9999) - 20;
        }, { wanted, most });
        assert.ok((await page.locator("#grid tbody tr").count()) <= most + 2);
      }
      await page.locator("#grid").focus();
      await page.keyboard.press("End");
      await page.locator("#robot-9999.active").waitFor();
      await page.locator("#search").fill("9998");
      await page.waitForFunction(() => document.querySelectorAll("#grid tbody tr[id]").length === 1);
      await page.locator("#robot-9998").waitFor();
    });
  });
});

for (const robots of [1_000, 10_000]) {
  test(`what ${robots} robots cost the browser is printed`, async () => {
    const fleet = new Fleet("cost", robots);
    try {
      await fleet.worker();
      const server = await fleet.serve();
      fleet.publish("--robots", String(robots), ...(robots > 1_000 ? ["--rate", "1"] : []));
      for (const view of ["/", "/?robot=3"]) {
        await withPage(server.url + view, {}, async (page) => {
          await page.waitForFunction((count) => document.getElementById("grid").ariaRowCount === String(count + 1), robots);
          const { thread, process: all } = await processorShare(page, 5);
          const share = (value) => `${(value * 100).toFixed(1)} %`;
          console.log(`${robots} robots, ${view}: main thread ${share(thread)}, browser process of the page ${share(all)} of a core`);
          assert.ok((await page.locator("#grid tbody tr[id]").count()) > 0);
          await live(page);
        });
      }
    } finally {
      await fleet.close();
    }
  });
}
