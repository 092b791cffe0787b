"""Networks of other programs become plain safetensors, by what is stated about them, and no file runs code."""
from __future__ import annotations

import gzip
import io
import itertools
import json
import math
import pickle
import struct
import subprocess
import tracemalloc
import zipfile
from pathlib import Path

import joulebus
import numpy as np
import pytest
from joulebus.models import PUBLISHED, convert

FIXTURES = Path(__file__).parent / "models"
STATED = {
    "unit": "mW",
    "lag_order": "newest-first",
    "activation": "gelu_erf",
    "derivative": "normalised-per-second",
    "magnitude": "as-velocity",
}
OWN = {**STATED, "derivative": "own-per-second", "magnitude": "own"}
POWERS = {name: STATED[name] for name in ("unit", "lag_order", "activation")}


def fixture(name: str, folder: Path) -> Path:
    """A file that NumPy or PyTorch wrote (tools/model_fixtures.py of commit d912ee38)."""
    path = folder / name
    path.write_bytes(gzip.decompress((FIXTURES / f"{name}.gz").read_bytes()))
    return path


def read(path: Path) -> tuple[dict[str, np.ndarray], dict[str, str]]:
    """The tensors and the metadata of plain safetensors."""
    data = path.read_bytes()
    end = 8 + int.from_bytes(data[:8], "little")
    header = json.loads(data[8:end])
    metadata = header.pop("__metadata__")
    kinds = {"F32": "<f4", "F64": "<f8"}
    tensors = {
        name: np.frombuffer(data[end:][slice(*one["data_offsets"])], kinds[one["dtype"]]).reshape(one["shape"])
        for name, one in header.items()
    }
    return tensors, metadata


def expected(folder: Path) -> tuple[np.ndarray, np.ndarray]:
    """Rows of features in SI units, newest power first, and the forecasts that NumPy made of them."""
    with np.load(fixture("expected.npz", folder)) as found:
        return found["features"].astype(np.float64), found["numpy_power_w"]


def forecasts_w(tensors: dict[str, np.ndarray], rows: np.ndarray) -> np.ndarray:
    """Of a network that has GELU and reads mW, by the names alone."""
    values = (rows * np.array([1.0] * 6 + [1e3] * 5) - tensors["feature_mean"]) / tensors["feature_std"]
    layers = len(tensors) // 2 - 2
    for number in range(layers):
        values = values @ tensors[f"layers.{number}.weight"].T.astype(np.float64) + tensors[f"layers.{number}.bias"]
        if number + 1 < layers:
            values = np.vectorize(lambda x: 0.5 * x * (1.0 + math.erf(x / math.sqrt(2.0))))(values)
    return (values[:, 0] * tensors["power_std"] + tensors["power_mean"]) / 1e3


def layers(*widths: int, seed: int = 3) -> list[tuple[np.ndarray, np.ndarray]]:
    noise = np.random.default_rng(seed)
    return [
        (noise.normal(size=(after, before)).astype(np.float32), noise.normal(size=after).astype(np.float32))
        for before, after in itertools.pairwise(widths)
    ]


def named(network: list[tuple[np.ndarray, np.ndarray]], name: str = "net.{}.{}", step: int = 5) -> dict[str, np.ndarray]:
    return {
        name.format(step * at, what): array
        for at, pair in enumerate(network)
        for what, array in zip(("weight", "bias"), pair)
    }


def assert_is(path: Path, network: list[tuple[np.ndarray, np.ndarray]]) -> None:
    tensors, _ = read(path)
    for at, pair in enumerate(network):
        for what, array in zip(("weight", "bias"), pair):
            assert np.array_equal(tensors[f"layers.{at}.{what}"], array), (at, what)
    assert len(tensors) == 2 * len(network) + 4


NUMPY = ["flat.npy", "nested.npy", "pairs.npy", "lists.npy", "arrays.npz", "compressed.npz"]
TORCH = ["state_dict.pt", "state_dict_legacy.pt"]


def statistics(name: str) -> dict[str, float] | None:
    """Those that a file lacks."""
    return PUBLISHED if name in ["pairs.npy", *TORCH] else None


