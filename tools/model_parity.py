#!/usr/bin/env python3
"""Holds joulebus's forecasts against NumPy and ONNX Runtime on the same weights.

There: each model is exported as .npz and .onnx. NumPy computes it from the plain arrays in double
precision, ONNX Runtime runs the graph. Both forecast the rows that the export carries beside
joulebus's own forecasts.

Back: the tests of `joulebus.models.convert` run with the real PyTorch, ONNX and safetensors.

Every difference has to stay below 1e-5 W. Exit code 1 if one does not, or if a test fails or is skipped.
The packages are in target/model-parity, in pinned versions: 5 GB, or 1 GB where PyTorch's index of CPU wheels can be reached.

Usage: python3 tools/model_parity.py [MODEL.safetensors ...]     (default: the models that ship)
       JOULEBUS=path/to/joulebus sets the program, with joulebus-lab beside it
       [default: cargo build --release -p joulebus -p joulebus-lab]. The package's native half is built in any case
"""
import json
import math
import os
import pathlib
import shutil
import subprocess
import sys
import tempfile

from pinned_environment import TORCH, python_of

ROOT = pathlib.Path(__file__).resolve().parent.parent
HOME = pathlib.Path(os.environ.get("JOULEBUS_PARITY_HOME", ROOT / "target/model-parity"))
# The newest that Python 3.11 has.
PINNED = ["numpy==2.4.6", "onnx==1.23.2", "onnxruntime==1.32.0", "pytest==9.2.0", "safetensors==0.8.0", TORCH]
if pathlib.Path(sys.prefix).resolve() != HOME.resolve():
    python = python_of(HOME, PINNED)
    os.execv(python, [python, *sys.argv])

import numpy as np  # noqa: E402
import onnx  # noqa: E402
import onnxruntime  # noqa: E402

LIMIT_W = 1e-5
TARGET = pathlib.Path(os.environ.get("CARGO_TARGET_DIR", ROOT / "target"))


def program():
    given = os.environ.get("JOULEBUS")
    if given:
        return given
    subprocess.run(["cargo", "build", "--release", "-p", "joulebus", "-p", "joulebus-lab"], cwd=ROOT, check=True)
    return str(TARGET / "release/joulebus")


def joulebus(*arguments):
    command = [PROGRAM, "--format", "json", *map(str, arguments)]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True)
    if done.returncode:
        sys.exit(f"{' '.join(command)}: exit {done.returncode}\n{done.stderr}")
    return json.loads(done.stdout)


def gelu(x):
    return np.vectorize(lambda value: 0.5 * value * (1.0 + math.erf(value / math.sqrt(2.0))))(x)


def by_numpy(arrays, rows):
    std = arrays["feature_std"].astype(np.float64)
    inverse = np.divide(1.0, std, out=np.zeros_like(std), where=std > 0)
    values = (rows.astype(np.float64) - arrays["feature_mean"]) * inverse
    for number in range(4):
        weight = arrays[f"layers.{number}.weight"].astype(np.float64)
        values = values @ weight.T + arrays[f"layers.{number}.bias"]
        values = gelu(values) if number < 3 else values
    return values[:, 0] * arrays["power_std_w"] + arrays["power_mean_w"]


def by_onnx(path, rows):
    onnx.checker.check_model(onnx.load(path), full_check=True)
    session = onnxruntime.InferenceSession(path, providers=["CPUExecutionProvider"])
    (power_w,) = session.run(["power_w"], {"features": rows})
    return power_w[:, 0]


def export(model, folder):
    files = [folder / "model.npz", folder / "model.onnx"]
    for file in files:
        joulebus("model", "export", model, "--out", file)
    arrays = dict(np.load(files[0], allow_pickle=False))
    return arrays, str(files[1])


def there(model, folder):
    """Largest difference to each program, W."""
    arrays, graph = export(model, folder)
    rows, own = arrays["check_features"], arrays["check_power_w"]
    return {
        "NumPy": abs(by_numpy(arrays, rows) - own).max(),
        "ONNX Runtime": abs(by_onnx(graph, rows) - own).max(),
    }


def back(folder):
    """Runs the tests of conversions. True if all of them ran and passed."""
    subprocess.run(["cargo", "build", "--release", "-p", "joulebus-python"], cwd=ROOT, check=True)
    package = folder / "package/joulebus"
    shutil.copytree(ROOT / "crates/languages/python/python/joulebus", package)
    shutil.copy(TARGET / "release/lib_native.so", package / "_native.abi3.so")
    tests = ROOT / "crates/languages/python"
    command = [sys.executable, "-P", "-m", "pytest", "-rs", "-p", "no:cacheprovider", "--rootdir", tests,
               "--config-file", tests / "pyproject.toml", tests / "tests/test_models.py"]
    done = subprocess.run(command, text=True, stdout=subprocess.PIPE,
                          env=os.environ | {"PYTHONPATH": str(package.parent), "JOULEBUS_PROGRAM": PROGRAM})
    print(done.stdout)
    return done.returncode == 0 and "skipped" not in done.stdout


def main():
    models = [pathlib.Path(model).resolve() for model in sys.argv[1:]]
    models = models or sorted((ROOT / "configs/models").glob("*.safetensors"))
    print(f"numpy {np.__version__}, "
          f"onnxruntime {onnxruntime.__version__}; differences in W, allowed {LIMIT_W:.0e}")
    worst = 0.0
    with tempfile.TemporaryDirectory() as folder:
        folder = pathlib.Path(folder)
        for model in models:
            for peer, difference in there(model, folder).items():
                print(f"  {model.name} exported, {peer}: {difference:.1e}")
                worst = max(worst, difference)
        converts = back(folder)
    print(f"largest {worst:.1e}: {'fine' if worst < LIMIT_W else 'TOO LARGE'}")
    return 0 if worst < LIMIT_W and converts else 1


if __name__ == "__main__":
    PROGRAM = program()
    sys.exit(main())
