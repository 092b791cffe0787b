"""The lab computes what the program's verbs compute, and Ctrl-C ends it."""
from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path

import joulebus
import numpy as np
import pytest
from conftest import ROOT, model_file, needed
from worker import PATIENCE_S, until

matplotlib = pytest.importorskip("matplotlib")
matplotlib.use("Agg")

MODEL = model_file("gternal-sim")
#: What differs from run to run, or says where the program wrote.
APART = ("duration_s", "file", "next")


@pytest.fixture(scope="module")
def simulation() -> joulebus.Simulation:
    return joulebus.simulate(3, steps=900, progress=False)


@pytest.fixture(scope="module")
def files(simulation, tmp_path_factory) -> list[Path]:
    return simulation.write(tmp_path_factory.mktemp("simulated"))


def without(data: dict, names=APART) -> dict:
    return {name: value for name, value in data.items() if name not in names}


def test_simulated_trials_are_the_bytes_that_the_program_writes(run, tmp_path):
    run("data", "simulate", tmp_path / "program", "--seed", 5)
    made = joulebus.simulate(5, progress=False).write(tmp_path / "python")
    assert len(made) == 13 and sorted(made) == sorted(tmp_path.glob("python/*"))
    for path in made:
        assert path.read_bytes() == (tmp_path / "program" / path.name).read_bytes(), path.name
    with pytest.raises(ValueError, match="steps is 1, allowed are 2"):
        joulebus.simulate(5, steps=1)


def test_a_training_gives_the_programs_bytes_report_and_scores(run, files, tmp_path):
    recipe, out = tmp_path / "recipe.toml", tmp_path / "mine.safetensors"
    recipe.write_text("[training]\nmax_epochs = 3\n")
    arguments = [*files[:6], "--split", "time", "--seed", 9, "--recipe", recipe, "--out", out]
    told = json.loads(run("train", "trials", *arguments, "--format", "json"))
    seen = []
    made = joulebus.train(
        files[:6], split="time", seed=9, recipe=recipe, name="mine", out=tmp_path / "python.safetensors",
        progress=lambda *epoch: seen.append(epoch),
    )
    assert (tmp_path / "python.safetensors").read_bytes() == out.read_bytes()
    assert without(made.data) == without(told)
    assert [epoch[0] for epoch in seen] == [1, 2, 3] == made.epochs["number"].tolist()
    assert made.predictor.hash == told["model_hash"] and made.scores["r2"] == told["scores"]["r2"]
    assert len(made.to_pandas()) == 3
    assert made.plot().get_xlabel() == "epoch"
    by_number = joulebus.train(files[:6], split="time", seed=9, max_epochs=3, name="mine", progress=False)
    assert by_number.predictor.hash == made.predictor.hash


def test_parts_that_are_given_are_those_of_the_program(run, files, tmp_path):
    recipe, out = tmp_path / "recipe.toml", tmp_path / "parts.safetensors"
    recipe.write_text("[training]\nmax_epochs = 2\n")
    parts = ["--validate", files[4], "--hold-out", files[5]]
    run("train", "trials", *files[:4], *parts, "--recipe", recipe, "--out", out)
    (tmp_path / "python").mkdir()
    made = joulebus.train(
        files[:4], validate=files[4], hold_out=[files[5]], max_epochs=2, out=tmp_path / "python/parts.safetensors", progress=False
    )
    assert made.data["split"]["name"] == "given individually"
    assert (tmp_path / "python/parts.safetensors").read_bytes() == out.read_bytes()


