"""Runs what users copy: every controller of README, docs and examples in Rust, C, C++ and Python, all at once for a minute
beside one worker, one page and the planners of the same pages. No alarm may be raised, and no robot may be anything but ok.

tools/readme_projects.py builds the Rust programs and calls this. Each controller gets robots of its own: its first id is
replaced in a copy of its text. A source of the same name replaces another, so each text also has a name of its own.
"""
import json
import os
import re
import shutil
import signal
import subprocess
import sys
import tempfile
import time
import urllib.request
from pathlib import Path

import blocks

ROOT = Path(__file__).resolve().parent.parent
SECONDS = 60.0
READY_S = 600.0
# Of all controllers.
ROBOTS = 20 + 20 + 8 + 1 + 2 + 8 + 20 + 8
# Alarms that a machine without a free processor raises, whatever is published.
BUSY = {"WorkerStale", "DeadlineMissed"}
ADDRESS = r"http://[\d.]+:\d+"
FLEET = """[fleet]
name = "snippets"
[domain]
root = "/dev/shm/jbsn{pid}"
prefix = "sn{mark}_"
[ledger]
checkpoint = ""
[readers]
max_planners = 16
[[platform]]
file = "builtin:gternal"
robots = ["0-99"]
# How long a busy machine lets a program wait says nothing about what it does.
stale_after_s = 30.0
hold_max_s = 10.0
"""


def block(page, language, containing):
    """The only code block of a page in this language with this text."""
    found = [one.text for one in blocks.blocks(page) if one.language == language and containing in one.text]
    assert len(found) == 1, f"{page}: {len(found)} blocks of {language} with {containing!r}"
    return found[0]


def moved(text, ids, to):
    """A program with robots of its own."""
    assert text.count(ids) == 1, f"{ids!r} is there {text.count(ids)} times"
    return text.replace(ids, to)


class Programs:
    """Processes in a folder with a fleet's config, as in a clone."""

    def __init__(self, folder, environment):
        self.folder, self.environment, self.running = folder, environment, {}

    def start(self, name, *command):
        with open(self.folder / f"{name}.log", "wb") as log:
            process = subprocess.Popen(command, stdout=log, stderr=log, cwd=self.folder, env=self.environment)
        self.running[name] = process

    def log(self, name):
        return (self.folder / f"{name}.log").read_text(errors="replace")

    def until(self, name, text):
        """Waits until a program has written this, and returns its log."""
        end = time.monotonic() + READY_S
        while (written := self.log(name)) is not None and not re.search(text, written):
            assert self.running[name].poll() is None and time.monotonic() < end, f"{name}: no {text!r}\n{written}"
            time.sleep(0.05)
        return written

    def stop(self):
        for process in self.running.values():
            if process.poll() is None:
                process.send_signal(signal.SIGTERM)
        for process in self.running.values():
            try:
                process.wait(20)
            except subprocess.TimeoutExpired:
                process.kill()


def built(folder, built_at):
    """The C and C++ programs, with the library of the workspace's build."""
    subprocess.run(["tools/install_c.sh", "--prefix", folder / "prefix", "--from", built_at], cwd=ROOT, check=True, stdout=subprocess.DEVNULL)
    flags = [f"-I{folder}/prefix/include", f"-L{folder}/prefix/lib", "-ljoulebus", "-pthread"]
    c, cpp = ["cc", "-std=gnu11"], ["c++", "-std=c++17"]
    sources = {
        "docs-c": (c, ".c", moved(block("docs/tutorial/cpp.md", "c", "joulebus_publisher_open"), "FIRST = 0", "FIRST = 40")),
        "docs-cpp": (cpp, ".cpp", moved(block("docs/tutorial/cpp.md", "cpp", "Publisher::open"), "RobotState(0)", "RobotState(50)")),
        "example-c": (c, ".c", moved((ROOT / "examples/c/controller.c").read_text(), ".robot = robot", ".robot = 60 + robot")),
        "example-cpp": (cpp, ".cpp", moved((ROOT / "examples/cpp/controller.cpp").read_text(), "RobotState(robot)", "RobotState(70 + robot)")),
    }
    for name, (compiler, suffix, text) in sources.items():
        (folder / (name + suffix)).write_text(text)
        subprocess.run([*compiler, "-Wall", "-Wextra", "-Werror", folder / (name + suffix), *flags, "-o", folder / name], check=True)
        yield name, [folder / name, *([folder / "configs/fleet.toml"] if name.startswith("example") else [])]


