// Pictures of the page for the documentation, from the real programs: a fleet of 40 robots, some with little left.

import { join, resolve } from "node:path";

import { PHONE, launch, live, openPage } from "./browser.mjs";
import { Fleet, sleep } from "./programs.mjs";

/** Long enough that charts are full and alarms have been raised. */
const RECORDED_MS = 125_000;
const SHOWN = { width: 1280, height: 800 };

const folder = resolve(process.argv[2] ?? "docs/pictures");
const platforms = [
  { name: "gternal", robots: "0-23", wh: 2.0, soc: 0.82 },
  { name: "gternal-b", robots: "24-33", wh: 1.4, soc: 0.47 },
  { name: "gternal-old", robots: "34-39", wh: 0.9, soc: 0.33 },
];
const fleet = new Fleet("lab", 40, platforms);
const browser = await launch();
try {
  await fleet.worker();
  const server = await fleet.serve();
  const faults = { gternal: ["--fault", "5=load:1.5@20", "--fault", "11=stuck@20"], "gternal-b": ["--fault", "27=noise:1.2@20"] };
  for (const [at, { name, robots }] of platforms.entries()) {
    const [first, last] = robots.split("-").map(Number);
    fleet.publish("--platform", name, "--robots", String(last - first + 1), "--seed", String(7 + at), "--name", name, ...(faults[name] ?? []));
  }
  await sleep(RECORDED_MS);
  const pictures = [
    ["page.png", "/?robot=5", SHOWN, "light"],
    ["page-phone.png", "/", PHONE, "dark"],
  ];
  for (const [file, view, viewport, colorScheme] of pictures) {
    // A phone has no keyboard: the page shows no keys.
    const page = await openPage(browser, server.url + view, { viewport, colorScheme, hasTouch: viewport === PHONE });
    await live(page);
    await sleep(2500);
    await page.screenshot({ path: join(folder, file) });
    console.log(join(folder, file));
    if (page.complaints.length > 0) throw new Error(page.complaints.join("\n"));
    await page.context().close();
  }
} finally {
  await browser.close();
  await fleet.close();
}