def test_an_evaluation_has_the_programs_numbers(run, files):
    told = json.loads(run("eval", *files[:3], "--model", MODEL, "--resamples", 50, "--format", "json"))
    found = joulebus.evaluate(files[:3], MODEL, resamples=50, progress=False)
    assert found.data == told
    assert str(found).startswith(run("eval", *files[:3], "--model", MODEL, "--resamples", 50)[:200])
    # By name too, and as an object.
    same = joulebus.evaluate(files[:3], joulebus.Predictor(), resamples=50, progress=False)
    assert same.report["all"] == found.report["all"]
    rows = found.to_pandas()
    network = rows[(rows["set"] == "all") & (rows["role"] == "published")].iloc[0]
    assert network["r2"] == told["evaluations"][0]["all"]["forecasters"][0]["r2"]["value"]
    assert set(rows["set"]) == {"all", "group", "trial"}
    series = found.series[1]
    assert series["trial"] == str(files[1])
    assert len(found.to_pandas("series")) == sum(len(one["time_s"]) for one in found.series)
    errors = np.abs(series["reading_w"] - series["forecast_w"])
    assert errors.mean() == pytest.approx(found.report["trials"][1]["forecasters"][0]["mae_w"]["value"], rel=1e-3)
    assert len(found.plot(series=1).lines) == 2


def test_a_split_evaluates_what_a_training_has_held_out(run, files, simulation):
    arguments = ["--model", MODEL, "--resamples", 0, "--split", "trial", "--leave-out", files[5]]
    told = json.loads(run("eval", *files[:6], *arguments, "--format", "json"))
    found = joulebus.evaluate(files[:6], MODEL, split="trial", leave_out=[str(files[5])], resamples=0, progress=False)
    assert found.data == told
    fitted = joulebus.evaluate(files[5], MODEL, fit=files[:4], resamples=0, progress=False)
    arguments = ["--model", MODEL, "--fit", *files[:4], "--resamples", 0]
    assert fitted.data == json.loads(run("eval", files[5], *arguments, "--format", "json"))
    # Trials in memory have the numbers of their files but for the rounding of mW in them.
    memory = joulebus.evaluate(
        simulation.trials[5], MODEL, fit=simulation.trials[:4], resamples=0, progress=False
    )
    for name, scores in fitted.scores.items():
        assert memory.scores[name]["r2"]["value"] == pytest.approx(scores["r2"]["value"], rel=1e-4), name


def test_an_analysis_has_the_programs_numbers(run, files):
    told = json.loads(run("analyze", *files[:6], "--lags", 4, "--model", MODEL, "--format", "json"))
    found = joulebus.analyze(files[:6], lags=4, model=MODEL)
    assert found.data == told
    features = found.to_pandas().set_index(["series", "features"])
    assert {"persistence", "velocities + 1 lag"} <= set(features.loc["native"].index)
    assert len(found.to_pandas("autocorrelation")) == 8
    assert len(found.plot().lines) == 2 and len(found.plot(what="features").containers) == 2
    with pytest.raises(ValueError, match="what is 'lags', allowed are features and autocorrelation"):
        found.plot(what="lags")


def test_a_report_is_the_programs_and_its_figures_are_drawn_by_matplotlib(program, files, tmp_path):
    if not program.with_name("joulebus-lab").is_file():
        needed("program joulebus-lab beside joulebus")
    command = [program, "report", *files[:2], "--model", MODEL, "--out", tmp_path / "program"]
    subprocess.run(list(map(str, command)), check=True, capture_output=True)
    found = joulebus.report(files[:2], MODEL)
    page = found.save(tmp_path / "python")
    assert page.read_text() == found.html()
    expected = {path.relative_to(tmp_path / "program"): path.read_bytes() for path in (tmp_path / "program").rglob("*.*")}
    for path, contents in expected.items():
        assert (tmp_path / "python" / path).read_bytes() == contents, path
    assert json.loads(expected[Path("report.json")]) == found.data
    for figure in found.figures:
        drawn = found.figure(figure.name)
        drawn.canvas.draw()
        assert len(drawn.axes) >= len(figure.panels)
        matplotlib.pyplot.close(drawn)
    assert len(found.to_pandas(next(iter(found.tables)))) > 0
    with pytest.raises(KeyError, match="there is no figure none, allowed are figure-"):
        found.figure("none")
    assert found.network is None


