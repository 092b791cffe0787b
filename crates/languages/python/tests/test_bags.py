"""Bags of ROS, written by rosbags, are read as the program's import reads them."""
from __future__ import annotations

import csv
import sqlite3
from pathlib import Path

import joulebus
import numpy as np
import pytest

pytest.importorskip("rosbags")

from rosbags.rosbag1 import Writer as Writer1
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore

STEPS = 120
STORE = get_typestore(Stores.ROS2_JAZZY)
OLD = get_typestore(Stores.ROS1_NOETIC)
MODES = [(plugin, mode) for plugin in ("SQLITE3", "MCAP") for mode in (None, "MESSAGE", "FILE", "STORAGE")]


def messages(store, sign=-1.0):
    """Topic, time in ns, type and message of a robot that drives ever faster."""
    types, empty = store.types, np.array([], np.float32)
    # Of ROS 1 the header also counts.
    more = {} if store is STORE else {"seq": 0}
    temperature = {"temperature": float("nan")} if "temperature" in types["sensor_msgs/msg/BatteryState"].__dataclass_fields__ else {}

    def header(ns):
        stamp = types["builtin_interfaces/msg/Time"](sec=ns // 10**9, nanosec=ns % 10**9)
        return types["std_msgs/msg/Header"](stamp=stamp, frame_id="base", **more)

    def vector(x, z):
        return types["geometry_msgs/msg/Vector3"](x=float(x), y=0.0, z=float(z))

    for step in range(STEPS):
        ns = 1_700_000_000 * 10**9 + step * 10**8
        twist = types["geometry_msgs/msg/Twist"](linear=vector(0.001 * step, 0), angular=vector(0, 0.5))
        stamped = types["geometry_msgs/msg/TwistStamped"](header=header(ns - 10**7), twist=twist)
        state = types["sensor_msgs/msg/BatteryState"](
            header=header(ns), voltage=11.5, current=sign * (2.0 + 0.1 * np.sin(step)), charge=1.0, capacity=2.0,
            design_capacity=2.0, percentage=0.75, power_supply_status=2, power_supply_health=1, power_supply_technology=3,
            present=True, cell_voltage=empty, location="", serial_number="", **temperature,
            **({"cell_temperature": empty} if "cell_temperature" in types["sensor_msgs/msg/BatteryState"].__dataclass_fields__ else {}),
        )
        yield "/r7/cmd_vel", ns - 10**7, "geometry_msgs/msg/TwistStamped", stamped
        yield "/r7/battery", ns, "sensor_msgs/msg/BatteryState", state
        yield "/chatter", ns, "std_msgs/msg/String", types["std_msgs/msg/String"](data="hello")


def write(path: Path, plugin: str, mode: str | None, **more) -> Path:
    with Writer(path, version=9, storage_plugin=StoragePlugin[plugin]) if mode is None else compressed(path, plugin, mode) as writer:
        connections = {}
        for topic, ns, kind, message in messages(STORE, **more):
            if topic not in connections:
                connections[topic] = writer.add_connection(topic, kind, typestore=STORE)
            writer.write(connections[topic], ns, STORE.serialize_cdr(message, kind))
    return path


def compressed(path, plugin, mode):
    writer = Writer(path, version=9, storage_plugin=StoragePlugin[plugin])
    writer.set_compression(CompressionMode[mode], CompressionFormat.ZSTD)
    return writer


def write_old(path: Path, compression: str | None) -> Path:
    writer = Writer1(path)
    if compression:
        writer.set_compression(Writer1.CompressionFormat[compression])
    with writer:
        connections = {}
        for topic, ns, kind, message in messages(OLD):
            if topic not in connections:
                connections[topic] = writer.add_connection(topic, kind, typestore=OLD)
            writer.write(connections[topic], ns, OLD.serialize_ros1(message, kind))
    return path


def same(found, expected):
    [found], [expected] = found, expected
    assert found.robot == expected.robot and found.columns.keys() == expected.columns.keys()
    for name, values in expected.columns.items():
        assert found.columns[name].tobytes() == values.tobytes(), name


@pytest.fixture(scope="module")
def plain(tmp_path_factory):
    """A bag in MCAP as a whole folder, and its trials."""
    bag = write(tmp_path_factory.mktemp("plain") / "bag", "MCAP", None)
    return bag, joulebus.read_bag(bag)


def test_a_bag_has_the_values_that_were_written_and_those_of_the_programs_import(plain, tmp_path, run):
    bag, [trial] = plain
    assert len(trial) == STEPS and trial.robot == "r7" and trial.name == str(bag)
    # The current is negative while discharging.
    assert np.allclose(trial.columns["power_w"], 11.5 * (2.0 + 0.1 * np.sin(np.arange(STEPS))), rtol=1e-6)
    assert np.allclose(trial.columns["v_mps"], 0.001 * np.arange(STEPS), atol=1e-12)
    [file] = bag.glob("*.mcap")
    same(joulebus.read_bag(file), [trial])
    run("import", file, "-o", tmp_path / "out.csv")
    with open(tmp_path / "out.csv", newline="") as rows:
        rows = list(csv.DictReader(rows))
    for column, name in (("power_mW", "power_w"), ("voltage_mV", "voltage_v"), ("current_mA", "current_a")):
        written = np.array([float(row[column]) for row in rows])
        assert (1000.0 * trial.columns[name]).tobytes() == written.tobytes(), name


@pytest.mark.parametrize(("plugin", "mode"), MODES)
def test_bags_of_every_storage_and_compression_have_the_same_trials(plugin, mode, plain, tmp_path):
    if mode == "STORAGE" and plugin != "MCAP":
        pytest.skip("SQLite compresses nothing itself")
    bag = write(tmp_path / "bag", plugin, mode)
    same(joulebus.read_bag(bag), plain[1])
    if mode == "FILE":
        return
    [file] = [file for file in bag.iterdir() if file.suffix in (".db3", ".mcap")]
    same(joulebus.read_bag(file), plain[1])
    # Its recorder was killed before it wrote the list of files.
    (bag / "metadata.yaml").unlink()
    same(joulebus.read_bag(bag), plain[1])


@pytest.mark.parametrize("compression", [None, "BZ2", "LZ4"])
def test_bags_of_ros_1_have_the_same_trials(compression, plain, tmp_path):
    (tmp_path / "bags").mkdir()
    bag = write_old(tmp_path / "bags" / "run.bag", compression)
    for given in (bag, str(bag), bag.parent):
        same(joulebus.read_bag(given), plain[1])


def test_a_bag_without_definitions_as_older_ros_writes_it_is_read(plain, tmp_path):
    bag = write(tmp_path / "bag", "SQLITE3", None)
    [file] = bag.glob("*.db3")
    base = sqlite3.connect(file)
    base.execute("DROP TABLE message_definitions")
    base.execute("UPDATE schema SET schema_version = 3")
    base.commit()
    base.close()
    same(joulebus.read_bag(file), plain[1])


def test_mapping_and_sign_are_those_of_the_import(plain, tmp_path):
    bag = write(tmp_path / "bag", "SQLITE3", None, sign=1.0)
    with pytest.raises(joulebus.RecordingError, match="(?s)sign"):
        joulebus.read_bag(bag)
    same(joulebus.read_bag(bag, current="discharge-positive"), plain[1])
    assert (joulebus.read_bag(bag, accept="sign")[0].columns["power_w"] < 0.0).any()
    mapping = tmp_path / "mapping.toml"
    mapping.write_text('[[robot]]\nname = "seven"\nbattery = "/r7/battery"\ncurrent = "discharge-positive"\nvoltage_unit_v = 0.5\n')
    [trial] = joulebus.read_bag(bag, mapping=mapping)
    assert trial.robot == "seven" and np.allclose(trial.columns["voltage_v"], 5.75)
    mapping.write_text("tme = 1")
    with pytest.raises(ValueError, match="(?s)mapping.toml: .*tme"):
        joulebus.read_bag(bag, mapping=mapping)
    with pytest.raises(ValueError, match="current is 'up'|current is \"up\""):
        joulebus.read_bag(bag, current="up")


def test_what_is_no_bag_is_refused_with_its_name(plain, tmp_path):
    with pytest.raises(FileNotFoundError, match="missing.db3"):
        joulebus.read_bag(tmp_path / "missing.db3")
    for name, contents in [("a.db3", b""), ("b.db3", b"SQLite format 3\0" + bytes(4096)), ("c.bag", b"#ROSBAG V2.0\n"), ("d.mcap", b"hello"), ("e.txt", b"")]:
        (tmp_path / name).write_bytes(contents)
        with pytest.raises(joulebus.RecordingError, match=name):
            joulebus.read_bag(tmp_path / name)
    (tmp_path / "empty").mkdir()
    with pytest.raises(joulebus.RecordingError, match="empty: has no metadata.yaml, and no files of one kind.*none"):
        joulebus.read_bag(tmp_path / "empty")
    bag = tmp_path / "talk"
    with Writer(bag, version=9, storage_plugin=StoragePlugin.SQLITE3) as writer:
        talk = writer.add_connection("/chatter", "std_msgs/msg/String", typestore=STORE)
        writer.write(talk, 1, STORE.serialize_cdr(STORE.types["std_msgs/msg/String"](data="x"), "std_msgs/msg/String"))
    with pytest.raises(joulebus.RecordingError, match="talk: no topic has the type sensor_msgs/msg/BatteryState, found: std_msgs/msg/String"):
        joulebus.read_bag(bag)


def test_messages_that_only_a_log_of_sqlite_has_are_not_lost_silently(tmp_path):
    bag = write(tmp_path / "bag", "SQLITE3", None)
    [file] = bag.glob("*.db3")
    file.with_name(file.name + "-wal").write_bytes(b"log")
    for given in (bag, file):
        with pytest.raises(joulebus.RecordingError, match="wal_checkpoint"):
            joulebus.read_bag(given)


def test_nothing_is_printed_and_no_file_stays(tmp_path, monkeypatch, capfd):
    bag, temporary = write_old(tmp_path / "run.bag", None), tmp_path / "tmp"
    temporary.mkdir()
    monkeypatch.setattr("tempfile.tempdir", str(temporary))
    joulebus.read_bag(bag)
    assert capfd.readouterr() == ("", "")
    assert list(temporary.iterdir()) == []
