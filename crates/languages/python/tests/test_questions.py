"""Questions about plans beside a real worker."""
from __future__ import annotations

import json
import signal
import threading

import joulebus
import numpy as np
import pytest
from test_live import ROBOTS, Source, child, next_frame
from worker import PATIENCE_S, Fleet, until

BATTERY = "[platform.battery]\ncapacity_wh = 5.0\ninitial_soc_lo = 0.95\n"
PATH = [(0.0, 0.0), (1.0, 0.0), (1.0, 0.5)]


@pytest.fixture
def fleet(program, tmp_path):
    made = Fleet(program, tmp_path, ROBOTS, battery=BATTERY)
    yield made
    made.close()


@pytest.fixture
def asking(fleet):
    """A planner of a fleet whose robots have levels and batteries."""
    fleet.start()
    with joulebus.Planner(fleet.config) as planner, Source(fleet):

        def known():
            try:
                answer = planner.ask(7, idle_s=1.0)[0]
            except (KeyError, joulebus.ReadError):
                return None
            return answer.energy_j is not None and answer.margin_j is not None

        until("answers", known, fleet)
        yield planner


def known(question):
    """The answers to a question once none is unknown: on a busy machine the newest frame, or a robot in it, may be stale."""

    def answers():
        found = question()
        return found if "unknown" not in found.verdict.tolist() else None

    return until("answers that are known", answers)


def told(run, *arguments):
    """What the program answers once it is known: it gives up where no frame comes in time."""

    def report():
        try:
            found = json.loads(run("ask", *arguments, "--format", "json"))
        except AssertionError:
            return None
        return found if found["answers"][0]["verdict"] != "unknown" else None

    return until("an answer of the program", report)


def test_what_if_answers_every_candidate_with_the_power_of_every_step(asking):
    speeds = np.array([0.0, 0.05, 0.15])
    v = np.repeat(speeds[:, None], 90, axis=1)
    answers = known(lambda: asking.what_if(7, v, np.zeros_like(v), power=True))
    assert len(answers) == 3 and answers.power_w.shape == (3, 90) and answers.tick > 0
    assert (answers.robot == 7).all() and np.allclose(answers.duration_s, 90 * 0.0333333, rtol=1e-3)
    assert set(answers.verdict) <= {"yes", "tight", "no"}
    # The energy is that of the steps, and lies in its interval.
    period_s = answers.duration_s / 90
    assert np.allclose(answers.power_w.sum(axis=1) * period_s, answers.energy_j, rtol=1e-3)
    assert (answers.energy_lo_j <= answers.energy_j).all() and (answers.energy_j <= answers.energy_hi_j).all()
    assert (answers.left_lo_j <= answers.left_j).all() and (answers.left_j < 5.0 * 3600.0).all()
    assert (answers.turn_back_s != answers.turn_back_s).all()
    one = answers[1]
    assert one.energy_j == float(answers.energy_j[1]) and one.turn_back_s is None and one.reason is None
    ranks = ["yes", "tight", "no", "unknown"]
    first = min(range(3), key=lambda at: (ranks.index(answers.verdict[at]), answers.energy_j[at]))
    assert answers.best == first
    # One sequence is one candidate. Commands may be in force for longer than a tick.
    longer = asking.what_if(7, np.zeros(10), np.zeros(10), period_s=0.5)
    assert len(longer) == 1 and longer.power_w is None and abs(longer[0].duration_s - 5.0) < 1e-5
    assert "Answers(1" in repr(longer) and "verdict" in repr(longer[0])


def test_a_wider_coverage_is_a_wider_interval(asking):
    widths = []
    for coverage in (0.5, 0.9, 0.99):
        answer = known(lambda: asking.ask(3, idle_s=5.0, coverage=coverage))[0]
        widths.append(answer.energy_hi_j - answer.energy_lo_j)
    # Between two questions there may be a tick.
    assert widths[0] <= 1.05 * widths[1] and widths[1] <= 1.05 * widths[2], widths


