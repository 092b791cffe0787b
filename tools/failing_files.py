#!/usr/bin/env python3
"""Fails each step of each verb that writes files, and damages its files at each step.

    tools/failing_files.py                       # all verbs, up to 12 steps of each kind
    tools/failing_files.py --only import --steps 1000

For each verb it makes inputs, lets the verb run once for the right result, and lists under strace
the system calls that reach its files. Then it repeats the verb: one of these calls fails (no space,
no permission, a broken disk), or the verb is stopped at that call while an input or an output is
removed, cut, replaced or forbidden, and goes on. What must hold: no signal, no panic, an exit code of
0 to 3. With 0 the result is the right one. With another code the reason is said, and no part of a
result stands at the output's path, unless the code is 3.

Ends with 1 if something did not hold. Needs `strace`: without it, or where it may not trace, it says
that it skips.
"""

import argparse
import hashlib
import json
import os
import re
import shutil
import signal
import subprocess
import sys
import tempfile
import time

ROOT = os.path.dirname(os.path.dirname(os.path.abspath(__file__)))
MODEL = os.path.join(ROOT, "configs/models/gternal-sim.safetensors")
PATIENCE_S = 120
# Verbs with a file or folder as their result. `{}` is the folder with inputs, NEW the result.
VERBS = (
    "new controller NEW",
    "record --config {}/fleet.toml -o NEW --duration 0.5",
    "recover {}/cut.mcap -o NEW",
    "link init base edge-1 --out NEW",
    "import {}/capture.mcap -o NEW",
    "data convert {}/trials/robot1.npy --to csv -o NEW",
    "data convert {}/trials/robot1.npy --to csv.gz -o NEW",
    "data simulate NEW --steps 20",
    "export {}/trials --to parquet NEW",
    "export {}/capture.mcap --to parquet NEW --mixed",
    "config init --from {}/trials/robot1.npy -o NEW",
    "train trials {}/trials --split time -o NEW",
    "eval {}/trials --model MODEL --partition 1/2 --resamples 20 -o NEW",
    "report {}/trials/robot1.npy {}/trials/robot2.npy --model MODEL --draws 20 -o NEW",
    "calibrate {}/trials --false-alarms 1000000/hour --robots 1 -o NEW",
    "model import {}/exported.npz -o NEW",
    "model export MODEL --to npz -o NEW",
    "model export MODEL --python NEW",
    "man NEW",
)
# Calls on files, with an error that each may have on a machine that works badly.
FAILING = {
    "openat": ("EACCES", "ENOSPC", "EMFILE"), "read": ("EIO",), "pread64": ("EIO",), "write": ("ENOSPC", "EIO"),
    "writev": ("ENOSPC",), "pwrite64": ("ENOSPC",), "fsync": ("EIO",), "fdatasync": ("EIO",), "ftruncate": ("ENOSPC",),
    "rename": ("EACCES",), "renameat2": ("ENOSPC",), "link": ("EACCES",), "linkat": ("EACCES",), "unlink": ("EACCES",),
    "mkdir": ("ENOSPC",), "getdents64": ("EIO",), "statx": ("EIO",), "fchmod": ("EPERM",), "fallocate": ("ENOSPC",),
}
DAMAGES = ("removed", "cut", "replaced", "forbidden")


def strace(injected, trace, command):
    return ["strace", "-f", "-y", "-qq", "-s", "0", "-o", trace, "-e", "signal=none", *injected, *command]


def run(program, words, out):
    with open(out, "w", encoding="utf-8") as file:
        return subprocess.run([program, *words], stdin=subprocess.DEVNULL, stdout=file, stderr=subprocess.STDOUT,
                              timeout=PATIENCE_S, check=False).returncode


def content(path):
    """A digest of each file at a path, by its name below it."""
    if os.path.isfile(path):
        return {"": hashlib.sha256(open(path, "rb").read()).hexdigest()}
    return {os.path.relpath(os.path.join(folder, name), path):
            hashlib.sha256(open(os.path.join(folder, name), "rb").read()).hexdigest()
            for folder, _, names in os.walk(path) for name in names}


