"""Networks of other programs, as the files that `joulebus model import` reads."""
from __future__ import annotations

import hashlib
import io
import json
import os
import pickle
import re
import zipfile
from collections.abc import Callable, Mapping, Sequence
from itertools import permutations
from pathlib import Path
from typing import Any, Literal, get_args

import numpy as np

from ._native import ModelError
from ._optional import needed

Activation = Literal["gelu_erf", "gelu_tanh", "relu"]
Derivative = Literal[
    "own-per-second",
    "own-per-step",
    "normalised-per-second",
    "normalised-per-step",
    "raw-per-second",
    "raw-per-step",
]
LagOrder = Literal["newest-first", "oldest-first"]
Lags = Literal["last", "first"]
Magnitude = Literal["own", "as-velocity", "divided", "raw"]
Unit = Literal["W", "mW"]

#: Statistics that the README of the paper's model states: m/s, rad/s, mW. Its file was never to be had.
PUBLISHED: dict[str, float] = {
    "v_mean": 0.0279,
    "v_std": 0.0736,
    "omega_mean": 0.0479,
    "omega_std": 1.0187,
    "power_mean": 3651.7,
    "power_std": 374.7,
}

_Array = np.ndarray[Any, np.dtype[Any]]
_COMMANDS, _LAGS = 6, 5
_INPUTS = (_COMMANDS + _LAGS, _LAGS)
_MAX_LAYERS = 4
_MAX_BYTES = 16 << 20
_MAX_DEPTH, _MAX_VALUES, _MAX_NUMBERS = 16, 1 << 16, 1 << 20
_STATISTICS = ("feature_mean", "feature_std", *PUBLISHED)
#: Further names of statistics.
_ALIASES = {"w_mean": "omega_mean", "w_std": "omega_std", "power_mean_w": "power_mean", "power_std_w": "power_std"}
#: Element types of safetensors. Of bfloat16, which NumPy lacks, the bits are read.
_DTYPES = {
    "F64": "<f8", "F32": "<f4", "F16": "<f2", "BF16": "<u2", "I64": "<i8", "I32": "<i4", "I16": "<i2", "I8": "i1",
    "U64": "<u8", "U32": "<u4", "U16": "<u2", "U8": "u1", "BOOL": "?",
}  # fmt: skip


def convert(
    source: Any,
    to: str | os.PathLike[str],
    *,
    unit: Unit,
    lag_order: LagOrder,
    activation: Activation,
    derivative: Derivative | None = None,
    magnitude: Magnitude | None = None,
    lags: Lags = "last",
    part: str | None = None,
    statistics: Mapping[str, float | Sequence[float] | _Array] | None = None,
) -> Path:
    """Writes the network of another program as plain safetensors `to`, and returns its path. Convert it to a model of
    joulebus with ``joulebus model import TO --data RECORDINGS --out MODEL``.

    No code of a file runs. How its features were computed is stated here, because a file does not say it. The
    recordings of the import check that statement. A network has two to four dense layers from 11 inputs, or from the
    5 powers alone, to the normalised power.

    source:      a file of PyTorch (a state dict or a checkpoint), of ONNX, of safetensors or of NumPy (`.npz`, or the
                 paper's `.npy` with a dict of arrays), or what you read yourself: a module of PyTorch, or a mapping of
                 names to arrays
    to:          the file to write
    unit:        of the powers that the statistics are of: ``"W"`` or ``"mW"``
    lag_order:   of the five powers: ``"newest-first"`` or ``"oldest-first"``
    activation:  of the hidden layers: ``"gelu_erf"`` (PyTorch's default), ``"gelu_tanh"`` or ``"relu"``
    derivative:  of v and omega, divided by the time since the row before (``per-second``), or not (``per-step``):
                 ``"own-per-…"`` normalised by statistics of its own, ``"normalised-per-…"`` of the normalised
                 velocity, ``"raw-per-…"`` not normalised. Not for a network of the powers alone
    magnitude:   of v and omega, normalised by statistics of its own (``"own"``), by mean and deviation of the velocity
                 (``"as-velocity"``), by the deviation alone (``"divided"``), or not (``"raw"``)
    lags:        whether the powers come after the commands (``"last"``) or before them (``"first"``)
    part:        the part of the source with the network, such as ``"model_state_dict"``, if there are several
    statistics:  means and deviations that the source lacks: ``power_mean``, ``power_std`` and either ``feature_mean``,
                 ``feature_std`` of all inputs or of the commands, or ``v_mean``, ``v_std``, ``omega_mean``,
                 ``omega_std``. ``joulebus.models.PUBLISHED`` has those of the paper
    """
    stated = {"unit": unit, "lag_order": lag_order, "activation": activation, "lags": lags}
    for (name, value), allowed in zip(stated.items(), (Unit, LagOrder, Activation, Lags)):
        _allowed(name, value, get_args(allowed))
    contents, origin, sha256 = _contents(source)
    try:
        tensors = _plain(contents, part, statistics, derivative, magnitude, stated)
    except ModelError as error:
        raise ModelError(f"{origin}: {error}") from error
    target = Path(to)
    partial = target.with_name(f"{target.name}.part")
    partial.write_bytes(_safetensors(tensors, stated | {"source": origin, "source_sha256": sha256}))
    return partial.replace(target)


