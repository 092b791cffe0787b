"""The two distributions: `joulebus`, and `joulebus-lab`, whose native half takes the other's place."""
from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import joulebus
import pytest
from conftest import ROOT
from joulebus import _native, _optional

HERE = Path(__file__).resolve().parent.parent


def test_without_the_lab_what_needs_it_names_the_command_that_installs_it(monkeypatch):
    monkeypatch.setattr(_optional, "_native", object())
    calls = [
        lambda: joulebus.simulate(1),
        lambda: joulebus.train(simulated=True),
        lambda: joulebus.evaluate("recordings/"),
        lambda: joulebus.analyze("recordings/"),
        lambda: joulebus.report("recordings/"),
        lambda: joulebus.read_arrays("run.mcap", "forecasts"),
        lambda: joulebus.read_trials("trial.npy"),
        lambda: joulebus.arrays(),
        lambda: joulebus.Predictor().fit([], []),
    ]
    for call in calls:
        with pytest.raises(ImportError, match=r"need the lab, .* pip install 'joulebus\[lab\]'"):
            call()


def test_the_lab_takes_the_place_of_the_package_s_own_half(tmp_path):
    lab = tmp_path / "joulebus_lab"
    lab.mkdir()
    (lab / "__init__.py").touch()
    (lab / "_native.abi3.so").symlink_to(_native.__file__)
    code = f"import sys; sys.path[:] = [{str(tmp_path)!r}, *{sys.path!r}]; import joulebus; from joulebus import _native; print(_native.__file__, sys.modules['joulebus._native'] is joulebus.live._native)"
    told = subprocess.run([sys.executable, "-c", code], check=True, capture_output=True, text=True).stdout
    assert told.split() == [str(lab / "_native.abi3.so"), "True"]


def test_both_are_of_one_release():
    version = joulebus.__version__
    assert f'lab = ["joulebus-lab=={version}"]' in (HERE / "pyproject.toml").read_text()
    assert f'dependencies = ["joulebus=={version}"]' in (HERE / "lab/pyproject.toml").read_text()
    assert f"\nversion: {version}\n" in (ROOT / "CITATION.cff").read_text()
