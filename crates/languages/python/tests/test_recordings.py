"""Captures and trials, from files that the program writes."""
from __future__ import annotations

import csv
import io
import json
import subprocess
import sys
import time
import warnings
from datetime import datetime, timezone

import joulebus
import numpy as np
import pytest
from conftest import ROOT, bits
from test_live import ROBOTS, Source, next_frame
from worker import PATIENCE_S, Fleet, until

TOPICS = {
    "samples": joulebus.SAMPLE,
    "forecasts": joulebus.FORECAST,
    "diagnostics": joulebus.DIAGNOSTIC,
    "budgets": joulebus.BUDGET,
    "outlooks": joulebus.OUTLOOK,
}


@pytest.fixture(scope="module")
def capture(program, tmp_path_factory):
    """A fleet's first seconds, recorded, and the frames that a planner saw meanwhile."""
    folder = tmp_path_factory.mktemp("capture")
    # Frames are overwritten, and the recorder says so, if it gets no processor: then it is recorded
    # again.
    for attempt in range(5):
        code, *recorded = record(program, folder, attempt)
        if code == 0:
            return recorded
        assert code == 3
    pytest.fail("frames were lost each time")


def first_log_ns(path):
    """The log time of the first message of all topics."""
    return min(int(joulebus.read_arrays(path, topic)["log_ns"].min()) for topic in TOPICS)


def nanoseconds(unix_ns):
    """A moment in the zone of Tokyo, as pandas has it."""
    return pytest.importorskip("pandas").Timestamp(unix_ns, unit="ns", tz="Asia/Tokyo")


def record(program, folder, attempt):
    fleet, path, seen = Fleet(program, folder, ROBOTS), folder / f"run-{attempt}.mcap", {}
    try:
        fleet.start()
        recorder = subprocess.Popen([program, "record", "--config", fleet.config, "-o", path], stderr=subprocess.PIPE)
        with joulebus.Planner(fleet.config) as planner, Source(fleet):
            until("a recorder", lambda: path.exists() and path.stat().st_size > 4096, fleet)
            for _ in range(30):
                frame = next_frame(planner)
                seen[int(frame.tick)] = frame.rows.copy()
        recorder.terminate()
        code = recorder.wait(PATIENCE_S)
    finally:
        fleet.close()
    return code, path, seen


def test_a_capture_is_read_with_the_bits_that_a_planner_saw(capture):
    path, seen = capture
    found = joulebus.read_arrays(path, "forecasts")
    assert set(found) == {"tick", "log_ns", "sent_ns", *joulebus.FORECAST.names}
    both = sorted(set(seen) & set(found["tick"].tolist()))
    assert len(both) > 10
    for tick in both:
        rows = found["tick"] == tick
        for name in joulebus.FORECAST.names:
            assert found[name][rows].tobytes() == seen[tick][name].tobytes(), (tick, name)


def test_the_lines_of_the_document_make_of_it_what_rerun_plots(capture, tmp_path, monkeypatch):
    # It is large: tested where it is installed.
    rerun = pytest.importorskip("rerun")
    page = (ROOT / "docs/how-to/python-lab.md").read_text()
    lines = page.split("## Plot a capture in Rerun")[1].split("```python\n")[1].split("```")[0]
    monkeypatch.chdir(tmp_path)
    (tmp_path / "run.mcap").symlink_to(capture[0])
    exec(compile(lines, "docs/how-to/python-lab.md", "exec"), {})
    # It writes the rest when a program ends.
    rerun.disconnect()
    assert (tmp_path / "run.rrd").stat().st_size > 4096


