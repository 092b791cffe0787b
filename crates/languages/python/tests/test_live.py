"""A planner and a publisher in Python beside a real worker, in real shared memory."""
from __future__ import annotations

import gc
import os
import shutil
import signal
import subprocess
import sys
import threading
import time
import warnings
import weakref
from pathlib import Path

import joulebus
import numpy as np
import pytest
from conftest import bits
from worker import PATIENCE_S, Fleet, until

ROBOTS = 16
IDS = np.arange(ROBOTS)


@pytest.fixture
def fleet(program, tmp_path):
    made = Fleet(program, tmp_path, ROBOTS)
    yield made
    made.close()


class Source(threading.Thread):
    """Publishes all robots at 30 Hz until it is stopped. `sent` are the commands and readings of each frame."""

    def __init__(self, fleet: Fleet) -> None:
        super().__init__()
        self.publisher = joulebus.Publisher(fleet.config, "source")
        self.stopping = threading.Event()
        self.sent: list[tuple[np.ndarray, np.ndarray, np.ndarray]] = []

    def run(self) -> None:
        noise = np.random.default_rng(1)
        with self.publisher as publisher:
            while not self.stopping.wait(0.033):
                v, omega = noise.uniform(0.0, 0.15, ROBOTS), noise.uniform(-1.0, 1.0, ROBOTS)
                power = noise.uniform(3.2, 4.2, ROBOTS)
                self.sent.append((v, omega, power))
                publisher.publish(IDS, v=v, omega=omega, power=power)

    def __enter__(self) -> Source:
        self.start()
        return self

    def __exit__(self, *_: object) -> None:
        self.stopping.set()
        self.join()


def next_event(planner: joulebus.Planner, kind: type):
    """The next event of this kind. Others are passed over."""

    def found():
        event = planner.next(1.0)
        return event if isinstance(event, kind) else None

    return until(f"an event {kind.__name__}", found)


def next_frame(planner: joulebus.Planner) -> joulebus.Frame:
    return next_event(planner, joulebus.Frame)


@pytest.fixture
def running(fleet):
    """A planner beside a worker and a source."""
    fleet.start()
    with joulebus.Planner(fleet.config) as planner, Source(fleet) as source:
        planner.source = source

        def known():
            # The first frames of a worker may have no robots.
            frame = next_frame(planner)
            return frame[0].expected_w if len(frame) == ROBOTS else None

        until("forecasts", known, fleet)
        yield planner


def test_frames_are_read_only_views_on_shared_memory(running):
    frame = next_frame(running)
    assert len(frame) == ROBOTS and sorted(frame.robot.tolist()) == IDS.tolist()
    for array in [frame.rows, frame.power_w, frame.lo_w, frame.quality]:
        assert not array.flags.owndata and not array.flags.writeable
        with pytest.raises(ValueError):
            array[0] = array[1]
        with pytest.raises(ValueError):
            array.flags.writeable = True
    address = frame.rows.__array_interface__["data"][0]
    assert frame.power_w.__array_interface__["data"][0] == address + joulebus.FORECAST.fields["power_w"][1]
    shared = [line.split() for line in Path("/proc/self/maps").read_text().splitlines()]
    inside = [
        line
        for line in shared
        if int(line[0].split("-")[0], 16) <= address < int(line[0].split("-")[1], 16)
    ]
    assert len(inside) == 1 and "/dev/shm/" in inside[0][-1] or "shm" in inside[0][-1], inside
    assert inside[0][1].startswith("r-"), inside


