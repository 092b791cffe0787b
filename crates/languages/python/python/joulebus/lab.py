"""The lab: simulated trials, training, evaluation, analysis and reports, as by the verbs of the program.

Numbers are those of the verbs' ``--format json``: the same functions compute them. Recordings are paths (files,
directories, patterns), `Trial` objects, or a list of both. Other Python threads run meanwhile, and Ctrl-C raises
KeyboardInterrupt at once. Progress is shown by tqdm where it is installed.
"""
from __future__ import annotations

import json
import os
import warnings
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Callable, Iterable, Sequence, Union

import numpy as np

from . import _native
from ._optional import Progress, axes, lab, needed
from .figures import Figure
from .predictor import Predictor, _restored
from .recordings import Trial, _reading

_Path = Union[str, "os.PathLike[str]"]
Recordings = Union[_Path, Trial, Iterable[Union[_Path, Trial]]]
Models = Union[_Path, Predictor, "Training", Iterable[Union[_Path, Predictor, "Training"]]]

_COLOURS = ("#0072B2", "#E69F00", "#009E73", "#AA4499", "#56B4E9", "#D55E00", "#6E7781")


@dataclass
class Simulation:
    """Simulated trials: ``trials``, the paper's six of one robot, and ``robots``, one of each of seven together."""

    seed: int
    trials: list[Trial]
    robots: list[Trial]

    def write(self, directory: _Path) -> list[Path]:
        """Writes each as an .npy file into `directory`, as `joulebus data simulate` does, and returns the paths."""
        folder = Path(directory)
        folder.mkdir(parents=True, exist_ok=True)
        paths = [folder / Path(trial.name or "").name for trial in self.trials + self.robots]
        for path, trial in zip(paths, self.trials + self.robots):
            trial.write(path)
        return paths


def simulate(seed: int = 1, *, steps: int = 8000, progress: bool = True) -> Simulation:
    """The simulated stand-in for the paper's dataset, `steps` samples of each robot (33 ms; 2 to 4,194,304).

    Nothing about it is a claim about real robots. The same seed gives the same bits on every machine.
    """
    if not 2 <= steps <= 1 << 22:
        raise ValueError(f"steps is {steps}, allowed are 2 to {1 << 22}")
    native = lab("simulations")
    with Progress(progress, "simulating", "trial") as bar:
        made = native.simulate(seed, steps, bar.reach)
    alone, together = ([Trial(columns, robot, name) for name, robot, columns in trials] for trials in made)
    return Simulation(seed, alone, together)


class _Result:
    """What all results have: ``data``, the report as `--format json` prints it, and ``text``, as the terminal shows."""

    def __init__(self, data: str, text: str) -> None:
        self.data: dict[str, Any] = json.loads(data)
        self.text = text

    def __str__(self) -> str:
        return self.text


class Training(_Result):
    """A finished training.

    ``predictor`` is the model, ``scores`` those on the held-out rows, ``epochs`` has the columns ``number``,
    ``training_loss``, ``validation_loss`` (mean squared errors in units of the training variance) and ``best``.
    """

    def __init__(self, data: str, text: str, contents: bytes, epochs: list[tuple[int, float, float, bool]]) -> None:
        super().__init__(data, text)
        self._contents = contents
        params = {"model": "trained", "feature_set": "full", "seed": self.data["seed"], "max_epochs": 100, "patience": 10}
        self.predictor: Predictor = _restored(Predictor, params, contents, epochs)
        self.predictor.feature_set = self.predictor.reads
        self.scores: dict[str, float] = self.data["scores"]
        names = ("number", "training_loss", "validation_loss", "best")
        self.epochs: dict[str, np.ndarray] = {name: np.array([row[at] for row in epochs]) for at, name in enumerate(names)}

    def save(self, path: _Path) -> None:
        """Writes the model file (.safetensors), which the worker and all verbs read."""
        Path(path).write_bytes(self._contents)

    def to_pandas(self) -> Any:
        """The epochs as a DataFrame. Needs pandas."""
        return needed("pandas", "data frames").DataFrame(self.epochs)

    def plot(self, ax: Any = None) -> Any:
        """Losses by epoch, on `ax` or on new axes, which are returned. Needs matplotlib."""
        ax, epochs = axes(ax), self.epochs
        ax.plot(epochs["number"], epochs["training_loss"], color=_COLOURS[6], label="training, with dropout")
        ax.plot(epochs["number"], epochs["validation_loss"], color=_COLOURS[0], label="validation")
        ax.axvline(self.data["best_epoch"], linestyle="--", color=_COLOURS[5], label="selected epoch")
        ax.set(xlabel="epoch", ylabel="loss (share of the training variance)", yscale="log")
        ax.legend()
        return ax

    def __repr__(self) -> str:
        scores = self.scores
        return f"Training({self.data['model']!r}, epochs={len(self.epochs['number'])}, held-out R²={scores['r2']:.4f})"