@pytest.mark.parametrize("name", [*NUMPY, *TORCH])
def test_every_file_of_numpy_and_pytorch_gives_the_forecasts_of_its_author(name, tmp_path):
    if name in TORCH:
        pytest.importorskip("torch", reason="skipped: no torch, tools/model_parity.py runs this")
    to = tmp_path / "plain.safetensors"
    assert convert(fixture(name, tmp_path), to, **STATED, statistics=statistics(name)) == to
    tensors, metadata = read(to)
    rows, power_w = expected(tmp_path)
    assert abs(forecasts_w(tensors, rows) - power_w).max() < 1e-5
    assert metadata.items() >= STATED.items() and metadata["lags"] == "last" and metadata["source"] == name
    assert len(metadata["source_sha256"]) == 64


@pytest.mark.parametrize("protocol", range(2, pickle.HIGHEST_PROTOCOL + 1))
def test_arrays_of_every_protocol_of_pickles_are_read(protocol, tmp_path):
    network = [(weight.astype(kind), bias) for kind, (weight, bias) in zip(("<f4", ">f8"), layers(11, 8, 1))]
    network[0] = (np.asfortranarray(network[0][0]), network[0][1][::1])
    contents = named(network) | {"power_mean": np.float32(3.5), "power_std": np.float64(0.5), "note": "größer"}
    to = tmp_path / "plain.safetensors"
    of = {name: PUBLISHED[name] for name in PUBLISHED if not name.startswith("power")}
    for name, data in [("x.pkl", contents | of), ("x.npy", np.array(contents | of, object))]:
        pickled = pickle.dumps(data, protocol)
        (tmp_path / name).write_bytes(pickled if name == "x.pkl" else in_npy(pickled))
        convert(tmp_path / name, to, **STATED)
        assert_is(to, network)
        assert read(to)[0]["power_mean"] == 3.5


@pytest.mark.parametrize("name", ["checkpoint.pt", "checkpoint_legacy.pt", "module.pt", "script.pt"])
def test_a_file_of_pytorch_with_more_than_tensors_is_refused_unless_its_owner_reads_it(name, tmp_path):
    torch = pytest.importorskip("torch", reason="skipped: no torch, tools/model_parity.py runs this")
    path, to = fixture(name, tmp_path), tmp_path / "plain.safetensors"
    with pytest.raises(joulebus.ModelError, match="weights_only=False"):
        convert(path, to, **STATED)
    assert not to.exists()
    if name == "script.pt":
        return
    trusted = torch.load(path, weights_only=False)
    convert(trusted, to, **STATED, statistics=PUBLISHED)
    rows, power_w = expected(tmp_path)
    assert abs(forecasts_w(read(to)[0], rows) - power_w).max() < 1e-5


def test_tensors_of_every_width_are_read_from_pytorch(tmp_path):
    torch = pytest.importorskip("torch", reason="skipped: no torch, tools/model_parity.py runs this")
    network = [tuple(torch.tensor(one).bfloat16() for one in pair) for pair in layers(11, 8, 1)]
    path, to = tmp_path / "bf16.pt", tmp_path / "plain.safetensors"
    torch.save(named(network), path)
    convert(path, to, **STATED, statistics=PUBLISHED)
    assert_is(to, [tuple(one.float().numpy() for one in pair) for pair in network])


