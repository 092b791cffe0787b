"""Forecasts on arrays have the bits of Rust, and what is wrong is an exception that says so."""
from __future__ import annotations

import pickle
import threading

import joulebus
import numpy as np
import pytest
from conftest import bits, model_file, rows

MODELS = ["gternal-sim", "gternal-sim-power", "gternal-sim-freshness"]


@pytest.mark.parametrize("name", MODELS)
def test_forecasts_have_the_bits_that_the_program_exports(name, run, tmp_path):
    archive = tmp_path / "model.npz"
    run("model", "export", model_file(name), "--out", archive)
    with np.load(archive) as found:
        read, expected_w = found["check_features"], found["check_power_w"]
    inputs = np.full((len(read), 13), np.nan, np.float32)
    first = 6 if "power" in name else 0
    inputs[:, first : first + read.shape[1]] = read
    for model in [str(model_file(name)), f"builtin:{name}"]:
        predictor = joulebus.Predictor(model)
        assert np.array_equal(bits(predictor.predict(inputs)), bits(expected_w)), model
        if read.shape[1] <= 11:
            assert np.array_equal(bits(predictor.predict(inputs[:, :11])), bits(expected_w)), model


def test_a_robot_has_the_same_bits_in_every_batch_type_and_layout():
    predictor, inputs = joulebus.Predictor(), rows(1000)
    expected = bits(predictor.predict(inputs))
    for count in [1, 2, 15, 16, 17, 31, 32, 33, 999]:
        assert np.array_equal(bits(predictor.predict(inputs[:count])), expected[:count])
    for same in [
        inputs.astype(np.float64),
        np.asfortranarray(inputs),
        inputs.astype(">f4"),
        inputs[:, ::-1][:, ::-1],
        inputs.tolist(),
        np.hstack([inputs, np.full((1000, 2), np.nan, np.float32)]),
    ]:
        assert np.array_equal(bits(predictor.predict(same)), expected)
    spaced = np.empty((1000, 22), np.float32)
    spaced[:, ::2] = inputs
    assert np.array_equal(bits(predictor.predict(spaced[:, ::2])), expected)
    inputs.flags.writeable = False
    assert np.array_equal(bits(predictor.predict(inputs)), expected)
    found = predictor.predict(inputs)
    assert found.dtype == np.float32 and found.shape == (1000,)
    assert predictor.predict(np.empty((0, 11))).shape == (0,)


def test_a_nan_affects_its_own_robot_only():
    predictor, inputs = joulebus.Predictor(), rows(100)
    expected = bits(predictor.predict(inputs))
    for value in [np.nan, np.inf, -np.inf]:
        for feature in range(11):
            wrong = inputs.copy()
            wrong[40, feature] = value
            found = predictor.predict(wrong)
            assert not np.isfinite(found[40])
            assert np.array_equal(np.delete(bits(found), 40), np.delete(expected, 40))


@pytest.mark.parametrize(
    "wrong, kind, said",
    [
        (np.zeros(11), ValueError, "features has shape (11,), allowed: (robots, 11)"),
        (np.zeros((3, 10)), ValueError, "features has shape (3, 10)"),
        (np.zeros((3, 12)), ValueError, "(3, 12)"),
        (np.zeros((1, 3, 11)), ValueError, "(1, 3, 11)"),
        (np.zeros((3, 0)), ValueError, "(3, 0)"),
        (3.0, ValueError, "features has shape ()"),
        (np.zeros((2, 11), complex), TypeError, "dtype complex128"),
        (np.zeros((2, 11), bool), TypeError, "dtype bool"),
        (np.full((2, 11), "1"), TypeError, "allowed are real numbers"),
        (np.full((2, 11), None), TypeError, "dtype object"),
        (np.zeros((2, 11), "m8[s]"), TypeError, "timedelta64"),
        ("rows", TypeError, "allowed are real numbers"),
        (None, TypeError, "dtype object"),
        ([[1.0] * 11, [1.0] * 10], ValueError, ""),
    ],
)
def test_wrong_rows_are_refused_with_what_is_allowed(wrong, kind, said):
    with pytest.raises(kind) as refused:
        joulebus.Predictor().predict(wrong)
    assert said in str(refused.value)


def test_a_network_that_reads_ages_is_not_fed_without_them():
    predictor = joulebus.Predictor("builtin:gternal-sim-freshness")
    assert predictor.reads == "freshness"
    with pytest.raises(ValueError, match="13"):
        predictor.predict(rows(3))
    with pytest.raises(joulebus.ModelError, match="age of readings"):
        predictor.rollout([0.1], [0.0])
    with pytest.raises(joulebus.ModelError, match="age of readings"):
        joulebus.EnergyPredictor("builtin:gternal-sim-freshness")