def test_a_forecast_tells_what_is_known_of_its_robot(running):

    def whole():
        found = next_frame(running)
        # On a busy machine a sample may be late: then the forecast is open loop.
        return found if found[7].interval_w and found[7].quality in ("Fresh", "Held") else None

    frame = until("a whole frame", whole)
    forecast = frame[7]
    lo_w, hi_w = forecast.interval_w
    assert forecast.robot == 7 and lo_w <= hi_w and 3.0 < forecast.last_reading_w < 4.3
    assert forecast.quality in ("Fresh", "Held") and forecast.quality_detail is None
    assert abs(forecast.target_ns - time.monotonic_ns()) < PATIENCE_S * 1e9
    assert 7 in frame and 99 not in frame and frame.tick > 0 and frame.age_s >= 0.0
    assert [each.robot for each in frame] == frame.robot.tolist()
    for absent in [99, -1, 2**32, 2**70]:
        with pytest.raises(KeyError, match="is not in the frame"):
            frame[absent]
    with pytest.raises(AttributeError, match="power_w"):
        frame.power
    assert "interval_w" in repr(forecast) and "tick" in repr(frame)


def test_no_accessor_of_a_forecast_has_the_name_of_a_field_that_can_be_nan():
    can_be_nan = {name for name in joulebus.FORECAST.names if joulebus.FORECAST[name].kind == "f"}
    assert can_be_nan and not can_be_nan & set(dir(joulebus.Forecast))


def test_a_forecast_without_readings_is_none_and_says_why(fleet):
    fleet.start()
    with joulebus.Planner(fleet.config) as planner, joulebus.Publisher(fleet.config) as publisher:

        def warming_up():
            publisher.publish([0, 1], v=0.1, omega=0.0, power=[3.5, np.nan])
            event = planner.next(0.05)
            return event if isinstance(event, joulebus.Frame) and 0 in event and 1 in event else None

        frame = until("a frame", warming_up, fleet)
        assert frame[1].expected_w is None and frame[1].interval_w is None and frame[1].last_reading_w is None
        assert frame[1].quality in ("Warmup", "Invalid") and frame[1].quality_detail is not None


def test_a_view_keeps_its_frame_and_releases_it(running):
    frame = next_frame(running)
    held, copied = frame.rows["power_w"][2:5], frame.rows.copy()
    owner = weakref.ref(frame)
    ids, numbers = frame.rows["robot"][2:5].copy(), bits(held).copy()
    del frame
    gc.collect()
    assert owner() is None and running.status["frames_kept"] == 1
    for _ in range(30):
        next_frame(running)
        assert np.array_equal(bits(held), numbers), "the worker wrote into a frame that is kept"
    assert np.array_equal(copied["robot"][2:5], ids)
    del held
    gc.collect()
    next_frame(running)
    gc.collect()
    assert running.status["frames_kept"] == 0


def test_more_frames_than_can_be_kept_are_refused_with_the_remedy(running):
    kept = [next_frame(running), next_frame(running)]

    def keep_on():
        try:
            event = running.next(0.2)
        except joulebus.ReadError as error:
            return error
        if isinstance(event, joulebus.Frame):
            kept.append(event)
        return None

    error = until("a refusal", keep_on)
    assert "frames are in use" in str(error) and "copy()" in str(error)
    assert len(kept) <= 4
    first = bits(kept[0].power_w).copy()
    assert np.array_equal(bits(kept[0].power_w), first)
    kept.clear()
    del error
    gc.collect()
    assert len(next_frame(running)) == ROBOTS


def test_a_loop_reads_every_new_frame(running):
    ticks = []
    for event in running.events(timeout=PATIENCE_S):
        if isinstance(event, joulebus.Frame):
            ticks.append(event.tick)
        if len(ticks) == 20:
            break
    assert ticks == sorted(set(ticks))


def test_views_live_on_after_the_planner_and_its_worker(fleet):
    fleet.start()
    with Source(fleet):
        with joulebus.Planner(fleet.config) as planner:
            frame = next_frame(planner)
            before = frame.rows.tobytes()
        with pytest.raises(RuntimeError, match="planner is closed"):
            planner.next(0.0)
        planner.close()
        # 33 ticks later, memory that was given back has been written to.
        with joulebus.Planner(fleet.config) as later:
            for _ in range(40):
                next_frame(later)
                assert frame.rows.tobytes() == before, "the worker wrote into a frame that is kept"
        fleet.kill()
        assert frame.rows.tobytes() == before
        assert frame.power_w.tobytes() == frame.rows["power_w"].tobytes()


