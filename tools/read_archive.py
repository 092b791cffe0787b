#!/usr/bin/env python3
"""Reads an archive of `joulebus export` with DuckDB and with Polars, and compares it with what was exported.

Nothing of joulebus is used to read. EXPECTED is JSON, a list of trials: `file` below the archive, `rows`, `fleet`, `day` and
`robot` of its partition or null, and `columns`, each a list with one text for each row: the number's 64 bits as an
unsigned integer for a DOUBLE, the number itself for others, null where there is none. Compared by both, for every
file: the columns' names and types, every value to the bit, and what the partition says; of the whole archive, the
sum of its rows.

The packages go into an environment of their own, ~/.cache/joulebus/read-archive (or --venv).

    tools/read_archive.py ARCHIVE EXPECTED
"""

import argparse
import json
import os
import pathlib
import struct
import subprocess
import sys

from pinned_environment import python_of

PINNED = ["duckdb==2.0.0", "polars==2.1.0"]
# What the script ends with where the packages cannot be had.
NO_PACKAGES = 77


def arguments():
    words = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    words.add_argument("archive", type=pathlib.Path)
    words.add_argument("expected", type=pathlib.Path)
    words.add_argument(
        "--venv",
        type=pathlib.Path,
        default=pathlib.Path.home() / ".cache" / "joulebus" / "read-archive",
        help="where the packages are installed",
    )
    return words.parse_args()


def inside(place):
    """Runs this script again in an environment that has the packages."""
    try:
        python = python_of(place, PINNED)
    except subprocess.CalledProcessError as error:
        print(f"skipped: {' and '.join(PINNED)} cannot be installed: {error}", file=sys.stderr)
        return NO_PACKAGES
    environment = dict(os.environ, JOULEBUS_READ_ARCHIVE="1")
    return subprocess.run([python, __file__, *sys.argv[1:]], env=environment, check=False).returncode


class Differs(Exception):
    """What a reader found is not what was exported."""


def texts(values, kind):
    """Values as EXPECTED has them."""
    if kind == "DOUBLE":
        return [None if value is None else str(struct.unpack("<Q", struct.pack("<d", value))[0]) for value in values]
    return [None if value is None else str(value) for value in values]


def compare(reader, file, wanted, kinds, columns, values_of, partition):
    where = f"{reader}, {file}"
    if columns != kinds:
        raise Differs(f"{where}: columns {columns}; wanted {kinds}")
    for name, kind in kinds.items():
        found = texts(values_of(name), kind)
        if found != wanted["columns"][name]:
            pairs = zip(found, wanted["columns"][name])
            at = next((at for at, (one, other) in enumerate(pairs) if one != other), "their number")
            raise Differs(f"{where}: {name} differs, first at {at}")
    asked = {key: wanted[key] for key in ("fleet", "day", "robot")}
    if partition != asked:
        raise Differs(f"{where}: its partition says {partition}; wanted {asked}")


def by_duckdb(archive, trials, kinds):
    import duckdb

    base = duckdb.connect()
    all_files = str(archive / "**" / "*.parquet")
    for trial in trials:
        file = str(archive / trial["file"])
        plain = base.execute("SELECT * FROM read_parquet(?, hive_partitioning = false)", [file])
        names = [(column[0], str(column[1])) for column in plain.description]
        rows = plain.fetchall()
        columns = dict(names)
        place = {name: at for at, (name, _) in enumerate(names)}
        query = "SELECT DISTINCT fleet, day, robot FROM read_parquet(?, hive_partitioning = true, hive_types_autocast = false)"
        found = base.execute(query, [file]).fetchall()
        if len(found) != 1:
            raise Differs(f"DuckDB, {file}: {len(found)} partitions")
        partition = dict(zip(("fleet", "day", "robot"), found[0]))
        compare("DuckDB", file, trial, kinds, columns, lambda name: [row[place[name]] for row in rows], partition)
    count = base.execute("SELECT count(*) FROM read_parquet(?, hive_partitioning = true)", [all_files]).fetchone()[0]
    return count, duckdb.__version__


def by_polars(archive, trials, kinds):
    import polars

    named = {"Float64": "DOUBLE", "UInt32": "UINTEGER", "UInt64": "UBIGINT", "Int64": "BIGINT"}
    for trial in trials:
        file = str(archive / trial["file"])
        frame = polars.read_parquet(file, hive_partitioning=False)
        columns = {name: named.get(str(kind), str(kind)) for name, kind in frame.schema.items()}
        parts = polars.read_parquet(file, hive_partitioning=True, try_parse_hive_dates=False)
        partition = {}
        for key in ("fleet", "day", "robot"):
            values = parts[key].unique().to_list()
            if len(values) != 1:
                raise Differs(f"Polars, {file}: {key} has {values}")
            partition[key] = None if values[0] is None else str(values[0])
        compare("Polars", file, trial, kinds, columns, lambda name: frame[name].to_list(), partition)
    lazy = polars.scan_parquet(str(archive / "**" / "*.parquet"), hive_partitioning=False)
    return lazy.select(polars.len()).collect().item(), polars.__version__


def main():
    asked = arguments()
    if os.environ.get("JOULEBUS_READ_ARCHIVE") != "1":
        return inside(asked.venv)
    expected = json.loads(asked.expected.read_text())
    trials, kinds = expected["trials"], expected["kinds"]
    rows = sum(trial["rows"] for trial in trials)
    try:
        for name, read in (("DuckDB", by_duckdb), ("Polars", by_polars)):
            found, version = read(asked.archive, trials, kinds)
            if found != rows:
                raise Differs(f"{name}: {found} rows in the archive; wanted {rows}")
            print(f"{name} {version}: {len(trials)} trials, {rows} rows, equal")
    except Differs as error:
        print(f"differs: {error}", file=sys.stderr)
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
