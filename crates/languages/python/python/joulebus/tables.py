"""Tables in memory, of pandas, Polars, SciPy or NumPy, as trials: by the program's reader of CSV."""
from __future__ import annotations

import csv
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from datetime import date, time, timedelta
from decimal import Decimal
from typing import Any

import numpy as np

from ._optional import lab
from .recordings import Trial, _reading, _trials

#: Rows that are text at a time.
_AT_ONCE = 1 << 16
_REMEDY = "numbers, times or the robot's name. Select the columns first"


def read_table(
    frame: Any,
    *,
    columns: dict[str, str] | None = None,
    current: str | None = None,
    accept: Sequence[str] = (),
    name: str = "table",
) -> list[Trial]:
    """The trials of a table in memory: one for each robot, as `read_trials` has them of a CSV with these columns.

    frame:   a DataFrame of pandas or Polars, a dict of arrays (such as `scipy.io.loadmat` returns), or a structured array of
             NumPy. The index of a DataFrame is a column if it has a name or times
    columns: columns whose names joulebus does not know: ``{"power": "load_W"}``
    current: sign of the current: ``discharge-positive`` (default) or ``discharge-negative``
    accept:  findings to let through, as of `read_trials`
    name:    of the trials, and in errors

    Names state quantities and units, as in a CSV: ``power_W``, ``current_mA``, ``time_ms``.

        joulebus.read_table(pandas.read_parquet("run.parquet"))
        joulebus.read_table(scipy.io.loadmat("run.mat"), columns={"time_s": "t", "power_W": "P"})
    """
    native, reading = lab("tables"), _reading(columns, current, accept)
    found = [(str(column), _array(str(column), values)) for column, values in _columns(frame)]
    if not found:
        raise ValueError(f"{name} has no columns, allowed: {_REMEDY}")
    lengths = {column: len(values) for column, values in found}
    if len(set(lengths.values())) > 1:
        told = ", ".join(f"{column} {rows}" for column, rows in lengths.items())
        raise ValueError(f"{name} has columns of several lengths: {told}, allowed: one length. Select the columns first")
    with tempfile.NamedTemporaryFile("w", encoding="utf-8", newline="", prefix="joulebus-", suffix=".csv") as file:
        # A name may begin like a comment.
        csv.writer(file, lineterminator="\n", quoting=csv.QUOTE_ALL).writerow([column for column, _ in found])
        rows = csv.writer(file, lineterminator="\n")
        for start in range(0, len(found[0][1]), _AT_ONCE):
            part = slice(start, start + _AT_ONCE)
            rows.writerows(zip(*(_cells(column, values[part], start) for column, values in found)))
        file.flush()
        return _trials(native.read_trials(file.name, reading, name), name)


def _columns(frame: Any) -> Iterator[tuple[Any, Any]]:
    """The columns with their names."""
    if isinstance(frame, Mapping):
        # What SciPy says of a file, beside its variables.
        of_file = ("__header__", "__version__", "__globals__", "__function_workspace__")
        yield from ((column, values) for column, values in frame.items() if column not in of_file)
    elif isinstance(frame, np.ndarray) and frame.dtype.names:
        yield from ((column, frame[column]) for column in frame.dtype.names)
    elif hasattr(frame, "iloc") and hasattr(frame, "columns"):
        index, names = frame.index, list(frame.columns)
        for level, column in enumerate(index.names):
            values = index.get_level_values(level)
            if column is None and getattr(values.dtype, "kind", "") in "mM":
                column = "timestamp"
            if column is not None and column not in names:
                yield column, values
        yield from ((column, frame.iloc[:, place]) for place, column in enumerate(names))
    elif hasattr(frame, "get_columns"):
        yield from ((series.name, series) for series in frame.get_columns())
    else:
        remedy = "collect() it first" if hasattr(frame, "collect") else "make one of these"
        raise TypeError(
            f"the table is a {type(frame).__name__}, allowed: a DataFrame of pandas or Polars, a dict of arrays,"
            f" a structured array. {remedy}"
        )


def _array(column: str, values: Any) -> np.ndarray:
    """The values of a column in one dimension."""
    dtype = getattr(values, "dtype", None)
    if isinstance(values, np.ma.MaskedArray):
        nothing = np.array("NaT", values.dtype) if values.dtype.kind in "mM" else None
        found = values.data.astype(values.dtype if nothing is not None else object)
        found[np.ma.getmaskarray(values)] = nothing
    elif hasattr(values, "null_count") and dtype.is_integer() and values.null_count():
        # Polars makes floats of them, which are not exact.
        found = np.array(values.to_list(), object)
    else:
        found = np.asarray(values)
    # MATLAB has matrices of one row or one column.
    if found.ndim == 2 and 1 in found.shape:
        found = found.ravel()
    if found.ndim != 1 or found.dtype.kind not in "biufMmUSO":
        raise TypeError(f"column {column} has shape {found.shape} and type {found.dtype}, allowed: {_REMEDY}")
    if found.dtype.kind == "S":
        found = np.array([text.decode("utf-8", "replace") for text in found.tolist()], object)
    return found


def _cells(column: str, values: np.ndarray, start: int) -> list[Any]:
    """Values as the reader of CSV takes them, to the bit. `start`: the first row's number."""
    if values.dtype.kind == "f":
        return values.astype(np.float64).tolist()
    if values.dtype.kind == "b":
        return values.astype(np.uint8).tolist()
    if values.dtype.kind == "M":
        return np.datetime_as_string(values.astype("datetime64[ns]")).tolist()
    if values.dtype.kind == "m":
        return [_difference(value) for value in values]
    if values.dtype.kind != "O":
        return values.tolist()
    # A row of missing numbers is no empty line.
    missing = "" if any(isinstance(value, str) for value in values) else "nan"
    return [_cell(column, start + row, value, missing) for row, value in enumerate(values, 1)]


def _cell(column: str, row: int, value: Any, missing: str) -> Any:
    if value is None or type(value).__name__ in ("NAType", "NaTType"):
        return missing
    if isinstance(value, (bool, np.bool_)):
        return int(value)
    if isinstance(value, (float, np.floating)):
        return float(value)
    if isinstance(value, (str, int, np.integer, Decimal)):
        return value
    if isinstance(value, (date, time)):
        return value.isoformat()
    if isinstance(value, (timedelta, np.timedelta64)):
        return _difference(np.timedelta64(value))
    if isinstance(value, np.datetime64):
        return str(value.astype("datetime64[ns]"))
    raise TypeError(f"column {column}, row {row}: found a {type(value).__name__}, allowed: {_REMEDY}")


def _difference(value: np.timedelta64) -> str:
    """A difference of times, as pandas writes it."""
    if np.isnat(value):
        return "NaT"
    days, rest = divmod(int(value.astype("timedelta64[ns]").astype(np.int64)), 86_400_000_000_000)
    seconds, ns = divmod(rest, 1_000_000_000)
    return f"{days} days {seconds // 3600:02}:{seconds // 60 % 60:02}:{seconds % 60:02}.{ns:09}"
