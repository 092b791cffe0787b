#!/usr/bin/env python3
"""Training beside PyTorch: the same recipe on the same rows and the same two processors.

The recipe is that of arXiv 2603.13908, section 5: Adam at 1e-3, batches of 256, at most 100 epochs,
dropout 0.1, early stopping after ten epochs without progress, 11-64-64-32-1 with GELU. The rows are
those that `joulebus train trials --rows` writes: trials 1 to 4 to learn from, 5 to stop by, 6 to
score, simulated (`joulebus data simulate`) unless recordings are named.

    python3 tools/train_peer.py                    # installs PyTorch if it is missing
    python3 tools/train_peer.py --quick            # a smoke test
    python3 tools/train_peer.py --training a.npy b.npy --validation c.npy --held-out d.npy

PyTorch takes part in three ways: `pytorch-loader` as tutorials write it (DataLoader over a
TensorDataset); `pytorch` with all rows in one tensor, batches cut by a permutation, and Adam's fused
form; `pytorch-compile` the same with forward and backward compiled (torch.compile; its compilation
is shown apart and not counted). Each runs in a process of its own, in turns. Early stopping ends runs
at different epochs, because random numbers differ: compare the time of an epoch.

Where PyTorch is installed: target/peers, as tools/peers/network.py has it, or what JOULEBUS_PEERS
names.
"""
import argparse
import json
import os
import pathlib
import shutil
import subprocess
import sys

HERE = pathlib.Path(__file__).resolve().parent
ROOT = HERE.parent
sys.path[:0] = [str(HERE), str(HERE / "peers")]
import figures  # noqa: E402
import network  # noqa: E402

PEERS = ["joulebus", "pytorch", "pytorch-loader", "pytorch-compile"]
FEATURES, WIDTHS = 11, [64, 64, 32]
BATCH, RATE, DROPOUT, PATIENCE = 256, 1e-3, 0.1, 10


# A peer in Python: a separate process, with its threads and seed; its report is a line of JSON.

def rows_of(directory, name):
    """Features and readings of a part; rows with a missing number are left out, as the trainer does."""
    import numpy

    rows = numpy.load(directory / f"{name}.npy")
    used = numpy.concatenate([rows[:, :FEATURES], rows[:, -1:]], axis=1)
    return used[numpy.isfinite(used).all(axis=1)].astype(numpy.float64)


def be_peer(arguments):
    import time

    import numpy
    import torch

    os.sched_setaffinity(0, network.processors(arguments.threads))
    torch.set_num_threads(arguments.threads)
    torch.manual_seed(arguments.seed)
    training, validation, held_out = (rows_of(arguments.rows, name) for name in ("training", "validation", "held_out"))
    mean, std = training.mean(axis=0), training.std(axis=0)
    scaled = lambda rows: numpy.divide(rows - mean, std, out=numpy.zeros_like(rows), where=std > 0)
    tensors = [torch.from_numpy(scaled(rows).astype(numpy.float32)) for rows in (training, validation, held_out)]
    sizes = [FEATURES, *WIDTHS]
    layers = []
    for inputs, outputs in zip(sizes, sizes[1:]):
        layers += [torch.nn.Linear(inputs, outputs), torch.nn.GELU(), torch.nn.Dropout(DROPOUT)]
    model = torch.nn.Sequential(*layers, torch.nn.Linear(sizes[-1], 1))
    loader = arguments.be == "pytorch-loader"
    adam = torch.optim.Adam(model.parameters(), RATE, fused=not loader)
    loss_of = torch.nn.MSELoss()
    prepared_s = 0.0
    forward = model
    if arguments.be == "pytorch-compile":
        forward = torch.compile(model)
        start = time.perf_counter()
        # Compiles for whole batches; the shorter last one of an epoch uses the plain model.
        loss_of(forward(tensors[0][:BATCH, :FEATURES]), tensors[0][:BATCH, FEATURES:]).backward()
        model.zero_grad()
        prepared_s = time.perf_counter() - start

    def batches():
        rows = tensors[0]
        if loader:
            data = torch.utils.data.TensorDataset(rows[:, :FEATURES], rows[:, FEATURES:])
            yield from torch.utils.data.DataLoader(data, batch_size=BATCH, shuffle=True)
            return
        shuffled = rows[torch.randperm(len(rows))]
        for batch in shuffled.split(BATCH):
            yield batch[:, :FEATURES], batch[:, FEATURES:]

    best, best_loss, since, seconds = None, float("inf"), 0, []
    begin = time.perf_counter()
    for _ in range(arguments.epochs):
        start = time.perf_counter()
        model.train()
        for inputs, targets in batches():
            adam.zero_grad(set_to_none=True)
            run = forward if len(inputs) == BATCH else model
            loss_of(run(inputs), targets).backward()
            adam.step()
        model.eval()
        with torch.no_grad():
            loss = float(loss_of(model(tensors[1][:, :FEATURES]), tensors[1][:, FEATURES:]))
        seconds.append(time.perf_counter() - start)
        since += 1
        if loss < best_loss:
            best_loss, since = loss, 0
            best = {name: value.clone() for name, value in model.state_dict().items()}
        if since >= PATIENCE:
            break
    duration_s = time.perf_counter() - begin
    model.load_state_dict(best)
    model.eval()
    with torch.no_grad():
        forecasts = model(tensors[2][:, :FEATURES]).numpy()[:, 0].astype(float) * std[-1] + mean[-1]
    readings = held_out[:, -1]
    errors = readings - forecasts
    r2 = 1 - float((errors ** 2).sum() / ((readings - readings.mean()) ** 2).sum())
    print(json.dumps({"epochs": len(seconds), "duration_s": duration_s, "epoch_s": seconds, "prepared_s": prepared_s,
                      "r2": r2, "mae_w": float(abs(errors).mean()), "rows": [len(rows) for rows in tensors]}))


