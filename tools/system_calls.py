#!/usr/bin/env python3
"""Lets system calls fail beneath a fleet's processes, and looks whether they end well.

    tools/system_calls.py --minutes 5 --seed 7

Each round makes a fleet of its own: worker, source, recorder and live view. strace lets one of
them start or work with calls that fail: once, from some call on for a while, or every few calls.
What must hold: nobody ends by a signal or a panic, an exit code is one of the documented ones
(0 to 3) and not 0 without a result, a signal to end is obeyed, EINTR ends nobody, and afterwards a
new fleet of the same name works and leaves nothing behind.

A round that fails is printed with the seed that repeats it. Ends with 1 if one failed. Needs
`strace`: without it, or where it may not trace, it says that it skips.
"""

import argparse
import os
import random
import shutil
import signal
import subprocess
import sys
import tempfile
import time

ROOT = os.path.dirname(os.path.dirname(os.path.abspath(__file__)))
PATIENCE_S = 120
# Calls that wait, which a signal may interrupt. Linux interrupts none that opens, reads or writes a
# file.
INTERRUPTED = ("clock_nanosleep recvfrom sendto recvmsg sendmsg poll ppoll epoll_wait futex flock fallocate "
               "accept4").split()
# Calls with the errors that they may have on a machine that works badly.
FAILING = {
    "openat": ("EMFILE", "ENFILE", "EACCES", "ENOMEM", "EIO"), "read": ("EIO", "EAGAIN", "EINTR"), "write": ("EIO", "ENOSPC", "EINTR"),
    "pread64": ("EIO",), "fsync": ("EIO", "ENOSPC"), "ftruncate": ("EIO", "ENOSPC"), "fallocate": ("ENOSPC", "ENOSYS"),
    "rename": ("EIO", "EACCES", "ENOSPC"), "renameat2": ("EIO", "EINVAL", "ENOSYS"), "unlink": ("EIO", "EACCES", "EBUSY"),
    "mkdir": ("ENOSPC", "EACCES"), "rmdir": ("EBUSY",), "flock": ("ENOLCK",), "fcntl": ("EIO", "EACCES"),
    "statx": ("EIO", "EACCES"), "newfstatat": ("EIO",), "getdents64": ("EIO",), "statfs": ("ENOSYS",),
    "clone3": ("EAGAIN", "ENOMEM"), "socket": ("EMFILE", "EACCES"), "bind": ("EACCES", "EADDRINUSE"),
    "recvfrom": ("ENOMEM",), "sendto": ("ENOBUFS",), "fchmod": ("EPERM",), "setpriority": ("EACCES",),
    "sched_setscheduler": ("EPERM",), "mlockall": ("ENOMEM",), "sched_setaffinity": ("EINVAL",), "getrandom": ("ENOSYS",),
    "readlink": ("EACCES",),
}
ROLES = ("worker", "source", "recorder", "view")


class Fleet:
    """A fleet in a folder of its own."""

    def __init__(self, program, folder):
        self.program, self.folder, self.running = program, folder, {}
        self.name = f"c{os.getpid() % 1_000_000}"
        with open(os.path.join(folder, "fleet.toml"), "w", encoding="utf-8") as config:
            config.write(f'[fleet]\nname = "{self.name}"\ncapacity = 10\n[domain]\nroot = "/dev/shm/{self.name}"\n'
                         f'prefix = "{self.name}_"\n[ledger]\ncheckpoint = "{folder}/ledger.json"\nevery_s = 0.2\n'
                         '[[platform]]\nfile = "builtin:gternal"\nrobots = ["0-9"]\n')

    def start(self, role, injected=()):
        words = {"worker": ["run"], "source": ["publish", "sim", "--robots", "3"], "view": ["watch", "--format", "json"],
                 "recorder": ["record", "-o", f"{self.folder}/capture.mcap"]}[role]
        traced = []
        if injected:
            traced = ["strace", "-f", "-qq", "-o", f"{self.folder}/{role}.trace", "-e", "signal=none", *injected]
        with open(self.output(role), "w", encoding="utf-8") as out:
            self.running[role] = subprocess.Popen(
                [*traced, self.program, *words, "--config", f"{self.folder}/fleet.toml"],
                stdin=subprocess.DEVNULL, stdout=out, stderr=subprocess.STDOUT, start_new_session=True)

    def output(self, role):
        return f"{self.folder}/{role}.out"

    def text(self, role):
        with open(self.output(role), encoding="utf-8", errors="replace") as out:
            return out.read()

    def sees_robots(self):
        """Whether the live view has shown forecasts since it was asked."""
        before = len(self.text("view"))
        until = time.monotonic() + PATIENCE_S
        while time.monotonic() < until and self.running["view"].poll() is None:
            if '"power_w":' in self.text("view")[before:]:
                return True
            time.sleep(0.1)
        return False

    def end(self):
        """Ends all as a user would. Returns the exit codes by role, None of one that had to be killed."""
        codes = {}
        for role in reversed(self.running):
            process = self.running[role]
            if process.poll() is None:
                # strace passes no signal on: its child gets it.
                with open(f"/proc/{process.pid}/task/{process.pid}/children", encoding="utf-8") as children:
                    pids = [int(pid) for pid in children.read().split()] if process.args[0] == "strace" else []
                for pid in pids or [process.pid]:
                    os.kill(pid, signal.SIGTERM)
            try:
                codes[role] = process.wait(PATIENCE_S)
            except subprocess.TimeoutExpired:
                os.killpg(process.pid, signal.SIGKILL)
                codes[role] = process.wait() and None
        self.running = {}
        return codes

    def left_behind(self):
        return [name for name in os.listdir("/dev/shm") if name.startswith(self.name)]


