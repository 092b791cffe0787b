"""The interface of the paper, in mW: by name, by unit, and bit for bit what the network says."""
from __future__ import annotations

import importlib.util
import inspect

import joulebus
import numpy as np
import pytest
from conftest import bits, model_file


def test_the_interface_is_the_papers_word_for_word():
    predictor = joulebus.EnergyPredictor(str(model_file("gternal-sim")))
    predictor.reset(initial_power=3500.0)
    assert isinstance(predictor.step(v_cmd=0.1, w_cmd=0.0), float)
    assert isinstance(predictor.step_with_correction(v_cmd=0.1, w_cmd=0.0, measured_power=3600.0), float)
    names = list(inspect.signature(predictor.step_with_correction).parameters)
    assert names == ["v_cmd", "w_cmd", "measured_power"]


def test_its_forecasts_are_those_of_the_exported_module(run, tmp_path):
    run("model", "export", model_file("gternal-sim"), "--out", tmp_path / "predictor.py")
    spec = importlib.util.spec_from_file_location("exported_predictor", tmp_path / "predictor.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    ours, exported = joulebus.EnergyPredictor(model_file("gternal-sim")), module.EnergyPredictor()
    noise = np.random.default_rng(1)
    for initial in [3500.0, 4200, np.array([3100.0, 3500.0, 5000.0])]:
        ours.reset(initial)
        exported.reset(initial)
        for step in range(200):
            v, w = noise.uniform(-0.15, 0.16), noise.uniform(-3.0, 3.0)
            if step % 3 == 0:
                found, expected = ours.step(v, w), exported.step(v, w)
            else:
                measured = float("nan") if step % 7 == 0 else noise.uniform(3000.0, 5000.0)
                found = ours.step_with_correction(v, w, measured)
                expected = exported.step_with_correction(v, w, measured)
            # The module computes in double precision.
            assert np.shape(found) == np.shape(expected)
            assert np.allclose(found, expected, rtol=0.0, atol=0.05), step


def test_its_forecasts_are_the_networks_bit_for_bit():
    predictor, model = joulebus.EnergyPredictor(), joulebus.Predictor()
    noise = np.random.default_rng(2)
    predictor.reset(3500.0)
    lag_w, before = [np.float32(3.5)] * 5, None
    for _ in range(100):
        v, w, measured = noise.uniform(-0.15, 0.16), noise.uniform(-3.0, 3.0), noise.uniform(3000.0, 5000.0)
        command = np.array([v, w], np.float32)
        change = np.zeros(2, np.float32) if before is None else (command - before) / np.float32(0.033)
        row = np.array([*command, *change, *np.abs(command), *lag_w], np.float32)
        found = predictor.step_with_correction(v, w, measured)
        assert bits(found * 1e-3) == bits(model.predict(row[None])[0])
        lag_w, before = [np.float32(1e-3 * measured), *lag_w[:-1]], command


def test_arrays_have_one_element_for_each_robot():
    many = joulebus.EnergyPredictor()
    v, w = np.linspace(-0.1, 0.1, 50), np.linspace(-1.0, 1.0, 50)
    found = [many.step(v, w), many.step_with_correction(v, 0.0, np.full(50, 3600.0)), many.step(0.1, 0.0)]
    for robot in [0, 17, 49]:
        one = joulebus.EnergyPredictor()
        expected = [one.step(v[robot], w[robot]), one.step_with_correction(v[robot], 0.0, 3600), one.step(0.1, 0)]
        assert [float(each[robot]) for each in found] == expected
    assert found[0].dtype == np.float64 and found[0].shape == (50,)
    many.reset()
    assert isinstance(many.step(0.0, 0.0), float)


def test_what_is_wrong_is_refused_and_changes_nothing():
    predictor, same = joulebus.EnergyPredictor(), joulebus.EnergyPredictor()
    nan, inf = float("nan"), float("inf")
    for wrong, kind, said in [
        (lambda: predictor.step(nan, 0.0), ValueError, "allowed are finite numbers"),
        (lambda: predictor.step(0.0, inf), ValueError, "the command is"),
        (lambda: predictor.step_with_correction(0.0, 0.0, inf), ValueError, "measured_power is inf"),
        (lambda: predictor.step("a", 0.0), TypeError, "v_cmd has dtype"),
        (lambda: predictor.step(None, 0.0), TypeError, "v_cmd"),
        (lambda: predictor.step(1j, 0.0), TypeError, "complex"),
        (lambda: predictor.step(np.zeros(3), np.zeros(4)), ValueError, "w_cmd has shape (4,), allowed: (3,)"),
        (lambda: predictor.reset(inf), ValueError, "initial_power is inf"),
        (lambda: predictor.reset(nan), ValueError, "finite powers in mW"),
        (lambda: predictor.reset([3500.0, nan]), ValueError, "finite powers in mW"),
        (lambda: joulebus.EnergyPredictor(period_s=0.0), ValueError, "period_s is 0"),
        (lambda: joulebus.EnergyPredictor(period_s=nan), ValueError, "above 0 s"),
    ]:
        with pytest.raises(kind) as refused:
            wrong()
        assert said in str(refused.value)
        assert predictor.step(0.1, 0.2) == same.step(0.1, 0.2)
    with pytest.raises(OverflowError):
        predictor.step(10**400, 0.0)


def test_nan_measured_continues_with_the_forecast():
    corrected, open_loop = joulebus.EnergyPredictor(), joulebus.EnergyPredictor()
    for _ in range(10):
        assert corrected.step_with_correction(0.1, 0.5, float("nan")) == open_loop.step(0.1, 0.5)


def test_the_period_is_the_models(run, tmp_path):
    time_s = np.arange(600) / 6.5
    power_w = 40.0 + 5.0 * np.sin(0.3 * np.arange(600)) + np.cos(2.9 * np.arange(600))
    table = np.column_stack([time_s, power_w, 0.2 + 0.1 * np.sin(time_s), 0.1 * np.cos(time_s)])
    recording, model = tmp_path / "slow.csv", tmp_path / "slow.safetensors"
    np.savetxt(recording, table, delimiter=",", header="time,power_W,v_cmd,omega_cmd", comments="")
    run("train", "trials", recording, "--split", "time", "--out", model)
    assert np.isclose(joulebus.EnergyPredictor(model).period_s, 1 / 6.5, rtol=1e-3)
    assert joulebus.EnergyPredictor(model, 0.033).period_s == np.float32(0.033)
    assert joulebus.EnergyPredictor().period_s == np.float32(0.033)