def test_a_path_and_back_says_when_to_turn_and_several_robots_are_ranked(asking):
    there = known(lambda: asking.ask(7, PATH, speed=0.15))[0]
    trip = known(lambda: asking.ask(7, PATH, speed=0.15, back_to=(0.0, 0.0), power=True))
    assert there.turn_back_s is None and trip[0].duration_s > there.duration_s
    assert trip[0].energy_j > there.energy_j
    assert trip.power_w.shape[0] == 1 and trip.power_w.shape[1] > 30
    # Without a calibrated energy model nothing is promised, so there may be no time to turn back.
    assert trip[0].turn_back_s is None or 0.0 <= trip[0].turn_back_s <= trip[0].duration_s
    assert trip[0].verdict != "yes" or trip[0].turn_back_s is None
    ranked = known(lambda: asking.ask([3, 9, 12], PATH))
    assert sorted(ranked.robot.tolist()) == [3, 9, 12] and ranked.best == 0
    ranks = ["yes", "tight", "no", "unknown"]
    order = [(ranks.index(each.verdict), each.energy_j, each.robot) for each in ranked]
    assert order == sorted(order)
    slow = asking.ask(7, PATH, speed=[1.0, 0.05, 0.05])[0]
    assert slow.duration_s > there.duration_s


def test_a_path_costs_the_same_with_two_points_and_with_a_point_every_millimetre(asking):
    few = known(lambda: asking.ask(7, [(0.0, 0.0), (1.0, 0.0)], speed=0.2))[0]
    dense = [(x, 0.0) for x in np.linspace(0.0, 1.0, 1001)]
    many = known(lambda: asking.ask(7, [dense[0], *dense, dense[-1]], speed=0.2))[0]
    assert many.duration_s == pytest.approx(few.duration_s, rel=0.005)


def test_waits_and_loads_cost_and_times_that_cannot_be_kept_are_said(asking):
    plain = known(lambda: asking.ask(7, PATH, speed=0.15))[0]
    legs = {"dwell": [0.0, 60.0, 0.0], "load": [0.0, 0.0, 2.0]}
    there = known(lambda: asking.ask(7, PATH, speed=0.15, moments=8, **legs))
    assert there[0].duration_s > plain.duration_s + 59 and there[0].energy_j > plain.energy_j + 60
    assert len(there.along) == 8 and there.along.duration_s[-1] == there.duration_s[0]
    assert np.all(np.diff(there.along.energy_j) > 0)
    assert asking.ask([7, 3], PATH, moments=8).along is None
    slow, fast = (known(lambda: asking.ask(7, PATH, times=[50.0, 50.0 + t, 50.0 + 2 * t]))[0] for t in (90.0, 0.5))
    assert abs(slow.duration_s - 180.0) < 0.2 and "times cannot" not in (slow.caveats or "")
    assert "times cannot be kept" in fast.caveats


def test_a_speed_above_the_platforms_is_refused_and_infinity_is_none(asking):
    with pytest.raises(ValueError, match="3 m/s towards point 1.*at most 0.25 m/s.*v_max_mps"):
        asking.ask(7, PATH, speed=3)
    assert known(lambda: asking.ask(7, PATH))[0].duration_s > 0.0


def test_answers_are_those_of_the_program(asking, fleet, run, tmp_path):
    rows = tmp_path / "path.csv"
    rows.write_text("x_m,y_m,speed_mps\n" + "".join(f"{x},{y},0.15\n" for x, y in PATH))
    theirs = told(run, "--config", fleet.config, "--robot", 7, "--path", rows)["answers"][0]
    ours = known(lambda: asking.ask(7, PATH, speed=0.15))[0]
    assert ours.duration_s == pytest.approx(theirs["duration_s"], rel=1e-6)
    # Of different ticks of a robot whose power changes little.
    assert ours.energy_j == pytest.approx(theirs["energy"]["mean_j"], rel=0.2)
    assert ours.energy_lo_j < theirs["energy"]["hi_j"] and theirs["energy"]["lo_j"] < ours.energy_hi_j
    # Whether a reading is overdue may differ between the two ticks.
    said, caveats = ours.caveats or "", theirs["caveats"]
    assert ("outside" in said) == (caveats["steps_outside_training"] > 0)
    assert ("longer than" in said) == caveats["beyond_horizon"]


