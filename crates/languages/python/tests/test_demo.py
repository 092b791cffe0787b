"""`joulebus.demo()`: a fleet that answers, and that leaves nothing behind however it ends."""
from __future__ import annotations

import os
import signal
import subprocess
import sys
from pathlib import Path

import joulebus
import pytest
from conftest import ROOT
from worker import until

PATH = [(0.0, 0.0), (1.0, 0.0)]


def left() -> set[Path]:
    """What a demo has in shared memory, but for demos of other processes."""
    found = {path for path in Path("/dev/shm").glob(f"joulebus-{os.geteuid()}-demo-*")}
    return {path for path in found if path.name.endswith(f"-{os.getpid()}") or path.name.endswith(f"-{os.getpid() + 1}")}


def test_it_answers_yes_at_once_and_raises_no_alarm():
    with joulebus.demo() as demo:
        trip = demo.planner.ask(7, PATH, back_to=(0.0, 0.0))[0]
        assert trip.verdict == "yes" and trip.margin_j > 0.0
        # The whole path can be driven: there is no time to turn back.
        assert trip.turn_back_s is None and trip.alarms is None
        everyone = demo.planner.ask(demo.robots, PATH, back_to=(0.0, 0.0))
        assert set(everyone.verdict) == {"yes"} and len(everyone.verdict) == 20
        frame = next(event for event in demo.planner.events(60.0) if isinstance(event, joulebus.Frame))
        assert len(frame) == 20
        del frame
        assert demo.config.is_file() and left()
        assert "robots=20" in repr(demo)
    assert not left()
    demo.close()


def test_the_first_lines_of_the_documentation_say_yes(capsys):
    pytest.importorskip("pandas")
    page = (ROOT / "docs/tutorial/python.md").read_text()
    lines = page.split("## 2. A fleet")[1].split("```python\n")[1].split("```")[0]
    exec(compile(lines, "docs/tutorial/python.md", "exec"), {})
    assert capsys.readouterr().out.startswith("yes ")


def test_two_demos_are_two_fleets():
    with joulebus.demo(3) as one, joulebus.demo(2, seed=1) as other:
        assert len(left()) == 2 and one.config != other.config
        assert len(one.planner.ask(one.robots, idle_s=1.0).verdict) == 3
        with pytest.raises(KeyError):
            other.planner.ask(2, idle_s=1.0)
    assert not left()


def test_an_exception_ends_it():
    with pytest.raises(ZeroDivisionError), joulebus.demo(1):
        1 / 0
    assert not left()


def test_a_dead_fleet_is_cleared_by_its_owner():
    with joulebus.demo(1) as demo:
        demo._process.kill()
        told = until("its end", lambda: (event := demo.planner.next(60.0)) is not None and isinstance(event, joulebus.Gone))
        assert told
    assert not left()


def test_a_fleet_that_does_not_start_says_why():
    with pytest.raises(joulebus.ConnectError, match="the demo's fleet does not start: (?s:.*)OverflowError"):
        joulebus.demo(1, seed=-1)
    assert not left()


def test_a_number_of_robots_that_is_none_is_refused():
    with pytest.raises(ValueError, match="robots is 0, allowed are 1 to 100000"):
        joulebus.demo(0)


@pytest.mark.parametrize(("number", "code"), [(signal.SIGINT, -signal.SIGINT), (signal.SIGKILL, -signal.SIGKILL)])
def test_ctrl_c_and_a_killed_owner_end_it(tmp_path, number, code):
    """The whole group gets Ctrl-C, as from a terminal."""
    script = tmp_path / "script.py"
    script.write_text(
        "import joulebus, signal, time\n"
        "signal.signal(signal.SIGINT, signal.default_int_handler)\n"
        "with joulebus.demo(2) as demo:\n"
        "    print(demo.config.parent, demo._process.pid, flush=True)\n"
        "    time.sleep(600)\n"
    )
    owner = subprocess.Popen([sys.executable, str(script)], stdout=subprocess.PIPE, text=True, start_new_session=True)
    root, pid = owner.stdout.readline().split()
    assert Path(root).is_dir()
    os.killpg(owner.pid, number)
    assert owner.wait(60.0) == code
    until("the fleet's end", lambda: not Path("/proc", pid).exists() and not Path(root).exists())