def _plain(
    contents: Any,
    part: str | None,
    statistics: Mapping[str, Any] | None,
    derivative: Derivative | None,
    magnitude: Magnitude | None,
    stated: dict[str, str],
) -> dict[str, _Array]:
    """The tensors to write. Adds to `stated` what networks that read commands state."""
    found, containers = _numbers(contents)
    layers = _network(found, containers, part)
    inputs = layers[0][0].shape[1]
    given = _given(found, statistics, inputs)
    if inputs == _INPUTS[0]:
        has_own = "feature_mean" in given
        why = "with feature_mean" if has_own else "without feature_mean"
        kinds = ("own",) if has_own else ("normalised", "raw")
        _allowed("derivative", derivative, [f"{kind}-per-{by}" for kind in kinds for by in ("second", "step")], why)
        _allowed("magnitude", magnitude, ("own",) if has_own else get_args(Magnitude)[1:], why)
        stated |= {"derivative": str(derivative), "magnitude": str(magnitude)}
    elif derivative is not None or magnitude is not None:
        raise ValueError("the network reads the 5 powers alone: leave out derivative and magnitude")
    tensors = {f"layers.{at}.{name}": array for at, pair in enumerate(layers) for name, array in zip(("weight", "bias"), pair)}
    # A number that float32 lacks becomes infinite, and is refused.
    with np.errstate(over="ignore"):
        tensors = {name: array.astype("<f4") for name, array in tensors.items()}
    tensors["feature_mean"], tensors["feature_std"] = _by_input(given, inputs, stated)
    tensors |= {name: given[name].reshape(()) for name in ("power_mean", "power_std")}
    for name, array in tensors.items():
        fine = np.isfinite(array) & ((array >= 0.0) | (not name.endswith("_std")))
        if not fine.all():
            allowed = "deviations from 0" if name.endswith("_std") else "finite numbers of float32"
            raise ModelError(f"{name} has {array[~fine].flat[0]}, allowed are {allowed}")
    return tensors


def _allowed(name: str, value: object, allowed: Sequence[str], why: str = "") -> None:
    if value not in allowed:
        stated = "is not stated" if value is None else f"is {value!r}"
        raise ValueError(f"{name} {stated}, allowed{f' {why}' if why else ''}: {', '.join(map(repr, allowed))}")


# What a source holds.


def _contents(source: Any) -> tuple[Any, str, str]:
    """The contents of a source, its name, and the SHA-256 of its bytes."""
    if isinstance(source, Mapping):
        return source, "a mapping", ""
    if callable(getattr(source, "state_dict", None)):
        return source.state_dict(), type(source).__name__, ""
    path = Path(source)
    if not path.exists():
        raise FileNotFoundError(f"{path} does not exist")
    size = path.stat().st_size if path.is_file() else -1
    if not 0 <= size <= _MAX_BYTES:
        found = "is not a regular file" if size < 0 else f"has {size} bytes, at most {_MAX_BYTES} are read"
        raise ModelError(f"{path} {found}. Read it yourself, and give a mapping of names to arrays")
    data = path.read_bytes()
    try:
        return _read(data), path.name, hashlib.sha256(data).hexdigest()
    except ImportError:
        raise
    except Exception as error:
        # A damaged file raises whatever the library that reads it raises.
        what = str(error) if isinstance(error, ModelError) else f"{type(error).__name__}: {error}"
        raise ModelError(f"{path}: {what}") from error