def test_every_figure_of_a_report_is_written_as_svg_and_pdf(files, tmp_path):
    found = joulebus.report(files[:2], MODEL, battery_wh=20.0)
    assert next(iter(found.tables)) == "table-speed" and found.to_pandas("table-battery")["lasts_h"].notna().any()
    report = found.save(tmp_path).with_name("report.json")
    command = [sys.executable, "-m", "joulebus.figures", report]
    subprocess.run(command, check=True, capture_output=True)
    names = sorted(path.name for path in (tmp_path / "figures").iterdir())
    assert names == sorted(f"{figure.name}.{ending}" for figure in found.figures for ending in ("svg", "pdf"))
    for figure in found.figures:
        assert (tmp_path / "figures" / f"{figure.name}.pdf").read_bytes().startswith(b"%PDF")
        assert "<svg" in (tmp_path / "figures" / f"{figure.name}.svg").read_text()
    refused = subprocess.run([*command, "none"], capture_output=True, text=True)
    assert refused.returncode == 1 and "there is no figure none, allowed are figure-" in refused.stderr
    with pytest.raises(ValueError, match="battery_wh is 0, allowed is 0.001 to"):
        joulebus.report(files[:2], MODEL, battery_wh=0)
    without = joulebus.report(files[:2])
    assert "table-speed" in without.tables and without.data != joulebus.report(files[:2], MODEL).data



def test_the_papers_experiments_run_on_simulated_robots():
    found = joulebus.report(simulated=True, seed=3, draws=2, samples=700, max_epochs=2, progress=False)
    assert "simulated" in found.data["warning"] and found.network.name == "network"
    for figure in found.figures:
        matplotlib.pyplot.close(figure.figure())


def test_the_lines_of_the_document_give_the_papers_table(tmp_path, monkeypatch):
    page = (ROOT / "docs/how-to/python-lab.md").read_text()
    lines = page.split("## Train and evaluate")[1].split("```python\n")[1].split("```")[0]
    assert len(lines.splitlines()) <= 14, lines
    found: dict = {}
    # Shorter trials, and another folder: the rest as it stands there.
    monkeypatch.chdir(tmp_path)
    assert "seed=1)" in lines
    exec(lines.replace("simulate(seed=1)", "simulate(seed=1, steps=3000)"), found)
    table = found["table"].set_index("features")["r2"]
    # The paper: .16 of velocities alone, .90 with one reading. More readings add little.
    assert 0.05 < table["velocities"] < 0.4 < 0.8 < table["velocities + 1 lag"] < 0.97
    assert found["scores"]["r2"] > 0.8 and (tmp_path / "my.safetensors").is_file()


def test_what_is_wrong_is_refused_with_what_is_allowed(files, simulation, tmp_path):
    trial = simulation.trials[0]
    for kind, said, call in [
        (ValueError, "validate and hold_out go together", lambda: joulebus.train(trial, validate=trial)),
        (ValueError, "give recordings, or simulated=True", lambda: joulebus.train()),
        (ValueError, "give recordings, or simulated=True", lambda: joulebus.report(trial, simulated=True)),
        (ValueError, "unknown variant `row`", lambda: joulebus.train(trial, split="row")),
        (ValueError, "feature_set is most, allowed: full", lambda: joulebus.train(trial, feature_set="most")),
        (ValueError, "at least 3 are needed", lambda: joulebus.train(trial, progress=False)),
        (FileNotFoundError, "does not exist", lambda: joulebus.train(trial, out=tmp_path / "no/where.safetensors")),
        (FileNotFoundError, "nothing.csv", lambda: joulebus.evaluate(tmp_path / "nothing.csv")),
        (TypeError, "a recording is 7, allowed are paths and Trial", lambda: joulebus.evaluate([7])),
        (TypeError, "allowed are paths, builtin:NAME and Predictor", lambda: joulebus.evaluate(trial, model=[7])),
        (ValueError, "found no recording", lambda: joulebus.evaluate([])),
        (ValueError, "found no model", lambda: joulebus.evaluate(trial, model=[])),
        (ValueError, "leave_out needs split", lambda: joulebus.evaluate(trial, leave_out=["a"])),
        (ValueError, "lags = 0", lambda: joulebus.analyze(trial, lags=0)),
        (ValueError, "unknown variant `sum`", lambda: joulebus.analyze(trial, resample=["sum"])),
        (joulebus.ModelError, "no built-in model", lambda: joulebus.evaluate(trial, model="builtin:none")),
        (ValueError, "draws", lambda: joulebus.report(simulated=True, draws=1)),
        (ValueError, "power", lambda: joulebus.evaluate(files[0], columns={"powers": "x"})),
    ]:
        with pytest.raises(kind) as refused:
            call()
        assert said in str(refused.value), refused.value
    # An exception of the caller's own function ends the training too.
    with pytest.raises(ZeroDivisionError):
        joulebus.train(files[:6], split="time", progress=lambda *_: 1 / 0)