def test_a_killed_worker_is_an_event_at_once_and_its_successor_is_followed(fleet):
    fleet.start()
    with joulebus.Planner(fleet.config) as planner, Source(fleet):
        before = next_frame(planner).worker_pid
        assert before == fleet.process.pid
        fleet.kill()
        assert next_event(planner, joulebus.Gone).how == "exited"
        assert planner.status["worker"] == "gone"
        fleet.start()
        after = next_frame(planner)
        assert after.worker_pid == fleet.process.pid != before and after.restarted
        assert planner.status["workers"] == 2


def test_a_stopped_worker_is_stale(fleet):
    fleet.start()
    with joulebus.Planner(fleet.config) as planner, Source(fleet):
        next_frame(planner)
        fleet.process.send_signal(signal.SIGSTOP)
        try:
            stale = next_event(planner, joulebus.Stale)
        finally:
            fleet.process.send_signal(signal.SIGCONT)
        assert stale.age_s > 0.0
        next_frame(planner)


def test_diagnostics_and_budgets_are_tables(running):
    def scored():
        table = running.diagnostics()
        return table if table is not None and table.scored.min() > 3 else None

    table = until("scores", scored)
    assert table.rows.dtype == joulebus.DIAGNOSTIC and len(table) == ROBOTS and table.tick > 0
    assert 0.0 < table[7]["mae_w"] < 5.0 and not table.rows.flags.writeable
    budgets = until("budgets", running.budgets)
    assert budgets.rows.dtype == joulebus.BUDGET
    assert until("energy", lambda: running.budgets().drawn_uj.min() > 0)
    assert until("outlooks", lambda: (running.outlooks().flags & 2).all())
    outlooks = running.outlooks()
    assert outlooks.rows.dtype == joulebus.OUTLOOK and outlooks.energy_j.shape == (ROBOTS, len(joulebus.OUTLOOK_S))
    assert (np.diff(outlooks.energy_j) > 0).all()
    with pytest.raises(KeyError, match="99"):
        budgets[99]
    with pytest.raises(AttributeError, match="drawn_uj"):
        budgets.drawn


def test_frames_and_tables_become_data_frames(running):
    pandas = pytest.importorskip("pandas")
    frame = next_frame(running)
    found = frame.to_pandas()
    assert isinstance(found, pandas.DataFrame) and sorted(found.index) == IDS.tolist()
    assert np.array_equal(bits(found["power_w"]), bits(frame.power_w))
    names = [[f"{name}_{tenth}" for tenth in range(10)] if name == "charge_rate" else [name] for name in joulebus.BUDGET.names[1:]]
    assert list(running.budgets().to_pandas().columns) == sum(names, [])
    found = until("outlooks", running.outlooks).to_pandas()
    assert {"mean_w", "energy_j_10s", "energy_hi_j_300s"} < set(found.columns) and "energy_j" not in found