def test_frames_are_read_on_while_questions_are_asked(asking):
    ticks, stopping = [], threading.Event()

    def read():
        while not stopping.is_set():
            ticks.append(int(next_frame(asking).tick))

    reader = threading.Thread(target=read)
    reader.start()
    try:
        for _ in range(20):
            assert asking.what_if(1, np.zeros(30), np.zeros(30)).tick > 0
    finally:
        until("frames", lambda: len(ticks) > 3)
        stopping.set()
        reader.join()
    assert ticks == sorted(set(ticks))


REFUSED = [
    (lambda p: p.what_if(7, np.zeros((2, 3, 4)), np.zeros((2, 3, 4))), ValueError, "v has shape (2, 3, 4), allowed"),
    (lambda p: p.what_if(7, np.zeros(3), np.zeros(4)), ValueError, "omega has shape (4,), allowed: (3,)"),
    (lambda p: p.what_if(7, np.zeros((2, 0)), np.zeros((2, 0))), ValueError, "at least one of each"),
    (lambda p: p.what_if(7, np.zeros((0, 5)), np.zeros((0, 5))), ValueError, "at least one of each"),
    (lambda p: p.what_if(7, [0.0, float("nan")], [0.0, 0.0]), ValueError, "step 1 is NaN"),
    (lambda p: p.what_if(7, [9.0], [0.0]), ValueError, "v_max_mps"),
    (lambda p: p.what_if(7, ["fast"], [0.0]), TypeError, "v has dtype"),
    (lambda p: p.what_if(7, [0.0], [0.0], period_s=0.0), ValueError, "a period of 0 s"),
    (lambda p: p.what_if(7, [0.0], [0.0], period_s=float("nan")), ValueError, "a period of NaN s"),
    (lambda p: p.what_if(7, [0.0], [0.0], coverage=1.0), ValueError, "a coverage of 1"),
    (lambda p: p.what_if(7, [0.0], [0.0], coverage=float("nan")), ValueError, "a coverage of NaN"),
    (lambda p: p.what_if(7, [0.0], [0.0], timeout=float("nan")), ValueError, "allowed are 0 s and more"),
    (lambda p: p.what_if(99, [0.0], [0.0]), KeyError, "robot 99 is not in the fleet"),
    (lambda p: p.what_if(-1, [0.0], [0.0]), ValueError, "robot has -1"),
    (lambda p: p.what_if(2**40, [0.0], [0.0]), ValueError, "1099511627776"),
    (lambda p: p.what_if(True, [0.0], [0.0]), TypeError, "dtype bool"),
    (lambda p: p.ask(7), ValueError, "either a path or idle_s"),
    (lambda p: p.ask(7, PATH, idle_s=1.0), ValueError, "either a path or idle_s"),
    (lambda p: p.ask(7, idle_s=-1.0), ValueError, "a duration of -1 s"),
    (lambda p: p.ask(7, idle_s=float("inf")), ValueError, "a duration of inf s"),
    (lambda p: p.ask(7, idle_s=1.0, power=True), ValueError, "are of a path"),
    (lambda p: p.ask([7, 99], idle_s=1.0), KeyError, "robot 99 is not in the fleet"),
    (lambda p: p.ask(7, [(0.0, 0.0)]), ValueError, "a path of 1 points"),
    (lambda p: p.ask(7, [0.0, 1.0]), ValueError, "path has shape (2,)"),
    (lambda p: p.ask(7, [(0.0, 0.0), (float("nan"), 1.0)]), ValueError, "of point 1 is NaN"),
    (lambda p: p.ask(7, [(0.0, 0.0), (1e9, 1.0)]), ValueError, "of point 1 is 1000000000"),
    (lambda p: p.ask(7, PATH, speed=0.0), ValueError, "a speed of 0 m/s"),
    (lambda p: p.ask(7, PATH, speed=[1.0, 2.0]), ValueError, "speed has shape (2,), allowed: () or (3,)"),
    (lambda p: p.ask(7, PATH, back_to=(float("nan"), 0.0)), ValueError, "NaN"),
    (lambda p: p.ask(7, PATH, dwell=[1.0]), ValueError, "dwell has shape (1,), allowed: (3,)"),
    (lambda p: p.ask(7, PATH, dwell=[0.0, -1.0, 0.0]), ValueError, "dwell_s of point 1 is -1"),
    (lambda p: p.ask(7, PATH, load=[0.0, float("nan"), 0.0]), ValueError, "load_w of point 1 is NaN"),
    (lambda p: p.ask(7, PATH, times=[0.0, 2.0, 1.0]), ValueError, "times never fall"),
    (lambda p: p.ask(7, PATH, tolerance=2.0), ValueError, "a tolerance of 2 m"),
    (lambda p: p.ask(7, PATH, moments=300), ValueError, "300 moments along the plan: allowed are 256"),
    (lambda p: p.ask(7, idle_s=1.0, dwell=[1.0]), ValueError, "are of a path"),
]