@pytest.mark.parametrize("operator", ["Gemm", "MatMul"])
def test_a_graph_of_onnx_is_read_in_the_order_in_which_it_computes(operator, tmp_path):
    onnx = pytest.importorskip("onnx", reason="skipped: no onnx, tools/model_parity.py runs this")
    network = layers(11, 20, 20, 20, 1)
    nodes, initializers, value = [], [], "x"
    for at, (weight, bias) in enumerate(network):
        matrix = weight if operator == "Gemm" else weight.T.copy()
        # Names and the order of the list tell nothing.
        names = [f"t{7 - at}", f"u{at * 3 % 4}"]
        initializers += [onnx.numpy_helper.from_array(one, name) for one, name in zip((matrix, bias), names)]
        if operator == "Gemm":
            nodes.append(onnx.helper.make_node("Gemm", [value, *names], [f"y{at}"], transB=1))
        else:
            nodes.append(onnx.helper.make_node("MatMul", [value, names[0]], [f"m{at}"]))
            nodes.append(onnx.helper.make_node("Add", [f"m{at}", names[1]], [f"y{at}"]))
        nodes.append(onnx.helper.make_node("Relu", [f"y{at}"], [f"z{at}"]))
        value = f"z{at}"
    described = [onnx.helper.make_tensor_value_info(name, 1, ["n", width]) for name, width in (("x", 11), (value, 1))]
    graph = onnx.helper.make_graph(nodes, "g", described[:1], described[1:], initializers[::-1])
    path, to = tmp_path / "model.onnx", tmp_path / "plain.safetensors"
    onnx.save(onnx.helper.make_model(graph), path)
    convert(path, to, **STATED, statistics=PUBLISHED)
    assert_is(to, network)
    onnx.save(onnx.load(path), path, save_as_external_data=True, location="weights", size_threshold=0)
    with pytest.raises(joulebus.ModelError, match="in other files"):
        convert(path, to, **STATED, statistics=PUBLISHED)


@pytest.mark.parametrize("kind", ["float16", "float32", "float64"])
def test_safetensors_of_others_are_read_with_statistics_in_their_metadata(kind, tmp_path):
    safetensors = pytest.importorskip("safetensors.numpy", reason="skipped: no safetensors")
    network = [tuple(one.astype(kind).astype(np.float32) for one in pair) for pair in layers(11, 30, 30, 30, 1)]
    mean, std = np.arange(11.0), np.arange(1.0, 12.0)
    metadata = {"feature_mean": json.dumps(mean.tolist()), "feature_std": json.dumps(std.tolist()),
                "power_mean": "3651.7", "power_std": "374.7", "format": "pt"}  # fmt: skip
    path, to = tmp_path / "state.safetensors", tmp_path / "plain.safetensors"
    arrays = {name: array.astype(kind) for name, array in named(network).items()}
    safetensors.save_file(arrays, path, metadata=metadata)
    convert(path, to, **OWN)
    assert_is(to, network)
    tensors, _ = read(to)
    assert np.array_equal(tensors["feature_mean"], mean) and np.array_equal(tensors["feature_std"], std)
    assert tensors["power_mean"] == 3651.7 and tensors["power_mean"].shape == ()
    # What is written is read by the library itself.
    assert np.array_equal(safetensors.load_file(to)["layers.0.weight"], network[0][0])


def test_bfloat16_of_safetensors_is_exact(tmp_path):
    bits = [(one.view(np.uint32) >> 16).astype("<u2") for pair in layers(11, 8, 1) for one in pair]
    names = list(named(layers(11, 8, 1)))
    header, data = {}, b""
    for name, one in zip(names, bits):
        header[name] = {"dtype": "BF16", "shape": one.shape, "data_offsets": [len(data), len(data) + one.nbytes]}
        data += one.tobytes()
    text = json.dumps(header).encode()
    path, to = tmp_path / "bf16.safetensors", tmp_path / "plain.safetensors"
    path.write_bytes(len(text).to_bytes(8, "little") + text + data)
    convert(path, to, **STATED, statistics=PUBLISHED)
    exact = [(one.astype(np.uint32) << 16).view(np.float32) for one in bits]
    assert_is(to, [(exact[0], exact[1]), (exact[2], exact[3])])


def test_statistics_of_quantities_are_written_for_each_input_as_stated(tmp_path):
    source, to = named(layers(11, 8, 1)) | PUBLISHED, tmp_path / "plain.safetensors"
    (v, omega), power = (0.0279, 0.0479), [3651.7] * 5
    v_std, omega_std, power_std = 0.0736, 1.0187, [374.7] * 5
    magnitudes = {"as-velocity": ([v, omega], [v_std, omega_std]), "divided": ([0, 0], [v_std, omega_std]),
                  "raw": ([0, 0], [1, 1])}  # fmt: skip
    for kind, by, (magnitude, of_magnitude), lags in itertools.product(
        ("normalised", "raw"), ("second", "step"), magnitudes.items(), ("last", "first")
    ):
        stated = {**STATED, "derivative": f"{kind}-per-{by}", "magnitude": magnitude, "lags": lags}
        convert(source, to, **stated)
        scale = [v_std, omega_std] if kind == "normalised" else [1, 1]
        commands = [v, omega, 0, 0, *of_magnitude[0]], [v_std, omega_std, *scale, *of_magnitude[1]]
        both = [[*one, *more] if lags == "last" else [*more, *one] for one, more in zip(commands, (power, power_std))]
        tensors, metadata = read(to)
        assert [tensors["feature_mean"].tolist(), tensors["feature_std"].tolist()] == both, stated
        assert metadata.items() >= stated.items()


