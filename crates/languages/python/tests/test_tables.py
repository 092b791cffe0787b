"""Tables in memory are read as a CSV with the same columns."""
from __future__ import annotations

import datetime

import joulebus
import numpy as np
import pytest

ROWS = 200
TIME_S = 1.7e9 + 0.1 * np.arange(ROWS)
POWER_W = 3.5 + 0.25 * np.sin(np.arange(ROWS))
TABLE = {"timestamp_s": TIME_S, "power_W": POWER_W, "v_mps": np.tile([0.0, 0.1], ROWS // 2)}


def one(frame, **more):
    [trial] = joulebus.read_table(frame, **more)
    return trial


def same(found, expected):
    assert found.columns.keys() == expected.columns.keys()
    for name, values in expected.columns.items():
        assert found.columns[name].tobytes() == values.tobytes(), name


@pytest.fixture
def frames():
    return {package: pytest.importorskip(package) for package in ("pandas", "polars")}


def structured(table):
    rows = np.empty(ROWS, [(name, values.dtype) for name, values in table.items()])
    for name, values in table.items():
        rows[name] = values
    return rows


def test_every_table_is_read_as_the_csv_with_its_columns(frames, tmp_path):
    frames["pandas"].DataFrame(TABLE).to_csv(tmp_path / "table.csv", index=False)
    [expected] = joulebus.read_trials(tmp_path / "table.csv")
    assert len(expected) == ROWS and len(expected.columns) == 4 - 1
    for frame in [TABLE, structured(TABLE), *(package.DataFrame(TABLE) for package in frames.values())]:
        same(one(frame), expected)


def test_a_trials_own_frame_is_read_to_the_same_trial():
    every = ["voltage_v", "current_a", "x_m", "y_m", "theta_rad", "v_measured_mps", "omega_measured_radps", "phase"]
    noise = np.random.default_rng(5)
    columns = {"timestamp_s": TIME_S, "v_mps": TABLE["v_mps"], "omega_radps": noise.normal(0.0, 0.3, ROWS), "power_w": POWER_W}
    columns |= {name: 7.0 + 0.1 * noise.random(ROWS) for name in every} | {"soc": np.linspace(0.9, 0.8, ROWS)}
    columns["current_a"] = columns["power_w"] / columns["voltage_v"]
    found = one(columns)
    assert found.columns.keys() == columns.keys()
    for name, values in columns.items():
        # Through mW, where the last bit may change.
        assert np.allclose(found.columns[name], values, rtol=1e-15, atol=0.0), name


def test_numbers_of_every_type_are_those_of_double_precision(frames):
    for dtype in (np.float16, np.float32, ">f8", np.int8, np.uint16, np.int32, np.uint64, bool):
        speed = np.tile([0, 1], ROWS // 2).astype(dtype)
        power = (3000.5 + 100 * np.sin(np.arange(ROWS))).astype(np.float32)
        found = one({"time_s": 0.1 * np.arange(ROWS), "power_mW": power, "v_mps": speed})
        assert np.array_equal(found.columns["v_mps"], speed.astype(np.float64)), dtype
        assert np.array_equal(found.columns["power_w"], power.astype(np.float64) / 1000.0), dtype


def test_times_of_every_type_are_times(frames):
    pandas, polars = frames["pandas"], frames["polars"]
    moments = np.datetime64("2026-04-07T23:59:50", "ns") + np.arange(ROWS) * np.timedelta64(100, "ms")
    zoned = pandas.to_datetime(moments).tz_localize("UTC").tz_convert("Asia/Tokyo")
    power = pandas.DataFrame({"power_W": POWER_W})
    zoned_polars = polars.DataFrame({"time": moments, "power_W": POWER_W}).with_columns(
        polars.col("time").dt.replace_time_zone("UTC").dt.convert_time_zone("Asia/Tokyo")
    )
    python = [datetime.datetime(2026, 4, 7, 23, 59, 50) + at * datetime.timedelta(seconds=0.1) for at in range(ROWS)]
    for table in [
        power.assign(time=moments),
        power.assign(time=moments.astype("datetime64[ms]")),
        power.assign(time=zoned),
        power.set_index(pandas.DatetimeIndex(moments)),
        power.set_index(zoned.rename("time")),
        polars.DataFrame({"time": moments, "power_W": POWER_W}),
        zoned_polars,
        {"time": np.array(python, object), "power_W": POWER_W},
        {"time": moments - moments[0], "power_W": POWER_W},
        {"time_ns": moments.astype(np.int64), "power_W": POWER_W},
        {"time": np.ma.MaskedArray(moments, False), "power_W": POWER_W},
        power.set_index(pandas.Index(0.1 * np.arange(ROWS), name="time_s")),
    ]:
        found = one(table).columns["timestamp_s"]
        assert np.allclose(found - found[0], 0.1 * np.arange(ROWS), rtol=0.0, atol=1e-6), table


def test_what_is_missing_is_missing_however_a_library_marks_it(frames):
    pandas, polars = frames["pandas"], frames["polars"]
    gone = np.arange(ROWS) % 17 == 3
    power = np.where(gone, np.nan, POWER_W)
    expected = one({"time_s": 0.1 * np.arange(ROWS), "power_W": power})
    assert np.array_equal(np.isnan(expected.columns["power_w"]), gone)
    objects = np.array([None if lost else value for lost, value in zip(gone, POWER_W)], object)
    times = 0.1 * np.arange(ROWS)
    for values in [
        objects,
        np.ma.MaskedArray(POWER_W, gone),
        pandas.array(objects, "Float64"),
        pandas.array(objects.tolist(), pandas.ArrowDtype(pytest.importorskip("pyarrow").float64())),
        polars.Series("power_W", objects.tolist()),
    ]:
        same(one({"time_s": times, "power_W": values}), expected)
        if not isinstance(values, polars.Series):
            same(one(pandas.DataFrame({"time_s": times, "power_W": values})), expected)
    # Of whole numbers, and where nothing of a row is left.
    counts = polars.DataFrame({"time_ns": [10**8 * at + 1_700_000_000 * 10**9 for at in range(ROWS)], "power_mW": [None, 3500] * (ROWS // 2)})
    found = one(counts).columns
    assert np.array_equal(np.isnan(found["power_w"]), np.tile([True, False], ROWS // 2))
    empty = pandas.DataFrame({"time_s": times, "power_W": objects}).convert_dtypes().set_index("time_s")
    same(one(empty), expected)


@pytest.mark.parametrize("package", ["pandas", "polars"])
def test_robots_of_a_table_are_trials_of_their_own(package, frames):
    robots = ["#r, 1", 'the "second"', "dritter ü"]
    table = {
        "robot_id": np.repeat(robots, ROWS),
        "timestamp_s": np.tile(TIME_S, 3),
        "power_W": np.concatenate([POWER_W, POWER_W + 1.0, POWER_W + 2.0]),
    }
    frame = frames[package].DataFrame(table)
    for given in (frame, table, frame.with_columns(frame["robot_id"].cast(frames["polars"].Categorical)) if package == "polars" else frame.astype({"robot_id": "category"})):
        found = joulebus.read_table(given, name="fleet")
        assert [trial.robot for trial in found] == robots
        assert [trial.name for trial in found] == [f"fleet {robot}" for robot in robots]
        for trial, more in zip(found, range(3)):
            assert np.allclose(trial.columns["power_w"], POWER_W + more)


def test_a_file_of_matlab_is_read_by_scipy_and_the_reader_of_tables(tmp_path):
    io = pytest.importorskip("scipy.io")
    path = tmp_path / "run.mat"
    variables = {"t": 0.1 * np.arange(ROWS), "P": POWER_W, "vel": TABLE["v_mps"].reshape(-1, 1)}
    io.savemat(path, variables)
    expected = one({"time_s": variables["t"], "power_W": POWER_W, "v_mps": TABLE["v_mps"]})
    columns = {"time_s": "t", "power_W": "P", "v_mps": "vel"}
    same(one(io.loadmat(path), columns=columns), expected)
    same(one(io.loadmat(path, squeeze_me=True), columns=columns), expected)
    io.savemat(path, variables | {"rate_Hz": 10.0})
    with pytest.raises(ValueError, match="run.mat has columns of several lengths: t 200, P 200, vel 200, rate_Hz 1, allowed"):
        joulebus.read_table(io.loadmat(path), name="run.mat")


def test_refusals_are_those_of_the_program_with_the_tables_name(frames):
    table = frames["pandas"].DataFrame(TABLE)
    with pytest.raises(joulebus.RecordingError, match="mine: no column for power"):
        joulebus.read_table(table[["timestamp_s"]], name="mine")
    with pytest.raises(joulebus.RecordingError, match="(?s)mine.*power.*negative.*accept=") as told:
        joulebus.read_table(table.assign(power_W=-POWER_W), name="mine")
    assert "--" not in str(told.value) and 'current="discharge-negative"' in str(told.value)
    [turned] = joulebus.read_table(table.assign(power_W=-POWER_W), current="discharge-negative")
    assert (turned.columns["power_w"] > 0.0).all()
    [kept] = joulebus.read_table(table.assign(power_W=-POWER_W), accept=["sign"])
    assert (kept.columns["power_w"] < 0.0).all()
    with pytest.raises(joulebus.RecordingError, match="mine: row 3, column power_W: found"):
        joulebus.read_table(table.assign(power_W=["3"] * 2 + ["much"] + ["3"] * (ROWS - 3)), name="mine")
    with pytest.raises(joulebus.RecordingError, match="table"):
        joulebus.read_table(table[:0])
    for said, wrong in [
        ("a list, allowed: a DataFrame of pandas", [1.0]),
        ("LazyFrame.*collect", frames["polars"].DataFrame(TABLE).lazy()),
        ("column power_W has shape", TABLE | {"power_W": np.ones((ROWS, 2))}),
        ("column power_W has shape .*complex", TABLE | {"power_W": POWER_W * 1j}),
        ("column power_W, row 1: found a dict", TABLE | {"power_W": np.array([{}] * ROWS, object)}),
    ]:
        with pytest.raises(TypeError, match=said):
            joulebus.read_table(wrong)
    for wrong in [{}, TABLE | {"power_W": POWER_W[1:]}]:
        with pytest.raises(ValueError, match="table has"):
            joulebus.read_table(wrong)
