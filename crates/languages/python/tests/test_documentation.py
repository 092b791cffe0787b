"""What is public is documented and typed, and the API's pages can be made."""
from __future__ import annotations

import ast
import importlib
import inspect
import subprocess
import sys
from pathlib import Path

import joulebus
import pytest
from conftest import ROOT

PACKAGE = Path(joulebus.__file__).parent


def public() -> list[tuple[str, object]]:
    found = [(name, getattr(joulebus, name)) for name in joulebus.__all__ if name != "__version__"]
    # EnergyRobotarium is made of a simulator that is on no registry.
    optional = [name for name in joulebus._OPTIONAL if name != "EnergyRobotarium"]
    return [*found, *((name, getattr(joulebus, name)) for name in optional)]


def members(kind: type) -> list[tuple[str, object]]:
    """What a class of this package defines publicly."""
    found = []
    for base in kind.__mro__:
        if base.__module__.split(".")[0] == "joulebus":
            found += [(name, member) for name, member in vars(base).items() if not name.startswith("_")]
    return found


def test_every_public_name_has_documentation():
    missing = []
    for name, found in public():
        if (inspect.isclass(found) or inspect.isfunction(found)) and not inspect.getdoc(found):
            missing.append(name)
        if inspect.isclass(found):
            for member, value in members(found):
                if (callable(value) or isinstance(value, property)) and not inspect.getdoc(value):
                    missing.append(f"{name}.{member}")
    assert not missing, missing


def test_the_native_module_has_exactly_the_names_of_its_stub():
    native = importlib.import_module("joulebus._native")
    stub = ast.parse((PACKAGE / "_native.pyi").read_text())
    typed: dict[str, set[str]] = {}
    for node in stub.body:
        if isinstance(node, ast.ClassDef):
            typed[node.name] = {one.name for one in node.body if isinstance(one, ast.FunctionDef)} - {"__new__"}
        elif isinstance(node, ast.FunctionDef):
            typed[node.name] = set()
        elif isinstance(node, ast.AnnAssign) and isinstance(node.target, ast.Name):
            typed[node.target.id] = set()
    names = {name for name in dir(native) if not name.startswith("__") or name == "__version__"}
    assert set(typed) == names
    for name, methods in typed.items():
        found = getattr(native, name)
        if inspect.isclass(found) and not issubclass(found, Exception):
            defined = {member for member in vars(found) if not member.startswith("__") or member in methods}
            assert defined == methods, name


def test_every_public_function_and_method_is_annotated():
    missing = []
    for module in PACKAGE.glob("*.py"):
        for node in ast.walk(ast.parse(module.read_text())):
            if isinstance(node, ast.FunctionDef):
                arguments = [*node.args.posonlyargs, *node.args.args, *node.args.kwonlyargs]
                plain = [one.arg for one in arguments if one.annotation is None and one.arg not in ("self", "cls")]
                if plain or node.returns is None:
                    missing.append(f"{module.name}: {node.name} {plain}")
    assert not missing, missing


@pytest.mark.parametrize(
    ("name", "heading"),
    [("python-forecasts", "## Learning online"), ("gymnasium", "# Train policies"), ("gymnasium", "## PettingZoo"), ("gymnasium", "## JAX")],
)
def test_the_lines_of_the_document_run(name, heading, tmp_path, monkeypatch):
    page = (ROOT / f"docs/how-to/{name}.md").read_text()
    lines = page.split(heading)[1].split("```python\n")[1].split("```")[0]
    monkeypatch.chdir(tmp_path)
    exec(compile(lines, f"docs/how-to/{name}.md", "exec"), {})


def test_the_pages_of_the_api_are_made(tmp_path):
    pytest.importorskip("pdoc")
    command = [sys.executable, "-P", "-m", "pdoc", "joulebus", "joulebus.vector_env", "joulebus.online", "--output-directory", str(tmp_path)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert "Warn" not in done.stderr, done.stderr
    page = (tmp_path / "joulebus.html").read_text()
    for name in ("train", "evaluate", "analyze", "report", "EnergyPredictor", "Planner"):
        assert f'id="{name}"' in page, name