def test_a_network_of_the_powers_alone_needs_the_statistics_of_power_alone(tmp_path):
    to = tmp_path / "plain.safetensors"
    power = {"power_mean": [20.0], "power_std": np.float32(4.0)}
    convert(named(layers(5, 8, 1)), to, **POWERS, statistics=power)
    tensors, metadata = read(to)
    assert tensors["feature_mean"].tolist() == [20.0] * 5 and tensors["feature_std"].tolist() == [4.0] * 5
    assert "derivative" not in metadata
    with pytest.raises(ValueError, match="leave out derivative"):
        convert(named(layers(5, 8, 1)), to, **STATED, statistics=power)


def test_layers_are_found_in_every_arrangement_and_biases_by_the_names_of_weights(tmp_path):
    network, to = layers(11, 20, 20, 20, 1), tmp_path / "plain.safetensors"
    (w1, b1), (w2, b2), (w3, b3), (w4, b4) = network
    deep = layers(11, 7, 6, 5, 1)
    cases = [
        (named(network), network),
        ({"W1": w1, "b1": b1, "W2": w2, "b2": b2, "W3": w3, "b3": b3, "W4": w4, "b4": b4}, network),
        ({"W1": w1, "W2": w2, "W3": w3, "W4": w4, "b4": b4, "b3": b3, "b1": b1, "b2": b2}, network),
        ({"matrices": [w1.T, w2.T, w3.T, w4.T], "biases": [b1, b2, b3, b4]}, network),
        ([{"w": w.tolist(), "b": b.tolist()} for w, b in network], network),
        # The only order that fits.
        (dict(reversed(list(named(deep).items()))), deep),
        # Arrays of the same widths in other parts.
        ({"a": named(network), "optimizer": {"0": {"exp_avg": w1}, "1": {"exp_avg": b1}}, "epoch": 3}, network),
        ({"net": named(layers(11, 3, 1))} | {"history": {"loss": [0.5, 0.25]}}, layers(11, 3, 1)),
    ]
    for source, wanted in cases:
        source = source if isinstance(source, dict) else {"layers": source}
        convert({**source, **PUBLISHED}, to, **STATED)
        assert_is(to, wanted)


def test_what_is_no_chain_of_dense_layers_is_refused_with_what_was_found(tmp_path):
    network, to = named(layers(11, 8, 4, 1)), tmp_path / "plain.safetensors"
    normalised = network | {"norm.weight": np.ones(8, np.float32), "norm.bias": np.ones(8, np.float32)}
    factors = {"0.weight_g": np.ones((8, 1)), "0.weight_v": np.ones((8, 11)), "0.bias": np.ones(8)} | {
        f"1.{what}": array for what, array in zip(("weight", "bias"), layers(8, 1)[0])
    }
    without_bias = {name: array for name, array in network.items() if name != "net.5.bias"}
    for source in [
        {}, {"a": 3.0}, normalised, factors, without_bias, named(layers(12, 8, 1)), named(layers(11, 8, 2)),
        named(layers(11, 8, 8, 8, 8, 1)), network | {"conv": np.ones((2, 2, 2))}, named(layers(11, 1)),
    ]:  # fmt: skip
        with pytest.raises(joulebus.ModelError, match="holds no network of dense layers: found"):
            convert(source, to, **STATED, statistics=PUBLISHED)
    both = {"model": network, "ema": network}
    with pytest.raises(joulebus.ModelError, match=r"several networks. State one with part, allowed: 'model', 'ema'"):
        convert(both, to, **STATED, statistics=PUBLISHED)
    convert(both, to, **STATED, part="ema", statistics=PUBLISHED)
    with pytest.raises(joulebus.ModelError, match="part 'other' holds no network of dense layers"):
        convert(both, to, **STATED, part="other", statistics=PUBLISHED)