def train(
    recordings: Recordings | None = None,
    *,
    out: _Path | None = None,
    validate: Recordings | None = None,
    hold_out: Recordings | None = None,
    split: str | None = None,
    recipe: _Path | None = None,
    feature_set: str | None = None,
    seed: int | None = None,
    name: str | None = None,
    max_epochs: int | None = None,
    patience: int | None = None,
    columns: dict[str, str] | None = None,
    current: str | None = None,
    accept: Sequence[str] = (),
    simulated: bool = False,
    threads: int = 0,
    progress: bool | Callable[..., Any] = True,
) -> Training:
    """Trains a network, as `joulebus train trials` does. With `simulated`, as `joulebus train sim`, without recordings.

    recordings:  what trains. Without the next two they are split into training, validation and held-out rows
    validate, hold_out: recordings that end the training early, and that are only scored
    split:       what is not divided: ``trial`` (default), ``robot``, ``group``, or ``time``, which cuts each trial
    recipe:      a TOML file (`configs/recipes/paper.toml` explains it) [default: the paper's recipe]. The next five
                 replace its settings
    feature_set: ``full`` (the paper's), ``power_only``, ``freshness``, ``power_freshness``
    columns:     columns of CSV files whose names joulebus does not know: ``{"power": "load_W"}``.
                 ``missing:`` is a number that stands for no value: ``{"missing:": "-999"}``
    current:     sign of the current in files: ``discharge-positive`` (default) or ``discharge-negative``
    accept:      findings to let through, because you know better: ``sign``, ``unit``, ``clock``, … (`joulebus data check`)
    out:         the model file to write. `Training.save` writes it later
    progress:    a bar by tqdm, or a function that is called after each epoch with its number, both losses and whether it
                 is the best

    The same recordings, settings and seed give the same bytes, with any number of threads.
    """
    if (validate is None) != (hold_out is None):
        raise ValueError("validate and hold_out go together: give both, or neither for a split")
    if split is not None and hold_out is not None:
        raise ValueError("split and hold_out are both given: the parts are given, or made by a split")
    if simulated != (recordings is None):
        raise ValueError("give recordings, or simulated=True without them")
    if out is not None and not Path(out).parent.is_dir():
        raise FileNotFoundError(f"directory {Path(out).parent} does not exist")
    asked = json.dumps(
        {
            "recipe": None if recipe is None else Path(recipe).read_text(encoding="utf-8"),
            "split": split,
            "seed": seed,
            "name": name if name is not None or out is None or simulated else Path(out).stem,
            "feature_set": feature_set,
            "max_epochs": max_epochs,
            "patience": patience,
            "threads": threads,
        }
    )
    file, native = None if out is None else os.fspath(out), lab("trainings")
    with Progress(progress is True, "training", "epoch") as bar:

        def told(number: int, training_loss: float, validation_loss: float, best: bool) -> None:
            bar.reach(number, note=f"validation {validation_loss:.4f}")
            if callable(progress):
                progress(number, training_loss, validation_loss, best)

        if simulated:
            made = native.train_simulated(asked, file, _warn, told)
        else:
            parts = (_inputs(validate), _inputs(hold_out))
            reading = _reading(columns, current, accept)
            made = native.train_recordings(_inputs(recordings), parts, reading, asked, file, _warn, told)
    trained = Training(*made)
    if out is not None:
        trained.save(out)
    return trained