def test_live_forecasts_of_the_network_have_the_bits_of_predict(running):
    """The worker, a process of Rust, and this one compute the same network on the same readings."""
    model = joulebus.Predictor()
    seen: dict[int, dict[int, int]] = {}
    # A sample that comes later is overdue: what was missed before it is in the worker's window as
    # forecasts.
    on_time_ns = 45_000_000

    def compared():
        frame = next_frame(running)
        # Of every frame, so that two samples in a row are known.
        for forecast in frame:
            seen.setdefault(forecast.robot, {})[int(forecast.row["sample_seq"])] = int(forecast.row["stamp_ns"])
        ticks = {"samples": int(frame.sample_seq[0]), "network_w": None}
        table = running.diagnostics()
        if table is None or int(table[0]["sample_seq"]) < 6:
            return None
        found = 0
        for robot in range(ROBOTS):
            row = table[robot]
            newest = int(row["sample_seq"])
            sent = running.source.sent
            if newest < 6 or newest >= len(sent) or np.isnan(row["network_w"]):
                continue
            v, omega = (np.float32(sent[newest][column][robot]) for column in (0, 1))
            before = [np.float32(sent[newest - 1][column][robot]) for column in (0, 1)]
            lags_w = [np.float32(sent[newest - lag][2][robot]) for lag in range(5)]
            # The true time between the samples is the worker's to know: a row that it may have had,
            # for the periods around 33 ms.
            dt = between(robot, newest)
            if dt is None:
                continue
            change = [(new - old) / np.float32(dt) for new, old in zip((v, omega), before)]
            forecast_w = model.predict(np.array([[v, omega, *change, abs(v), abs(omega), *lags_w]], np.float32))[0]
            assert bits(forecast_w) == bits(row["network_w"]), (robot, newest, forecast_w, row["network_w"], ticks)
            found += 1
        return found or None

    def between(robot, newest):
        """Time before the newest sample, s. It is None unless all five were seen, and each came in time."""
        known = seen.get(robot, {})
        stamps = [known.get(number) for number in range(newest - 4, newest + 1)]
        if None in stamps or (np.diff(stamps) > on_time_ns).any():
            return None
        return (stamps[-1] - stamps[-2]) * 1e-9

    assert until("comparable forecasts", compared) >= 1


WRONG = [
    (dict(ids=[1, 1]), joulebus.PublishError, "robot 1 is in the frame twice"),
    (dict(ids=[-1]), ValueError, "ids has -1, allowed are integers from 0 to 4294967295"),
    (dict(ids=[2**32]), ValueError, "ids has 4294967296"),
    (dict(ids=[2**64 - 1]), ValueError, "18446744073709551615"),
    (dict(ids=[2**80]), ValueError, "allowed are integers"),
    (dict(ids=[1.5]), TypeError, "dtype float64"),
    (dict(ids=[True]), TypeError, "dtype bool"),
    (dict(ids=["a"]), TypeError, "allowed are integers"),
    (dict(ids=3), ValueError, "ids has shape ()"),
    (dict(ids=[[1]]), ValueError, "ids has shape (1, 1)"),
    (dict(ids=np.arange(ROBOTS + 1)), joulebus.PublishError, "fleet.capacity"),
    (dict(power=[1.0]), ValueError, "power has shape (1,), allowed: () or (2,), as ids"),
    (dict(power="much"), TypeError, "power has dtype"),
    (dict(held=1.0), TypeError, "held is 1.0"),
    (dict(held=[1, 0]), TypeError, "held has dtype int64, allowed is bool"),
    (dict(powers=1.0), ValueError, "there is no column powers, allowed are v, omega, power"),
]


def test_wrong_frames_are_refused_with_the_remedy_and_not_sent(fleet):
    with joulebus.Publisher(fleet.config) as publisher:
        for given, kind, said in WRONG:
            with pytest.raises(kind) as refused:
                publisher.publish(**({"ids": [1, 2]} | given))
            assert said in str(refused.value), (given, str(refused.value))
        assert publisher.frames_sent == 0 and publisher.samples_sent == 0
        assert publisher.publish([1, 2], v=0.1, omega=[0.0, 0.1], power=[3.5, np.nan], soc=0.5, held=[False, True]) == 0
        assert publisher.frames_sent == 1 and publisher.samples_sent == 2 and publisher.capacity == ROBOTS
        publisher.publish([], v=0.1)
        publisher.publish(np.array([3], np.uint64))
    with pytest.raises(RuntimeError, match="publisher is closed"):
        publisher.publish([1])


def test_a_publisher_whose_files_were_removed_says_that_it_has_to_connect_again(fleet):
    with joulebus.Publisher(fleet.config) as publisher:
        publisher.publish([1], power=3.5)
        shutil.rmtree(fleet.root)

        def refusal():
            try:
                publisher.publish([1], power=3.5)
            except joulebus.ConnectError as error:
                return str(error)

        assert "start it again" in until("a refusal", refusal, fleet)