def _read(data: bytes) -> Any:
    if data.startswith(b"\x93NUMPY"):
        return _npy(data)
    if data.startswith(b"PK\x03\x04"):
        with zipfile.ZipFile(io.BytesIO(data)) as archive:
            members = archive.infolist()
        if any(member.filename.endswith("data.pkl") for member in members):
            return _torch(data)
        size = sum(member.file_size for member in members)
        if not size <= _MAX_BYTES:
            raise ModelError(f"the archive holds {size} bytes, at most {_MAX_BYTES} are read")
        with np.load(io.BytesIO(data), allow_pickle=False) as arrays:
            return dict(arrays)
    if data.startswith(b"\x80\x02\x8a\x0al\xfc\x9cF\xf9 j\xa8P\x19."):
        return _torch(data)
    if data.startswith(b"\x80") and data[8:9] != b"{":
        return _Unpickler(data).load()
    if data[8:9] == b"{":
        return _tensors(data)
    if data.startswith(b"\x08"):
        return _onnx(data)
    raise ModelError(
        f"it begins with {data[:8].hex(' ') or 'nothing'}. Allowed are files of PyTorch (.pt), of ONNX, of safetensors"
        " and of NumPy (.npz, .npy with a dict). Read another one yourself, and give a mapping of names to arrays"
    )


def _torch(data: bytes) -> Any:
    torch = needed("torch", "files of PyTorch")
    try:
        return torch.load(io.BytesIO(data), map_location="cpu", weights_only=True)
    except (pickle.UnpicklingError, RuntimeError) as error:
        name = re.search(r"GLOBAL (\S+)|TorchScript", str(error))
        raise ModelError(
            f"it is damaged, or holds more than tensors and numbers: {name[1] or name[0] if name else error}. Save its"
            f" state dict. Only if you trust it, let its code run, and give what it holds to joulebus.models.convert:"
            " torch.load(…, weights_only=False)"
        ) from error


def _onnx(data: bytes) -> dict[str, _Array]:
    onnx = needed("onnx", "files of ONNX")
    graph = onnx.load_model_from_string(data).graph
    outside = [one.name for one in graph.initializer if onnx.external_data_helper.uses_external_data(one)]
    if outside:
        raise ModelError(f"its numbers are in other files: {_listed(outside)}. Save the network as one file")
    arrays = {one.name: onnx.numpy_helper.to_array(one) for one in graph.initializer}
    # In the order in which the graph uses them.
    used = {name: arrays[name] for node in graph.node for name in node.input if name in arrays}
    return used | arrays


def _tensors(data: bytes) -> dict[str, Any]:
    end = 8 + int.from_bytes(data[:8], "little")
    header, values = json.loads(data[8:end]), data[end:]
    found: dict[str, Any] = {}
    for name, text in header.pop("__metadata__", {}).items():
        try:
            found[name] = json.loads(text)
        except ValueError:
            continue
    # A header has no order: layers are numbered.
    for name in sorted(header, key=_natural):
        stated = header[name]
        begin, stop = stated["data_offsets"]
        if stated["dtype"] not in _DTYPES:
            continue
        array = np.frombuffer(values[begin:stop], _DTYPES[stated["dtype"]])
        if stated["dtype"] == "BF16":
            array = (array.astype("<u4") << 16).view("<f4")
        found[name] = array.reshape(stated["shape"])
    return found


def _natural(name: str) -> list[tuple[int, str]]:
    return [(int(one), "") if one.isdecimal() else (-1, one) for one in re.split(r"([0-9]+)", name)]


def _npy(data: bytes) -> Any:
    file = io.BytesIO(data)
    version = np.lib.format.read_magic(file)
    read = np.lib.format.read_array_header_1_0 if version == (1, 0) else np.lib.format.read_array_header_2_0
    *_, dtype = read(file)
    if dtype.hasobject:
        return _Unpickler(data[file.tell() :]).load()
    raise ModelError("it is one array, which is no network. Give a mapping of names to arrays")


class _Stub:
    """What stands for a function or class of NumPy in a pickle, so that no code of NumPy sees unchecked states."""

    def __init__(self, made: Callable[..., Any]) -> None:
        self.made = made

    def __call__(self, *arguments: Any) -> Any:
        return self.made(*arguments)


