#!/usr/bin/env python3
"""The network beside what a user could pick instead: the same weights, rows, batches and threads.

Installs the peers into a virtual environment of its own (pinned versions), builds the Rust peers,
checks that all give the same forecasts, then lets them take turns, each in a process of its own on
the same processor, and writes figures (JSON) and a table (Markdown).

    python3 tools/peers/network.py                 # everything; some minutes after the installation
    python3 tools/peers/network.py --quick         # a smoke test
    python3 tools/peers/network.py --peers joulebus,onnxruntime --batches 1,100

PyTorch: its index of CPU wheels is tried first. Where that cannot be reached, the package of PyPI is
taken, with 2 GB of libraries for GPUs that it needs to start.

What is given to peers is the least work there is: normalisation folded into the first and last
layer, rows already in the peer's own memory, one call on the whole batch.
"""
import argparse
import json
import os
import pathlib
import struct
import subprocess
import sys

HERE = pathlib.Path(__file__).resolve().parent
ROOT = HERE.parent.parent
sys.path.insert(0, str(HERE.parent))
import figures  # noqa: E402
from pinned_environment import TORCH, install_torch  # noqa: E402

BATCHES = [1, 7, 20, 100, 1_000, 10_000, 100_000]
SHARED_FROM = 10_000
ROWS = 100_000
ROUNDS = 3
NAMES = ["joulebus", "onnxruntime", "openvino", "pytorch", "numpy", "nalgebra"]
RUST = {"joulebus", "nalgebra"}
THREADED = {"joulebus", "onnxruntime", "openvino", "pytorch"}
# Largest allowed error against double precision, W: of single precision, and of the other form of
# GELU. A larger error means a different computation.
ALLOWED_W = {"numpy": 1e-2}
ALLOWED_SINGLE_W = 2e-5

PACKAGES = ["numpy==2.4.6", "scipy==1.17.1", "safetensors==0.8.0"]
PACKAGES_OF = {
    "onnxruntime": ["onnx==1.23.2", "onnxruntime==1.31.1"],
    "openvino": ["onnx==1.23.2", "openvino==2026.4.1"],
}


def say(text):
    print(text, file=sys.stderr, flush=True)


# The first half runs in any Python: it installs the packages, and starts this file again in the
# environment.

def in_environment(directory, wanted):
    """The environment's Python, with everything that the wanted peers need."""
    environment = directory / "venv"
    python = environment / "bin" / "python"
    if not python.exists():
        say(f"making {environment}")
        subprocess.run([sys.executable, "-m", "venv", environment], check=True)
    needed = set(PACKAGES).union(*(PACKAGES_OF.get(peer, []) for peer in wanted))
    if "pytorch" in wanted:
        needed.add(TORCH)
    there = subprocess.run([python, "-m", "pip", "freeze"], capture_output=True, text=True).stdout
    there = {line.split("+")[0].lower() for line in there.splitlines()}
    missing = sorted(package for package in needed if package.lower() not in there)
    install = [python, "-m", "pip", "install", "--quiet", "--no-cache-dir"]
    for package in missing:
        say(f"installing {package}")
        done = install_torch(install) if package == TORCH else subprocess.run([*install, package]).returncode == 0
        if not done:
            say(f"{package} cannot be installed: its peers are left out")
    return python


def build_rust(directory):
    say("building the Rust peers")
    target = directory / "target"
    command = ["cargo", "build", "--release", "--locked", "--target-dir", target]
    subprocess.run(command, cwd=HERE / "network", check=True)
    return target / "release" / "joulebus-network-peers"


# Peers in Python: each is started as `network.py --as PEER …` and uses the protocol of the Rust
# one.

def layers_of(model):
    """Folded weights, outputs by inputs, and biases, in double precision, then as float32."""
    import numpy
    from safetensors import safe_open

    with safe_open(model, framework="numpy") as file:
        told = file.metadata()
        column = lambda key: numpy.array([float(word) for word in told[key].split(",")])
        layers = [
            [file.get_tensor(f"layers.{place}.{part}").astype(numpy.float64) for part in ("weight", "bias")]
            for place in range(4)
        ]
    if told["activation"] != "gelu_erf" or told["feature_set"] != "full":
        sys.exit(f"{model}: a network of all features with GELU by the error function is needed")
    mean, std = column("feature_mean"), column("feature_std")
    inverse = numpy.divide(1.0, std, out=numpy.zeros_like(std), where=std > 0)
    weights, bias = layers[0]
    layers[0] = [weights * inverse, bias - (weights * inverse) @ mean]
    weights, bias = layers[3]
    scale_w, mean_w = float(told["power_std_w"]), float(told["power_mean_w"])
    layers[3] = [weights * scale_w, bias * scale_w + mean_w]
    return [[part.astype(numpy.float32) for part in layer] for layer in layers]


