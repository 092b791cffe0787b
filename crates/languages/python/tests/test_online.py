"""Online forecasts without a fleet: the bits of the tick, scikit-learn's checks, and a Predictor in scikit-learn's hands."""
from __future__ import annotations

import copy
import pickle
import subprocess
import sys

import joulebus
import numpy as np
import pytest
from conftest import bits, model_file
from sklearn.base import clone, is_regressor
from sklearn.ensemble import RandomForestRegressor
from sklearn.frozen import FrozenEstimator
from sklearn.model_selection import GridSearchCV, cross_val_score
from sklearn.pipeline import make_pipeline
from sklearn.preprocessing import StandardScaler
from sklearn.utils.estimator_checks import check_estimator

KINDS = [joulebus.OnlineForecaster, joulebus.OnlineConformal]
#: Of the shipped GTernal platform.
PLATFORM = {"resolution": 0.01, "limits": (0.0, 20.0)}


@pytest.fixture(scope="module")
def trials() -> list[joulebus.Trial]:
    return joulebus.simulate(5, steps=700, progress=False).trials


def stream(trial: joulebus.Trial):
    """Rows, readings, and whether each is held, as a worker gets them: the first five readings have no row."""
    power_w = trial.columns["power_w"].astype(np.float32)
    same = [np.diff(trial.columns[name], prepend=np.nan) == 0.0 for name in ("power_w", "voltage_v", "current_a") if name in trial.columns]
    features, following = trial.rows()
    assert np.array_equal(bits(following), bits(power_w[5:])), "the trial has gaps"
    rows = np.full((len(power_w), 11), np.nan, np.float32)
    rows[5:] = features[:, :11]
    return rows, power_w, np.logical_and.reduce(same)


@pytest.mark.parametrize("name", ["gternal-sim", "gternal-sim-power"])
def test_forecasts_and_intervals_have_the_bits_of_a_fleet(trials, name):
    # The live path of `evaluate` is the fleet's tick, robot by robot.
    found = joulebus.evaluate(trials, str(model_file(name)), resamples=0, progress=False)
    forecaster = joulebus.OnlineForecaster(joulebus.Predictor(str(model_file(name))), **PLATFORM)
    held_somewhere = False
    for robot, (trial, series) in enumerate(zip(trials, found.series)):
        rows, power_w, held = stream(trial)
        held_somewhere |= held.any()
        # In parts: the next continues.
        made = np.concatenate(
            [forecaster.update(rows[part], power_w[part], robot, held[part]) for part in (slice(0, 300), slice(300, None))]
        )
        assert np.isnan(made[:5]).all() and len(series["lo_w"]) == len(power_w) - 5
        assert np.array_equal(bits(made[5:, 1]), bits(series["lo_w"])), trial.name
        assert np.array_equal(bits(made[5:, 2]), bits(series["hi_w"])), trial.name
        residual_w = series["reading_w"] - series["forecast_w"]
        assert np.array_equal(bits(power_w[5:] - made[5:, 0]), bits(residual_w)), trial.name
    assert held_somewhere and not np.array_equal(bits(made[5:, 0]), bits(forecaster.regressor.predict(rows[5:])))


def test_missing_readings_are_bridged_with_the_bits_of_a_fleet(trials):
    rows, power_w, held = stream(trials[1])
    missing = np.zeros(len(power_w), bool)
    # The last of them is longer than the longest gap: the window begins anew.
    for first, count in [(50, 1), (120, 2), (200, 14), (300, 1), (302, 1), (400, 40)]:
        missing[first : first + count] = True
    held &= ~missing & ~np.roll(missing, 1)
    measured = ("power_w", "voltage_v", "current_a")
    columns = {name: np.where(missing & (name in measured), np.nan, values) for name, values in trials[1].columns.items()}
    trial = joulebus.Trial(columns, "7", "gaps")
    found = joulebus.evaluate(trial, "builtin:gternal-sim", resamples=0, progress=False).series[0]
    forecaster = joulebus.OnlineForecaster(joulebus.Predictor(), **PLATFORM)
    made, lags, unread = np.empty((0, 3), np.float32), np.full(5, np.nan, np.float32), 0
    for row, reading_w, gone, again in zip(rows, np.where(missing, np.nan, power_w), missing, held):
        # Where a reading is missing, the forecast of it takes its place.
        row[6:] = lags
        made = np.concatenate([made, forecaster.update(row[None], [reading_w], held=again)])
        lags = np.concatenate([made[-1:, 0] if gone else [reading_w], lags[:-1]])
        unread = unread + 1 if gone else 0
        if unread > forecaster.longest_gap:
            lags[:] = np.nan
    scored = ~missing & ~np.roll(missing, 1) & ~np.isnan(made[:, 0])
    assert scored.sum() == len(found["lo_w"])
    assert np.array_equal(bits(made[scored, 1]), bits(found["lo_w"])) and np.array_equal(bits(made[scored, 2]), bits(found["hi_w"]))


