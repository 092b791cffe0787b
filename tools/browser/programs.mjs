// The real programs of a fleet, each a process of its own, in a domain of their own.

import { spawn } from "node:child_process";
import { mkdtempSync, rmSync, writeFileSync } from "node:fs";
import { tmpdir } from "node:os";
import { join } from "node:path";

const BIN = process.env.JOULEBUS_BIN;
/** Nothing here is a promise about speed: this only ends a test that hangs. */
export const PATIENCE_MS = 180_000;

/** Characters of a program's output, and frames of `joulebus watch`. */
const OUTPUT_KEPT = 20_000_000;
const FRAMES_KEPT = 300;

export const sleep = (ms) => new Promise((done) => setTimeout(done, ms));

/** Asks until the answer is true; what it is waiting for is part of the error. */
export async function until(what, ask, patienceMs = PATIENCE_MS) {
  const end = Date.now() + patienceMs;
  for (;;) {
    const answer = await ask();
    if (answer) return answer;
    if (Date.now() > end) throw new Error(`not within ${patienceMs / 1000} s: ${what}`);
    await sleep(50);
  }
}

class Program {
  constructor(name, args, environment) {
    this.name = `${name} ${args.join(" ")}`;
    this.output = "";
    this.child = spawn(join(BIN, name), args, {
      stdio: ["ignore", "pipe", "pipe"],
      env: { ...process.env, PATH: `${BIN}:${process.env.PATH}`, ...environment },
    });
    this.ended = new Promise((done) => this.child.on("close", (code, signal) => done(code ?? signal)));
    this.child.on("error", (error) => (this.output += `${error}\n`));
    this.onStdout = (text) => this.#keep(text);
    this.child.stdout.setEncoding("utf8").on("data", (text) => this.onStdout(text));
    this.child.stderr.setEncoding("utf8").on("data", (text) => this.#keep(text));
  }

  #keep(text) {
    this.output = (this.output + text).slice(-OUTPUT_KEPT);
  }

  get running() {
    return this.child.exitCode === null && this.child.signalCode === null;
  }

  async says(pattern) {
    return until(`${this.name} to say ${pattern}; it said:\n${this.output.slice(-2000)}`, () => {
      const found = this.output.match(pattern);
      if (!found && !this.running) throw new Error(`${this.name} ended:\n${this.output.slice(-2000)}`);
      return found;
    });
  }

  async stop(signal = "SIGTERM") {
    if (this.running) this.child.kill(signal);
    return this.ended;
  }
}

/** Robots of one kind with a battery that holds so many Wh and starts so full. */
const battery = ({ name, robots, wh, soc }) => `
[[platform]]
file = "builtin:gternal"
name = "${name}"
robots = ["${robots}"]
[platform.battery]
capacity_wh = ${wh}
reserve = 0.1
initial_soc = ${soc}
initial_soc_lo = ${(soc - 0.06).toFixed(2)}
low = 0.3
critical = 0.15
`;

/** A fleet of simulated robots in a domain of its own. */
export class Fleet {
  /** @param platforms each with name, robots (a range of ids), wh, soc */
  constructor(name, robots, platforms = [{ name: "gternal", robots: `0-${robots - 1}`, wh: 2.0, soc: 0.6 }]) {
    this.folder = mkdtempSync(join(tmpdir(), "joulebus-browser-"));
    this.root = mkdtempSync("/dev/shm/jb-browser-");
    this.config = join(this.folder, "fleet.toml");
    this.programs = [];
    writeFileSync(this.config, `
[fleet]
name = "${name}"
capacity = ${Math.max(robots, 10)}
[domain]
root = "${this.root}"
[ledger]
checkpoint = "state.json"
every_s = 0.2
${platforms.map(battery).join("")}`);
  }

  start(name, ...args) {
    const program = new Program(name, [...args, "--config", this.config]);
    this.programs.push(program);
    return program;
  }

  async worker() {
    const worker = this.start("joulebus", "run");
    await worker.says(/ready: fleet/);
    return worker;
  }

  publish(...args) {
    return this.start("joulebus", "publish", "sim", ...args);
  }

  /** The server, at a free port or the one given; its address is in `url`. */
  async serve(port = 0) {
    const server = this.start("joulebus-serve", "--http", `127.0.0.1:${port}`);
    const [url] = await server.says(/http:\/\/127\.0\.0\.1:\d+/);
    server.url = url;
    server.port = Number(new URL(url).port);
    return server;
  }

  /** The newest frames as `joulebus watch` reads them, by tick. */
  watch() {
    const watch = this.start("joulebus", "watch", "--format", "json");
    watch.frames = new Map();
    let rest = "";
    watch.onStdout = (text) => {
      const lines = (rest + text).split("\n");
      rest = lines.pop();
      for (const line of lines) {
        const frame = JSON.parse(line);
        watch.newest = frame;
        watch.frames.delete(frame.tick);
        watch.frames.set(frame.tick, frame);
      }
      for (const tick of watch.frames.keys()) {
        if (watch.frames.size <= FRAMES_KEPT) break;
        watch.frames.delete(tick);
      }
    };
    return watch;
  }

  /** One frame by `joulebus watch --once`, which gives up after three seconds without one. */
  async once() {
    return until("a frame of `joulebus watch --once`", async () => {
      const watch = this.start("joulebus", "watch", "--once", "--format", "json");
      const code = await watch.ended;
      if (code !== 0 && code !== 1) throw new Error(`${watch.name}: ${code}: ${watch.output}`);
      return code === 0 && JSON.parse(watch.output.split("\n").find((line) => line.startsWith("{")));
    });
  }

  async close() {
    await Promise.all(this.programs.map((program) => program.stop()));
    rmSync(this.root, { recursive: true, force: true });
    rmSync(this.folder, { recursive: true, force: true });
  }
}
