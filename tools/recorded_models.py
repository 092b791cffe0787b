#!/usr/bin/env python3
"""Makes the models of real robots again: configs/models/{husky,husky-grass,robotino,rover}.safetensors.

    python3 tools/recorded_models.py                  # from ../shared/data; ends with 1 if one has other bytes
    python3 tools/recorded_models.py DATA --write     # replaces them, after a change of the trainer or its format
    python3 tools/recorded_models.py --program P      # with this joulebus-lab instead of a release build

DATA has the folders robotino, borealtc_husky, husky_commanded and ase_rover. Their recipes are configs/recipes/NAME.toml, and
docs/reference/models.md has their cards. Standard library only.
"""
import argparse
import pathlib
import subprocess
import sys
import tempfile

ROOT = pathlib.Path(__file__).resolve().parent.parent
# Folder of each, and which of its recordings.
DATA = {
    "robotino": ("robotino", "*.csv.gz"),
    "husky": ("borealtc_husky", "*.csv.gz"),
    "husky-grass": ("husky_commanded", "wetgrass_*.csv.gz"),
    "rover": ("ase_rover", "*.csv.gz"),
}


def program(given):
    """The lab's program, built if none is given."""
    if given is None:
        subprocess.run(["cargo", "build", "--release", "--locked", "-p", "joulebus-lab"], cwd=ROOT, check=True)
        given = ROOT / "target/release/joulebus-lab"
    return pathlib.Path(given).resolve()


def arguments(description):
    parser = argparse.ArgumentParser(description=description, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("data", nargs="?", type=pathlib.Path, default=ROOT.parent / "shared/data")
    parser.add_argument("--program", type=pathlib.Path, help="a built joulebus-lab")
    return parser


def main():
    parser = arguments(__doc__)
    parser.add_argument("--write", action="store_true", help="replace the models")
    given = parser.parse_args()
    lab, others = program(given.program), 0
    with tempfile.TemporaryDirectory() as place:
        for name, (folder, pattern) in DATA.items():
            made = pathlib.Path(place) / f"{name}.safetensors"
            recipe = ROOT / f"configs/recipes/{name}.toml"
            files = sorted((given.data / folder).glob(pattern))
            subprocess.run([lab, "train", "trials", *files, "--recipe", recipe, "--out", made],
                           check=True, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
            shipped = ROOT / f"configs/models/{name}.safetensors"
            same = shipped.exists() and shipped.read_bytes() == made.read_bytes()
            print(f"{name}: {'the same bytes' if same else 'other bytes'}")
            if given.write:
                shipped.write_bytes(made.read_bytes())
            others += not same
    sys.exit(bool(others and not given.write))


if __name__ == "__main__":
    main()
