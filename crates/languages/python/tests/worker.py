"""A fleet of one test: its config, its worker as a real process, and its shared memory, removed at the end."""
from __future__ import annotations

import itertools
import os
import shutil
import signal
import subprocess
import time
from pathlib import Path

import numpy as np

_NUMBERS = itertools.count()
#: Longest time that a test waits for a condition: for a machine with much other work.
PATIENCE_S = 120.0


class Fleet:
    def __init__(self, program: Path, folder: Path, robots: int = 16, planners: int = 4, battery: str = "") -> None:
        name = f"joulebus-pytest-{os.getpid()}-{next(_NUMBERS)}"
        # A process uses one domain: its tests share the names, one after the other. At most 8
        # letters.
        self.prefix = f"p{os.getpid() % 0x1000000:06x}"
        self.program, self.root, self.folder = program, Path("/dev/shm", f"{self.prefix}.d"), folder
        self.config = folder / f"{name}.toml"
        self.config.write_text(
            f"""
[fleet]
name = "test"
capacity = {max(robots, 16)}
[domain]
root = "{self.root}"
prefix = "{self.prefix}"
[intake]
# A recorder that gets no processor for seconds loses nothing.
buffer_frames = 256
[readers]
max_planners = {planners}
[[platform]]
file = "builtin:gternal"
robots = ["0-{robots - 1}"]
{battery}"""
        )
        self.process: subprocess.Popen[bytes] | None = None

    def start(self) -> None:
        log = open(self.folder / "worker.log", "ab")
        command = [self.program, "run", "--config", self.config]
        state = {"XDG_STATE_HOME": str(self.folder / "state")}
        self.process = subprocess.Popen(command, stdout=log, stderr=log, env=os.environ | state)
        log.close()

    def kill(self) -> None:
        self.process.send_signal(signal.SIGKILL)
        self.process.wait()

    def log(self) -> str:
        return (self.folder / "worker.log").read_text(errors="replace")

    def close(self) -> None:
        if self.process is not None and self.process.poll() is None:
            self.process.terminate()
            try:
                self.process.wait(PATIENCE_S)
            except subprocess.TimeoutExpired:
                self.kill()
        shutil.rmtree(self.root, ignore_errors=True)
        for left in Path("/dev/shm").glob(f"{self.prefix}*"):
            left.unlink(missing_ok=True)


def until(what: str, condition, fleet: Fleet | None = None):
    """Waits until `condition()` is neither None nor false, and returns it. A number is a result, also 0."""
    end = time.monotonic() + PATIENCE_S
    while time.monotonic() < end:
        found = condition()
        if found is not None and not (isinstance(found, (bool, np.bool_)) and not found):
            return found
        time.sleep(0.01)
    raise AssertionError(f"waited {PATIENCE_S} s in vain for {what}\n{fleet.log() if fleet else ''}")