def rows_of(model, seed, count):
    """Rows spread evenly over the range of training."""
    import numpy
    from safetensors import safe_open

    with safe_open(model, framework="numpy") as file:
        told = file.metadata()
    column = lambda key: numpy.array([float(word) for word in told[key].split(",")])
    low, high = column("feature_min"), column("feature_max")
    random = numpy.random.default_rng(seed)
    return (low + random.random((count, low.size)) * (high - low)).astype(numpy.float32)


def truth(model, rows):
    """Forecasts in double precision, from the weights as the file has them, nothing folded."""
    import numpy
    from safetensors import safe_open
    from scipy.special import erf

    with safe_open(model, framework="numpy") as file:
        told = file.metadata()
        column = lambda key: numpy.array([float(word) for word in told[key].split(",")], numpy.float32)
        mean, std = column("feature_mean").astype(float), column("feature_std").astype(float)
        values = numpy.where(std > 0, (rows - mean) / numpy.where(std > 0, std, 1.0), 0.0)
        for place in range(4):
            weights = file.get_tensor(f"layers.{place}.weight").astype(float)
            values = values @ weights.T + file.get_tensor(f"layers.{place}.bias").astype(float)
            if place < 3:
                values = 0.5 * values * (1.0 + erf(values / numpy.sqrt(2.0)))
    return values[:, 0] * float(told["power_std_w"]) + float(told["power_mean_w"])


def write_onnx(path, layers):
    """The network as ONNX, with its operator Gelu (opset 20)."""
    import onnx
    from onnx import TensorProto, helper, numpy_helper

    nodes, constants, value = [], [], "rows"
    for place, (weights, bias) in enumerate(layers):
        constants += [numpy_helper.from_array(weights, f"w{place}"), numpy_helper.from_array(bias, f"b{place}")]
        sums = f"sums{place}" if place < 3 else "forecasts"
        nodes.append(helper.make_node("Gemm", [value, f"w{place}", f"b{place}"], [sums], transB=1))
        value = f"values{place}"
        if place < 3:
            nodes.append(helper.make_node("Gelu", [sums], [value], approximate="none"))
    shape = lambda name, width: helper.make_tensor_value_info(name, TensorProto.FLOAT, ["batch", width])
    graph = helper.make_graph(nodes, "network", [shape("rows", 11)], [shape("forecasts", 1)], constants)
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 20)], ir_version=9)
    onnx.checker.check_model(model)
    onnx.save(model, path)


def onnxruntime_peer(arguments):
    import onnxruntime

    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = arguments.threads
    options.inter_op_num_threads = 1
    session = onnxruntime.InferenceSession(arguments.onnx, options, providers=["CPUExecutionProvider"])

    def prepare(rows):
        binding = session.io_binding()
        output = onnxruntime.OrtValue.ortvalue_from_shape_and_type([len(rows), 1], rows.dtype)
        binding.bind_ortvalue_input("rows", onnxruntime.OrtValue.ortvalue_from_numpy(rows))
        binding.bind_ortvalue_output("forecasts", output)
        return lambda: session.run_with_iobinding(binding), lambda: output.numpy()

    return prepare


def openvino_peer(arguments):
    import openvino

    core = openvino.Core()
    told = {"INFERENCE_PRECISION_HINT": "f32", "INFERENCE_NUM_THREADS": str(arguments.threads),
            "PERFORMANCE_HINT": "LATENCY", "NUM_STREAMS": "1"}

    def prepare(rows):
        model = core.read_model(arguments.onnx)
        model.reshape([len(rows), 11])
        request = core.compile_model(model, "CPU", told).create_infer_request()
        request.set_input_tensor(openvino.Tensor(rows, shared_memory=True))
        return request.infer, lambda: request.get_output_tensor().data

    return prepare


