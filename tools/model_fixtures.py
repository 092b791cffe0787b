#!/usr/bin/env python3
"""Writes the model files that crates/languages/python/tests/test_models.py reads, with NumPy and PyTorch.

The files are what those programs really write: the published layout (a pickled object array of
NumPy) in several styles, PyTorch's state dicts, checkpoints and whole modules, zip and legacy, and
plain archives. All hold the same network of the published shape, 11-64-64-32-1, whose weights take
few values so that the files are a few kB when compressed. Beside them lie rows of features and the
forecasts that NumPy (double precision) and PyTorch make for them.

Everything is drawn from a fixed seed. With the versions of model_environment.py all files are the stored ones to the bit, except
*_legacy.pt and script.pt, which contain addresses and differ from run to run, and one of PyTorch's forecasts in expected.npz, which
differs by one unit in the last place between releases. The tests look at values. The stored files stay.

Usage: python3 tools/model_fixtures.py      (makes its own environment in target/model-parity)
"""
import gzip
import io
import math
import pickle
import sys

from model_environment import ROOT, inside

inside()

import numpy as np  # noqa: E402
import torch  # noqa: E402

OUT = ROOT / "crates/languages/python/tests/models"
SIZES = [(64, 11), (64, 64), (32, 64), (1, 32)]
V, OMEGA, POWER = (0.0279, 0.0736), (0.0479, 1.0187), (3651.7, 374.7)
ROWS = 48
STEP_S = 1.0 / 30.0


def weights(rng):
    """Layers whose weights are a few multiples of a power of two, most of them zero."""
    layers = []
    for outputs, inputs in SIZES:
        scale = 2.0 ** round(math.log2(2.0 / math.sqrt(inputs)))
        # A small last layer: with its own forecasts as inputs, the network does not diverge.
        scale = scale / 8.0 if outputs == 1 else scale
        steps = rng.choice([-1.0, 0.0, 0.0, 0.0, 1.0], size=(outputs, inputs))
        bias = rng.choice([-0.25, 0.0, 0.25], size=outputs)
        layers.append(((steps * scale).astype(np.float32), bias.astype(np.float32)))
    return layers


def features(rng):
    """Rows in SI units, in the order of the documentation, readings newest first."""
    v = rng.uniform(-0.2, 0.2, ROWS)
    omega = rng.uniform(-3.0, 3.0, ROWS)
    dv, domega = rng.uniform(-1.0, 1.0, ROWS), rng.uniform(-9.0, 9.0, ROWS)
    lags = rng.uniform(3.0, 5.0, (ROWS, 5))
    return np.column_stack([v, omega, dv, domega, abs(v), abs(omega), lags]).astype(np.float32)


def normalised(rows):
    """The rows as the test imports them: everything by the statistics of its quantity."""
    mean = [V[0], OMEGA[0], 0, 0, V[0], OMEGA[0]] + [POWER[0] / 1e3] * 5
    std = [V[1], OMEGA[1], V[1], OMEGA[1], V[1], OMEGA[1]] + [POWER[1] / 1e3] * 5
    return (rows.astype(np.float64) - mean) / std


def gelu(x):
    return np.vectorize(lambda value: 0.5 * value * (1.0 + math.erf(value / math.sqrt(2.0))))(x)


def forecast_numpy(layers, rows):
    values = normalised(rows)
    for number, (weight, bias) in enumerate(layers):
        values = values @ weight.astype(np.float64).T + bias
        values = gelu(values) if number < 3 else values
    return values[:, 0] * POWER[1] / 1e3 + POWER[0] / 1e3


def module(layers):
    parts = []
    for number, (weight, bias) in enumerate(layers):
        linear = torch.nn.Linear(weight.shape[1], weight.shape[0])
        with torch.no_grad():
            linear.weight.copy_(torch.from_numpy(weight))
            linear.bias.copy_(torch.from_numpy(bias))
        parts += [linear] if number == 3 else [linear, torch.nn.GELU(), torch.nn.Dropout(0.1)]
    return torch.nn.Sequential(*parts).eval()


def forecast_torch(net, rows):
    with torch.no_grad():
        values = net(torch.from_numpy(normalised(rows).astype(np.float32)))
    return values[:, 0].numpy() * np.float32(POWER[1] / 1e3) + np.float32(POWER[0] / 1e3)


def write(name, content):
    OUT.mkdir(parents=True, exist_ok=True)
    compressed = gzip.compress(content, 9, mtime=0)
    (OUT / (name + ".gz")).write_bytes(compressed)
    print(f"{name}: {len(content)} bytes, {len(compressed)} compressed")