def test_an_interval_of_its_own_adapts_around_the_network(trials):
    rows, power_w, held = stream(trials[2])
    conformal = joulebus.OnlineConformal(joulebus.Predictor(), **PLATFORM)
    made = conformal.update(rows, power_w, "a", held)
    assert np.array_equal(bits(made[5:, 0]), bits(conformal.regressor.predict(rows[5:])))
    inside = (made[5:, 1] <= power_w[5:]) & (power_w[5:] <= made[5:, 2])
    assert 0.86 <= inside.mean() <= 0.94


@pytest.mark.parametrize("kind", KINDS)
def test_scikit_learn_s_checks_find_nothing(kind):
    check_estimator(kind())
    assert is_regressor(kind())


def shifted(seed: int = 0, rows: int = 1500):
    """A target that is linear in its features, until it shifts by 3."""
    noise = np.random.default_rng(seed)
    features = noise.normal(size=(rows, 3))
    target = 5.0 + features @ [1.0, -0.5, 0.2] + 0.1 * noise.normal(size=rows)
    target[rows * 2 // 3 :] += 3.0
    return features, target


@pytest.mark.parametrize("regressor", [None, RandomForestRegressor(20, random_state=1)])
def test_any_regressor_is_a_member_and_a_shift_is_followed(regressor):
    X, y = shifted()
    forecaster = joulebus.OnlineForecaster(regressor).fit(X[:500], y[:500])
    alone = clone(forecaster.regressor_).fit(X[:500], y[:500]).predict(X[500:])
    assert np.array_equal(forecaster.predict(X[:7]), forecaster.regressor_.predict(X[:7]).astype(np.float32))
    made = forecaster.update(X[500:], y[500:])
    errors = [np.mean((one - y[500:]) ** 2) for one in (made[:, 0], alone)]
    assert errors[0] < 0.5 * errors[1]
    inside = (made[:, 1] <= y[500:]) & (y[500:] <= made[:, 2])
    assert 0.88 <= inside.mean() <= 0.92
    assert forecaster.weights().sum() == pytest.approx(1.0, abs=1e-5)
    # A frozen regressor is taken as it is.
    frozen = joulebus.OnlineForecaster(FrozenEstimator(forecaster.regressor_)).fit(X[:500], y[:500])
    assert np.array_equal(frozen.predict(X[500:510]), forecaster.regressor_.predict(X[500:510]).astype(np.float32))


@pytest.mark.parametrize("kind", KINDS)
def test_robots_learn_apart_and_a_copy_continues_to_the_bit(kind):
    X, y = shifted(1)
    both = kind().fit(X[:500], y[:500], robots=np.repeat(["a", "b"], 250))
    alone = copy.deepcopy(both)
    other = -y[600:700]
    mixed = both.update(np.repeat(X[600:700], 2, axis=0), np.stack([y[600:700], other], axis=1).ravel(), ["a", "b"] * 100)
    assert np.array_equal(bits(mixed[::2]), bits(alone.update(X[600:700], y[600:700], "a")))
    assert not np.array_equal(mixed[-2], mixed[-1])
    ahead = both.predict(X[700:720], robots=["a", "b"] * 10)
    assert np.array_equal(ahead[::2], both.predict(X[700:720:2], robots="a"))
    assert np.array_equal(both.predict(X[700:702], "new"), both.regressor_.predict(X[700:702]).astype(np.float32))
    for kept in (pickle.loads(pickle.dumps(both)), copy.deepcopy(both)):
        assert np.array_equal(bits(kept.update(X[700:], y[700:], "b")), bits(copy.deepcopy(both).update(X[700:], y[700:], "b")))
    interval = both.predict_interval(X[700:720], "a")
    assert interval.shape == (20, 2) and (interval[:, 0] <= both.predict(X[700:720], "a")).all()
    both.forget("a")
    assert np.array_equal(both.predict(X[:5], "a"), both.predict(X[:5], "new"))


def test_missing_readings_are_bridged_and_rows_that_are_missing_are_not_scored():
    X, y = shifted(2, 600)
    forecaster = joulebus.OnlineForecaster(longest_gap=3).fit(X, y)
    forecaster.update(X[:50], y[:50])
    narrow = np.diff(forecaster.predict_interval(X[50:51]))
    forecaster.update(X[50:52], [np.nan, np.nan])
    assert np.diff(forecaster.predict_interval(X[52:53])) == pytest.approx(narrow * np.sqrt(3.0), rel=1e-5)
    made = forecaster.update(None, y[52:60])
    assert np.isnan(made).all()
    rows = X[60:63].copy()
    rows[1, 0] = np.nan
    assert np.isnan(forecaster.update(rows, y[60:63])[:, 0]).tolist() == [False, True, False]


def test_wrong_arguments_are_refused_with_what_is_allowed():
    X, y = shifted(3, 40)
    for said, call in [
        ("coverage is 0.3, allowed are 0.5 to 0.99", lambda: joulebus.OnlineConformal(coverage=0.3).fit(X, y)),
        ("limits are (2, 1), allowed", lambda: joulebus.OnlineForecaster(limits=(2, 1)).fit(X, y)),
        ("robots has shape (3,), allowed: () or (40,)", lambda: joulebus.OnlineForecaster().fit(X, y, robots=[1, 2, 3])),
        ("X has 40 rows, allowed are 2", lambda: joulebus.OnlineForecaster().fit(X, y).update(X, y[:2])),
        ("X has 2 features", lambda: joulebus.OnlineForecaster().fit(X, y).update(X[:, :2], y)),
        ("without infinite readings", lambda: joulebus.OnlineForecaster().fit(X, y).update(X[:1], [np.inf])),
        ("cannot be read", lambda: joulebus.OnlineForecaster().fit(X, y)._robots.restore(b"jbonlin\x02\x07")),
        ("not a fleet's state in version 2", lambda: joulebus.OnlineForecaster().fit(X, y)._robots.restore(b"jbstate\x0b")),
    ]:
        with pytest.raises(ValueError) as refused:
            call()
        assert said in str(refused.value)
    with pytest.raises(KeyError, match="no robot 9"):
        joulebus.OnlineForecaster().fit(X, y).forget(9)


def test_scikit_learn_takes_a_predictor(trials):
    features, power_w = (np.concatenate(part) for part in zip(*(trial.rows() for trial in trials[:2])))
    features = features[:, :11]
    predictor = joulebus.Predictor(seed=3, max_epochs=2)
    copied = clone(predictor)
    assert copied is not predictor and copied.get_params() == predictor.get_params() and is_regressor(copied)
    scores = cross_val_score(predictor, features, power_w, cv=2)
    assert scores.shape == (2,) and np.isfinite(scores).all()
    search = GridSearchCV(predictor, {"max_epochs": [1, 2]}, cv=2).fit(features, power_w)
    assert search.best_params_["max_epochs"] in (1, 2) and search.best_estimator_.epochs_
    pipeline = make_pipeline(StandardScaler(), clone(predictor)).fit(features, power_w)
    assert pipeline.predict(features[:9]).shape == (9,) and clone(pipeline) is not pipeline
    assert np.isfinite(cross_val_score(pipeline, features, power_w, cv=2)).all()
    # One that was opened needs no fit.
    assert make_pipeline(joulebus.Predictor()).predict(features[:9]).shape == (9,)
    online = joulebus.OnlineForecaster(predictor)
    assert np.isfinite(cross_val_score(online, features, power_w, cv=2)).all()


def test_scikit_learn_is_imported_only_where_it_is_used():
    code = "import sys, joulebus; joulebus.Predictor(); print('sklearn' in sys.modules, 'OnlineForecaster' in dir(joulebus))"
    told = subprocess.run([sys.executable, "-c", code], check=True, capture_output=True, text=True).stdout
    assert told.split() == ["False", "True"]
    code = "import sys; sys.modules['sklearn'] = None; import joulebus; joulebus.OnlineForecaster"
    told = subprocess.run([sys.executable, "-c", code], check=False, capture_output=True, text=True).stderr
    assert "pip install scikit-learn" in told