def torch_peer(arguments):
    import torch

    torch.set_num_threads(arguments.threads)
    torch.set_grad_enabled(False)
    layers = [[torch.from_numpy(part) for part in layer] for layer in layers_of(arguments.model)]

    def network(values):
        for place, (weights, bias) in enumerate(layers):
            values = torch.nn.functional.linear(values, weights, bias)
            if place < 3:
                values = torch.nn.functional.gelu(values)
        return values

    def prepare(rows):
        rows = torch.from_numpy(rows)

        def call():
            with torch.inference_mode():
                return network(rows)

        return call, lambda: call().numpy()

    return prepare


def numpy_peer(arguments):
    """NumPy has no error function: GELU in its form with tanh, each step into memory that is there."""
    import numpy

    layers = layers_of(arguments.model)
    slope = numpy.float32((2.0 / numpy.pi) ** 0.5)

    def prepare(rows):
        sums = [numpy.empty((len(rows), bias.size), numpy.float32) for _, bias in layers]
        work = [numpy.empty_like(values) for values in sums]

        def call():
            values = rows
            for place, ((weights, bias), out, scratch) in enumerate(zip(layers, sums, work)):
                numpy.matmul(values, weights.T, out=out)
                out += bias
                if place < 3:
                    numpy.multiply(out, out, out=scratch)
                    scratch *= numpy.float32(0.044715)
                    scratch += numpy.float32(1.0)
                    scratch *= out
                    scratch *= slope
                    numpy.tanh(scratch, out=scratch)
                    scratch += numpy.float32(1.0)
                    out *= scratch
                    out *= numpy.float32(0.5)
                values = out

        return call, lambda: sums[3]

    return prepare


PREPARE = {
    "onnxruntime": onnxruntime_peer,
    "openvino": openvino_peer,
    "pytorch": torch_peer,
    "numpy": numpy_peer,
}


def be_peer(arguments):
    import time

    import numpy

    os.sched_setaffinity(0, processors(arguments.threads))
    rows = numpy.fromfile(arguments.rows, numpy.float32).reshape(-1, 11)
    prepare = PREPARE[arguments.be](arguments)
    print("ready", flush=True)
    for line in sys.stdin:
        match line.split():
            case ["check", path]:
                call, result = prepare(rows)
                call()
                numpy.asarray(result(), numpy.float32).reshape(-1).tofile(path)
                print("done", flush=True)
            case ["time", batch, seconds]:
                call, _ = prepare(numpy.ascontiguousarray(rows[: int(batch)]))
                print(json.dumps(timed(call, float(seconds), time.perf_counter_ns)), flush=True)


def timed(call, seconds, clock):
    """ns of each repetition divided by its calls: as many calls as make it 100 µs long."""
    call()
    calls = 1
    while True:
        start = clock()
        for _ in range(calls):
            call()
        if clock() - start >= 100_000:
            break
        calls *= 2
    times, begin = [], clock()
    while len(times) < 3 or clock() - begin < seconds * 1e9:
        start = clock()
        for _ in range(calls):
            call()
        times.append((clock() - start) / calls)
    return times


# The driver, in the environment.

def processors(count):
    return set(sorted(os.sched_getaffinity(0))[:count])


class Runner:
    """A peer's process."""

    def __init__(self, peer, threads, arguments, place, rust):
        self.peer, self.threads = peer, threads
        told = ["--model", arguments.model, "--rows", place / "rows.f32", "--threads", threads]
        if peer in RUST:
            command = [rust, peer, *told, "--layers", place / "layers.f32"]
        else:
            command = [sys.executable, pathlib.Path(__file__).resolve(), "--as", peer, *told, "--onnx", place / "network.onnx"]
        count = str(threads)
        environment = os.environ | {"OMP_NUM_THREADS": count, "OPENBLAS_NUM_THREADS": count, "MKL_NUM_THREADS": count,
                                    "RAYON_NUM_THREADS": count}
        log = (place / f"{peer}-{threads}.log").open("w")
        self.log = pathlib.Path(log.name)
        pin = lambda: os.sched_setaffinity(0, processors(threads))
        self.process = subprocess.Popen(
            [str(word) for word in command], stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=log,
            text=True, env=environment, preexec_fn=pin)

    def answer(self):
        line = self.process.stdout.readline()
        if not line:
            last = self.log.read_text().strip().splitlines()[-1:] or ["no message"]
            raise RuntimeError(f"{self.peer}: {last[0]} (whole: {self.log})")
        return line.strip()

    def ask(self, words):
        self.process.stdin.write(words + "\n")
        self.process.stdin.flush()
        return self.answer()

    def end(self):
        self.process.stdin.close()
        try:
            self.process.wait(20)
        except subprocess.TimeoutExpired:
            self.process.kill()