def saved(save):
    content = io.BytesIO()
    save(content)
    return content.getvalue()


def object_array(value, protocol):
    """As np.save writes it. Older versions of NumPy take protocol 3, newer ones 4."""
    content = io.BytesIO()
    array = np.empty((), dtype=object)
    array[()] = value
    header = {"descr": "|O", "fortran_order": False, "shape": ()}
    np.lib.format.write_array_header_1_0(content, header)
    pickle.dump(array, content, protocol=protocol)
    return content.getvalue()


def numpy_files(layers):
    scalars = {
        "v_mean": V[0], "v_std": V[1], "w_mean": np.float64(OMEGA[0]),
        "w_std": np.float64(OMEGA[1]), "power_mean": POWER[0], "power_std": np.float32(POWER[1]),
    }
    flat = {}
    for number, (weight, bias) in enumerate(layers, 1):
        flat |= {f"W{number}": weight, f"b{number}": bias}
    write("flat.npy", saved(lambda out: np.save(out, flat | scalars, allow_pickle=True)))
    nested = {
        "weights": {"biases": [bias for _, bias in layers],
                    "matrices": [np.asfortranarray(weight.T) for weight, _ in layers]},
        "norm_params": scalars,
        "history": {"loss": [0.5, 0.25], "note": "größer"},
    }
    write("nested.npy", object_array(nested, 3))
    pairs = np.empty(8, dtype=object)
    for number, (weight, bias) in enumerate(layers):
        pairs[2 * number], pairs[2 * number + 1] = weight, bias
    write("pairs.npy", saved(lambda out: np.save(out, pairs, allow_pickle=True)))
    lists = {"layers": [{"w": weight.tolist(), "b": bias.tolist()} for weight, bias in layers]}
    write("lists.npy", object_array(lists | scalars, 2))
    plain = {f"layers.{n}.{what}": array for n, pair in enumerate(layers)
             for what, array in zip(("weight", "bias"), pair)}
    write("arrays.npz", saved(lambda out: np.savez(out, **plain, **scalars)))
    write("compressed.npz", saved(lambda out: np.savez_compressed(out, **plain, **scalars)))


def torch_files(net):
    state = {key: value.clone() for key, value in net.state_dict().items()}
    zipped = lambda value: saved(lambda out: torch.save(value, out))
    legacy = lambda value: saved(
        lambda out: torch.save(value, out, _use_new_zipfile_serialization=False))
    write("state_dict.pt", zipped(state))
    write("state_dict_legacy.pt", legacy(state))
    optimizer = torch.optim.Adam(net.parameters(), lr=1e-3)
    for parameter in net.parameters():
        parameter.grad = torch.ones_like(parameter)
    optimizer.step()
    net.load_state_dict(state)
    checkpoint = {
        "epoch": 17, "model_state_dict": {"net." + key: value for key, value in state.items()},
        "optimizer_state_dict": optimizer.state_dict(),
        "v_mean": V[0], "v_std": V[1], "w_mean": torch.tensor(OMEGA[0], dtype=torch.float64),
        "w_std": np.float64(OMEGA[1]), "power_mean": np.array([POWER[0]]), "power_std": POWER[1],
    }
    write("checkpoint.pt", zipped(checkpoint))
    write("checkpoint_legacy.pt", legacy(checkpoint))
    write("module.pt", zipped(net))
    tanh = torch.nn.Sequential(*[torch.nn.GELU(approximate="tanh") if isinstance(part, torch.nn.GELU)
                                 else part for part in net]).eval()
    write("module_tanh.pt", zipped(tanh))
    write("script.pt", saved(lambda out: torch.jit.save(torch.jit.script(torch.nn.GELU()), out)))


def main():
    rng = np.random.default_rng(20260313)
    layers = weights(rng)
    rows = features(rng)
    net = module(layers)
    by_numpy, by_torch = forecast_numpy(layers, rows), forecast_torch(net, rows)
    print(f"numpy {np.__version__}, torch {torch.__version__}, differ by at most "
          f"{abs(by_numpy - by_torch).max():.1e} W")
    expected = {"features": rows, "numpy_power_w": by_numpy, "torch_power_w": by_torch}
    write("expected.npz", saved(lambda out: np.savez(out, **expected)))
    numpy_files(layers)
    torch_files(net)


if __name__ == "__main__":
    sys.exit(main())