class Evaluation(_Result):
    """Scores of models and baselines on the same rows.

    ``scores`` maps each forecaster's name to its scores one tick ahead. ``series`` has, for each model and trial, the
    readings and the live path's forecasts of them: ``trial``, ``model``, ``time_s``, ``reading_w``, ``forecast_w``,
    ``lo_w``, ``hi_w``.
    """

    def __init__(self, data: str, text: str, series: list[dict[str, Any]]) -> None:
        super().__init__(data, text)
        self.report: dict[str, Any] = self.data["evaluations"][0]
        self.series = series
        self.scores: dict[str, dict[str, Any]] = {one["name"]: one for one in self.report["all"]["forecasters"]}

    def to_pandas(self, what: str = "scores") -> Any:
        """A DataFrame: ``scores`` (one row for each set of rows and forecaster) or ``series``. Needs pandas."""
        pandas = needed("pandas", "data frames")
        if what == "scores":
            return pandas.DataFrame(self._score_rows())
        if what == "series":
            return pandas.concat([pandas.DataFrame(one) for one in self.series], ignore_index=True)
        raise ValueError(f"what is {what!r}, allowed are scores and series")

    def _score_rows(self) -> list[dict[str, Any]]:
        found = []
        sets = [("all", self.report["all"])]
        sets += [(kind[:-1], one) for kind in ("groups", "robots", "trials") for one in self.report[kind]]
        for kind, one in sets:
            for scores in one["forecasters"]:
                row = {"set": kind, "of": one["name"], "forecaster": scores["name"], "role": scores["role"]}
                row |= {"rows": scores["count"], "mape": scores["mape"]}
                for name in ("r2", "mae_w", "rmse_w", "bias_w", "energy_error"):
                    row |= _estimate(name, scores[name])
                found.append(row)
        return found

    def plot(self, ax: Any = None, *, series: int = 0, start_s: float = 0.0, duration_s: float = 20.0) -> Any:
        """Readings, forecasts and intervals of one of ``series``, on `ax` or on new axes, which are returned. Needs
        matplotlib."""
        ax, found = axes(ax), self.series[series]
        time_s = found["time_s"]
        shown = (time_s >= start_s) & (time_s < start_s + duration_s)
        at, lo, hi = time_s[shown], found["lo_w"][shown], found["hi_w"][shown]
        ax.fill_between(at, lo, hi, color=_COLOURS[0], alpha=0.15, label="90 % interval")
        ax.plot(at, found["reading_w"][shown], color="#1B1F24", linewidth=1.0, label="reading")
        ax.plot(at, found["forecast_w"][shown], color=_COLOURS[0], linewidth=1.0, label="forecast, one tick before")
        ax.set(xlabel="time (s)", ylabel="power (W)", title=found["trial"] or "")
        ax.legend(fontsize="small")
        return ax

    def __repr__(self) -> str:
        values = {name: one["r2"]["value"] for name, one in self.scores.items()}
        found = ", ".join(f"{name}: {value:.4f}" for name, value in values.items() if value is not None)
        return f"Evaluation({self.report['all']['rows']} rows; R² {found})"