@pytest.mark.parametrize(
    ("changed", "said"),
    [
        ({"unit": "kW"}, "unit is 'kW', allowed: 'W', 'mW'"),
        ({"lag_order": None}, "lag_order is not stated"),
        ({"activation": "tanh"}, "activation is 'tanh'"),
        ({"lags": "middle"}, "lags is 'middle'"),
        ({"derivative": None}, "derivative is not stated, allowed without feature_mean: 'normalised-per-second'"),
        ({"derivative": "own-per-step"}, "derivative is 'own-per-step', allowed without"),
        ({"magnitude": "own"}, "magnitude is 'own', allowed without feature_mean: 'as-velocity', 'divided', 'raw'"),
        ({"magnitude": None}, "magnitude is not stated"),
        ({"statistics": {"v": 1.0}}, "statistics have v, allowed are"),
    ],
)
def test_a_wrong_statement_is_refused_with_what_is_allowed(changed, said, tmp_path):
    with pytest.raises(ValueError) as refused:
        convert(named(layers(11, 8, 1)), tmp_path / "x", **{**STATED, "statistics": PUBLISHED, **changed})
    assert said in str(refused.value)
    assert not (tmp_path / "x").exists()


def test_statistics_that_are_missing_contradictory_or_no_numbers_are_refused_by_name(tmp_path):
    network, to = named(layers(11, 8, 1)), tmp_path / "plain.safetensors"
    own = {"feature_mean": np.zeros(11), "feature_std": np.ones(11), "power_mean": 1.0, "power_std": 1.0}
    less = dict(PUBLISHED)
    del less["omega_std"]
    for stated, given, said in [
        (STATED, less, "lacks the statistics omega_std"),
        (OWN, {**own, "feature_std": np.ones(10)}, "feature_std has 10 numbers, allowed are 6 or 11"),
        (OWN, {**own, "feature_std": [1.0] * 10 + [-1.0]}, "feature_std has -1.0, allowed are deviations from 0"),
        (OWN, {**own, "feature_mean": [0.0] * 10 + [math.nan]}, "feature_mean has nan"),
        (OWN, {**own, "power_std": math.inf}, "power_std has inf"),
    ]:
        with pytest.raises(joulebus.ModelError, match=said):
            convert(network, to, **stated, statistics=given)
    with pytest.raises(joulebus.ModelError, match="layers.0.bias has inf"):
        convert(network | {"net.0.bias": np.full(8, 1e300)}, to, **OWN, statistics=own)
    with pytest.raises(joulebus.ModelError, match="several statistics power_mean"):
        convert({"a": network, **PUBLISHED, "old": {"power_mean": 2.0}}, to, **STATED)
    commands = {**own, "feature_mean": np.arange(6.0), "feature_std": np.arange(1.0, 7.0), "power_mean": 9.0}
    convert(network, to, **OWN, statistics=commands)
    assert read(to)[0]["feature_mean"].tolist() == [0, 1, 2, 3, 4, 5, 9, 9, 9, 9, 9]


def in_npy(pickled: bytes) -> bytes:
    """An object array of NumPy with this pickle."""
    file = io.BytesIO()
    np.lib.format.write_array_header_1_0(file, {"descr": "|O", "fortran_order": False, "shape": ()})
    return file.getvalue() + pickled


