//! Bags that another program wrote: the package `rosbags` of PyPI.

use std::fs;
use std::process::Command;

use crate::bag::{joulebus, text};

/// Writes the bag `argv[1]`; `argv[2]`: how messages are compressed, if they are.
const WRITER: &str = r#"
import sys
from pathlib import Path

import numpy as np
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore

store = get_typestore(Stores.ROS2_JAZZY)
T = store.types
def header(ns):
    stamp = T["builtin_interfaces/msg/Time"](sec=ns // 10**9, nanosec=ns % 10**9)
    return T["std_msgs/msg/Header"](stamp=stamp, frame_id="base")
def vector(x, z):
    return T["geometry_msgs/msg/Vector3"](x=float(x), y=0.0, z=float(z))
plugin = StoragePlugin.MCAP if sys.argv[2] == "mcap" else StoragePlugin.SQLITE3
writer = Writer(Path(sys.argv[1]), version=9, storage_plugin=plugin)
if sys.argv[2] == "message":
    writer.set_compression(CompressionMode.MESSAGE, CompressionFormat.ZSTD)
if sys.argv[2] == "file":
    writer.set_compression(CompressionMode.FILE, CompressionFormat.ZSTD)
with writer:
    battery = writer.add_connection("/r7/battery", "sensor_msgs/msg/BatteryState", typestore=store)
    command = writer.add_connection("/r7/cmd_vel", "geometry_msgs/msg/TwistStamped", typestore=store)
    text = writer.add_connection("/chatter", "std_msgs/msg/String", typestore=store)
    for k in range(40):
        ns = 1_700_000_000 * 10**9 + k * 10**8
        twist = T["geometry_msgs/msg/Twist"](linear=vector(0.01 * k, 0), angular=vector(0, 0.5))
        stamped = T["geometry_msgs/msg/TwistStamped"](header=header(ns - 10**7), twist=twist)
        empty = np.array([], dtype=np.float32)
        state = T["sensor_msgs/msg/BatteryState"](
            header=header(ns), voltage=11.5, temperature=float("nan"), current=-2.0 - 0.1 * k, charge=1.0,
            capacity=2.0, design_capacity=2.0, percentage=0.75, power_supply_status=2, power_supply_health=1,
            power_supply_technology=3, present=True, cell_voltage=empty, cell_temperature=empty, location="",
            serial_number="")
        for connection, message, at in ((command, stamped, ns - 10**7), (battery, state, ns)):
            writer.write(connection, at, store.serialize_cdr(message, connection.msgtype))
        writer.write(text, ns, store.serialize_cdr(T["std_msgs/msg/String"](data="hello"), text.msgtype))
"#;

/// A Python with the package. `None` is logged.
fn python() -> Option<String> {
    let named = std::env::var("JOULEBUS_PYTHON").ok();
    let python = named.unwrap_or_else(|| "python3".to_owned());
    let works = Command::new(&python).args(["-c", "import rosbags.rosbag2, numpy"]).output();
    if works.is_ok_and(|output| output.status.success()) {
        return Some(python);
    }
    assert_ne!(std::env::var("CI").as_deref(), Ok("true"), "{python} lacks rosbags");
    eprintln!("SKIPPED: {python} lacks rosbags (JOULEBUS_PYTHON=$(tools/python.sh) has it)");
    None
}

#[test]
fn bags_of_another_writer_are_imported_with_its_values() {
    let Some(python) = python() else {
        return;
    };
    let place = tempfile::tempdir().unwrap();
    for how in ["plain", "message", "mcap"] {
        let (bag, out) = (place.path().join(how), place.path().join(format!("{how}.csv")));
        let mut write = Command::new(&python);
        let written = write.args(["-c", WRITER, &text(&bag), how]).output().unwrap();
        assert!(written.status.success(), "{how}: {written:?}");
        let ended = joulebus(&["import", &text(&bag), "-o", &text(&out)]);
        assert_eq!(ended.status.code(), Some(0), "{how}: {ended:?}");
        let message = String::from_utf8(ended.stdout).unwrap();
        assert!(message.contains("40 rows of r7"), "{how}: {message}");
        let table = fs::read_to_string(&out).unwrap();
        let mut lines = table.lines();
        let heads: Vec<&str> = lines.next().unwrap().split(',').collect();
        let column = |name: &str| heads.iter().position(|head| *head == name).unwrap();
        let (power, v) = (column("power_mW"), column("v_cmd_mps"));
        let mut rows = 0;
        for (line, k) in lines.zip(0..) {
            let values: Vec<f64> =
                line.split(',').map(|cell| cell.parse().unwrap_or(f64::NAN)).collect();
            let power_mw = 11_500.0 * (2.0 + 0.1 * f64::from(k));
            assert!((values[power] - power_mw).abs() < 0.01, "{how}: {line}");
            assert!((values[v] - 0.01 * f64::from(k)).abs() < 1e-9, "{how}: {line}");
            rows += 1;
        }
        assert_eq!(rows, 40, "{how}");
    }
    // A file that is compressed as a whole is named, with the remedy.
    let bag = place.path().join("file");
    let mut write = Command::new(&python);
    let written = write.args(["-c", WRITER, &text(&bag), "file"]).output().unwrap();
    assert!(written.status.success(), "{written:?}");
    let ended = joulebus(&["import", &text(&bag), "-o", &text(&place.path().join("f.csv"))]);
    assert_eq!(ended.status.code(), Some(1), "{ended:?}");
    let message = String::from_utf8(ended.stderr).unwrap();
    assert!(message.contains("zstd -d"), "{message}");
}