def computing() -> bool:
    """Whether a computation runs in this process."""

    def name(task: Path) -> str:
        try:
            return Path(task, "comm").read_text().strip()
        except OSError:
            # It has just ended.
            return ""

    return any(name(task) == "joulebus-lab" for task in Path("/proc/self/task").iterdir())


def interrupt_when_computing() -> threading.Thread:
    def interrupt() -> None:
        until("a computation", computing)
        os.kill(os.getpid(), signal.SIGINT)

    thread = threading.Thread(target=interrupt)
    thread.start()
    return thread


@pytest.mark.parametrize("what", ["train", "evaluate", "report", "simulate"])
def test_ctrl_c_ends_a_computation_that_would_last_for_hours(what, simulation):
    calls = {
        "train": lambda: joulebus.train(simulation.trials, split="time", max_epochs=10**6, patience=10**6, progress=False),
        "evaluate": lambda: joulebus.evaluate(simulation.trials * 50, resamples=0, progress=False),
        "report": lambda: joulebus.report(simulated=True, draws=900, samples=700, max_epochs=1000, progress=False),
        "simulate": lambda: joulebus.simulate(steps=1 << 19, progress=False),
    }
    # Of an earlier test.
    until("the end of other computations", lambda: not computing())
    interrupting = interrupt_when_computing()
    with pytest.raises(KeyboardInterrupt):
        calls[what]()
    interrupting.join()
    # Its threads end by themselves.
    until("the end of the computation", lambda: not computing())
    assert joulebus.Predictor().predict(np.ones((1, 11))).shape == (1,)


def test_other_threads_run_while_a_computation_does(simulation):
    counts, end = [0], threading.Event()

    def count() -> None:
        while not end.is_set():
            counts[0] += 1

    class Enough(Exception):
        pass

    seen: set[int] = set()
    patient_until = time.monotonic() + PATIENCE_S

    def progress(*_: object) -> None:
        # A busy machine may not let it count between two epochs.
        seen.add(counts[0])
        if len(seen) == 3 or time.monotonic() > patient_until:
            raise Enough

    thread = threading.Thread(target=count)
    thread.start()
    with pytest.raises(Enough):
        joulebus.train(simulation.trials, split="time", max_epochs=10**6, patience=10**6, progress=progress)
    end.set()
    thread.join()
    assert len(seen) == 3


BARE = """
import sys

class Missing:
    def find_spec(self, name, path=None, target=None):
        if name.partition(".")[0] in ("matplotlib", "pandas", "tqdm", "gymnasium", "jax", "torch", "scipy"):
            raise ModuleNotFoundError(f"No module named {name!r}")

sys.meta_path.insert(0, Missing())
import joulebus

trials = joulebus.simulate(1, steps=400).trials
made = joulebus.train(trials, split="time", max_epochs=2)
found = joulebus.analyze(trials)
for call, package in [(made.plot, "matplotlib"), (made.to_pandas, "pandas"), (found.plot, "matplotlib"),
                      (trials[0].to_pandas, "pandas"), (lambda: joulebus.EnergyVectorEnv, "gymnasium")]:
    try:
        call()
    except ImportError as error:
        assert f"pip install {package}" in str(error), error
    else:
        raise AssertionError(package)
features, power_w = trials[0].rows()
assert joulebus.forward()(joulebus.arrays(), features).shape == power_w.shape
print("fine")
"""


def test_numpy_is_enough_and_what_else_is_missing_is_named():
    done = subprocess.run([sys.executable, "-P", "-c", BARE], capture_output=True, text=True, check=False)
    assert done.stdout == "fine\n", done.stderr