def test_every_topic_has_the_rows_that_the_program_counts(capture, run):
    path, _ = capture
    for topic, dtype in TOPICS.items():
        found = joulebus.read_arrays(path, topic)
        channels = json.loads(run("info", path, "--format", "json"))["files"][0]["channels"]
        [channel] = [channel for channel in channels if channel["topic"] == f"joulebus/test/{topic}"]
        assert len(np.unique(found["log_ns"])) > 10
        columns = {name: (found[name].dtype, found[name].shape[1:]) for name in dtype.names}
        assert columns == {name: (dtype[name].base, dtype[name].shape) for name in dtype.names}
        assert len(set(map(len, found.values()))) == 1
        assert (np.diff(found["log_ns"].astype(np.int64)) >= 0).all()
        times = set(found["log_ns"].tolist())
        assert (min(times), max(times)) == (channel["start_ns"], channel["end_ns"])
        assert len(times) <= channel["messages"]
        one = joulebus.read_arrays(path, topic, robots=[7])
        assert (one["robot"] == 7).all() and np.array_equal(one["stamp_ns"], found["stamp_ns"][found["robot"] == 7])
        assert len(joulebus.read_arrays(path, topic, robots=[])["robot"]) == 0
        assert len(joulebus.read_arrays(path, topic, robots=[4_000_000_000])["robot"]) == 0


def test_a_capture_is_a_data_frame(capture):
    pandas = pytest.importorskip("pandas")
    found = joulebus.read(capture[0], "forecasts", robots=[1, 2], fleet="test")
    assert isinstance(found, pandas.DataFrame) and set(found["robot"]) == {1, 2}
    assert set(found.groupby("tick").size()) <= {1, 2}


