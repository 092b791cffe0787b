#!/usr/bin/env python3
"""Holds joulebus's forecasts against NumPy, PyTorch and ONNX Runtime on the same weights.

There: each model is exported as .npz and .onnx. NumPy (double precision) and PyTorch (single)
compute it from the plain arrays, ONNX Runtime runs the graph. All forecast the rows that the export
carries beside joulebus's own forecasts.

Back: a network of the published shape is written by NumPy and PyTorch in every style that is read,
with a recording that it forecasts exactly. joulebus imports each file, has to find the convention
of its features by itself, and its forecasts are compared with PyTorch's.

Every difference has to stay below 1e-5 W. Exit code 1 if one does not.

Usage: python3 tools/model_parity.py [MODEL.safetensors ...]     (default: the models that ship)
       JOULEBUS=path/to/joulebus sets the program, with joulebus-lab beside it
       [default: cargo build --release -p joulebus -p joulebus-lab]
"""
import json
import os
import pathlib
import subprocess
import sys
import tempfile

from model_environment import ROOT, inside

inside()

import numpy as np  # noqa: E402
import onnx  # noqa: E402
import onnxruntime  # noqa: E402
import torch  # noqa: E402

from model_fixtures import OMEGA, POWER, SIZES, V, gelu, object_array, saved  # noqa: E402

LIMIT_W = 1e-5
STEP_S = 1.0 / 30.0
CONVENTION = "mW+oldest-first+lags-last+d-normalised-per-step+abs-divided"


def program():
    given = os.environ.get("JOULEBUS")
    if given:
        return given
    subprocess.run(["cargo", "build", "--release", "-p", "joulebus", "-p", "joulebus-lab"], cwd=ROOT, check=True)
    target = pathlib.Path(os.environ.get("CARGO_TARGET_DIR", ROOT / "target"))
    return str(target / "release/joulebus")


def joulebus(*arguments):
    command = [PROGRAM, "--format", "json", *map(str, arguments)]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True)
    if done.returncode:
        sys.exit(f"{' '.join(command)}: exit {done.returncode}\n{done.stderr}")
    return json.loads(done.stdout)


def by_numpy(arrays, rows):
    std = arrays["feature_std"].astype(np.float64)
    inverse = np.divide(1.0, std, out=np.zeros_like(std), where=std > 0)
    values = (rows.astype(np.float64) - arrays["feature_mean"]) * inverse
    for number in range(4):
        weight = arrays[f"layers.{number}.weight"].astype(np.float64)
        values = values @ weight.T + arrays[f"layers.{number}.bias"]
        values = gelu(values) if number < 3 else values
    return values[:, 0] * arrays["power_std_w"] + arrays["power_mean_w"]


def module(layers):
    parts = []
    for number, (weight, bias) in enumerate(layers):
        linear = torch.nn.Linear(weight.shape[1], weight.shape[0])
        with torch.no_grad():
            linear.weight.copy_(torch.tensor(weight))
            linear.bias.copy_(torch.tensor(bias))
        parts += [linear] if number == 3 else [linear, torch.nn.GELU(), torch.nn.Dropout(0.1)]
    return torch.nn.Sequential(*parts).eval()


def by_torch(arrays, rows):
    std = torch.tensor(arrays["feature_std"])
    inverse = torch.where(std > 0, 1.0 / std, torch.zeros_like(std))
    values = (torch.tensor(rows) - torch.tensor(arrays["feature_mean"])) * inverse
    net = module([(arrays[f"layers.{n}.weight"], arrays[f"layers.{n}.bias"]) for n in range(4)])
    with torch.no_grad():
        values = net(values)[:, 0]
    return values.numpy() * arrays["power_std_w"] + arrays["power_mean_w"]


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
    again = folder / "again.safetensors"
    joulebus("model", "import", folder / "model.npz", "--out", again)
    assert again.read_bytes() == pathlib.Path(model).read_bytes(), "the export lost something"
    return {
        "NumPy": abs(by_numpy(arrays, rows) - own).max(),
        "PyTorch": abs(by_torch(arrays, rows) - own).max(),
        "ONNX Runtime": abs(by_onnx(graph, rows) - own).max(),
    }


def written_features(v, omega, before, lag_w):
    """The features of CONVENTION, as the author of a file would write them."""
    v_n, omega_n = (v - V[0]) / V[1], (omega - OMEGA[0]) / OMEGA[1]
    v_before, omega_before = (before[0] - V[0]) / V[1], (before[1] - OMEGA[0]) / OMEGA[1]
    lags = [(1e3 * power - POWER[0]) / POWER[1] for power in reversed(lag_w)]
    return [v_n, omega_n, v_n - v_before, omega_n - omega_before,
            abs(v) / V[1], abs(omega) / OMEGA[1], *lags]