def test_a_sample_that_the_worker_refuses_is_warned_of_at_once_and_once(fleet):
    with joulebus.Publisher(fleet.config) as publisher:
        for given, said in [
            (dict(soc=80.0), r"robot 1 \(BatteryOutOfRange\): soc is 80, allowed are -0.05 to 1.05; 1 more"),
            (dict(power=3500.0), r"robot 1 \(PowerOutOfRange\): power_w is 3500, allowed are"),
            (dict(v=[0.1, np.inf]), r"robot 2 \(NotFinite\): v_mps is inf"),
        ]:
            with pytest.warns(RuntimeWarning, match=said):
                publisher.publish([1, 2], **given)
            with warnings.catch_warnings():
                warnings.simplefilter("error")
                publisher.publish([1, 2], **given)
        with pytest.warns(RuntimeWarning, match="no platform of the config has it"):
            publisher.publish([10_000], power=3.5)


def test_a_publisher_learns_that_another_source_has_its_robots(fleet):
    fleet.start()
    with joulebus.Publisher(fleet.config, "first") as first, joulebus.Planner(fleet.config) as planner:
        def has_robot() -> bool:
            first.publish([1], v=0.1, omega=0.0, power=3.5)
            frame = planner.next(0.1)
            return isinstance(frame, joulebus.Frame) and len(frame) == 1

        until("the first source to have the robot", has_robot, fleet)
        with joulebus.Publisher(fleet.config, "second") as second, warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always")

            def is_told() -> bool:
                has_robot()
                second.publish([1], v=0.1, omega=0.0, power=3.5)
                return len(caught) > 0

            until("the second one to be told", is_told, fleet)
            assert "(ForeignSource)" in str(caught[0].message) and "end one of the two" in str(caught[0].message)
            refusal = second.refusals()[0]
            assert (refusal.reason, refusal.robot) == ("ForeignSource", 1) and 0 < refusal.count <= second.samples_sent
            for _ in range(5):
                is_told()
            assert len(caught) == 1 and first.refusals() == []


def test_configs_that_are_refused_say_what_the_program_says(program, tmp_path):
    config = tmp_path / "wrong.toml"
    config.write_text('[fleet]\nname = "a"\ncapacity = -3\n')
    said = subprocess.run([program, "config", "check", config], capture_output=True, text=True, check=False)
    for kind in (joulebus.Planner, joulebus.Publisher):
        with pytest.raises(joulebus.ConnectError) as refused:
            kind(config)
        line = str(refused.value).splitlines()[0]
        assert "capacity" in str(refused.value) and line.strip() in said.stdout + said.stderr
        with pytest.raises(joulebus.ConnectError, match="missing.toml"):
            kind(tmp_path / "missing.toml")


def test_wrong_timeouts_are_refused(fleet):
    with joulebus.Planner(fleet.config) as planner:
        assert planner.next(0.0) is None and list(planner.events(timeout=0.0)) == []
        for timeout in [-1.0, float("nan")]:
            with pytest.raises(ValueError, match="allowed are 0 s and more"):
                planner.next(timeout)
        assert planner.diagnostics(timeout=0.0) is None and planner.status["worker"] == "waiting"


def test_threads_may_share_a_planner(running):
    ticks, errors = [], []

    def read():
        try:
            for _ in range(10):
                event = running.next(PATIENCE_S)
                if isinstance(event, joulebus.Frame):
                    ticks.append(int(event.tick))
                del event
                running.diagnostics()
        except BaseException as error:
            errors.append(error)

    threads = [threading.Thread(target=read) for _ in range(2)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert not errors and len(set(ticks)) == len(ticks) > 0


def test_a_frame_may_be_dropped_by_another_thread(running):
    for _ in range(5):
        frames = [next_frame(running)]
        thread = threading.Thread(target=frames.clear)
        thread.start()
        thread.join()
    gc.collect()
    until("the release", lambda: running.status["frames_kept"] == 0)


CHILD = """
import os, sys, time
import joulebus
config, role = sys.argv[1:3]
"""


def child(fleet: Fleet, body: str) -> subprocess.Popen[str]:
    command = [sys.executable, "-c", CHILD + body, str(fleet.config), "child"]
    environment = os.environ | {"PYTHONPATH": os.pathsep.join(sys.path)}
    return subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, env=environment)


