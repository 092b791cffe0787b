"""The notebooks run from a clean folder. Their stored outputs are small and without errors.

With JOULEBUS_WRITE=1 the outputs are stored again.
"""
from __future__ import annotations

import os

import nbformat
import pytest
from conftest import ROOT
from nbclient import NotebookClient

NOTEBOOKS = sorted((ROOT / "crates/languages/python/notebooks").glob("*.ipynb"))
#: Longest time of one cell, s: for a machine with much other work.
CELL_S = 300


def pictures(notebook) -> int:
    outputs = [output for cell in notebook.cells if cell.cell_type == "code" for output in cell.outputs]
    return sum("image/png" in output.get("data", {}) for output in outputs)


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_a_notebook_runs_and_leaves_nothing_behind(path, program, tmp_path, monkeypatch):
    # The kernel chooses its own way to draw.
    monkeypatch.delenv("MPLBACKEND", raising=False)
    monkeypatch.setenv("PATH", f"{program.parent}{os.pathsep}{os.environ['PATH']}")
    monkeypatch.setenv("TMPDIR", str(tmp_path))
    notebook = nbformat.read(path, as_version=4)
    stored = pictures(notebook)
    client = NotebookClient(notebook, timeout=CELL_S, resources={"metadata": {"path": str(tmp_path)}})
    client.execute()
    assert not list(tmp_path.glob("joulebus-notebook-*")), "a folder is left"
    assert pictures(notebook) >= 2
    if os.environ.get("JOULEBUS_WRITE") == "1":
        for cell in notebook.cells:
            cell.metadata.pop("execution", None)
        nbformat.write(notebook, path)
    else:
        assert stored == pictures(notebook), "the stored outputs are old: JOULEBUS_WRITE=1 stores them again"


def test_there_are_three_notebooks_and_each_is_small():
    assert [path.stem for path in NOTEBOOKS] == ["first_forecast", "planning", "recordings_to_worker"]
    for path in NOTEBOOKS:
        assert path.stat().st_size < 150_000, path
        assert "Traceback" not in path.read_text()
