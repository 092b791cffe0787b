"""The environment of the scripts that compare with NumPy, PyTorch and ONNX Runtime.

It is made in target/model-parity when it is first needed: pinned versions from PyPI, some 7 GB
unpacked, because PyPI has PyTorch for Linux only with CUDA's libraries. Where
https://download.pytorch.org can be reached, its build without CUDA is taken instead (1 GB).
"""
import os
import pathlib
import subprocess
import sys
import venv

ROOT = pathlib.Path(__file__).resolve().parent.parent
HOME = pathlib.Path(os.environ.get("JOULEBUS_PARITY_HOME", ROOT / "target/model-parity"))
PINNED = ["numpy==2.3.4", "onnx==1.19.1", "onnxruntime==1.23.2"]
TORCH = "torch==2.9.1"
CPU_INDEX = "https://download.pytorch.org/whl/cpu"


def inside():
    """Continues in the environment; makes it if it is not there. Needs Python 3.11 to 3.13."""
    python = HOME / "bin/python"
    if pathlib.Path(sys.prefix).resolve() == HOME.resolve():
        return
    ready = HOME / "ready"
    if not ready.exists():
        print(f"making {HOME}", flush=True)
        venv.create(HOME, with_pip=True)
        pip = [str(python), "-m", "pip", "install", "--quiet", "--disable-pip-version-check"]
        subprocess.run(pip + PINNED, check=True)
        without_cuda = subprocess.run(pip + [TORCH + "+cpu", "--extra-index-url", CPU_INDEX])
        if without_cuda.returncode:
            subprocess.run(pip + [TORCH], check=True)
        ready.touch()
    os.execv(str(python), [str(python), *sys.argv])
