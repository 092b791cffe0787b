//! Bags as rosbag2 writes them, and the programs that read them.

use std::ops::Range;
use std::path::Path;
use std::process::{Command, Output};

use byteorder::LittleEndian;
use cdr_encoding::to_vec;
use joulebus_ros_messages::{
    BatteryState, Header, Odometry, Pose, PoseWithCovariance, Quaternion, Time, Twist,
    TwistWithCovariance, Vector3,
};
use joulebus_testkit::lab_beside;
use rusqlite::{Connection, params};
use serde::Serialize;

/// The tables of rosbag2 since Iron.
const TABLES: &str = "\
    CREATE TABLE schema(schema_version INTEGER PRIMARY KEY, ros_distro TEXT NOT NULL);\
    CREATE TABLE metadata(id INTEGER PRIMARY KEY, metadata_version INTEGER NOT NULL, metadata TEXT NOT NULL);\
    CREATE TABLE topics(id INTEGER PRIMARY KEY, name TEXT NOT NULL, type TEXT NOT NULL, \
        serialization_format TEXT NOT NULL, offered_qos_profiles TEXT NOT NULL, type_description_hash TEXT NOT NULL);\
    CREATE TABLE message_definitions(id INTEGER PRIMARY KEY, topic_type TEXT NOT NULL, encoding TEXT NOT NULL, \
        encoded_message_definition TEXT NOT NULL, type_description_hash TEXT NOT NULL);\
    CREATE TABLE messages(id INTEGER PRIMARY KEY, topic_id INTEGER NOT NULL, timestamp INTEGER NOT NULL, \
        data BLOB NOT NULL);\
    CREATE INDEX timestamp_idx ON messages (timestamp ASC);\
    INSERT INTO schema VALUES (4, 'jazzy');";
const TWIST: &str = "Vector3 linear\nVector3 angular\n\
    ================\nMSG: geometry_msgs/Vector3\nfloat64 x\nfloat64 y\nfloat64 z\n";
const TOPICS: [(&str, &str); 4] = [
    ("/r1/battery", "sensor_msgs/msg/BatteryState"),
    ("/r1/cmd_vel", "geometry_msgs/msg/Twist"),
    ("/r1/odom", "nav_msgs/msg/Odometry"),
    ("/r1/camera", "sensor_msgs/msg/Image"),
];

/// When step `step` of a drive is, Unix ns.
pub(crate) fn time_ns(step: u32) -> u64 {
    1_700_000_000_000_000_000 + u64::from(step) * 100_000_000
}

/// A bag that is written.
pub(crate) struct Bag {
    pub(crate) sqlite: Connection,
    /// Each message by itself, as `--compression-mode message` does.
    pub(crate) compress: bool,
}

impl Bag {
    pub(crate) fn create(path: &Path) -> Self {
        let sqlite = Connection::open(path).unwrap();
        sqlite.execute_batch(TABLES).unwrap();
        for ((name, type_name), id) in TOPICS.into_iter().zip(1..) {
            let sql = "INSERT INTO topics VALUES (?1, ?2, ?3, 'cdr', '', '')";
            sqlite.execute(sql, params![id, name, type_name]).unwrap();
        }
        let sql = "INSERT INTO message_definitions VALUES (1, 'geometry_msgs/msg/Twist', 'ros2msg', ?1, '')";
        sqlite.execute(sql, params![TWIST]).unwrap();
        Self { sqlite, compress: false }
    }

    pub(crate) fn run(&mut self, sql: &str) {
        self.sqlite.execute_batch(sql).unwrap();
    }

    pub(crate) fn message(&self, topic: i64, time_ns: u64, message: &impl Serialize) {
        let mut data = vec![0, 1, 0, 0];
        data.extend(to_vec::<_, LittleEndian>(message).unwrap());
        if self.compress {
            data = zstd::bulk::compress(&data, 3).unwrap();
        }
        self.raw(topic, time_ns, &data);
    }

    pub(crate) fn raw(&self, topic: i64, time_ns: u64, data: &[u8]) {
        let sql = "INSERT INTO messages (timestamp, topic_id, data) VALUES (?1, ?2, ?3)";
        let time_ns = i64::try_from(time_ns).unwrap();
        self.sqlite.execute(sql, params![time_ns, topic, data]).unwrap();
    }

    /// Ten steps a second of a robot that drives ever faster.
    pub(crate) fn drive(&mut self, steps: Range<u32>) {
        self.run("BEGIN");
        for step in steps {
            let time_ns = time_ns(step);
            self.message(2, time_ns - 20_000_000, &twist(f64::from(step) * 0.01));
            self.message(3, time_ns - 10_000_000, &odometry(time_ns - 10_000_000, step));
            self.message(1, time_ns, &battery(time_ns, step));
            self.raw(4, time_ns, &[7; 3_000]);
        }
        self.run("COMMIT");
    }

    pub(crate) fn close(self) {
        self.sqlite.close().unwrap();
    }
}

fn header(time_ns: u64) -> Header {
    Header {
        stamp: Time {
            sec: (time_ns / 1_000_000_000) as i32,
            nanosec: (time_ns % 1_000_000_000) as u32,
        },
        frame_id: "base".to_owned(),
    }
}

fn battery(time_ns: u64, step: u32) -> BatteryState {
    BatteryState {
        header: header(time_ns),
        voltage: 12.0,
        temperature: f32::NAN,
        current: -0.5 - step as f32 * 0.01,
        charge: f32::NAN,
        capacity: f32::NAN,
        design_capacity: f32::NAN,
        percentage: 0.5,
        power_supply_status: 2,
        power_supply_health: 1,
        power_supply_technology: 2,
        present: true,
        cell_voltage: vec![4.0; 3],
        cell_temperature: Vec::new(),
        location: String::new(),
        serial_number: "1".to_owned(),
    }
}

fn twist(v_mps: f64) -> Twist {
    let vector = |x, z| Vector3 { x, y: 0.0, z };
    Twist { linear: vector(v_mps, 0.0), angular: vector(0.0, 0.1) }
}

fn odometry(time_ns: u64, step: u32) -> Odometry {
    Odometry {
        header: header(time_ns),
        child_frame_id: "base_link".to_owned(),
        pose: PoseWithCovariance {
            pose: Pose {
                position: Vector3 { x: f64::from(step), y: 0.0, z: 0.0 },
                orientation: Quaternion { x: 0.0, y: 0.0, z: 0.0, w: 1.0 },
            },
            covariance: [[0.0; 6]; 6],
        },
        twist: TwistWithCovariance { twist: twist(0.1), covariance: [[0.0; 6]; 6] },
    }
}

pub(crate) fn text(path: &Path) -> String {
    path.display().to_string()
}

/// Runs `joulebus-rosbag`.
pub(crate) fn convert(bag: &Path, out: &Path) -> Output {
    let mut command = Command::new(env!("CARGO_BIN_EXE_joulebus-rosbag"));
    command.arg(bag).arg("-o").arg(out).output().unwrap()
}

/// Runs the program of the same build that `joulebus import` runs.
pub(crate) fn joulebus(words: &[&str]) -> Output {
    let program = lab_beside(env!("CARGO_BIN_EXE_joulebus-rosbag"));
    Command::new(program).args(words).output().unwrap()
}