class _Dtype:
    def __init__(self, code: str, *_: Any) -> None:
        if not (isinstance(code, str) and re.fullmatch(r"[<>|=]?(O8?|b1|[iu][1248]|f[248])", code)):
            raise pickle.UnpicklingError(f"elements of type {code!r}, allowed are numbers and objects")
        self.code = code.lstrip("<>|=")
        self.order = code[0] if code[0] in "<>" else "<"

    def restore(self, state: Any) -> None:
        self.order = ">" if state[1] == ">" else "<"

    def values(self, data: Any) -> _Array:
        if isinstance(data, str):
            data = data.encode("latin1")
        return np.frombuffer(data, self.order + self.code)


class _Pickled:
    """An array of a pickle: the values are set after it was made."""

    value: Any = None

    def restore(self, state: Any) -> None:
        _, shape, dtype, is_fortran, data = state
        if dtype.code.startswith("O"):
            self.value = data
        else:
            self.value = dtype.values(data).reshape(shape, order="F" if is_fortran else "C")


def _pickled(value: Any = None) -> _Pickled:
    made = _Pickled()
    made.value = value
    return made


_MADE: dict[str, Callable[..., Any]] = {
    "_reconstruct": lambda *_: _pickled(),
    "scalar": lambda dtype, data: dtype.values(data)[0],
    "_frombuffer": lambda data, dtype, shape, order: _pickled(dtype.values(data).reshape(shape, order=order)),
}
#: All that a pickle may name.
_NAMES: dict[str, Callable[..., Any]] = {
    "numpy.ndarray": lambda *_: _pickled(),
    "numpy.dtype": _Dtype,
    "collections.OrderedDict": dict,
    "_codecs.encode": lambda text, _="": text.encode("latin1"),
} | {
    f"numpy.{core}.{'numeric' if name == '_frombuffer' else 'multiarray'}.{name}": made
    for core in ("core", "_core")
    for name, made in _MADE.items()
}


class _Unpickler(pickle._Unpickler):  # type: ignore[name-defined, misc]
    """Reads arrays, dicts, lists, numbers and texts of a pickle, and refuses everything else. The reader in Python is
    taken, because the one in C allocates what a file merely claims."""

    def __init__(self, data: bytes) -> None:
        super().__init__(io.BytesIO(data))

    def find_class(self, module: str, name: str) -> _Stub:
        """The stand-in of one of the few names that files of arrays have."""
        made = _NAMES.get(f"{module}.{name}")
        if made is None:
            raise ModelError(
                f"the file names {module}.{name}, which is not run. Allowed are arrays, dicts, lists, numbers and texts."
                " Only if you trust it, read it yourself, and give a mapping of names to arrays"
            )
        return _Stub(made)

    def _build(self) -> None:
        state, made = self.stack.pop(), self.stack[-1]
        if not isinstance(made, (_Dtype, _Pickled)):
            raise pickle.UnpicklingError(f"a state of {type(made).__name__}")
        made.restore(state)

    def _bytes(self) -> None:
        # That of the library allocates what the file claims.
        self.append(self.read(int.from_bytes(self.read(8), "little")))

    def _refuse(self) -> None:
        raise pickle.UnpicklingError("it makes objects of classes, allowed are arrays, dicts, lists, numbers and texts")

    dispatch = dict(pickle._Unpickler.dispatch)  # type: ignore[attr-defined]
    dispatch[pickle.BUILD[0]], dispatch[pickle.BYTEARRAY8[0]] = _build, _bytes
    for _opcode in (pickle.INST, pickle.OBJ, pickle.NEWOBJ, pickle.NEWOBJ_EX, pickle.EXT1, pickle.EXT2, pickle.EXT4):
        dispatch[_opcode[0]] = _refuse


# Its numbers.


def _numbers(contents: Any) -> tuple[dict[str, _Array], list[str]]:
    """All numbers and arrays of numbers of a source, as float64 by their paths, in its order. And the paths of its dicts
    and lists: nothing that stands in one with a network is left out."""
    found: dict[str, _Array] = {}
    containers: list[str] = []
    visited = numbers = 0

    def visit(path: tuple[str, ...], value: Any) -> None:
        nonlocal visited, numbers
        visited += 1
        if isinstance(value, _Pickled):
            value = value.value
        if callable(getattr(value, "detach", None)):
            value = value.detach().cpu().double().numpy()
        if isinstance(value, np.ndarray) and value.dtype.hasobject:
            value = value.reshape(-1).tolist()
        if isinstance(value, (list, tuple)):
            value = _array(value)
        if isinstance(value, list) and len(value) == 1 and not path:
            # NumPy saves a dict as an array of one object.
            value = value[0]
        if isinstance(value, (Mapping, list)):
            if len(path) > _MAX_DEPTH or visited > _MAX_VALUES:
                raise ModelError(f"the source is nested deeper than {_MAX_DEPTH}, or has more than {_MAX_VALUES} values")
            containers.append(".".join(path))
            for key, one in value.items() if isinstance(value, Mapping) else enumerate(value):
                visit((*path, str(key)), one)
        elif isinstance(value, (int, float, np.number, np.ndarray)):
            array = np.asarray(value)
            numbers += array.size
            if numbers > _MAX_NUMBERS:
                raise ModelError(f"the source has more than {_MAX_NUMBERS} numbers. Give the part with the network")
            if array.dtype.kind in "fiub":
                found[".".join(path)] = array.astype(np.float64)

    visit((), contents)
    return found, containers