def evaluate(
    recordings: Recordings,
    model: Models = "builtin:gternal-sim",
    *,
    fit: Recordings = (),
    split: str | None = None,
    held_out: float = 0.15,
    leave_out: Sequence[str] = (),
    seed: int = 0,
    energy: bool = False,
    resamples: int = 1000,
    confidence: float = 0.95,
    block_rows: int = 50,
    columns: dict[str, str] | None = None,
    current: str | None = None,
    accept: Sequence[str] = (),
    progress: bool = True,
) -> Evaluation:
    """Evaluates models on recordings by the live code, as `joulebus eval --model` does.

    model:     a file, ``builtin:NAME``, a `Predictor`, a `Training`, or a list of these
    fit:       recordings that the linear baselines are fitted on. The default is cross-fitting
    split:     evaluates the held-out part of a split, as in `train` with the same recordings and seed. `held_out` is its
               share, `leave_out` names the units instead
    energy:    also scores the energy of the next 1 to 300 s
    resamples, confidence, block_rows: of the confidence intervals. 0 resamples disable them
    columns, current, accept: how recordings are read, as of `train`

    Period and limits are those of each recording. Rows that a model was trained on, as its file states, are scored apart.
    """
    asked = json.dumps(
        {
            "choice": _choice(split, held_out, leave_out, seed),
            "energy": energy,
            "resamples": resamples,
            "confidence": confidence,
            "block_rows": block_rows,
        }
    )
    native = lab("evaluations")
    with Progress(progress, "evaluating", "recording") as bar:
        found = native.evaluate(
            _inputs(recordings), _inputs(fit), _reading(columns, current, accept), _models(model), asked, _warn, bar.reach
        )
    result = Evaluation(*found)
    for text in result.report["warnings"]:
        warnings.warn(text, stacklevel=2)
    return result


class Analysis(_Result):
    """What a dataset lets be forecast: ``series`` lists the native one and one for each grid."""

    def __init__(self, data: str) -> None:
        super().__init__(data, "")
        self.series: list[dict[str, Any]] = self.data["series"]
        self.text = "\n".join(_analysis_lines(self.data))

    def to_pandas(self, what: str = "features") -> Any:
        """A DataFrame: ``features`` (one row for each series and set of features, on the held-out rows) or
        ``autocorrelation`` (one for each series and lag). Needs pandas."""
        pandas = needed("pandas", "data frames")
        if what == "features":
            return pandas.DataFrame([row for one in self.series for row in _feature_rows(one)])
        if what == "autocorrelation":
            return pandas.DataFrame([row for one in self.series for row in _lag_rows(one)])
        raise ValueError(f"what is {what!r}, allowed are features and autocorrelation")

    def plot(self, ax: Any = None, *, what: str = "autocorrelation") -> Any:
        """``autocorrelation`` by lag, or R² by ``features``, of each series, on `ax` or on new axes, which are returned.
        Needs matplotlib."""
        if what not in ("features", "autocorrelation"):
            raise ValueError(f"what is {what!r}, allowed are features and autocorrelation")
        ax = axes(ax)
        for at, one in enumerate(self.series):
            if what == "autocorrelation":
                values = np.array(one["mean_autocorrelation"], np.float64)
                ax.plot(range(1, len(values) + 1), values, "o-", color=_COLOURS[at % 7], label=one["name"])
                ax.set(xlabel="lag (rows)", ylabel="autocorrelation, mean of the trials")
            else:
                rows = _feature_rows(one)
                width = 0.78 / len(self.series)
                places = np.arange(len(rows)) + (at - 0.5 * (len(self.series) - 1)) * width
                ax.barh(places, [row["r2"] for row in rows], 0.9 * width, color=_COLOURS[at % 7], label=one["name"])
                ax.set_yticks(range(len(rows)), [row["features"] for row in rows])
                ax.set(xlabel="R² on held-out rows")
        if what == "features":
            ax.invert_yaxis()
        ax.legend(fontsize="small")
        return ax

    def __repr__(self) -> str:
        return f"Analysis({self.data['trials']} trials, series: {', '.join(one['name'] for one in self.series)})"