def said_yes(command, programs):
    """Whether a program says yes, run again until it does: on a busy machine frames are stale now and then."""
    end = time.monotonic() + READY_S
    while time.monotonic() < end:
        asked = subprocess.run(command, cwd=programs.folder, env=programs.environment, capture_output=True, text=True)
        if asked.returncode == 0 and re.search(r"\byes\b", asked.stdout):
            print(asked.stdout.splitlines()[0])
            return True
    print(asked.stdout, asked.stderr, file=sys.stderr)
    return False


def complaints(folder, target, programs):
    """Runs everything for a minute. Returns what was wrong, as text."""
    config, joulebus, rust = folder / "configs/fleet.toml", target / "debug/joulebus", target / "debug"
    python = target / "python/bin/python"
    publishes = moved(block("docs/reference/python.md", "python", "joulebus.Publisher("), "np.arange(0, 8)", "np.arange(90, 98)")
    controllers = dict(built(folder, target / "debug/deps")) | {
        "controller": [rust / "controller"],
        "two-robots": [rust / "two-robots"],
        "example": [rust / "example", config, "1000000"],
        "docs-python": [python, "-c", publishes],
    }
    planners = {"planner": [rust / "planner"], "python-planner": [python, "-c", block("docs/reference/python.md", "python", "planner.events(")]}
    programs.start("worker", joulebus, "run", "--config", config)
    programs.until("worker", "ready: fleet")
    programs.start("page", rust / "joulebus-serve", "--http", "127.0.0.1:0", "--config", config)
    address = re.search(ADDRESS, programs.until("page", ADDRESS))[0]
    programs.start("alarms", joulebus, "alarms", "--config", config, "--format", "json")
    for name, command in controllers.items():
        programs.start(name, *command)
    end = time.monotonic() + SECONDS
    programs.start("planner", *planners["planner"])
    programs.until("planner", "robot 7 will draw")
    programs.start("python-planner", *planners["python-planner"])
    wrong = [f"{name} does not say yes" for name in ("planning", "queries") if not said_yes([rust / name], programs)]
    while time.monotonic() < end:
        time.sleep(0.5)
    with urllib.request.urlopen(f"{address}/api/v1/robots?count=100", timeout=30) as answer:
        robots = json.load(answer)["robots"]
    wrong += [f"{name} has ended\n{programs.log(name)}" for name, process in programs.running.items() if process.poll() is not None]
    changes = [json.loads(line) for line in programs.log("alarms").splitlines() if line.startswith("{")]
    wrong += [f"an alarm: {change}" for change in changes if change["alarm"] not in BUSY]
    wrong += [f"robot {robot['robot']} is {robot['level']}: {robot}" for robot in robots
              if robot["level"] != "ok" and not BUSY.issuperset(robot["alarms"] or {"unknown"})]
    wrong += [] if len(robots) == ROBOTS else [f"{len(robots)} robots on the page, {ROBOTS} are published"]
    print(f"{len(controllers)} controllers in four languages beside one worker and one page: {len(robots)} robots, {len(wrong)} complaints")
    return wrong


def run(target):
    """Whether something was wrong."""
    missing = [tool for tool in ("cc", "c++") if not shutil.which(tool)]
    python = target / "python/bin/python"
    # What tools/python_package.sh --workspace leaves.
    os.environ["PYTHONPATH"] = str(target / "python-package")
    if not python.exists() or subprocess.run([python, "-c", "import joulebus"], capture_output=True).returncode:
        missing.append(f"{python} with joulebus (tools/python_package.sh --workspace)")
    if missing:
        print(f"snippets: skipped: {', '.join(missing)} is missing", file=sys.stderr)
        return os.environ.get("CI") == "true"
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        (folder / "configs").mkdir()
        (folder / "configs/fleet.toml").write_text(FLEET.format(pid=os.getpid(), mark=os.getpid() % 100_000))
        programs = Programs(folder, os.environ | {"LD_LIBRARY_PATH": str(folder / "prefix/lib"), "PYTHONUNBUFFERED": "1"})
        try:
            wrong = complaints(folder, target, programs)
        finally:
            programs.stop()
    print("\n".join(wrong), file=sys.stderr, end="\n" if wrong else "")
    return bool(wrong)


if __name__ == "__main__":
    sys.exit(run(ROOT / "target"))