def test_ctrl_c_ends_a_wait_without_end(fleet):
    waiting = child(
        fleet,
        """
planner = joulebus.Planner(config)
try:
    print("waiting", flush=True)
    planner.next(None)
except KeyboardInterrupt:
    print("interrupted", time.monotonic(), flush=True)
    sys.exit(3)
""",
    )
    assert waiting.stdout.readline() == "waiting\n"
    time.sleep(0.3)
    begin = time.monotonic()
    waiting.send_signal(signal.SIGINT)
    said = waiting.stdout.readline().split()
    assert waiting.wait(PATIENCE_S) == 3, waiting.stderr.read()
    assert said[0] == "interrupted"
    # The promise is 100 ms. A busy machine may run nothing at all for much longer.
    assert float(said[1]) - begin < 30.0


def test_a_fork_cannot_use_its_parents_ports_and_leaves_them_alone(fleet):
    fleet.start()
    with Source(fleet):
        forked = child(
            fleet,
            """
planner, publisher = joulebus.Planner(config), joulebus.Publisher(config, "forked")
event = None
while not isinstance(event, joulebus.Frame):
    event = planner.next(1.0)
pid = os.fork()
if pid == 0:
    refused = 0
    for use in [lambda: planner.next(0.0), lambda: planner.diagnostics(), lambda: publisher.publish([1]),
                lambda: planner.close(), lambda: joulebus.live.np.asarray(event._memory)]:
        try:
            use()
        except RuntimeError as error:
            refused += "forked from" in str(error)
    del event, planner, publisher
    sys.exit(10 + refused)
_, status = os.waitpid(pid, 0)
assert os.waitstatus_to_exitcode(status) == 15, os.waitstatus_to_exitcode(status)
for _ in range(5):
    del event
    event = planner.next(None)
assert publisher.publish([1], power=3.5) >= 0
print("whole")
""",
        )
        said, errors = forked.communicate(timeout=PATIENCE_S)
        assert forked.returncode == 0 and said == "whole\n", errors


@pytest.mark.parametrize("end", ["", "sys.exit(7)", "raise KeyError('x')", "del joulebus", "os._exit(0)"])
def test_the_interpreter_ends_with_open_planners(fleet, end):
    fleet.start()
    with Source(fleet):
        ending = child(
            fleet,
            f"""
planner, publisher = joulebus.Planner(config), joulebus.Publisher(config, "ending")
event = None
while not isinstance(event, joulebus.Frame):
    event = planner.next(1.0)
kept = event.power_w
loop = planner.events()
next(loop)
{end}
""",
        )
        _, errors = ending.communicate(timeout=PATIENCE_S)
        expected = {"sys.exit(7)": 7, "raise KeyError('x')": 1}.get(end, 0)
        assert ending.returncode == expected, errors
        assert "panicked" not in errors and "Fatal" not in errors


def test_an_alarm_is_acknowledged_once_it_is_raised(fleet):
    fleet.start()
    with joulebus.Planner(fleet.config) as planner:
        with Source(fleet):
            next_event(planner, joulebus.Frame)
            with pytest.raises(RuntimeError, match="is not raised"):
                planner.acknowledge(3, "NoData", "ann")
            with pytest.raises(RuntimeError, match="allowed: LevelHigh, LevelLow"):
                planner.acknowledge(3, "NoData", "ann", new_normal=True)
            with pytest.raises(ValueError, match="NoData"):
                planner.acknowledge(3, "WorkerGone", "ann")

        def is_taken():
            try:
                return planner.acknowledge(3, "NoData", "ann") is None
            except RuntimeError:
                return False

        until("the robot is silent", is_taken, fleet)
    fleet.kill()
    with joulebus.Planner(fleet.config) as planner, pytest.raises(RuntimeError, match="worker"):
        planner.acknowledge(3, "NoData", "ann")
