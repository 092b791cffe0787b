#!/usr/bin/env python3
"""Attacks joulebus for a given time.

    tools/attack.py --minutes 30                      # all attacks in turn, from seed 1 on
    tools/attack.py --minutes 5 --seed 7 --only clients,hosts

An attack is a test of the repository with another seed in each round: processes that are killed
while others work, frames and messages that lie, files that are cut, simulated hosts with faults in
random order. Each compares with what must hold: no wrong bit, no loss that is not counted, no
foreign file touched. Rounds take turns until the time is over. A round that has begun ends. A round
that fails is printed with the command that repeats it. Ends with 1 if one failed, or none was run.
"""

import argparse
import os
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


def attack(name, command, variables, seed):
    """One round: whether it held."""
    command = command.format(seed=seed)
    variables = {**variables, "JOULEBUS_SEED": str(seed), "PROPTEST_RNG_SEED": str(seed)}
    begun = time.monotonic()
    ended = subprocess.run(
        command.split(), cwd=ROOT, env={**os.environ, **variables}, text=True, errors="replace",
        stdout=subprocess.PIPE, stderr=subprocess.STDOUT, check=False)
    lines = ended.stdout.splitlines()
    # A filter that matches nothing passes as well.
    passed = sum(int(line.split()[3]) for line in lines if line.startswith("test result:"))
    simulated = any("simulated hours" in line for line in lines)
    held = ended.returncode == 0 and (passed > 0 or simulated)
    print(f"{name:12} seed {seed:<6} {'ok' if held else 'FAILED':6} {time.monotonic() - begun:6.0f} s", flush=True)
    if not held:
        again = " ".join(f"{key}={value}" for key, value in variables.items())
        print(*lines[-40:], f"  again: {again} {command}", sep="\n", file=sys.stderr)
    return held


def main():
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter,
        epilog="\n".join(f"{name:12} {what}" for name, what, *_ in ATTACKS))
    parser.add_argument("--minutes", type=float, default=10.0, help="how long rounds begin [10]")
    parser.add_argument("--seed", type=int, default=1, help="of the first round; each round has the next [1]")
    parser.add_argument("--only", help="names of attacks, with commas between them")
    given = parser.parse_args()
    known = [name for name, *_ in ATTACKS]
    wanted = given.only.split(",") if given.only else known
    if unknown := set(wanted) - set(known):
        parser.error(f"no attack {', '.join(unknown)}. There are {', '.join(known)}")
    attacks = [attack for attack in ATTACKS if attack[0] in wanted]
    end, held = time.monotonic() + 60 * given.minutes, []
    # Each at least once: compiling takes the time, too.
    while time.monotonic() < end or len(held) < len(attacks):
        name, _, command, variables = attacks[len(held) % len(attacks)]
        held.append(attack(name, command, variables, given.seed + len(held)))
    print(f"{len(held)} rounds, {held.count(False)} failed")
    return 0 if all(held) else 1


if __name__ == "__main__":
    sys.exit(main())