def start_all(wanted, threads, arguments, place, rust):
    """Peers that start and give the right forecasts, with their largest error, W."""
    import numpy

    rows = numpy.fromfile(place / "rows.f32", numpy.float32).reshape(-1, 11)
    right_w = truth(arguments.model, rows)
    good = []
    for peer in wanted:
        say(f"checking {peer}, {threads} thread{'' if threads == 1 else 's'}")
        runner = Runner(peer, threads, arguments, place, rust)
        try:
            ready = runner.answer()
            if ready != "ready":
                raise RuntimeError(f"{peer}: said {ready!r} instead of ready")
            path = place / f"{peer}.out"
            runner.ask(f"check {path}")
            error_w = float(numpy.abs(numpy.fromfile(path, numpy.float32) - right_w).max())
            if not error_w <= ALLOWED_W.get(peer, ALLOWED_SINGLE_W):
                raise RuntimeError(f"{peer}: wrong by {error_w:.2e} W: it computes something else")
            good.append((runner, error_w))
        except (RuntimeError, ValueError, BrokenPipeError) as error:
            say(f"left out: {error}")
            runner.end()
            if peer == "joulebus":
                sys.exit("without joulebus there is nothing to compare")
    return good


def measure(runners, batches, seconds, rounds):
    """ns per robot of each peer and batch, interleaved."""
    times = {}
    for batch in batches:
        for _ in range(rounds):
            for runner, _ in list(runners):
                try:
                    answer = json.loads(runner.ask(f"time {batch} {seconds}"))
                except (RuntimeError, BrokenPipeError, json.JSONDecodeError) as error:
                    say(f"left out from here on: {error}")
                    runners[:] = [pair for pair in runners if pair[0] is not runner]
                    continue
                name = (runner.peer, runner.threads, batch)
                times.setdefault(name, []).extend(ns / batch for ns in answer)
        say(f"{figures.robots(batch)}: " + ", ".join(
            f"{runner.peer} {sorted(times[name])[len(times[name]) // 2]:.0f}"
            for runner, _ in runners if (name := (runner.peer, runner.threads, batch)) in times))
    return times


def versions(wanted):
    from importlib import metadata

    lock = (HERE / "Cargo.lock").read_text()
    found = {}
    for peer in wanted:
        if peer in RUST:
            crate = {"joulebus": "joulebus-predictor"}.get(peer, peer)
            after = lock.split(f'name = "{crate}"\nversion = "', 1)
            found[peer] = after[1].split('"', 1)[0] if len(after) == 2 else "?"
        else:
            found[peer] = metadata.version({"pytorch": "torch"}.get(peer, peer))
    return found