def _array(values: list[Any] | tuple[Any, ...]) -> Any:
    """A list of numbers, or of such lists of equal length, as an array. Others as a list."""
    rows = values if values and all(isinstance(one, (list, tuple)) for one in values) else [values]
    # The rows may all be one list, which a pickle has once.
    is_even = len({len(row) for row in rows}) == 1 and 0 < len(rows) * len(rows[0]) <= _MAX_VALUES
    is_array = is_even and all(isinstance(one, (int, float)) for row in rows for one in row)
    return np.array(values, np.float64) if is_array else list(values)


_Layers = list[tuple[_Array, _Array]]


def _network(found: dict[str, _Array], containers: list[str], part: str | None) -> _Layers:
    """Weights, one row of inputs per output, and biases of each layer."""
    networks: dict[tuple[str, ...], tuple[str, _Layers]] = {}
    for prefix in [part] if part is not None else containers:
        within = {name: array for name, array in found.items() if not prefix or name.startswith(f"{prefix}.")}
        layers = _layers(within)
        if layers:
            networks[tuple(name for name, array in within.items() if array.ndim == 2)] = (prefix, layers)
    if len(networks) == 1:
        return next(iter(networks.values()))[1]
    if networks:
        parts = _listed(repr(prefix) for prefix, _ in networks.values())
        raise ModelError(f"it holds several networks. State one with part, allowed: {parts}")
    shapes = _listed(f"{name} {array.shape}" for name, array in found.items() if array.ndim)
    raise ModelError(
        f"{'it' if part is None else f'part {part!r}'} holds no network of dense layers: found {shapes or 'no arrays'}."
        f" Allowed are two to {_MAX_LAYERS} layers from 11 or 5 inputs to one output, each with weights and biases, and no"
        " other array of these sizes. State where they are with part. Fold normalisation layers and factors of weights"
        " first. Or give a mapping with the layers in their order"
    )


def _listed(texts: Any) -> str:
    listed = list(texts)
    return ", ".join(listed[:20]) + (f" and {len(listed) - 20} more" if len(listed) > 20 else "")


def _layers(found: dict[str, _Array]) -> _Layers | None:
    """The layers, if the matrices are a chain from the inputs to one output and each has its biases."""
    arrays = {name: array for name, array in found.items() if _statistic(name) is None}
    matrices = {name: array for name, array in arrays.items() if array.ndim == 2}
    if not 2 <= len(matrices) <= _MAX_LAYERS or any(array.ndim > 2 for array in arrays.values()):
        return None
    for transposed in (False, True):
        ways = []
        for order in permutations(matrices):
            weights = [matrices[name].T if transposed else matrices[name] for name in order]
            joined = all(after.shape[1] == before.shape[0] for before, after in zip(weights, weights[1:]))
            if joined and weights[0].shape[1] in _INPUTS and weights[-1].shape[0] == 1:
                ways.append((order, weights))
        # The order of the source counts, or the only order that fits.
        if ways and (len(ways) == 1 or ways[0][0] == tuple(matrices)):
            order, weights = ways[0]
            biases = _biases(arrays, list(order), weights)
            return list(zip(weights, biases)) if biases else None
    return None


def _biases(arrays: dict[str, _Array], order: list[str], weights: list[_Array]) -> list[_Array] | None:
    """The biases by the names of the weights, else in their order. None if one is left over or missing."""
    widths = [len(array) for array in weights]
    vectors = {name: array for name, array in arrays.items() if array.ndim == 1 and len(array) in widths}
    known = {_stem(name): array for name, array in vectors.items()}
    named = [known[_stem(name)] for name in order if _stem(name) in known]
    biases = named if len(named) == len(order) else list(vectors.values())
    spare = len(vectors) - len(biases) - sum(len(array) == 1 for array in vectors.values()) + 1
    return biases if [len(array) for array in biases] == widths and spare <= 0 else None