def test_wrong_questions_are_refused_with_what_is_allowed(asking):
    for at, (question, kind, said) in enumerate(REFUSED):
        with pytest.raises(kind) as refused:
            question(asking)
        assert said in str(refused.value), (at, said, str(refused.value))
    assert asking.ask([], idle_s=1.0).verdict.tolist() == []


def test_a_stopped_worker_makes_every_answer_unknown_with_the_reason(asking, fleet):
    fleet.process.send_signal(signal.SIGSTOP)
    try:
        answers = until(
            "a stale answer",
            lambda: (found if (found := asking.ask([3, 7], PATH, timeout=0.0)).verdict[0] == "unknown" else None),
        )
    finally:
        fleet.process.send_signal(signal.SIGCONT)
    assert answers.verdict.tolist() == ["unknown"] * 2 and np.isnan(answers.energy_j).all()
    assert answers[0].energy_j is None and answers[0].margin_j is None and "Does it run?" in answers[0].reason
    until("answers again", lambda: asking.ask(7, idle_s=1.0).verdict[0] != "unknown")


def test_answers_become_data_frames(asking):
    pandas = pytest.importorskip("pandas")
    found = asking.what_if(7, np.zeros((2, 30)), np.zeros((2, 30))).to_pandas()
    assert isinstance(found, pandas.DataFrame) and len(found) == 2 and "energy_hi_j" in found


def test_without_a_worker_or_an_open_planner_nothing_is_answered(fleet):
    with joulebus.Planner(fleet.config) as planner:
        with pytest.raises(joulebus.ReadError, match="no frame of the fleet within 0.1 s"):
            planner.what_if(7, [0.0], [0.0], timeout=0.1)
    for question in (lambda: planner.what_if(7, [0.0], [0.0]), lambda: planner.ask(7, idle_s=1.0)):
        with pytest.raises(RuntimeError, match="planner is closed"):
            question()
    planner.close()


def test_ctrl_c_ends_a_question_and_a_fork_cannot_ask(fleet):
    waiting = child(
        fleet,
        """
import signal
planner = joulebus.Planner(config)
try:
    planner.ask(7, idle_s=1.0, timeout=0.0)
except joulebus.ReadError:
    pass
pid = os.fork()
if pid == 0:
    try:
        planner.ask(7, idle_s=1.0)
    except RuntimeError as error:
        os._exit(5 if "forked from" in str(error) else 6)
    os._exit(7)
_, status = os.waitpid(pid, 0)
assert os.waitstatus_to_exitcode(status) == 5, os.waitstatus_to_exitcode(status)
try:
    print("asking", flush=True)
    planner.ask(7, idle_s=1.0, timeout=1e9)
except KeyboardInterrupt:
    sys.exit(3)
""",
    )
    try:
        assert waiting.stdout.readline() == "asking\n", waiting.stderr.read()
        waiting.send_signal(signal.SIGINT)
        assert waiting.wait(PATIENCE_S) == 3, waiting.stderr.read()
    finally:
        waiting.kill()
        waiting.wait()