def recording(net, rng, rows=3_000):
    """A robot that draws what the network forecasts, as CSV."""
    lines = ["robot_id,timestamp_s,v_cmd_mps,omega_cmd_radps,power_mW"]
    lag_w, before, command = [3.65] * 5, (0.0, 0.0), (0.0, 0.0)
    for row in range(rows):
        if row % 3 == 0:
            command = (rng.uniform(-0.2, 0.2), rng.uniform(-3.0, 3.0))
        features = written_features(*command, before, lag_w)
        with torch.no_grad():
            output = float(net(torch.tensor([features], dtype=torch.float32)))
        power_w = (output * POWER[1] + POWER[0]) / 1e3 + rng.normal(0.0, 1e-4)
        lines.append(f"1,{row * STEP_S:.9f},{command[0]!r},{command[1]!r},{power_w * 1e3!r}")
        lag_w, before = [power_w, *lag_w[:4]], command
    return "\n".join(lines) + "\n"


def styles(net, layers):
    statistics = {"v_mean": V[0], "v_std": V[1], "w_mean": OMEGA[0], "w_std": OMEGA[1],
                  "power_mean": POWER[0], "power_std": POWER[1]}
    state = net.state_dict()
    flat = {f"{what}{n}": array for n, pair in enumerate(layers, 1)
            for what, array in zip("Wb", pair)}
    legacy = {"_use_new_zipfile_serialization": False}
    checkpoint = {"model_state_dict": state, "epoch": 3, **statistics}
    return {
        "dict.npy": saved(lambda out: np.save(out, flat | statistics, allow_pickle=True)),
        "dict3.npy": object_array(flat | statistics, 3),
        "plain.npz": saved(lambda out: np.savez(out, **flat, **statistics)),
        "state.pt": saved(lambda out: torch.save(state, out)),
        "state_legacy.pt": saved(lambda out: torch.save(state, out, **legacy)),
        "checkpoint.pt": saved(lambda out: torch.save(checkpoint, out)),
        "checkpoint_legacy.pt": saved(lambda out: torch.save(checkpoint, out, **legacy)),
        "module.pt": saved(lambda out: torch.save(net, out)),
    }


def back(folder):
    """For each style, the largest difference to PyTorch, W."""
    rng = np.random.default_rng(11)
    layers = [(rng.normal(0, 1 / np.sqrt(inputs), (outputs, inputs)).astype(np.float32),
               rng.normal(0, 0.2, outputs).astype(np.float32)) for outputs, inputs in SIZES]
    net = module(layers)
    data = folder / "recording.csv"
    data.write_text(recording(net, rng))
    differences = {}
    for name, content in styles(net, layers).items():
        file, out = folder / name, folder / (name + ".safetensors")
        file.write_bytes(content)
        report = joulebus("model", "import", file, "--data", data, "--out", out)
        assert report["convention"] == CONVENTION, (name, report["convention"])
        arrays, _ = export(out, folder)
        # Our rows in the format of the file's author: differences over the step, reversed.
        rows = arrays["check_features"].astype(np.float64)
        step_s = report["step_s"]
        inputs = np.column_stack([
            (rows[:, 0] - V[0]) / V[1], (rows[:, 1] - OMEGA[0]) / OMEGA[1],
            rows[:, 2] * step_s / V[1], rows[:, 3] * step_s / OMEGA[1],
            rows[:, 4] / V[1], rows[:, 5] / OMEGA[1],
            ((1e3 * rows[:, 6:] - POWER[0]) / POWER[1])[:, ::-1]])
        with torch.no_grad():
            theirs = net(torch.tensor(inputs, dtype=torch.float32))[:, 0].numpy()
        theirs = (theirs.astype(np.float64) * POWER[1] + POWER[0]) / 1e3
        differences[name] = abs(theirs - arrays["check_power_w"]).max()
    return differences


def main():
    models = [pathlib.Path(model).resolve() for model in sys.argv[1:]]
    models = models or sorted((ROOT / "configs/models").glob("*.safetensors"))
    print(f"numpy {np.__version__}, torch {torch.__version__}, "
          f"onnxruntime {onnxruntime.__version__}; differences in W, allowed {LIMIT_W:.0e}")
    worst = 0.0
    with tempfile.TemporaryDirectory() as folder:
        folder = pathlib.Path(folder)
        for model in models:
            for peer, difference in there(model, folder).items():
                print(f"  {model.name} exported, {peer}: {difference:.1e}")
                worst = max(worst, difference)
        for name, difference in back(folder).items():
            print(f"  {name} imported, PyTorch: {difference:.1e}")
            worst = max(worst, difference)
    print(f"largest {worst:.1e}: {'fine' if worst < LIMIT_W else 'TOO LARGE'}")
    return 0 if worst < LIMIT_W else 1


if __name__ == "__main__":
    PROGRAM = program()
    sys.exit(main())