# The driver.

def run(command, **more):
    told = subprocess.run([str(word) for word in command], stdout=subprocess.PIPE, text=True, **more)
    if told.returncode:
        raise RuntimeError(f"{' '.join(str(word) for word in command)}: ended with {told.returncode}")
    return told.stdout


def program(arguments):
    """The program, built if none is named."""
    if arguments.joulebus:
        return arguments.joulebus.resolve()
    network.say("building joulebus")
    command = ["cargo", "build", "--release", "--locked", "-p", "joulebus", "-p", "joulebus-lab"]
    subprocess.run(command, cwd=ROOT, check=True)
    target = pathlib.Path(os.environ.get("CARGO_TARGET_DIR", ROOT / "target"))
    return target / "release" / "joulebus"


def parts(arguments, joulebus, place):
    """The recordings of each part."""
    if arguments.training:
        return arguments.training, arguments.validation, arguments.held_out
    simulated = place / "simulated"
    shutil.rmtree(simulated, ignore_errors=True)
    run([joulebus, "data", "simulate", simulated, "--seed", arguments.seed])
    trials = [next(iter(simulated.glob(f"*trial{number}_*.npy"))) for number in range(1, 7)]
    return trials[:4], trials[4:5], trials[5:]


def train_ours(arguments, joulebus, place, files):
    """A run of ours, which also writes the rows for the others."""
    recipe = place / "recipe.toml"
    recipe.write_text(f"[training]\nmax_epochs = {arguments.epochs}\nseed = {arguments.seed}\n")
    training, validation, held_out = files
    told = json.loads(run([
        joulebus, "train", "trials", *training, "--validate", *validation, "--hold-out", *held_out, "--recipe", recipe,
        "--threads", arguments.threads, "--rows", place / "rows", "--out", place / "ours.safetensors", "--format", "json",
    ], stderr=subprocess.DEVNULL, preexec_fn=pin(arguments.threads)))
    scores = told["scores"]
    return {"epochs": told["epochs"], "duration_s": told["duration_s"], "prepared_s": 0.0, "r2": scores["r2"],
            "mae_w": scores["mae_w"], "persistence_r2": scores["persistence_r2"], "rows": told["split"]["rows"]}


def train_theirs(arguments, python, peer, place):
    command = [python, pathlib.Path(__file__).resolve(), "--as", peer, "--rows", place / "rows", "--threads", arguments.threads,
               "--epochs", arguments.epochs, "--seed", arguments.seed]
    count = str(arguments.threads)
    # A cache of its own: a killed run leaves half-written libraries in the usual one.
    cache = place / "compiled"
    shutil.rmtree(cache, ignore_errors=True)
    environment = os.environ | {"OMP_NUM_THREADS": count, "MKL_NUM_THREADS": count, "TORCHINDUCTOR_CACHE_DIR": str(cache)}
    log = place / f"{peer}.log"
    with log.open("w") as errors:
        try:
            lines = run(command, env=environment, stderr=errors, preexec_fn=pin(arguments.threads)).splitlines()
        except RuntimeError as error:
            network.say(f"left out: {error} (whole: {log})")
            return None
    return json.loads(lines[-1])


def pin(threads):
    return lambda: os.sched_setaffinity(0, network.processors(threads))