def analyze(
    recordings: Recordings,
    *,
    lags: int = 10,
    window: int = 5,
    resample: Sequence[str] = ("hold",),
    rate_hz: float = 30.0,
    split: str = "trial",
    held_out: float = 0.3,
    leave_out: Sequence[str] = (),
    seed: int = 0,
    model: Models = (),
    columns: dict[str, str] | None = None,
    current: str | None = None,
    accept: Sequence[str] = (),
) -> Analysis:
    """Analyses a dataset before training, as `joulebus analyze` does: autocorrelation, the gain of each input, and the
    share of a score that comes from held readings.

    lags:     of the autocorrelation
    window:   readings that the models may use, 1 to 5
    resample: fixed grids beside the native series: ``hold``, ``mean``, ``linear``. None for the native series only
    rate_hz:  rows per second of the grids
    split, held_out, leave_out, seed: which rows are held out: `split` names what stays together
    model:    models to score as well
    columns, current, accept: how recordings are read, as of `train`
    """
    asked = json.dumps(
        {
            "lags": lags,
            "window": window,
            "grids": [{"method": method, "rate_hz": rate_hz} for method in resample],
            "split": {"by": split, "held_out": held_out, "seed": seed},
            "leave_out": list(leave_out),
        }
    )
    reading = _reading(columns, current, accept)
    return Analysis(lab("analyses").analyze(_inputs(recordings), reading, asked, _models(model), _warn))


class Report(_Result):
    """A report: ``tables`` maps ids to rows, ``figures`` lists `Figure` objects, ``html()`` is the page.

    ``network`` is the predictor that simulated experiments trained and show, else None.
    """

    def __init__(self, native: _native.Report) -> None:
        super().__init__(native.json(), native.text())
        self._native = native
        parts = [part for section in self.data["sections"] for part in section["parts"]]
        self.tables: dict[str, list[dict[str, Any]]] = {
            part["table"]["id"]: part["table"]["rows"] for part in parts if "table" in part
        }
        self.figures: list[Figure] = [Figure(part["figure"]) for part in parts if "figure" in part]
        contents = native.network()
        self.network: Predictor | None = None
        if contents is not None:
            self.network = Predictor()
            self.network._load(contents)

    def to_pandas(self, table: str) -> Any:
        """A table as a DataFrame. Needs pandas."""
        if table not in self.tables:
            raise KeyError(f"there is no table {table}, allowed are {', '.join(self.tables)}")
        return needed("pandas", "data frames").DataFrame(self.tables[table])

    def figure(self, name: str) -> Any:
        """A figure by its name as a new ``matplotlib.figure.Figure``. Needs matplotlib."""
        for figure in self.figures:
            if figure.name == name:
                return figure.figure()
        raise KeyError(f"there is no figure {name}, allowed are {', '.join(figure.name for figure in self.figures)}")

    def html(self) -> str:
        """The report as one page that needs no other file."""
        return self._native.html()

    def save(self, directory: _Path) -> Path:
        """Writes what `joulebus report --out` writes, and returns the path of report.html."""
        folder = Path(directory)
        for path, contents in self._native.files():
            (folder / path).parent.mkdir(parents=True, exist_ok=True)
            (folder / path).write_bytes(contents)
        return folder / "report.html"

    def __repr__(self) -> str:
        return f"Report({self.data['title']!r}, {len(self.tables)} tables, {len(self.figures)} figures)"


