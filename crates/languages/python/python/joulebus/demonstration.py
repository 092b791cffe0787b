"""A fleet to try things with: simulated robots with batteries, a worker, and a planner."""
from __future__ import annotations

import fcntl
import os
import select
import shutil
import subprocess
import sys
import time
from pathlib import Path
from types import TracebackType
from typing import IO

import numpy as np

from . import _native
from .live import Planner, Publisher

#: Longest wait for the first answers, s: on a machine with much other work a start takes long.
_PATIENCE_S = 60.0
_PERIOD_S = 1 / 30


class Demo:
    """A running demo. ``planner`` is connected to its fleet. ``config`` is the fleet's file, for other planners and for the
    program's verbs (``joulebus watch --config …``). ``robots`` are their ids."""

    planner: Planner

    def __init__(self, robots: int, seed: int) -> None:
        if not 1 <= robots <= 100_000:
            raise ValueError(f"robots is {robots}, allowed are 1 to 100000")
        self.robots = np.arange(robots)
        self._root, self._lock = _scratch(robots)
        self.config = self._root / "demo.toml"
        self._process: subprocess.Popen[bytes] | None = None
        self._pid = os.getpid()
        try:
            self._process = self._started(seed)
            self.planner = Planner(self.config, "demo")
            self._wait_for_answers()
        except BaseException:
            self.close()
            raise

    def _started(self, seed: int) -> subprocess.Popen[bytes]:
        # The same package, wherever this process has it from.
        arguments = (str(self._root), len(self.robots), seed, os.getpid())
        code = f"import sys; sys.path[:] = {sys.path!r}; from joulebus.demonstration import play; play{arguments!r}"
        with open(self._root / "log", "wb") as log:
            # A session of its own: Ctrl-C reaches this process alone, which then ends the other.
            return subprocess.Popen(
                [sys.executable, "-c", code],
                stdin=subprocess.PIPE,
                stdout=log,
                stderr=log,
                pass_fds=[self._lock.fileno()],
                start_new_session=True,
            )

    def _wait_for_answers(self) -> None:
        end = time.monotonic() + _PATIENCE_S
        while True:
            try:
                if "unknown" not in self.planner.ask(self.robots, idle_s=1.0).verdict.tolist():
                    return
            except (KeyError, _native.ReadError):
                # No frame yet, or one from before the first samples.
                pass
            if self._process is None or self._process.poll() is not None or time.monotonic() > end:
                log = (self._root / "log").read_text(errors="replace").strip()
                raise _native.ConnectError(f"the demo's fleet does not start: {log or f'no answer for {_PATIENCE_S:g} s'}")
            time.sleep(0.02)

    def close(self) -> None:
        """Ends planner, fleet and worker, and removes their files. Closing again does nothing."""
        if self._pid != os.getpid():
            # A child made by `fork`: the fleet is its parent's.
            return
        if hasattr(self, "planner"):
            self.planner.close()
        process, self._process = self._process, None
        if process is not None:
            try:
                # Also while a process that was forked meanwhile holds the pipe open.
                process.communicate(b"end", timeout=10.0)
            except (subprocess.TimeoutExpired, BrokenPipeError):
                process.kill()
                process.wait()
        _removed(self._root)
        self._lock.close()

    def __enter__(self) -> Demo:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def __repr__(self) -> str:
        return f"Demo(robots={len(self.robots)}, config={str(self.config)!r})"


def demo(robots: int = 20, *, seed: int = 7) -> Demo:
    """Starts `robots` simulated GTernal robots with the shipped model and battery, a worker, and a planner.

        with joulebus.demo() as demo:
            print(demo.planner.ask(7, [(0.0, 0.0), (1.0, 0.0)], back_to=(0.0, 0.0))[0].verdict)

    Worker and robots are in a process of their own, their files in a directory of their own in
    memory. The end of the block removes both, even after an exception or Ctrl-C. The end of this
    process removes them too. The call returns when questions about every robot have an answer,
    after some two seconds.
    """
    return Demo(robots, seed)


def _scratch(robots: int) -> tuple[Path, IO[str]]:
    """A new directory with the config, which stays locked: by that `joulebus demo` knows what killed demos left."""
    for number in range(os.getpid(), 1 << 32):
        root = Path(f"/dev/shm/joulebus-{os.geteuid()}-demo-{number}")
        try:
            root.mkdir(mode=0o700)
            break
        except FileExistsError:
            continue
    lock = open(root / "demo.toml", "x", encoding="utf-8")
    fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
    lock.write(_native.demo_config(root, robots))
    lock.flush()
    return root, lock


def _removed(root: Path) -> None:
    if root.is_dir():
        try:
            _native.sweep_demo(root / "demo.toml")
        finally:
            shutil.rmtree(root, ignore_errors=True)


def play(folder: str, robots: int, seed: int, parent: int) -> None:
    """The other process: runs worker and robots until its standard input says so, or its parent is dead."""
    root, config = Path(folder), Path(folder, "demo.toml")
    try:
        worker = _native.DemoWorker(config)
        try:
            with Publisher(config, "demo-robots") as publisher:
                _drive(publisher, _native.DemoRobots(seed, robots), np.arange(robots))
        finally:
            worker.stop()
    finally:
        # A living parent still reads the log, and removes all of it itself.
        if os.getppid() != parent:
            _removed(root)


def _drive(publisher: Publisher, robots: _native.DemoRobots, ids: np.ndarray) -> None:
    due = before = time.monotonic()
    while True:
        due = max(due + _PERIOD_S, time.monotonic())
        if select.select([sys.stdin], [], [], max(0.0, due - time.monotonic()))[0]:
            return
        now = time.monotonic()
        columns = robots.step(now - before)
        before = now
        if publisher.publish(ids, **columns) == 0:
            raise RuntimeError("the demo's worker has ended")