def middle(values):
    return sorted(values)[len(values) // 2]


def to_suite(arguments, results):
    made, epoch_s = [], {}
    for peer, runs in results.items():
        case = f"{arguments.threads} threads"
        epoch_s[peer] = [result["duration_s"] / result["epochs"] for result in runs]
        made += [
            figures.figure(f"{peer}_epoch_s", case, "s", epoch_s[peer]),
            figures.figure(f"{peer}_training_s", case, "s", [result["duration_s"] for result in runs]),
            figures.figure(f"{peer}_epochs", case, "1", [result["epochs"] for result in runs]),
            figures.figure(f"{peer}_r2", case, "1", [result["r2"] for result in runs], "more"),
            figures.figure(f"{peer}_mae_w", case, "W", [result["mae_w"] for result in runs]),
        ]
    for peer in results:
        if peer != "joulebus":
            ratio = middle(epoch_s[peer]) / middle(epoch_s["joulebus"])
            made.append(figures.figure(f"{peer}_over_joulebus", "an epoch", "1", [ratio], "more"))
    first = results["joulebus"][0]
    simulated = not arguments.training
    inputs = {"rows": first["rows"], "simulated": simulated, "seed": arguments.seed, "epochs": arguments.epochs,
              "threads": arguments.threads, "rounds": arguments.rounds, "torch": network.TORCH}
    notes = ["Loading the rows and compilation by torch.compile are not counted."]
    if simulated:
        notes.append("The trials are simulated: they compare trainers and support no claim about robots.")
    return figures.suite(ROOT, [figures.report("train_peer", inputs, made, notes)])


def table(arguments, results):
    ours = middle([result["duration_s"] / result["epochs"] for result in results["joulebus"]])
    lines = ["| trainer | s per epoch | to joulebus | epochs | whole run, s | R² | MAE, W |", "|---|---|---|---|---|---|---|"]
    for peer, runs in results.items():
        epoch_s = middle([result["duration_s"] / result["epochs"] for result in runs])
        duration_s = middle([result["duration_s"] for result in runs])
        last = runs[-1]
        shown = [figures.shown(value) for value in (epoch_s, epoch_s / ours)]
        lines.append(f"| {peer} | {shown[0]} | {shown[1]} | {last['epochs']} | {figures.shown(duration_s)} | "
                     f"{last['r2']:.4f} | {last['mae_w']:.4f} |")
    rows = results["joulebus"][0]["rows"]
    source = "recordings" if arguments.training else "simulated trials"
    return "\n".join([*lines, "", f"{rows[0]} rows to learn from, {rows[1]} to stop by, {rows[2]} to score, of {source}; "
                      f"{arguments.threads} threads; medians of {arguments.rounds} runs."])


def parse():
    path = pathlib.Path
    parser = argparse.ArgumentParser(description=__doc__.split("\n\n")[0], epilog="With --training, name the other two as well.")
    parser.add_argument("--peers", type=lambda text: text.split(","), default=PEERS, metavar="NAME,…", help=", ".join(PEERS))
    parser.add_argument("--training", type=path, nargs="+", metavar="FILE", help="recordings to learn from")
    parser.add_argument("--validation", type=path, nargs="+", metavar="FILE", help="recordings to stop by")
    parser.add_argument("--held-out", type=path, nargs="+", metavar="FILE", help="recordings to score")
    parser.add_argument("--joulebus", type=path, metavar="FILE", help="a program that is built already")
    parser.add_argument("--epochs", type=int, default=100)
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--threads", type=int, default=2)
    parser.add_argument("--seed", type=int, default=7)
    parser.add_argument("--quick", action="store_true", help="a smoke test: three epochs, one round")
    parser.add_argument("--install", action="store_true", help="only install and build")
    home = path(os.environ.get("JOULEBUS_PEERS", ROOT / "target/peers"))
    parser.add_argument("--directory", type=path, default=home, help="of the environment")
    parser.add_argument("--json", type=path, default=ROOT / "bench-results/train_peer.json")
    parser.add_argument("--as", dest="be", help=argparse.SUPPRESS)
    parser.add_argument("--rows", type=path, help=argparse.SUPPRESS)
    return parser.parse_args()


def main():
    arguments = parse()
    if arguments.be:
        return be_peer(arguments)
    unknown = set(arguments.peers) - set(PEERS)
    if unknown:
        sys.exit(f"no such peer: {', '.join(sorted(unknown))}. There are {', '.join(PEERS)}")
    named = [arguments.training, arguments.validation, arguments.held_out]
    if any(named) and not all(named):
        sys.exit("--training, --validation and --held-out belong together")
    if arguments.quick:
        arguments.epochs, arguments.rounds = 3, 1
    directory = arguments.directory.resolve()
    directory.mkdir(parents=True, exist_ok=True)
    joulebus = program(arguments)
    python = network.in_environment(directory, ["pytorch"])
    if arguments.install:
        return None
    place = directory / "training"
    place.mkdir(exist_ok=True)
    files = parts(arguments, joulebus, place)
    wanted = ["joulebus", *(peer for peer in PEERS if peer in arguments.peers and peer != "joulebus")]
    results = {}
    for number in range(arguments.rounds):
        for peer in wanted:
            network.say(f"round {number + 1} of {arguments.rounds}: {peer}")
            if peer == "joulebus":
                result = train_ours(arguments, joulebus, place, files)
            else:
                result = train_theirs(arguments, python, peer, place)
            if result:
                results.setdefault(peer, []).append(result)
    figures.write(arguments.json, to_suite(arguments, results))
    print(table(arguments, results))
    network.say(f"written: {arguments.json}")


if __name__ == "__main__":
    main()