def inputs(program, folder):
    """What the verbs read: trials, a capture, one that is cut short, a model of another format."""
    def made(*words):
        if run(program, words, f"{folder}/made") != 0:
            sys.exit(f"joulebus {' '.join(words)}: {open(f'{folder}/made', encoding='utf-8').read()}")
    name = f"f{os.getpid() % 1_000_000}"
    with open(f"{folder}/fleet.toml", "w", encoding="utf-8") as config:
        config.write(f'[fleet]\nname = "{name}"\ncapacity = 4\n[domain]\nroot = "/dev/shm/{name}"\nprefix = "{name}_"\n'
                     f'[ledger]\ncheckpoint = "{folder}/ledger.json"\n''[[platform]]\nfile = "builtin:gternal"\nrobots = ["0-3"]\n')
    made("data", "simulate", f"{folder}/all", "--steps", "300")
    os.mkdir(f"{folder}/trials")
    for robot in (1, 2, 3):
        os.rename(f"{folder}/all/energy_data_seven_robots_robot{robot}.npy", f"{folder}/trials/robot{robot}.npy")
    shutil.rmtree(f"{folder}/all")
    made("model", "export", MODEL, "--to", "npz", "-o", f"{folder}/exported.npz")
    members = [subprocess.Popen([program, *words, "--config", f"{folder}/fleet.toml"], stdin=subprocess.DEVNULL,
                                stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
               for words in (["run"], ["publish", "sim", "--robots", "3"])]
    made("record", "--config", f"{folder}/fleet.toml", "-o", f"{folder}/capture.mcap", "--duration", "4")
    for member in members:
        member.terminate()
        member.wait(PATIENCE_S)
    whole = open(f"{folder}/capture.mcap", "rb").read()
    with open(f"{folder}/cut.mcap", "wb") as cut:
        cut.write(whole[:len(whole) * 2 // 3])


class Verb:
    """A verb with its inputs, in a folder that is made anew for each run."""

    def __init__(self, program, line, source, scratch):
        self.program, self.line, self.source, self.scratch = program, line, source, scratch
        self.words, self.folder, self.new = [], f"{scratch}/in", f"{scratch}/out/new"

    def prepare(self):
        shutil.rmtree(self.scratch)
        os.mkdir(self.scratch)
        shutil.copytree(self.source, self.folder)
        os.mkdir(f"{self.scratch}/out")
        suffix = ".mcap" if self.line.startswith(("record", "recover")) else ".toml" if "config init" in self.line else ""
        self.new = f"{self.scratch}/out/new{suffix}"
        return [word.replace("{}", self.folder).replace("NEW", self.new).replace("MODEL", f"{self.folder}/model")
                for word in self.line.split()]

    def start(self, injected):
        self.words = self.prepare()
        with open(f"{self.scratch}/said", "w", encoding="utf-8") as said:
            return subprocess.Popen(strace(injected, f"{self.scratch}/trace", [self.program, *self.words]),
                                    stdin=subprocess.DEVNULL, stdout=said, stderr=subprocess.STDOUT, start_new_session=True)

    def steps(self):
        """Calls that reach its files: name, number within its thread, path."""
        process = self.start(())
        code, found, counts = process.wait(PATIENCE_S), [], {}
        for line in open(f"{self.scratch}/trace", encoding="utf-8", errors="replace"):
            call = re.match(r"(\d+) +(\w+)\((.*)", line)
            if not call or call[2] not in FAILING:
                continue
            key = (call[1], call[2])
            counts[key] = counts.get(key, 0) + 1
            path = re.search(rf"{re.escape(self.scratch)}/(in|out)/[^\">]*", call[3])
            if path:
                found.append((call[2], counts[key], path[0]))
        return code, found

    def judge(self, code, right, is_ours):
        """What does not hold. `is_ours`: what stands at the result's path was put there from outside."""
        said = open(f"{self.scratch}/said", encoding="utf-8", errors="replace").read()
        if code is None:
            return "does not end"
        if code == 127 and "shared libraries" in said:
            return None
        if code not in (0, 1, 2, 3):
            return f"ends with {code}"
        if "panicked at" in said:
            return "panics"
        if code == 0:
            if not os.path.exists(self.new):
                return "ends with 0, and its result is not there"
            if right is not None and content(self.new) != right:
                return "ends with 0, and its result is another"
            return None
        if not said.strip():
            return f"ends with {code} and says no reason"
        if code != 3 and os.path.isfile(self.new) and not is_ours:
            return f"ends with {code}, and a result stands there"
        if code != 3 and self.line.startswith("export") and os.path.isdir(f"{self.new}/_joulebus"):
            # Whole recordings stay, and nothing of the others.
            found = content(self.new)
            listed = {trial["file"] for name in found if name.endswith(".recording")
                      for trial in json.load(open(f"{self.new}/{name}", encoding="utf-8"))["trials"]}
            there = {name for name in found if name.endswith(".parquet")}
            return None if listed == there else f"ends with {code}, lists {sorted(listed)} and has {sorted(there)}"
        if code != 3 and os.path.isdir(self.new) and not is_ours:
            # Part of a folder may stay, if the same call makes it whole.
            again = run(self.program, self.words, f"{self.scratch}/said")
            if again not in (0, 3) or right is not None and content(self.new) != right:
                return f"ends with {code}, and the same call again with {again}"
        return None


def damage(path, how):
    """Damages a file or folder. `False` where that is not possible."""
    try:
        if how == "removed":
            shutil.rmtree(path) if os.path.isdir(path) else os.remove(path)
        elif how == "forbidden":
            # Root may everything: a path that is a folder, or a file, in place of the other.
            was_folder = os.path.isdir(path)
            shutil.rmtree(path) if was_folder else os.remove(path)
            open(path, "w", encoding="utf-8").close() if was_folder else os.mkdir(path)
        elif os.path.isdir(path):
            return False
        elif how == "cut":
            os.truncate(path, os.path.getsize(path) // 2)
        else:
            with open(path + ".other", "wb") as other:
                other.write(b"something else\n" * 10)
            os.replace(path + ".other", path)
    except (FileNotFoundError, FileExistsError, IsADirectoryError):
        # Made again meanwhile, or gone.
        return False
    return True


def stopped(process):
    """The traced process once it has been stopped. None if it ended."""
    until = time.monotonic() + PATIENCE_S
    while process.poll() is None and time.monotonic() < until:
        try:
            with open(f"/proc/{process.pid}/task/{process.pid}/children", encoding="utf-8") as children:
                pids = children.read().split()
            for pid in pids:
                with open(f"/proc/{pid}/status", encoding="utf-8") as status:
                    if "SigPnd" in (text := status.read()) and re.search(r"State:\s+[Tt]", text):
                        time.sleep(0.02)
                        with open(f"/proc/{pid}/status", encoding="utf-8") as again:
                            if re.search(r"State:\s+[Tt]", again.read()):
                                return int(pid)
        except (FileNotFoundError, ProcessLookupError):
            pass
        time.sleep(0.005)
    return None


def chosen(steps, count):
    """Steps from all of a list, the first and last among them."""
    if len(steps) <= count:
        return steps
    return [steps[round(place * (len(steps) - 1) / (count - 1))] for place in range(count)]


def attempt(verb, count):
    """All that is tried with one verb: what, and what did not hold."""
    verb.prepare()
    code, steps = verb.steps()
    if code not in (0, 3) or not os.path.exists(verb.new):
        said = open(f"{verb.scratch}/said", encoding="utf-8").read()
        return [("as it is", f"ends with {code}: {said[-400:]}")]
    first = content(verb.new)
    verb.start(()).wait(PATIENCE_S)
    right = first if content(verb.new) == first else None
    results = []
    for call in sorted({call for call, _, _ in steps}):
        for number in chosen(sorted({number for name, number, _ in steps if name == call}), count):
            for error in FAILING[call]:
                process = verb.start(("-e", f"inject={call}:error={error}:when={number}"))
                results.append((f"{call} {number}: {error}", ended(verb, process, right)))
    paths = {}
    for call, number, path in steps:
        # Who changes a file under its temporary name wants to deceive, and could as well later.
        if not re.search(r"/(#\d+|\.joulebus-)", path):
            paths.setdefault(path, []).append((call, number))
    for path, calls in chosen(sorted(paths.items()), count):
        for call, number in chosen(calls, max(2, count // 4)):
            for how in DAMAGES:
                process = verb.start(("-e", f"inject={call}:signal=SIGSTOP:when={number}"))
                pid = stopped(process)
                # What stands there is whole. Only a recorder looks at it again.
                is_done = os.path.isfile(path) and path.startswith(verb.new) and not verb.line.startswith("record")
                done = pid is not None and not is_done and damage(path, how)
                wrong = ended(verb, process, right, pid, path.startswith(verb.new))
                if done:
                    results.append((f"{os.path.relpath(path, verb.scratch)} {how} at {call} {number}", wrong))
    return results


def ended(verb, process, right, pid=None, is_ours=False):
    """What does not hold once a call has ended. `pid` was stopped, and goes on."""
    until = time.monotonic() + PATIENCE_S
    while (code := process.poll()) is None and time.monotonic() < until:
        # Again and again: one that comes before strace has let the signal to stop through is lost.
        if pid is not None:
            try:
                os.kill(pid, signal.SIGCONT)
            except ProcessLookupError:
                pid = None
        time.sleep(0.01)
    if code is None:
        os.killpg(process.pid, signal.SIGKILL)
        process.wait()
    return verb.judge(code, right, is_ours)


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--only", default="", help="verbs that begin with this [all]")
    parser.add_argument("--steps", type=int, default=12, help="steps of each kind, from all [12]")
    parser.add_argument("--program", help="the program [target/debug/joulebus, which is built]")
    parser.add_argument("--report", default="target/failing_files.json", help="the report's file [target/failing_files.json]")
    given = parser.parse_args()
    tracing = shutil.which("strace") and subprocess.run(
        ["strace", "-qq", "-o", "/dev/null", "-e", "inject=?acct:error=EPERM", "true"], check=False, capture_output=True)
    if not tracing or tracing.returncode != 0:
        print("skipped: strace is missing, or may not trace here", file=sys.stderr)
        return 0
    if not given.program:
        subprocess.run(["cargo", "build", "--locked", "-q", "-p", "joulebus", "-p", "joulebus-lab", "-p", "joulebus-link"], cwd=ROOT, check=True)
    program = os.path.abspath(given.program or os.path.join(ROOT, "target/debug/joulebus"))
    table = []
    with tempfile.TemporaryDirectory(prefix="joulebus-files-") as scratch:
        source = f"{scratch}/source"
        os.mkdir(source)
        inputs(program, source)
        shutil.copy(MODEL, f"{source}/model")
        for line in VERBS:
            if not line.startswith(given.only):
                continue
            place = f"{scratch}/run"
            shutil.rmtree(place, ignore_errors=True)
            os.mkdir(place)
            results = attempt(Verb(program, line, source, place), given.steps)
            wrong = [(what, said) for what, said in results if said]
            table.append({"verb": line, "tried": len(results), "wrong": wrong})
            print(f"{line:70} {len(results):4} tried, {len(wrong)} wrong", flush=True)
            for what, said in wrong:
                print(f"  {what}: {said}", flush=True)
    with open(os.path.join(ROOT, given.report), "w", encoding="utf-8") as out:
        json.dump(table, out, indent=1)
    wrong = sum(len(one["wrong"]) for one in table)
    print(f"{sum(one['tried'] for one in table)} attempts at {len(table)} verbs, {wrong} wrong; {given.report}")
    return 1 if wrong or not table else 0


if __name__ == "__main__":
    sys.exit(main())