def to_suite(times, errors, inputs):
    made = []
    for (peer, threads, batch), values in times.items():
        name = f"{peer}_ns_per_robot" if threads == 1 else f"{peer}_{threads}_threads_ns_per_robot"
        made.append(figures.figure(name, figures.robots(batch), "ns", values))
    for (peer, threads, batch), values in times.items():
        mine = times.get(("joulebus", threads, batch))
        if peer == "joulebus" or not mine:
            continue
        middle = lambda all: sorted(all)[len(all) // 2]
        name = f"{peer}_over_joulebus" if threads == 1 else f"{peer}_{threads}_threads_over_joulebus"
        ratio = middle(values) / middle(mine)
        made.append(figures.figure(name, figures.robots(batch), "1", [ratio], "more"))
    for peer, error_w in errors.items():
        made.append(figures.figure(f"{peer}_largest_error_w", figures.robots(ROWS), "W", [error_w]))
    made.sort(key=lambda made: made["name"])
    notes = [
        "Peers get the least work: normalisation folded, rows in their own memory, one call a batch, "
        "IO binding (ONNX Runtime), static shapes (OpenVINO).",
        "OpenVINO is told to compute in f32: by itself it takes bf16 here, with an error of 3e-2.",
        "NumPy has no error function: GELU in its tanh form, another model by 1e-3 W.",
    ]
    return figures.suite(ROOT, [figures.report("peers", inputs, made, notes)])


def drive(arguments):
    place = arguments.directory
    wanted = arguments.peers
    rust = build_rust(place)
    rows = rows_of(arguments.model, arguments.seed, ROWS)
    rows.tofile(place / "rows.f32")
    layers = layers_of(arguments.model)
    (place / "layers.f32").write_bytes(b"".join(part.tobytes() for layer in layers for part in layer))
    if {"onnxruntime", "openvino"} & set(wanted):
        write_onnx(place / "network.onnx", layers)
    seconds, rounds = (0.02, 1) if arguments.quick else (arguments.seconds, ROUNDS)
    times, errors = {}, {}
    for threads in (1, 2):
        peers = [peer for peer in wanted if threads == 1 or peer in THREADED]
        batches = [batch for batch in arguments.batches if threads == 1 or batch >= SHARED_FROM]
        if not batches or len(processors(threads)) < threads:
            continue
        runners = start_all(peers, threads, arguments, place, rust)
        errors |= {runner.peer: error_w for runner, error_w in runners}
        times |= measure(runners, batches, seconds, rounds)
        for runner, _ in runners:
            runner.end()
    inputs = {"model": arguments.model.name, "seed": arguments.seed, "seconds": seconds, "rounds": rounds}
    inputs |= {peer: version for peer, version in versions(errors).items()}
    suite = to_suite(times, errors, inputs)
    print(figures.page(suite))
    figures.write(arguments.json, suite)
    say(f"written: {arguments.json}")


def parse():
    parser = argparse.ArgumentParser(description=__doc__.split("\n\n")[0], epilog="Everything after the first run is in the --directory.")
    split = lambda text: text.split(",")
    parser.add_argument("--peers", type=split, default=NAMES, metavar="NAME,…", help=", ".join(NAMES))
    parser.add_argument("--batches", type=lambda text: [int(word) for word in split(text)], default=BATCHES, metavar="N,…")
    parser.add_argument("--seconds", type=float, default=0.5, help="for each peer and batch, in each round")
    parser.add_argument("--install", action="store_true", help="only install and build")
    parser.add_argument("--quick", action="store_true", help="a smoke test")
    parser.add_argument("--seed", type=int, default=7)
    parser.add_argument("--model", type=pathlib.Path, default=ROOT / "configs/models/gternal-sim.safetensors")
    parser.add_argument("--directory", type=pathlib.Path, default=ROOT / "target/peers", help="of the environment and what is built")
    parser.add_argument("--json", type=pathlib.Path, default=ROOT / "bench-results/peers.json")
    parser.add_argument("--as", dest="be", help=argparse.SUPPRESS)
    parser.add_argument("--onnx", help=argparse.SUPPRESS)
    parser.add_argument("--rows", help=argparse.SUPPRESS)
    parser.add_argument("--threads", type=int, default=1, help=argparse.SUPPRESS)
    parser.add_argument("--inside", action="store_true", help=argparse.SUPPRESS)
    return parser.parse_args()


def main():
    arguments = parse()
    if arguments.be:
        return be_peer(arguments)
    unknown = set(arguments.peers) - set(NAMES)
    if unknown:
        sys.exit(f"no such peer: {', '.join(sorted(unknown))}. There are {', '.join(NAMES)}")
    if "joulebus" not in arguments.peers:
        arguments.peers.insert(0, "joulebus")
    arguments.directory = arguments.directory.resolve()
    arguments.directory.mkdir(parents=True, exist_ok=True)
    arguments.json.parent.mkdir(parents=True, exist_ok=True)
    if arguments.inside:
        return drive(arguments)
    python = in_environment(arguments.directory, arguments.peers)
    if arguments.install:
        build_rust(arguments.directory)
        return None
    sys.exit(subprocess.run([python, __file__, "--inside", *sys.argv[1:]]).returncode)


if __name__ == "__main__":
    main()
