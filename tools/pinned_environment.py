"""Environments of Python with exactly the packages that a tool names."""

import subprocess
import sys
import venv

TORCH = "torch==2.15.0"
TORCH_CPU_INDEX = "https://download.pytorch.org/whl/cpu"
# Libraries that the package of PyPI is linked with, without the compiler for GPUs.
TORCH_NEEDS = [
    "filelock", "fsspec", "jinja2", "networkx", "setuptools", "sympy", "typing-extensions",
    "cuda-toolkit[cublas,cudart,cufft,cufile,cupti,cusparse,nvjitlink,nvrtc,nvtx]==13.2.2",
    "nvidia-cudnn-cu13==9.26.0.51", "nvidia-cusparselt-cu13==0.8.1", "nvidia-nccl-cu13==2.30.7",
    "nvidia-nvshmem-cu13==3.7.2",
]


def python_of(place, pinned):
    """The interpreter of the environment at `place`, made anew if it has other packages."""
    python, installed = place / "bin" / "python", place / "installed.txt"
    wanted = "\n".join(pinned)
    if not installed.exists() or installed.read_text() != wanted:
        venv.create(place, with_pip=True, clear=True)
        pip = [python, "-m", "pip", "install", "--quiet", "--disable-pip-version-check"]
        subprocess.run([*pip, *(package for package in pinned if package != TORCH)], check=True, stdout=sys.stderr)
        if TORCH in pinned and not install_torch(pip):
            sys.exit(f"{TORCH} cannot be installed")
        installed.write_text(wanted)
    return str(python)


def install_torch(install):
    """PyTorch from the index of CPU wheels, or else from PyPI with the libraries that it needs to start."""
    run = lambda *command: subprocess.run(command, stdout=sys.stderr).returncode == 0
    there = subprocess.run([*install, "--retries", "0", "--timeout", "20", TORCH, "--index-url", TORCH_CPU_INDEX],
                           stdout=sys.stderr, stderr=subprocess.DEVNULL)
    return there.returncode == 0 or (run(*install, *TORCH_NEEDS) and run(*install, "--no-deps", TORCH))
