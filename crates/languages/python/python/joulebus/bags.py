"""Bags of ROS 1 and ROS 2 as trials: rosbags writes them as MCAP, which the program's import reads."""
from __future__ import annotations

import contextlib
import io
import os
import tempfile
import warnings
from collections.abc import Sequence
from pathlib import Path

from . import _native
from ._optional import lab, needed
from .recordings import RecordingDamaged, Trial, _reading

_BATTERY = "sensor_msgs/msg/BatteryState"
#: The types that the import reads.
_TYPES = (_BATTERY, "geometry_msgs/msg/Twist", "geometry_msgs/msg/TwistStamped", "nav_msgs/msg/Odometry")
_ENDINGS = (".bag", ".db3", ".mcap")


def read_bag(
    path: str | os.PathLike[str],
    *,
    mapping: str | os.PathLike[str] | None = None,
    current: str | None = None,
    accept: Sequence[str] = (),
) -> list[Trial]:
    """The trials of a bag, as ``joulebus import`` has them: one for each robot, and for each run of the recorder's clock.

    path:    a bag of ROS 2 (a folder, ``.db3`` or ``.mcap``) or ROS 1 (``.bag``, or a folder of them), compressed or not
    mapping: a file of ``joulebus import --mapping``. Without it every battery topic is a robot
    current: sign of the current: ``discharge-negative``, as in ROS (default), or ``discharge-positive``
    accept:  findings to let through, as of `read_trials`

    Bags other than ``.mcap`` files need the package rosbags. Messages that could not be used are named in a warning
    `RecordingDamaged`.
    """
    native, bag = lab("bags"), Path(path)
    if not bag.exists():
        raise FileNotFoundError(f"{bag}: there is no such file or folder")
    with tempfile.TemporaryDirectory(prefix="joulebus-") as folder:
        file = bag if bag.is_file() and bag.suffix.lower() == ".mcap" else _converted(bag, Path(folder) / "bag")
        found, lost = native.read_bag(file, (bag, bag.stem), mapping, _reading(None, current, accept))
    if lost is not None:
        warnings.warn(f"{bag}: some of it could not be used\n{lost}", RecordingDamaged, stacklevel=2)
    several = len(found) > 1
    return [Trial(columns, robot, f"{bag} {robot}" if several else str(bag)) for robot, columns in found]


def _converted(bag: Path, into: Path) -> Path:
    """A file of MCAP with the messages that the import reads."""
    highlevel, convert = needed("rosbags.highlevel", "bags"), needed("rosbags.convert", "bags")
    typesys = needed("rosbags.typesys", "bags")
    # Of bags without definitions. These types are the same in all of ROS 2.
    usual = typesys.get_typestore(typesys.Stores.ROS2_HUMBLE)
    files = _files(bag)
    try:
        with highlevel.AnyReader(files, default_typestore=usual) as reader:
            types = sorted({connection.msgtype for connection in reader.connections})
        # It prints what it does.
        with contextlib.redirect_stdout(io.StringIO()):
            if _BATTERY in types:
                convert.convert(files, into, "mcap", 9, None, "none", usual, usual, (), (), (), _TYPES)
    except Exception as error:
        # Of a damaged bag its readers raise errors of many kinds.
        raise _native.RecordingError(f"{bag}: rosbags cannot read it: {error or type(error).__name__}") from error
    if _BATTERY not in types:
        raise _native.RecordingError(f"{bag}: no topic has the type {_BATTERY}, found: {', '.join(types) or 'no topic'}")
    [file] = into.glob("*.mcap")
    return file


def _files(bag: Path) -> list[Path]:
    """The bag's folder or file, or the files of a folder without a list of them, after a killed recorder."""
    files = [bag]
    if bag.is_dir() and not (bag / "metadata.yaml").exists():
        files = sorted(file for file in bag.iterdir() if file.suffix.lower() in _ENDINGS)
        if len({file.suffix.lower() for file in files}) != 1:
            raise _native.RecordingError(
                f"{bag}: has no metadata.yaml, and no files of one kind ({', '.join(_ENDINGS)}), found:"
                f" {', '.join(file.name for file in files) or 'none'}"
            )
    elif bag.is_file() and bag.suffix.lower() not in _ENDINGS:
        raise _native.RecordingError(f"{bag}: allowed are a folder, and files of {', '.join(_ENDINGS)}")
    for file in sorted(bag.iterdir()) if bag.is_dir() else [bag]:
        log = file.with_name(file.name + "-wal")
        if log.exists() and log.stat().st_size > 0:
            raise _native.RecordingError(
                f"{file}: messages are in {log.name}, since its recorder was killed, and rosbags does not read them."
                f" Bring them in first: sqlite3 {file.name} 'PRAGMA wal_checkpoint(TRUNCATE)'"
            )
    return files