def _stem(name: str) -> str:
    """A name without what tells weights from biases."""
    return re.sub(r"(?i)(weights?|bias(es)?|kernels?|matri(x|ces)|(?<![a-z])[wb](?![a-z]))", "", name)


def _statistic(path: str) -> str | None:
    name = path.rpartition(".")[2]
    name = _ALIASES.get(name, name)
    return name if name in _STATISTICS else None


def _given(found: dict[str, _Array], statistics: Mapping[str, Any] | None, inputs: int) -> dict[str, _Array]:
    """The statistics that the network needs, by their names."""
    if statistics is not None:
        unknown = [name for name in statistics if _statistic(str(name)) != name]
        if unknown:
            raise ValueError(f"statistics have {_listed(unknown)}, allowed are {', '.join(_STATISTICS)}")
        found = {name: np.asarray(value, np.float64) for name, value in statistics.items()}
    given: dict[str, _Array] = {}
    for path, array in found.items():
        name = _statistic(path)
        if name is None:
            continue
        if name in given and not np.array_equal(given[name], array):
            raise ModelError(f"it has several statistics {name}. State them: statistics={{{name!r}: …}}")
        given[name] = array
    has_own = "feature_mean" in given or "feature_std" in given
    needed_names = ["power_mean", "power_std"]
    if has_own:
        needed_names += ["feature_mean", "feature_std"]
    elif inputs == _INPUTS[0]:
        needed_names += ["v_mean", "v_std", "omega_mean", "omega_std"]
    missing = [name for name in needed_names if name not in given]
    if missing:
        raise ModelError(
            f"it lacks the statistics {', '.join(missing)}. State all of them with statistics={{…}}: those of the"
            " training, or joulebus.models.PUBLISHED if the network is the paper's"
        )
    for name in needed_names:
        allowed = {inputs, *((_COMMANDS,) if inputs > _LAGS else ())} if name.startswith("feature") else {1}
        if given[name].size not in allowed:
            counts = " or ".join(map(str, sorted(allowed)))
            raise ModelError(f"{name} has {given[name].size} numbers, allowed are {counts}")
    return {name: given[name].reshape(-1) for name in needed_names}


def _by_input(given: dict[str, _Array], inputs: int, stated: dict[str, str]) -> tuple[_Array, _Array]:
    """Mean and deviation of each input, in the order of the source."""
    pairs: list[_Array] = []
    for kind in ("mean", "std"):
        power = np.repeat(given[f"power_{kind}"], _LAGS)
        if f"feature_{kind}" in given:
            own = given[f"feature_{kind}"]
            if len(own) == inputs:
                pairs.append(own)
                continue
            commands = own
        elif inputs == _LAGS:
            commands = np.empty(0)
        else:
            velocities = np.concatenate([given[f"v_{kind}"], given[f"omega_{kind}"]])
            deviations = np.concatenate([given["v_std"], given["omega_std"]])
            none = np.zeros(2) if kind == "mean" else np.ones(2)
            scaled = np.zeros(2) if kind == "mean" else deviations
            of_magnitude = {"raw": none, "divided": scaled, "as-velocity": velocities}[stated["magnitude"]]
            of_derivative = none if stated["derivative"].startswith("raw") else scaled
            commands = np.concatenate([velocities, of_derivative, of_magnitude])
        pairs.append(np.concatenate([power, commands] if stated["lags"] == "first" else [commands, power]))
    return pairs[0], pairs[1]


def _safetensors(tensors: dict[str, _Array], metadata: dict[str, str]) -> bytes:
    header: dict[str, Any] = {"__metadata__": metadata}
    values = b""
    # As its readers demand: wide elements first.
    for name, array in sorted(tensors.items(), key=lambda one: -one[1].dtype.itemsize):
        begin = len(values)
        values += array.astype(array.dtype.newbyteorder("<")).tobytes()
        dtype = {8: "F64", 4: "F32"}[array.dtype.itemsize]
        header[name] = {"dtype": dtype, "shape": list(array.shape), "data_offsets": [begin, len(values)]}
    text = json.dumps(header).encode()
    text += b" " * (-len(text) % 8)
    return len(text).to_bytes(8, "little") + text + values