def hostile(canary: Path) -> dict[str, bytes]:
    command = f"touch {canary}".encode()
    text = b"X" + struct.pack("<I", len(command)) + command
    array = b"cnumpy.core.multiarray\n_reconstruct\n(cnumpy\nndarray\n(K\x00tC\x01btR"
    return {
        "system": b"\x80\x02cos\nsystem\n" + text + b"\x85R.",
        "posix": b"\x80\x04\x8c\x05posix\x8c\x06system\x93" + text + b"\x85R.",
        "eval": b"\x80\x02cbuiltins\neval\n" + text + b"\x85R.",
        "getattr": b"\x80\x02cbuiltins\ngetattr\n(cnumpy\nndarray\nX\x08\x00\x00\x00__init__tR.",
        "numpy": b"\x80\x02cnumpy\nload\n" + text + b"\x85R.",
        "submodule": b"\x80\x02cjoulebus.models\nconvert\n" + text + b"\x85R.",
        "inst": b"\x80\x02(" + text + b"ios\nsystem\n.",
        "obj": b"\x80\x02(cos\nsystem\n" + text + b"o.",
        "new": b"\x80\x02cnumpy\nndarray\n)\x81.",
        "extension": b"\x80\x02\x82\x01.",
        "persistent": b"\x80\x02X\x01\x00\x00\x00aQ.",
        "state of a name": b"\x80\x02cnumpy\nndarray\n}X\x04\x00\x00\x00madeK\x01sb.",
        "state of a dict": b"\x80\x02}}X\x01\x00\x00\x00aK\x01sb.",
        "state of a shape": b"\x80\x02" + array + b"(K\x01(J\xff\xff\xff\x7ftcnumpy\ndtype\n(X\x02\x00\x00\x00f8tR\x89C\x08abcdefghtb.",
        "records": b"\x80\x02cnumpy\ndtype\n(X\x05\x00\x00\x00f8,f8tR.",
        "wide memo": b"\x80\x02K\x01r\xff\xff\xff\x7f.",
        "claimed bytes": b"\x80\x05\x96" + struct.pack("<Q", 1 << 40) + b".",
        "claimed text": b"\x80\x04\x8d" + struct.pack("<Q", 1 << 40) + b".",
        "claimed frame": b"\x80\x04\x95" + struct.pack("<Q", 1 << 40) + b".",
        "in itself": b"\x80\x02]q\x00h\x00a.",
        "doubled": b"\x80\x02]K\x01a" + b"".join(b"q" + bytes([at]) + b"]h" + bytes([at]) + b"ah" + bytes([at]) + b"a"
                                                  for at in range(60)) + b".",
        "one row for all": b"\x80\x02](" + b"K\x01" * 9_000 + b"eq\x00](" + b"h\x00" * 60_000 + b"e.",
        "many": b"\x80\x02]q\x00](" + b"h\x00" * 70_000 + b"e.",
        "empty": b"\x80\x02.",
        "stopped": b"\x80\x02}",
    }  # fmt: skip


def test_a_hostile_pickle_is_refused_before_anything_runs_and_without_memory(tmp_path):
    canary, to = tmp_path / "canary", tmp_path / "plain.safetensors"
    tracemalloc.start()
    for name, pickled in hostile(canary).items():
        for data in (pickled, in_npy(pickled)):
            path = tmp_path / "model.npy"
            path.write_bytes(data)
            with pytest.raises(joulebus.ModelError) as refused:
                convert(path, to, **STATED)
            assert path.name in str(refused.value), name
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert not canary.exists() and not to.exists()
    assert peak < 100 << 20, peak
    # Nothing of one file is left for the next one.
    convert(fixture("flat.npy", tmp_path), to, **STATED)


@pytest.mark.parametrize("name", ["flat.npy", "nested.npy", "lists.npy", "compressed.npz"])
def test_a_damaged_file_is_an_error_of_models_or_a_network(name, tmp_path):
    whole, to = fixture(name, tmp_path).read_bytes(), tmp_path / "plain.safetensors"
    noise = np.random.default_rng(5)
    path = tmp_path / "damaged.npy"
    for _ in range(60):
        damaged = bytearray(whole[: noise.integers(len(whole))] if noise.random() < 0.3 else whole)
        for at in noise.integers(0, max(1, min(len(damaged), 3000)), 4):
            if damaged:
                damaged[at] = noise.integers(256)
        path.write_bytes(damaged)
        try:
            convert(path, to, **STATED)
        except joulebus.ModelError as error:
            assert str(error)