def report(
    recordings: Recordings | None = None,
    model: Models | None = None,
    *,
    fit: Recordings = (),
    split: str | None = None,
    held_out: float = 0.15,
    leave_out: Sequence[str] = (),
    seed: int | None = None,
    battery_wh: float | None = None,
    simulated: bool = False,
    draws: int = 10,
    samples: int = 8000,
    max_epochs: int = 100,
    columns: dict[str, str] | None = None,
    current: str | None = None,
    accept: Sequence[str] = (),
    progress: bool = True,
) -> Report:
    """Reports what recordings say of energy, and the accuracy of models, as `joulebus report` does.

    recordings, model, fit, split, held_out, leave_out, columns, current, accept: as of `evaluate`. The first model is in every figure.
                Without one, the report is on what the recordings say by themselves
    battery_wh: energy of the battery from full to empty, to report how long it lasts
    simulated: runs the paper's experiments on simulated robots instead, without recordings: `draws` times, with `samples`
               of each trial and at most `max_epochs` of training. `seed` is that of the first draw (1)
    """
    if simulated != (recordings is None):
        raise ValueError("give recordings, or simulated=True without them")
    native = lab("reports")
    if simulated:
        first = 1 if seed is None else seed
        with Progress(progress, "simulating", "epoch", draws * max_epochs) as bar:

            def told(seed: int, number: int) -> None:
                bar.reach((seed - first) * max_epochs + number, note=f"seed {seed}")

            return Report(native.report_simulated(first, draws, samples, max_epochs, told))
    choice = _choice(split, held_out, leave_out, seed or 0)
    asked = json.dumps({"choice": choice, "battery_wh": battery_wh})
    found = native.report_recorded(
        _inputs(recordings), _inputs(fit), _reading(columns, current, accept), _models(model), asked, _warn
    )
    return Report(found)


def _inputs(recordings: Any) -> list[Any]:
    if recordings is None:
        return []
    given = [recordings] if isinstance(recordings, (str, os.PathLike, Trial)) else list(recordings)
    found: list[Any] = []
    for at, one in enumerate(given, 1):
        if isinstance(one, Trial):
            found.append((one.name or f"trial_{at}", one.robot, one.columns))
        elif isinstance(one, (str, os.PathLike)):
            found.append(os.fspath(one))
        else:
            raise TypeError(f"a recording is {one!r}, allowed are paths and Trial objects")
    return found


def _models(model: Any) -> list[Any]:
    single = isinstance(model, (str, os.PathLike, _native.Predictor, Training))
    if model is None:
        return []
    return [one.predictor if isinstance(one, Training) else one for one in ([model] if single else model)]


def _choice(split: str | None, held_out: float, leave_out: Sequence[str], seed: int) -> dict[str, Any]:
    if leave_out and split is None:
        raise ValueError("leave_out needs split: trial, robot or group")
    return {"split": split, "held_out": held_out, "leave_out": list(leave_out), "seed": seed}


def _warn(text: str) -> None:
    warnings.warn(text, stacklevel=4)


def _estimate(name: str, found: dict[str, Any]) -> dict[str, Any]:
    return {name: found["value"], f"{name}_lo": found["lo"], f"{name}_hi": found["hi"]}


def _feature_rows(series: dict[str, Any]) -> list[dict[str, Any]]:
    ablation = series["ablation"] or {"members": []}
    return [
        {
            "series": series["name"],
            "features": member["name"],
            "rows": member["all"]["rows"],
            "r2": member["all"]["r2"],
            "mae_w": member["all"]["mae_w"],
            "r2_new": member["new"]["r2"],
            "mae_new_w": member["new"]["mae_w"],
            "held_share_of_gain": member["held_share_of_gain"],
        }
        for member in ablation["members"]
    ]


def _lag_rows(series: dict[str, Any]) -> list[dict[str, Any]]:
    pairs = zip(series["mean_autocorrelation"], series["pooled_autocorrelation"])
    return [
        {"series": series["name"], "lag": lag, "mean": mean, "pooled": pooled}
        for lag, (mean, pooled) in enumerate(pairs, 1)
    ]


def _analysis_lines(data: dict[str, Any]) -> Iterable[str]:
    for series in data["series"]:
        yield f"{series['name']}: {series['rows']} rows, {100.0 * series['held_share']:.1f} % of the readings are held"
        for row in _feature_rows(series):
            yield f"  {row['features']:26} R² {row['r2']:8.4f}  MAE {row['mae_w']:.4f} W"
