"""rmf_battery's parameters: those that made the data, errors on real drives, and the keys that a fleet adapter reads."""
from __future__ import annotations

import re
import subprocess
import sys
import time

import joulebus
import numpy as np
import pytest
from conftest import ROOT, needed
from joulebus import rmf
from worker import PATIENCE_S, Fleet, until

DATA = ROOT.parent / "shared/data"
MADE = {"mass_kg": 80.0, "moment_of_inertia_kgm2": 20.0, "friction_coefficient": 0.22, "ambient_w": 25.0}


def profile(distance: float, top: float, rate: float, at: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Speed and acceleration of a trapezoid at times after its start."""
    top = min(top, np.sqrt(distance * rate))
    ramp, whole = top / rate, distance / top + top / rate
    speed = np.clip(np.minimum(at, whole - at) * rate, 0.0, top)
    accelerating = np.where((0.0 <= at) & (at < ramp), rate, np.where((whole - ramp < at) & (at <= whole), rate, 0.0))
    return speed, accelerating


def drive(seed: int, noise: float = 0.02) -> joulebus.Trial:
    """Ways of Open-RMF: turn on the spot, then straight ahead, as its planner makes them, with rests."""
    random = np.random.default_rng(seed)
    rows: list[np.ndarray] = []
    for _ in range(8):
        for turns, most, top, rate in ((True, 3.0, 0.6, 0.35), (False, 8.0, random.uniform(0.3, 0.7), 0.25)):
            time_s = np.arange(0.0, 20.0, 0.05)
            speed, accelerating = profile(random.uniform(0.3, most), top, rate, time_s)
            power_w = accelerating * speed * MADE["moment_of_inertia_kgm2" if turns else "mass_kg"] + MADE["ambient_w"]
            if not turns:
                power_w += MADE["friction_coefficient"] * MADE["mass_kg"] * 9.81 * speed
            rows.append(np.array([0.0 * speed, speed, power_w] if turns else [speed, 0.0 * speed, power_w]))
    v, omega, power_w = np.concatenate(rows, axis=1)
    power_w *= random.normal(1.0, noise, len(power_w))
    voltage_v = np.full(len(v), 24.0)
    columns = {"timestamp_s": 0.05 * np.arange(len(v)), "v_mps": v, "omega_radps": omega, "power_w": power_w}
    return joulebus.Trial(columns | {"voltage_v": voltage_v}, name=f"drive {seed}")


def test_the_parameters_that_made_the_power_are_found():
    found = rmf.fit([drive(seed) for seed in range(3)], capacity_wh=960.0, charging_a=26.4)
    for name, value in MADE.items():
        assert found.data[name] == pytest.approx(value, rel=0.05), name
    assert all(found.data["from"][name].startswith("fitted") for name in MADE)
    assert found.data["from"]["friction_coefficient"] == "fitted, for this mass"
    errors = found.data["errors"]
    assert errors["rmf_battery"] < 0.01 < errors["mean_power"]
    # A given mass is taken, and the friction stays what the distance costs.
    given = rmf.fit(drive(0), mass_kg=100.0, hotel_w=5.0, tool_w=3.0)
    friction_n = given.data["friction_coefficient"] * 100.0
    assert friction_n == pytest.approx(MADE["friction_coefficient"] * MADE["mass_kg"], rel=0.1)
    assert given.data["from"]["mass_kg"] == "given" and given.data["tool_w"] == 3.0
    assert given.data["from"]["friction_coefficient"] == "fitted"
    assert given.data["ambient_w"] == pytest.approx(30.0, rel=0.05)
    assert given.data["errors"]["rmf_battery"] is None


def test_the_terms_are_those_of_open_rmf():
    """The sum that SimpleMotionPowerSink makes of moments, in finer steps than its 0.5 s."""
    time_s = np.arange(0.0, 60.01, 0.01)
    for turns, distance, top, rate in ((False, 20.0, 0.7, 0.3), (True, 6.0, 0.6, 0.4)):
        speed, accelerating = profile(distance, top, rate, time_s)
        v, omega = (0.0 * speed, speed) if turns else (speed, 0.0 * speed)
        costs, way = (accelerating * speed).sum() * 0.01, speed.sum() * 0.01
        expected = [0.0, costs, 0.0, 60.0] if turns else [costs, 0.0, way, 60.0]
        np.testing.assert_allclose(rmf.terms(time_s, v, omega).sum(axis=0), expected, rtol=0.02)
    # A curve costs the acceleration across it: the mean of a circle is m v² ω.
    curve = rmf.terms(time_s, 0.5 + 0.0 * time_s, 0.4 + 0.0 * time_s)
    np.testing.assert_allclose(curve, rmf.STEP_S * np.tile([0.5 * 0.5 * 0.4, 0.0, 0.5, 1.0], (len(curve), 1)), rtol=1e-9, atol=1e-12)


def test_what_drives_do_not_tell_is_named_and_costs_nothing():
    straight = drive(0)
    straight.columns["omega_radps"][:] = 0.0
    found = rmf.fit(straight)
    assert "not told" in found.data["from"]["moment_of_inertia_kgm2"]
    assert found.data["capacity_wh"] is None and found.data["voltage_v"] == 24.0
    text = found.yaml()
    assert "# battery_system: yours. capacity_wh is unknown: --capacity-wh." in text and "voltage:" not in text
    resting = drive(1)
    for name in ("v_mps", "omega_radps"):
        resting.columns[name][:] = 0.0
    resting.columns["power_w"][:] = 12.0 + 0.01 * np.arange(len(resting)) % 0.1
    still = rmf.fit(resting).data
    assert still["ambient_w"] == pytest.approx(12.0, abs=0.1) and all(still[name] > 0.0 for name in MADE), "RMF allows no 0"
    nothing = drive(2)
    nothing.columns["power_w"][:] = np.nan
    with pytest.raises(ValueError, match="none of 1 recordings has velocities and power"):
        rmf.fit(nothing)
    with pytest.raises(ValueError, match="mass_kg is nan, allowed: a finite number > 0"):
        rmf.fit(straight, mass_kg=float("nan"))


def test_the_yaml_has_the_keys_that_a_fleet_adapter_reads():
    keys = {
        "battery_system": ("voltage", "capacity", "charging_current"),
        "mechanical_system": ("mass", "moment_of_inertia", "friction_coefficient"),
        "ambient_system": ("power",),
        "tool_system": ("power",),
    }
    text = rmf.fit([drive(seed) for seed in range(2)], capacity_wh=960.0, charging_a=26.4).yaml()
    lines = text.splitlines()
    assert lines[0] == "rmf_fleet:"
    at = iter(lines[1:])
    values = {}
    for section, names in keys.items():
        assert next(at) == f"  {section}:"
        for name in names:
            values[section, name] = float(re.fullmatch(rf"    {name}: (\S+)  # .+", next(at))[1])
    assert next(at, None) is None
    assert values["battery_system", "voltage"] == 24.0 and values["battery_system", "capacity"] == 40.0
    yaml = pytest.importorskip("ruamel.yaml")
    read = yaml.YAML(typ="safe").load(text)["rmf_fleet"]
    assert {(section, name): read[section][name] for section, name in values} == values


@pytest.mark.parametrize("folder, pattern, most", [("husky_commanded", "wetgrass*", 0.02), ("warthog_commanded", "*.csv.gz", 0.45)])
def test_real_drives_have_errors_beside_those_of_joulebus(folder, pattern, most):
    paths = sorted((DATA / folder).glob(pattern))
    if not paths:
        needed(f"{DATA / folder}")
    command = [sys.executable, "-m", "joulebus.rmf", *map(str, paths), "--capacity-wh", "480"]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert "battery_system: yours. charging_a is unknown" in done.stdout and "  ambient_system:" in done.stdout
    errors = rmf.fit(paths).data["errors"]
    told = re.search(r"missed by: rmf_battery (\S+) %, mean power of the others (\S+) %, joulebus (\S+) %", done.stderr)
    assert [round(100.0 * one, 1) for one in errors.values()] == [float(one) for one in told.groups()]
    assert 0.0 < errors["rmf_battery"] < most and errors["joulebus"] < 0.25


def test_a_capture_of_a_live_fleet_tells_its_battery(program, tmp_path):
    battery = "[platform.battery]\ncapacity_wh = 10.0\ninitial_soc_lo = 0.9\n"
    fleet, path = Fleet(program, tmp_path, 4, battery=battery), tmp_path / "run.mcap"
    try:
        fleet.start()
        until("a worker", lambda: "ready" in fleet.log(), fleet)
        recorder = subprocess.Popen([program, "record", "--config", fleet.config, "-o", path], stderr=subprocess.PIPE)
        until("a recorder", path.exists, fleet)
        with joulebus.Publisher(fleet.config, "robots") as publisher:
            for tick in range(150):
                v = 0.1 + 0.05 * np.sin(0.2 * tick + np.arange(4))
                # Robot 0 is on its charger, whose current flows into the battery.
                docked = np.arange(4) == 0
                voltage, power = 4.0 + 0.01 * np.sin(tick), np.where(docked, np.nan, 3.0 + 9.0 * v)
                current = np.where(docked, -2.0 + 0.1 * np.cos(tick), power / voltage)
                columns = {"v": np.where(docked, 0.0, v), "power": power, "voltage": voltage, "current": current}
                publisher.publish(np.arange(4), omega=0.0, charging=docked, **columns)
                time.sleep(0.033)
        recorder.terminate()
        assert recorder.wait(PATIENCE_S) in (0, 3)
    finally:
        fleet.close()
    found = rmf.fit(path).data
    assert found["capacity_wh"] == pytest.approx(10.0, rel=1e-3) and found["charging_a"] == pytest.approx(2.0, rel=0.02)
    assert found["voltage_v"] == pytest.approx(4.0, rel=0.01) and found["drives"] == 3
    assert found["from"]["capacity_wh"] == "10 Wh by which the worker counted"