def damaged(tmp_path):
    whole = model_file("gternal-sim").read_bytes()
    flipped = bytearray(whole)
    flipped[len(whole) // 2] ^= 1
    for name, contents in [("empty", b""), ("short", whole[:1000]), ("flipped", bytes(flipped)), ("text", b"hello")]:
        path = tmp_path / f"{name}.safetensors"
        path.write_bytes(contents)
        yield path


@pytest.mark.parametrize("kind", [joulebus.Predictor, joulebus.EnergyPredictor])
def test_a_model_that_cannot_be_read_is_an_exception_with_its_name(kind, tmp_path):
    with pytest.raises(FileNotFoundError, match="missing.safetensors"):
        kind(tmp_path / "missing.safetensors")
    with pytest.raises(OSError, match="regular files"):
        kind(tmp_path)
    with pytest.raises(joulebus.ModelError, match="gternal-sim-power"):
        kind("builtin:other")
    for path in damaged(tmp_path):
        with pytest.raises(joulebus.ModelError) as refused:
            kind(path)
        assert path.name in str(refused.value) and issubclass(refused.type, joulebus.Error)
    np.savez(tmp_path / "foreign.npz", a=np.zeros(3))
    with pytest.raises(joulebus.ModelError, match=r"joulebus\.models\.convert"):
        kind(tmp_path / "foreign.npz")


def test_the_message_of_a_refused_model_is_that_of_the_program(program, tmp_path):
    import subprocess

    for path in damaged(tmp_path):
        command = [program, "model", "export", path, "--out", tmp_path / "out.npz"]
        said = subprocess.run(command, capture_output=True, text=True, check=False).stderr
        with pytest.raises(joulebus.ModelError) as refused:
            joulebus.Predictor(path)
        for part in str(refused.value).removeprefix(f"{path}: ").split(": "):
            assert part in said, (said, str(refused.value))


def test_rollouts_are_the_steps_of_the_papers_interface_bit_for_bit():
    noise = np.random.default_rng(3)
    v, omega = noise.uniform(-0.15, 0.16, (20, 50)), noise.uniform(-3.0, 3.0, (20, 50))
    start_w = noise.uniform(3.0, 5.0, 20)
    predictor, one_by_one = joulebus.Predictor(), joulebus.EnergyPredictor()
    energy_j, power_w = predictor.rollout(v, omega, readings_w=start_w)
    assert energy_j.shape == (20,) and power_w.shape == (20, 50)
    for robot in range(20):
        one_by_one.reset(start_w[robot] * 1e3)
        steps_mw = [one_by_one.step(v[robot, step], omega[robot, step]) for step in range(50)]
        assert np.array_equal(bits(np.array(steps_mw) * 1e-3), bits(power_w[robot]))
        total_j = np.float32(np.float64(np.float32(0.033)) * np.sum(power_w[robot].astype(np.float64)))
        assert abs(energy_j[robot] - total_j) <= np.spacing(total_j)


def test_rollouts_of_every_shape_agree_bit_for_bit():
    noise = np.random.default_rng(4)
    v, omega = noise.uniform(-0.15, 0.16, (7, 3, 20)), noise.uniform(-3.0, 3.0, (7, 3, 20))
    lags_w, before = noise.uniform(3.0, 5.0, (7, 5)), (noise.uniform(0.0, 0.1, 7), noise.uniform(0.0, 1.0, 7))
    predictor = joulebus.Predictor()
    energy_j, power_w = predictor.rollout(v, omega, readings_w=lags_w, before=before, step_s=0.05)
    assert energy_j.shape == (7, 3) and power_w.shape == (7, 3, 20)
    for candidate in range(3):
        each_j, each_w = predictor.rollout(
            v[:, candidate], omega[:, candidate], readings_w=lags_w, before=before, step_s=0.05
        )
        assert np.array_equal(bits(each_j), bits(energy_j[:, candidate]))
        assert np.array_equal(bits(each_w), bits(power_w[:, candidate]))
    for robot in range(7):
        one_j, one_w = predictor.rollout(
            v[robot, 0], omega[robot, 0], readings_w=lags_w[[robot]], before=(before[0][robot], before[1][robot]), step_s=0.05
        )
        assert one_j.shape == () and bits(one_j[()]) == bits(energy_j[robot, 0])
        assert np.array_equal(bits(one_w), bits(power_w[robot, 0]))
    # The first step is an ordinary row.
    row = np.column_stack(
        [v[:, 0, 0], omega[:, 0, 0]]
        + [
            (new[:, 0, 0].astype(np.float32) - old.astype(np.float32)) / np.float32(0.05)
            for new, old in zip((v, omega), before)
        ]
        + [np.abs(v[:, 0, 0]), np.abs(omega[:, 0, 0]), lags_w]
    )
    assert np.array_equal(bits(predictor.predict(row)), bits(power_w[:, 0, 0]))


@pytest.mark.parametrize(
    "wrong, said",
    [
        (dict(v=np.zeros(3), omega=np.zeros(4)), "omega has shape (4,), allowed: (3,), that of v"),
        (dict(v=0.0, omega=0.0), "v has shape ()"),
        (dict(v=np.zeros((1, 1, 1, 1)), omega=np.zeros((1, 1, 1, 1))), "(robots, candidates, steps)"),
        (dict(step_s=0.0), "step_s is 0"),
        (dict(step_s=float("nan")), "step_s is NaN"),
        (dict(step_s=-1.0), "positive and finite"),
        (dict(readings_w=np.zeros(3)), "readings_w has shape (3,), allowed: (), (2,), or (2, 5) newest first"),
        (dict(readings_w=np.zeros((2, 4))), "(2, 4)"),
        (dict(before=(np.zeros(3), 0.0)), "before[0] has shape (3,)"),
    ],
)
def test_wrong_rollouts_are_refused_with_what_is_allowed(wrong, said):
    given = dict(v=np.zeros((2, 3)), omega=np.zeros((2, 3))) | wrong
    with pytest.raises(ValueError) as refused:
        joulebus.Predictor().rollout(given.pop("v"), given.pop("omega"), **given)
    assert said in str(refused.value)


def test_many_threads_may_use_one_predictor():
    predictor, inputs = joulebus.Predictor(), rows(500)
    expected, found = bits(predictor.predict(inputs)), []

    def ask():
        found.extend(np.array_equal(bits(predictor.predict(inputs)), expected) for _ in range(50))

    threads = [threading.Thread(target=ask) for _ in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert len(found) == 200 and all(found)


def test_other_threads_run_during_a_long_call():
    predictor = joulebus.Predictor()
    v = np.zeros((200, 2000), np.float32)
    done, turns = threading.Event(), []

    def count():
        while not done.is_set():
            turns.append(None)
            done.wait(0.001)

    thread = threading.Thread(target=count)
    thread.start()
    # A thread that never runs during the call has one turn, before it.
    before = len(turns)
    for _ in range(20):
        predictor.rollout(v, v)
        if len(turns) > before + 3:
            break
    done.set()
    thread.join()
    assert len(turns) > before + 3


def linear_rows(count):
    inputs = rows(count, seed=9)
    return inputs, 0.9 * inputs[:, 6] + 0.1 * inputs[:, 7] + 2.0 * inputs[:, 4]


def test_fitting_learns_repeats_itself_and_is_a_model_file(tmp_path, run):
    inputs, readings_w = linear_rows(3000)
    heard = []
    fitted = joulebus.Predictor(seed=5, max_epochs=8).fit(inputs, readings_w, progress=lambda *epoch: heard.append(epoch))
    assert fitted.score(inputs[2700:], readings_w[2700:]) > 0.9 > joulebus.Predictor().score(inputs, readings_w)
    assert [epoch[0] for epoch in heard] == list(range(1, 9)) and fitted.epochs_ == heard
    again = joulebus.Predictor(seed=5, max_epochs=8).fit(inputs.astype(np.float64), readings_w)
    assert again.hash == fitted.hash and again.to_bytes() == fitted.to_bytes()
    fitted.save(tmp_path / "fitted.safetensors")
    assert fitted.hash in run("model", "info", tmp_path / "fitted.safetensors")
    read = joulebus.Predictor(tmp_path / "fitted.safetensors")
    assert np.array_equal(bits(read.predict(inputs)), bits(fitted.predict(inputs)))


def test_wrong_training_rows_are_refused_and_the_model_stays():
    predictor = joulebus.Predictor()
    before = predictor.hash
    inputs, readings_w = linear_rows(200)
    for wrong_inputs, wrong_readings, said in [
        (inputs, readings_w[:-1], "one reading for each row"),
        (inputs[:, :5], readings_w, "(rows, 11)"),
        (inputs[:3], readings_w[:3], ""),
        (np.full_like(inputs, np.nan), readings_w, ""),
        (inputs, np.full_like(readings_w, 3.0), ""),
    ]:
        with pytest.raises(ValueError) as refused:
            predictor.fit(wrong_inputs, wrong_readings)
        assert said in str(refused.value)
    with pytest.raises(ZeroDivisionError):
        predictor.fit(inputs, readings_w, progress=lambda *_: 1 / 0)
    with pytest.raises(ValueError, match="power_only"):
        joulebus.Predictor(feature_set="some").fit(inputs, readings_w)
    assert predictor.hash == before


def test_scikit_learns_conventions_hold():
    predictor = joulebus.Predictor("builtin:gternal-sim-power", seed=3)
    params = predictor.get_params()
    assert params["model"] == "builtin:gternal-sim-power" and params["seed"] == 3
    # As `sklearn.base.clone` does it.
    assert type(predictor)(**params).get_params() == params
    assert predictor.set_params(model="builtin:gternal-sim") is predictor
    assert predictor.hash == joulebus.Predictor().hash
    with pytest.raises(ValueError, match="there is no parameter depth"):
        predictor.set_params(depth=3)
    copied = pickle.loads(pickle.dumps(predictor))
    assert copied.hash == predictor.hash and copied.get_params() == predictor.get_params()