def test_files_of_other_kinds_are_refused_with_what_is_read(tmp_path):
    to = tmp_path / "plain.safetensors"
    with pytest.raises(FileNotFoundError, match="missing.pt"):
        convert(tmp_path / "missing.pt", to, **STATED)
    with pytest.raises(joulebus.ModelError, match="is not a regular file"):
        convert(tmp_path, to, **STATED)
    np.save(tmp_path / "numbers.npy", np.zeros((3, 11)))
    np.savez(tmp_path / "objects.npz", a=np.array([{}], object))
    with zipfile.ZipFile(tmp_path / "bomb.npz", "w", zipfile.ZIP_DEFLATED) as bomb:
        bomb.writestr("a.npy", bytes(20 << 20))
    for name, data, said in [
        ("empty.pt", b"", "begins with nothing"),
        ("text.csv", b"robot_id,timestamp_s\n", "begins with 72 6f"),
        ("huge.npy", bytes((16 << 20) + 1), "16777217 bytes"),
        ("numbers.npy", None, "is one array"),
        ("objects.npz", None, "allow_pickle=False"),
        ("bomb.npz", None, "holds 20971520 bytes"),
    ]:
        if data is not None:
            (tmp_path / name).write_bytes(data)
        with pytest.raises(joulebus.ModelError, match=said):
            convert(tmp_path / name, to, **STATED)
    assert not to.exists()


def recording(path: Path, forecast_w, rows: int = 1_500) -> Path:
    """A robot that draws what a network forecasts, and a little noise, in the published layout of commands."""
    noise, step_s = np.random.default_rng(7), 1.0 / 30.0
    lag_w, before, command = [3.6] * 5, np.zeros(2), np.zeros(2)
    lines = ["robot_id,timestamp_s,v_cmd_mps,omega_cmd_radps,power_mW"]
    for row in range(rows):
        if row % 3 == 0:
            command = noise.uniform(-1.0, 1.0, 2) * [0.2, 2.0]
        features = np.array([*command, *(command - before) / step_s, *abs(command), *lag_w])
        power_w = forecast_w(features[None])[0] + 0.001 * noise.uniform(-1.0, 1.0)
        lines.append(f"1,{row * step_s:.9f},{command[0]!r},{command[1]!r},{power_w * 1e3!r}".replace("np.float64(", "").replace(")", ""))
        lag_w, before = [power_w, *lag_w[:4]], command
    path.write_text("\n".join(lines) + "\n")
    return path


@pytest.mark.parametrize("name", ["flat.npy", "state_dict.pt"])
def test_a_converted_network_is_imported_with_the_forecasts_of_its_author(name, run, program, tmp_path):
    if name in TORCH:
        pytest.importorskip("torch", reason="skipped: no torch, tools/model_parity.py runs this")
    plain, to = tmp_path / "plain.safetensors", tmp_path / "model.safetensors"
    convert(fixture(name, tmp_path), plain, **STATED, statistics=statistics(name))
    tensors, _ = read(plain)
    data = recording(tmp_path / "trial.csv", lambda rows: forecasts_w(tensors, rows))
    run("model", "import", plain, "--data", data, "--out", to)
    rows, power_w = expected(tmp_path)
    model = joulebus.Predictor(str(to))
    assert abs(model.predict(rows.astype(np.float32)) - power_w).max() < 1e-5
    # A false statement is refused with the true one, as the arguments of the call.
    convert(fixture(name, tmp_path), plain, **{**STATED, "lag_order": "oldest-first"}, statistics=statistics(name))
    command = [program, "model", "import", plain, "--data", data, "--out", tmp_path / "other.safetensors"]
    refused = subprocess.run(command, capture_output=True, text=True, check=False)
    assert refused.returncode == 1 and 'lag_order="newest-first"' in refused.stderr, refused.stderr
    assert not (tmp_path / "other.safetensors").exists()


def test_a_file_of_another_program_is_no_model_and_the_error_has_the_call(tmp_path):
    path = fixture("flat.npy", tmp_path)
    with pytest.raises(joulebus.ModelError, match=r"joulebus\.models\.convert\(") as refused:
        joulebus.Predictor(str(path))
    # The call is one of this package, with values that it takes.
    call = str(refused.value).split("`")[1]
    assert call.startswith("joulebus.models.convert(")
    given = call.replace(json.dumps(f"{path.stem}.plain.safetensors"), repr(str(tmp_path / "plain.safetensors")))
    assert eval(given, {"joulebus": joulebus}) == tmp_path / "plain.safetensors"
