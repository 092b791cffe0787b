#!/usr/bin/env python3
"""Reads an archive of `joulebus export` with DuckDB, Polars, pandas, pyarrow and Dask, and compares it with what was exported.

Nothing of joulebus is used to read. EXPECTED is JSON. `levels` is what the archive's folders name, `mixed` whether some of that is
unknown, which pandas and Dask do not read; `kinds` has the columns' types; `trials` is a list: `file` below the archive,
`rows`, `fleet`, `day` and `robot` of its partition or null, and `columns`, each a list with one text for each row: the
number's 64 bits as an unsigned integer for a DOUBLE, the number itself for others, null where there is none. Compared for
every file: the columns' names and types, every value to the bit, and what the partition says; of the whole archive, as
each reader opens a folder, the sum of its rows and its partitions.

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

PINNED = ["duckdb==2.0.0", "polars==2.1.0", "pandas==3.1.1", "pyarrow==26.0.1", "dask[dataframe]==2026.8.0"]
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


def compare(reader, file, wanted, kinds, columns, values_of):
    where = f"{reader}, {file}"
    if columns != kinds:
        raise Differs(f"{where}: columns {columns}; wanted {kinds}")
    for name, kind in kinds.items():
        found = texts(values_of(name), kind)
        if found != wanted["columns"][name]:
            pairs = zip(found, wanted["columns"][name])
            at = next((at for at, (one, other) in enumerate(pairs) if one != other), "their number")
            raise Differs(f"{where}: {name} differs, first at {at}")


def by_duckdb(archive, expected):
    import duckdb

    base, levels = duckdb.connect(), expected["levels"]
    for trial in expected["trials"]:
        plain = base.execute("SELECT * FROM read_parquet(?, hive_partitioning = false)", [str(archive / trial["file"])])
        names = [(column[0], str(column[1])) for column in plain.description]
        rows = plain.fetchall()
        place = {name: at for at, (name, _) in enumerate(names)}
        compare("DuckDB", trial["file"], trial, expected["kinds"], dict(names), lambda name: [row[place[name]] for row in rows])
    read = "FROM read_parquet(?, hive_partitioning = true, hive_types_autocast = false)"
    all_files = [str(archive / "**" / "*.parquet")]
    parts = base.execute(f"SELECT DISTINCT {', '.join(levels)} {read}", all_files).fetchall() if levels else [()]
    count = base.execute(f"SELECT count(*) {read}", all_files).fetchone()[0]
    return count, set(parts), duckdb.__version__


def by_polars(archive, expected):
    import polars

    named, levels = {"Float64": "DOUBLE", "UInt32": "UINTEGER", "UInt64": "UBIGINT", "Int64": "BIGINT"}, expected["levels"]
    for trial in expected["trials"]:
        frame = polars.read_parquet(archive / trial["file"], hive_partitioning=False)
        columns = {name: named.get(str(kind), str(kind)) for name, kind in frame.schema.items()}
        compare("Polars", trial["file"], trial, expected["kinds"], columns, lambda name: frame[name].to_list())
    frame = polars.read_parquet(archive / "**" / "*.parquet", hive_partitioning=True, try_parse_hive_dates=False)
    found = {tuple(None if value is None else str(value) for value in row) for row in frame.select(levels).rows()} if levels else {()}
    return frame.height, found, polars.__version__


def by_pyarrow(archive, expected):
    import pyarrow
    import pyarrow.dataset
    import pyarrow.parquet

    named = {"double": "DOUBLE", "uint32": "UINTEGER", "uint64": "UBIGINT", "int64": "BIGINT"}
    for trial in expected["trials"]:
        table = pyarrow.parquet.ParquetFile(archive / trial["file"]).read()
        columns = {field.name: named.get(str(field.type), str(field.type)) for field in table.schema}
        compare("pyarrow", trial["file"], trial, expected["kinds"], columns, lambda name: table[name].to_pylist())
    table = pyarrow.dataset.dataset(archive, partitioning="hive").to_table()
    return table.num_rows, partitions(table.to_pandas(), expected["levels"]), pyarrow.__version__


def by_pandas(archive, expected):
    import pandas

    of_frames("pandas", lambda path: pandas.read_parquet(path, dtype_backend="pyarrow"), archive, expected)
    frame = pandas.read_parquet(archive)
    return len(frame), partitions(frame, expected["levels"]), pandas.__version__


def by_dask(archive, expected):
    import dask
    import dask.dataframe

    read = lambda path: dask.dataframe.read_parquet(path, dtype_backend="pyarrow").compute()
    of_frames("Dask", read, archive, expected)
    frame = dask.dataframe.read_parquet(archive).compute()
    return len(frame), partitions(frame, expected["levels"]), dask.__version__


def of_frames(reader, read, archive, expected):
    """Compares the files that `read` gives as frames of pandas."""
    named = {"double": "DOUBLE", "uint32": "UINTEGER", "uint64": "UBIGINT", "int64": "BIGINT"}
    for trial in expected["trials"]:
        # By another name: the folders of the archive would be columns.
        alone = archive.parent / "alone.parquet"
        alone.write_bytes((archive / trial["file"]).read_bytes())
        frame = read(str(alone))
        columns = {name: named.get(str(kind).split("[")[0], str(kind)) for name, kind in frame.dtypes.items()}
        values = lambda name: frame[name].array.__arrow_array__().to_pylist()
        compare(reader, trial["file"], trial, expected["kinds"], columns, values)


def partitions(frame, levels):
    """The distinct partitions of a frame of pandas, as text."""
    if not levels:
        return {()}
    rows = frame[levels].astype(object).drop_duplicates()
    return {tuple(None if value != value or value is None else str(value) for value in row) for row in rows.itertuples(index=False)}


def main():
    asked = arguments()
    if os.environ.get("JOULEBUS_READ_ARCHIVE") != "1":
        return inside(asked.venv)
    expected = json.loads(asked.expected.read_text())
    trials = expected["trials"]
    rows = sum(trial["rows"] for trial in trials)
    wanted = {tuple(trial[level] for level in expected["levels"]) for trial in trials}
    readers = [("DuckDB", by_duckdb), ("Polars", by_polars), ("pyarrow", by_pyarrow)]
    if not expected["mixed"]:
        readers += [("pandas", by_pandas), ("Dask", by_dask)]
    try:
        for name, read in readers:
            found, parts, version = read(asked.archive, expected)
            if found != rows:
                raise Differs(f"{name}: {found} rows in the archive; wanted {rows}")
            if parts != wanted:
                raise Differs(f"{name}: the partitions are {parts}; wanted {wanted}")
            print(f"{name} {version}: {len(trials)} trials, {rows} rows, equal")
    except Differs as error:
        print(f"differs: {error}", file=sys.stderr)
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
