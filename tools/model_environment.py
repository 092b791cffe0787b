"""The environment of the scripts that compare with NumPy, PyTorch and ONNX Runtime.

It is made in target/model-parity when it is first needed: pinned versions from PyPI, 5 GB unpacked, because PyPI has
PyTorch for Linux only with CUDA's libraries. Where PyTorch's own index can be reached, its build without CUDA is taken (1 GB).
"""
import os
import pathlib
import sys

from pinned_environment import TORCH, python_of

ROOT = pathlib.Path(__file__).resolve().parent.parent
HOME = pathlib.Path(os.environ.get("JOULEBUS_PARITY_HOME", ROOT / "target/model-parity"))
# The newest that Python 3.11 has.
PINNED = ["numpy==2.4.6", "onnx==1.23.2", "onnxruntime==1.32.0", "pytest==9.2.0", "safetensors==0.8.0", TORCH]


def inside():
    """Continues in the environment. Makes it if it is not there. Needs Python 3.11 or later."""
    if pathlib.Path(sys.prefix).resolve() != HOME.resolve():
        python = python_of(HOME, PINNED)
        os.execv(python, [python, *sys.argv])