def injection(dice):
    """What fails in a round: arguments of strace, and whether all must go on as usual."""
    interrupts = dice.random() < 0.4
    call = dice.choice(INTERRUPTED if interrupts else sorted(FAILING))
    error = "EINTR" if interrupts else dice.choice(FAILING[call])
    first = dice.choice((1, 2, 5, 20, 100, 400)) + dice.randrange(5)
    when = dice.choice((f"{first}", f"{first}..{first + dice.randrange(1, 40)}", f"{first}+{dice.randrange(2, 30)}"))
    return ["-e", f"inject=?{call}:error={error}:when={when}"], interrupts


def attempt(program, seed):
    """One round: what was injected, and what was wrong."""
    dice = random.Random(seed)
    wrong = []
    role = dice.choice(ROLES)
    injected, as_usual = injection(dice)
    with tempfile.TemporaryDirectory(prefix="joulebus-calls-") as folder:
        fleet = Fleet(program, folder)
        for each in ROLES:
            fleet.start(each, injected if each == role else ())
        others_work = role in ("worker", "view") or fleet.sees_robots()
        if as_usual and not fleet.sees_robots():
            wrong.append("no forecasts, although nothing but interruptions came")
        if not others_work and role != "source":
            wrong.append(f"nothing is forecast because of the {role}")
        time.sleep(1 + dice.random())
        alive = {each: process.poll() is None for each, process in fleet.running.items()}
        codes = fleet.end()
        texts = {each: fleet.text(each) for each in ROLES}
        for each, code in codes.items():
            if code is None:
                wrong.append(f"the {each} does not end")
            elif code not in (0, 1, 2, 3) and "while loading shared libraries" not in texts[each]:
                wrong.append(f"the {each} ends with {code}")
            elif as_usual and not (alive[each] and code in (0, 3)):
                wrong.append(f"the {each} has ended with {code}, although all should go on")
            elif each != role and not alive[each] and role != "worker":
                wrong.append(f"the {each} has ended with {code} because of the {role}")
            if "panicked at" in texts[each]:
                wrong.append(f"the {each} panics")
            if code in (1, 2) and "error:" not in texts[each]:
                wrong.append(f"the {each} ends with {code} and says no reason")
        # A new one of the same name.
        for each in ("worker", "source", "view"):
            fleet.start(each)
        if not fleet.sees_robots():
            wrong.append("the next fleet does not work")
        wrong += [f"the next fleet's {each} ends with {code}" for each, code in fleet.end().items() if code != 0]
        if fleet.left_behind():
            wrong.append(f"left behind: {', '.join(fleet.left_behind())}")
            for name in fleet.left_behind():
                path = f"/dev/shm/{name}"
                shutil.rmtree(path, ignore_errors=True) if os.path.isdir(path) else os.remove(path)
    what = f"{role}: {injected[-1].removeprefix('inject=?')}"
    ends = [texts[role][-600:]] if wrong else []
    return what, wrong, ends


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--minutes", type=float, default=5.0, help="how long rounds begin [5]")
    parser.add_argument("--seed", type=int, default=1, help="of the first round [1]")
    parser.add_argument("--program", help="the program [target/debug/joulebus, which is built]")
    given = parser.parse_args()
    tracing = shutil.which("strace") and subprocess.run(
        ["strace", "-qq", "-o", "/dev/null", "-e", "inject=?acct:error=EPERM", "true"], check=False, capture_output=True)
    if not tracing or tracing.returncode != 0:
        print("skipped: strace is missing, or may not trace here", file=sys.stderr)
        return 0
    if not given.program:
        subprocess.run(["cargo", "build", "--locked", "-q", "-p", "joulebus"], cwd=ROOT, check=True)
    program = os.path.abspath(given.program or os.path.join(ROOT, "target/debug/joulebus"))
    rounds, seed, until = [], given.seed, time.monotonic() + 60 * given.minutes
    while time.monotonic() < until:
        what, wrong, ends = attempt(program, seed)
        rounds.append(wrong)
        print(f"seed {seed:<6} {what:60} {'ok' if not wrong else 'FAILED'}", flush=True)
        for line in wrong:
            print(f"  {line}; again: tools/system_calls.py --minutes 0.01 --seed {seed}", flush=True)
        print(*ends, sep="\n", end="", flush=True)
        seed += 1
    failed = [wrong for wrong in rounds if wrong]
    print(f"{len(rounds)} rounds, {len(failed)} failed")
    return 1 if failed or not rounds else 0


if __name__ == "__main__":
    sys.exit(main())