def test_a_window_has_the_messages_of_the_whole_capture_in_it(capture):
    path, _ = capture
    for topic in TOPICS:
        whole = joulebus.read_arrays(path, topic)
        log_ns = whole["log_ns"].astype(np.int64)
        first_ns = first_log_ns(path)
        for start_ns, stop_ns in [
            (None, None),
            (log_ns[len(log_ns) // 3], log_ns[len(log_ns) // 2]),
            (log_ns[0], log_ns[-1]),
            (log_ns[-1], None),
            (None, log_ns[-1] + 1),
            (log_ns[len(log_ns) // 2] + 1, None),
            (None, first_ns),
            (log_ns[-1] + 1, None),
            (log_ns[0], log_ns[0]),
        ]:
            kept = np.ones(len(log_ns), bool)
            kept &= True if start_ns is None else log_ns >= start_ns
            kept &= True if stop_ns is None else log_ns < stop_ns
            given = {"start": start_ns, "stop": stop_ns}
            forms = [lambda ns: np.datetime64(int(ns), "ns"), lambda ns: nanoseconds(int(ns))]
            for form in forms:
                window = {name: None if ns is None else form(ns) for name, ns in given.items()}
                found = joulebus.read_arrays(path, topic, **window)
                for name, values in whole.items():
                    assert found[name].tobytes() == values[kept].tobytes(), (topic, name, window)


def test_seconds_of_a_window_count_from_the_captures_first_message(capture):
    path, _ = capture
    whole, first_ns = joulebus.read_arrays(path, "samples"), first_log_ns(path)
    since_ns = whole["log_ns"].astype(np.int64) - first_ns
    start, stop = (np.ceil(1e-6 * since_ns[len(since_ns) * third // 3]) / 1e3 for third in (1, 2))
    found = joulebus.read_arrays(path, "samples", start=start, stop=stop)
    kept = (since_ns >= round(start * 1e9)) & (since_ns < round(stop * 1e9))
    assert 0 < kept.sum() < len(kept)
    assert np.array_equal(found["log_ns"], whole["log_ns"][kept])
    assert len(joulebus.read_arrays(path, "samples", start=0)["tick"]) == len(kept)
    assert len(joulebus.read_arrays(path, "samples", stop=0, robots=[7])["tick"]) == 0
    assert len(joulebus.read_arrays(path, "samples", start=1e6)["tick"]) == 0


def test_times_that_are_none_are_refused_with_what_is_allowed(capture):
    for wrong in [
        -1,
        float("nan"),
        float("inf"),
        time.time(),
        time.time_ns(),
        np.uint64(time.time_ns()),
        datetime.now(),
        np.datetime64("NaT"),
        np.datetime64("1969-12-31"),
        np.datetime64("9999-01-01"),
        datetime(1960, 1, 1, tzinfo=timezone.utc),
    ]:
        for name in ("start", "stop"):
            for read in (joulebus.read_arrays, joulebus.read_frames):
                with pytest.raises(ValueError, match=f"{name} is .*allowed: seconds after the capture's first"):
                    read(capture[0], "forecasts", **{name: wrong})
    for wrong in ["12:00", True, [1.0]]:
        with pytest.raises(TypeError, match="start is .*allowed"):
            joulebus.read_arrays(capture[0], "forecasts", start=wrong)
    with pytest.raises(ValueError, match="start is 2, after stop, which is 1"):
        joulebus.read_arrays(capture[0], "forecasts", start=2, stop=1)


def test_frames_of_a_capture_are_those_of_the_whole_one_after_the_other(capture):
    path, _ = capture
    for topic in TOPICS:
        whole = joulebus.live._columns(joulebus.read_arrays(path, topic))
        for given in [{}, {"rows": 100}, {"rows": 10**9}, {"robots": [2, 7]}, {"start": 0.2, "stop": 0.6, "rows": np.int64(7)}]:
            parts = list(joulebus.read_frames(path, topic, **given))
            window = {name: value for name, value in given.items() if name != "rows"}
            expected = joulebus.live._columns(joulebus.read_arrays(path, topic, **window)) if window else whole
            assert all(part.keys() == expected.keys() for part in parts)
            for name, values in expected.items():
                # A window may have no message of a topic.
                joined = np.concatenate([values[:0], *(part[name] for part in parts)])
                assert joined.dtype == values.dtype and joined.tobytes() == values.tobytes(), (topic, name)
            for part in parts[:-1]:
                assert len(part["tick"]) >= given.get("rows", 1)
            if "rows" not in given:
                # Whole frames, each once.
                assert all(len(set(part["log_ns"].tolist())) == 1 for part in parts)
    for wrong in (0, -1, 1.5, True, None):
        with pytest.raises(ValueError, match="rows is .*allowed: a whole number from 1"):
            joulebus.read_frames(path, "samples", rows=wrong)


@pytest.mark.parametrize("package", ["pandas", "polars"])
def test_frames_are_what_data_frames_take_and_write_as_parquet(package, capture, tmp_path):
    frames, file = pytest.importorskip(package), tmp_path / "part.parquet"
    if package == "pandas":
        pytest.importorskip("pyarrow")
    for topic in TOPICS:
        part = next(joulebus.read_frames(capture[0], topic, robots=[1, 2], rows=20))
        frame = frames.DataFrame(part)
        getattr(frame, {"pandas": "to_parquet", "polars": "write_parquet"}[package])(file)
        for frame in (frame, frames.read_parquet(file)):
            assert frame.shape == (len(part["tick"]), len(part))
            for name, values in part.items():
                assert frame[name].to_numpy().tobytes() == values.tobytes(), (topic, name)


def test_frames_of_a_long_capture_need_the_memory_of_one(tmp_path, run):
    steps = 200_000
    columns = {"timestamp_s": np.arange(steps) * 0.033, "power_w": 3.5 + 0.25 * np.sin(np.arange(steps))}
    joulebus.Trial(columns, "7").write(tmp_path / "long.csv")
    run("import", tmp_path / "long.csv", "-o", tmp_path / "long.mcap")
    measured = """
import sys, joulebus
peak = lambda: next(int(line.split()[1]) for line in open("/proc/self/status") if line.startswith("VmHWM"))
rows = lambda part: len(part["tick"])
path = sys.argv[1]
next(joulebus.read_frames(path, "samples"))
before = peak()
parts = sum(map(rows, joulebus.read_frames(path, "samples", rows=1000)))
in_parts = peak()
whole = rows(joulebus.read_arrays(path, "samples"))
print(parts, whole, in_parts - before, peak() - in_parts)
"""
    command = [sys.executable, "-P", "-c", measured, str(tmp_path / "long.mcap")]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    parts, whole, parts_kb, whole_kb = map(int, done.stdout.split())
    assert parts == whole == steps
    assert 4 * parts_kb < whole_kb


def test_wrong_captures_are_refused_and_damaged_ones_read_up_to_the_damage(capture, tmp_path):
    path, _ = capture
    whole = joulebus.read_arrays(path, "forecasts")
    with pytest.raises(ValueError, match="there is no topic forecast, allowed are samples, forecasts"):
        joulebus.read_arrays(path, "forecast")
    with pytest.raises(joulebus.RecordingError, match="no forecasts of fleet other, but of: test"):
        joulebus.read_arrays(path, "forecasts", fleet="other")
    with pytest.raises(FileNotFoundError, match="missing.mcap"):
        joulebus.read_arrays(tmp_path / "missing.mcap", "forecasts")
    with pytest.raises(ValueError, match="robots has -1"):
        joulebus.read_arrays(path, "forecasts", robots=[-1])
    contents = path.read_bytes()
    broken = tmp_path / "broken.mcap"
    for wrong in (b"", b"no capture", contents[100:], bytes(1 << 16)):
        broken.write_bytes(wrong)
        with pytest.raises(joulebus.RecordingError, match="broken.mcap"):
            joulebus.read_arrays(broken, "forecasts")
    # A recorder that was killed, and noise in the middle.
    rng, told = np.random.default_rng(3), 0
    for at in rng.integers(len(contents) // 10, len(contents) * 9 // 10, 12).tolist():
        for wrong in (contents[:at], contents[:at] + rng.bytes(64) + contents[at + 64 :]):
            broken.write_bytes(wrong)
            with warnings.catch_warnings(record=True) as warned:
                warnings.simplefilter("always")
                try:
                    found = joulebus.read_arrays(broken, "forecasts")
                except joulebus.RecordingError as error:
                    # Damaged before the first forecast.
                    assert "broken.mcap" in str(error)
                    continue
            assert [each.category for each in warned] == [joulebus.RecordingDamaged], at
            with pytest.warns(joulebus.RecordingDamaged):
                parts = list(joulebus.read_frames(broken, "forecasts"))
            assert sum(len(part["tick"]) for part in parts) == len(found["tick"])
            assert "broken.mcap" in str(warned[0].message)
            told += 1
            rows = len(found["tick"])
            assert rows <= len(whole["tick"])
            if len(wrong) == at:
                assert np.array_equal(found["tick"], whole["tick"][:rows])
    assert told > 0


COLUMNS = {
    "timestamp_s": np.arange(200) * 0.033,
    "v_mps": np.tile([0.0, 0.1], 100),
    "omega_radps": np.full(200, 0.25),
    "power_w": 3.5 + 0.25 * np.sin(np.arange(200)),
}


@pytest.mark.parametrize("name", ["trial.csv", "trial.csv.gz", "trial.npy"])
def test_trials_are_written_and_read_back(name, tmp_path, run):
    path = tmp_path / name
    joulebus.Trial(dict(COLUMNS), "7").write(path)
    [found] = joulebus.read_trials(path)
    assert len(found) == 200 and float(found.robot) == 7.0
    for column, values in COLUMNS.items():
        # Through mW, where the last bit may change.
        assert np.allclose(found.columns[column], values, rtol=1e-15, atol=0.0), column
    told = json.loads(run("data", "info", path, "--format", "json"))
    assert "200" in json.dumps(told)


def test_several_robots_share_a_file(tmp_path):
    rows = io.StringIO()
    writer = csv.writer(rows)
    writer.writerow(["robot_id", "timestamp_s", "power_mW"])
    writer.writerows([robot, 0.033 * at, 3500 + robot] for at in range(10) for robot in (1, 2))
    path = tmp_path / "both.csv"
    path.write_text(rows.getvalue())
    found = joulebus.read_trials(path)
    assert [trial.robot for trial in found] == ["1", "2"]
    assert [trial.columns["power_w"][0] for trial in found] == [3.501, 3.502]
    assert "v_mps" not in found[0].columns and "rows=10" in repr(found[0])


def test_a_trials_rows_are_the_features_of_the_paper(tmp_path):
    features, power_w = joulebus.Trial(dict(COLUMNS)).rows()
    assert features.shape == (len(power_w), 13) and features.dtype == power_w.dtype == np.float32
    readings = COLUMNS["power_w"].astype(np.float32)
    # Five readings before, newest first, and the one after.
    at = 10
    row = int(np.flatnonzero(bits(features[:, 6]) == bits(readings[at : at + 1])[0])[0])
    assert np.array_equal(bits(features[row, 6:11]), bits(readings[at - 4 : at + 1][::-1]))
    assert bits(power_w[row : row + 1])[0] == bits(readings[at + 1 : at + 2])[0]
    assert np.array_equal(features[:, 4], np.abs(features[:, 0]))
    model = joulebus.Predictor()
    assert model.predict(features).shape == power_w.shape and model.score(features, power_w) < 1.0
    fitted = joulebus.Predictor(seed=1, max_epochs=2).fit(features, power_w)
    assert np.isfinite(fitted.predict(features)).all()


def test_wrong_trials_are_refused_with_what_is_allowed(tmp_path):
    def write(name="a.csv", **columns):
        joulebus.Trial(COLUMNS | columns, "7").write(tmp_path / name)

    for said, columns in [
        ("there is no column power, allowed are timestamp_s", dict(power=COLUMNS["power_w"])),
        ("power_w has shape (3,), allowed: (200,)", dict(power_w=[1.0, 2.0, 3.0])),
        ("power_w has shape ()", dict(power_w=1.0)),
    ]:
        with pytest.raises(ValueError) as refused:
            write(**columns)
        assert said in str(refused.value)
    with pytest.raises(ValueError, match="timestamp_s is missing"):
        joulebus.Trial({"power_w": [1.0, 2.0]}).write(tmp_path / "a.csv")
    for columns in [dict(timestamp_s=np.full(200, np.nan)), dict(power_w=np.full(200, 1e300)), dict(timestamp_s=np.zeros(200))]:
        with pytest.raises(joulebus.RecordingError):
            write(**columns)
    with pytest.raises(joulebus.RecordingError, match="txt"):
        write(name="a.txt")
    with pytest.raises(FileNotFoundError):
        joulebus.read_trials(tmp_path / "missing.csv")
    (tmp_path / "b.csv").write_text("nothing\n")
    with pytest.raises(joulebus.RecordingError, match="b.csv"):
        joulebus.read_trials(tmp_path / "b.csv")


def test_implausible_trials_raise_unless_they_are_accepted_or_turned(tmp_path):
    turned = joulebus.Trial(COLUMNS | {"power_w": -COLUMNS["power_w"]}, "7")
    for refused in [lambda: turned.write(tmp_path / "a.csv"), turned.rows]:
        with pytest.raises(joulebus.RecordingError, match="sign.*negative"):
            refused()
    turned.write(tmp_path / "a.csv", accept="sign")
    assert len(turned.rows(accept=["sign"])[1]) > 100
    with pytest.raises(joulebus.RecordingError, match="accept="):
        joulebus.read_trials(tmp_path / "a.csv")
    [kept] = joulebus.read_trials(tmp_path / "a.csv", accept=["sign"])
    assert (kept.columns["power_w"] < 0.0).all()
    [found] = joulebus.read_trials(tmp_path / "a.csv", current="discharge-negative")
    assert np.allclose(found.columns["power_w"], COLUMNS["power_w"])
    [found] = joulebus.read_trials(tmp_path / "a.csv", columns={"power_mW": "-power_mW"})
    assert np.allclose(found.columns["power_w"], COLUMNS["power_w"])
    for arguments in [dict(accept=["sing"]), dict(current="negative"), dict(columns={"power_hp": "p"})]:
        with pytest.raises(ValueError):
            joulebus.read_trials(tmp_path / "a.csv", **arguments)
    for computed in [joulebus.train, joulebus.analyze]:
        with pytest.raises(joulebus.RecordingError, match="sign"):
            computed(turned)
