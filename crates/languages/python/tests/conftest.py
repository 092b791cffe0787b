"""What the tests share: the program under test, and models."""
from __future__ import annotations

import os
import signal
import subprocess
from pathlib import Path

import numpy as np
import pytest

# A shell that starts the tests in the background lets them ignore SIGINT, and their processes would
# inherit that.
signal.signal(signal.SIGINT, signal.default_int_handler)

ROOT = Path(__file__).resolve().parents[4]


def needed(what: str) -> None:
    """Skips aloud without something. With CI=true that is a failure."""
    message = f"skipped: no {what}"
    if os.environ.get("CI") == "true":
        pytest.fail(message)
    pytest.skip(message)


@pytest.fixture(scope="session")
def program() -> Path:
    """The `joulebus` program of this repository: JOULEBUS_PROGRAM, else that in target/debug."""
    named = os.environ.get("JOULEBUS_PROGRAM")
    path = Path(named) if named else ROOT / "target/debug/joulebus"
    if not path.is_file():
        needed(f"program {path}: cargo build -p joulebus -p joulebus-lab, or set JOULEBUS_PROGRAM")
    return path


@pytest.fixture(scope="session")
def run(program: Path):
    """Runs the program and returns its standard output."""

    def run_program(*arguments: object) -> str:
        command = [str(program), *map(str, arguments)]
        done = subprocess.run(command, capture_output=True, text=True, check=False)
        assert done.returncode == 0, f"{command}: {done.returncode}\n{done.stderr}"
        return done.stdout

    return run_program


def model_file(name: str) -> Path:
    return ROOT / "configs/models" / f"{name}.safetensors"


def bits(values) -> np.ndarray:
    """Single-precision numbers as integers: NaN equals NaN, and 0 differs from -0."""
    return np.ascontiguousarray(values, np.float32).view(np.uint32)


def rows(count: int, seed: int = 0, width: int = 11) -> np.ndarray:
    """Plausible rows of features."""
    noise = np.random.default_rng(seed)
    found = np.empty((count, width), np.float32)
    found[:, 0] = noise.uniform(-0.15, 0.16, count)
    found[:, 1] = noise.uniform(-3.1, 3.1, count)
    found[:, 2:4] = noise.normal(0.0, 0.5, (count, 2))
    found[:, 4:6] = np.abs(found[:, :2])
    found[:, 6:11] = noise.uniform(3.0, 5.0, (count, 5))
    if width == 13:
        found[:, 11] = noise.integers(0, 3, count)
        found[:, 12] = found[:, 11] == 2
    return found
