"""Projects of `joulebus new --lang python` run as printed, beside a real worker."""
from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest
from worker import Fleet, until

BATTERY = "[platform.battery]\ncapacity_wh = 10.0\ninitial_soc_lo = 0.9\n"
# Alarms that a late process raises: a test does not depend on being scheduled.
OF_TIMING = {"NoData", "HeldTooLong", "DeadlineMissed", "WatchdogStop", "WorkerStale", "WorkerGone"}


@pytest.fixture
def fleet(program, tmp_path):
    made = Fleet(program, tmp_path, 20, battery=BATTERY)
    yield made
    made.close()


class Project:
    """A project, and its program as a process with its output in `log`."""

    def __init__(self, run, fleet: Fleet, kind: str) -> None:
        self.folder, self.log = fleet.folder / kind, fleet.folder / f"{kind}.log"
        written = json.loads(run("new", kind, "--lang", "python", self.folder, "--format", "json"))
        self.command = written["run"][1]["command"]
        requirement = (self.folder / "requirements.txt").read_text().splitlines()[-1]
        assert Path(requirement, "pyproject.toml").is_file()
        assert "[platform.battery]" in (self.folder / "configs/fleet.toml").read_text()
        (self.folder / "configs/fleet.toml").write_text(fleet.config.read_text())
        # In place of an environment in which the package would be compiled.
        python = self.folder / "venv/bin/python"
        python.parent.mkdir(parents=True)
        python.write_text(f'#!/bin/sh\nexec "{sys.executable}" -P "$@"\n')
        python.chmod(0o755)

    def __enter__(self) -> Project:
        with open(self.log, "wb") as log:
            options = {"stdout": log, "stderr": log, "start_new_session": True}
            self.process = subprocess.Popen(self.command, shell=True, **options)
        return self

    def __exit__(self, *_: object) -> None:
        os.killpg(self.process.pid, signal.SIGINT)
        self.process.wait()

    def says(self, text: str):
        return until(text, lambda: text in self.log.read_text())


def test_projects_run_as_printed_without_an_alarm(run, program, fleet):
    planner, controller = Project(run, fleet, "planner"), Project(run, fleet, "controller")
    with planner:
        planner.says("no forecasts: does a worker run")
        fleet.start()
        until("a worker", lambda: "ready:" in fleet.log())
        with controller:
            planner.says(" to ")
            command = [program, "alarms", "--config", fleet.config, "--format", "json", "--duration", "15"]
            # 3: ticks were missed.
            told = subprocess.run(command, capture_output=True, text=True, check=False)
            assert told.returncode in (0, 3), told
            raised = [json.loads(line)["alarm"] for line in told.stdout.splitlines()]
            assert not set(raised) - OF_TIMING, told.stdout
            robots = json.loads(run("watch", "--once", "--config", fleet.config, "--format", "json"))["robots"]
            assert len(robots) == 20 and all(robot["time_to_empty_s"] for robot in robots)
    fleets = {line.split(":")[1] for line in planner.log.read_text().splitlines() if " to " in line}
    assert len(fleets) > 10
    assert "samples sent" in controller.log.read_text()
