"""An environment of Python with exactly the packages that a tool names."""

import subprocess
import sys
import venv


def python_of(place, pinned):
    """The interpreter of the environment at `place`, made anew if it has other packages."""
    python, installed = place / "bin" / "python", place / "installed.txt"
    wanted = "\n".join(pinned)
    if not installed.exists() or installed.read_text() != wanted:
        venv.create(place, with_pip=True, clear=True)
        pip = [python, "-m", "pip", "install", "--quiet", "--disable-pip-version-check", *pinned]
        subprocess.run(pip, check=True, stdout=sys.stderr)
        installed.write_text(wanted)
    return str(python)
