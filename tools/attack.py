#!/usr/bin/env python3
"""Attacks joulebus for a given time, and writes a report.

    tools/attack.py --minutes 30                      # all attacks in turn, from seed 1 on
    tools/attack.py --minutes 480 --seed 7 --report night.json
    tools/attack.py --minutes 5 --only clients,hosts  # these attacks. --list shows all

An attack is a test of the repository with another seed in each round: processes that are killed
while others work, frames and messages that lie, files that are cut, simulated hosts with faults in
random order. Each compares with what must hold: no wrong bit, no loss that is not counted, no
foreign file touched. Rounds take turns until the time is over. A round that has begun ends. The
report has commit, machine, each round's seed, duration, result and figures. A round that fails is
printed with the command that repeats it. Ends with 1 if one failed, or none was run.
"""

import argparse
import datetime
import json
import os
import platform
import subprocess
import sys
import time

ROOT = os.path.dirname(os.path.dirname(os.path.abspath(__file__)))
SYSTEM = "cargo test --locked -p joulebus-tests --test system {} -- --nocapture"
# What is attacked: name, what happens, the test, its variables. {seed} is the round's.
ATTACKS = [
    ("fleet", "every process of a fleet killed, paused, starved and flooded in random order",
     SYSTEM.format("random_faults"),
     {"JOULEBUS_RANDOM_FLEETS": "1"}),
    ("hosts", "simulated hosts: kills at every step, disks, clocks, power, false frames",
     "cargo run --locked -q -p joulebus-simulator --bin joulebus-sim -- --from {seed} --seeds 4", {}),
    ("publishers", "sources killed at random instants", SYSTEM.format("publishers"),
     {"JOULEBUS_PUBLISHER_KILLS": "40"}),
    ("clients", "clients killed in the middle of questions, and the worker while it is asked",
     SYSTEM.format("questions"), {"JOULEBUS_ASK_KILLS": "40", "JOULEBUS_ANSWERER_KILLS": "20"}),
    ("recorders", "recorders killed while they write", SYSTEM.format("captures"),
     {"JOULEBUS_KILLS": "10"}),
    ("verbs", "programs killed while they write files", "cargo test --locked -p joulebus --test cli killed",
     {"JOULEBUS_KILLS": "10"}),
    ("memory", "shared memory and its files run out", SYSTEM.format("full_memory"), {"JOULEBUS_EVERY": "1"}),
    ("links", "hostile and damaged messages between hosts",
     "cargo test --locked -p joulebus-link --bin joulebus-link protocol", {"PROPTEST_CASES": "2000"}),
    ("brokers", "damaged and endless messages of brokers",
     "cargo test --locked -p joulebus-bridge --bin joulebus-bridge", {"PROPTEST_CASES": "2000"}),
    ("captures", "damaged and foreign recordings",
     "cargo test --locked -p joulebus-capture-format --test bounded -- --nocapture", {"PROPTEST_CASES": "500"}),
    ("models", "damaged model files", "cargo test --locked -p joulebus-predictor --test all files", {}),
]


def arguments():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--minutes", type=float, default=10.0, help="how long rounds begin [10]")
    parser.add_argument("--seed", type=int, default=1, help="of the first round; each round has the next [1]")
    parser.add_argument("--only", help="names of attacks, with commas between them")
    parser.add_argument("--report", default="target/attack.json", help="the report's file [target/attack.json]")
    parser.add_argument("--list", action="store_true", help="show the attacks")
    given = parser.parse_args()
    known = [name for name, *_ in ATTACKS]
    wanted = given.only.split(",") if given.only else known
    unknown = [name for name in wanted if name not in known]
    if unknown:
        parser.error(f"no attack {', '.join(unknown)}. There are {', '.join(known)}")
    if not 0 < given.minutes < 1e5:
        parser.error(f"--minutes {given.minutes}: more than 0, less than 100000")
    given.attacks = [attack for attack in ATTACKS if attack[0] in wanted]
    return given


def output(*command):
    return subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False).stdout.strip()


def machine():
    try:
        with open("/proc/cpuinfo", encoding="utf-8") as cpus:
            model = next((line.split(":")[1].strip() for line in cpus if line.startswith("model name")), "?")
    except OSError:
        model = "?"
    return f"{os.cpu_count()} × {model}, Linux {platform.release()}"


def attack(what, seed):
    """One round: its result for the report."""
    name, _, command, variables = what
    command = command.format(seed=seed)
    variables = {**variables, "JOULEBUS_SEED": str(seed), "PROPTEST_RNG_SEED": str(seed)}
    begun = time.monotonic()
    ended = subprocess.run(
        command.split(), cwd=ROOT, env={**os.environ, **variables}, text=True, errors="replace",
        stdout=subprocess.PIPE, stderr=subprocess.STDOUT, check=False)
    lines = ended.stdout.splitlines()
    # A filter that matches nothing passes as well.
    passed = sum(int(line.split()[3]) for line in lines if line.startswith("test result:"))
    simulated = [line for line in lines if "simulated hours" in line]
    passed += len(simulated)
    ok = ended.returncode == 0 and passed > 0
    return {
        "attack": name, "seed": seed, "seconds": round(time.monotonic() - begun, 1),
        "ok": ok,
        "figures": simulated + [line.removeprefix("figure: ").strip() for line in lines if line.startswith("figure: ")],
        "repeat": " ".join(f"{key}={value}" for key, value in variables.items()) + " " + command,
        **({} if ok else {"end": lines[-40:]}),
    }


def main():
    given = arguments()
    if given.list:
        for name, what, *_ in ATTACKS:
            print(f"{name:12} {what}")
        return 0
    report = {
        "commit": output("git", "rev-parse", "HEAD"),
        "changed": bool(output("git", "status", "--porcelain", "--untracked-files=no")),
        "date": datetime.date.today().isoformat(), "machine": machine(), "minutes": given.minutes, "rounds": [],
    }
    end, seed = time.monotonic() + 60 * given.minutes, given.seed
    path = os.path.join(ROOT, given.report)
    os.makedirs(os.path.dirname(path), exist_ok=True)
    # Each at least once: compiling takes the time, too.
    while time.monotonic() < end or seed - given.seed < len(given.attacks):
        what = given.attacks[(seed - given.seed) % len(given.attacks)]
        result = attack(what, seed)
        report["rounds"].append(result)
        print(f"{result['attack']:12} seed {seed:<6} {'ok' if result['ok'] else 'FAILED':6} {result['seconds']:6.0f} s",
              flush=True)
        if not result["ok"]:
            print(f"  again: {result['repeat']}", file=sys.stderr)
        with open(path, "w", encoding="utf-8") as out:
            json.dump(report, out, indent=1)
        seed += 1
    failed = [result for result in report["rounds"] if not result["ok"]]
    print(f"{len(report['rounds'])} rounds, {len(failed)} failed; {given.report}")
    return 1 if failed or not report["rounds"] else 0


if __name__ == "__main__":
    sys.exit(main())
