//! Recordings of other programs, written for tests.

use std::collections::BTreeMap;
use std::io::Cursor;

use byteorder::LittleEndian;
use cdr_encoding::to_vec;
use joulebus_capture_format::import::{ImportError, Imported, Mapping, import};
use joulebus_ros_messages::{
    BatteryState, Header, Odometry, Pose, PoseWithCovariance, Quaternion, Time, Twist,
    TwistWithCovariance, Vector3,
};
use mcap::WriteOptions;
use mcap::records::MessageHeader;
use serde::Serialize;

/// Definition of a battery message, as in a recording.
pub(crate) const BATTERY: &str = "std_msgs/Header header\nfloat32 voltage # V\nfloat32 temperature\nfloat32 current\nfloat32 charge\n\
    float32 capacity\nfloat32 design_capacity\nfloat32 percentage\nuint8 power_supply_status\n\
    uint8 POWER_SUPPLY_STATUS_UNKNOWN = 0\nuint8 power_supply_health\nuint8 power_supply_technology\nbool present\n\
    float32[] cell_voltage\nfloat32[] cell_temperature\nstring location\nstring serial_number\n\
    ================\nMSG: std_msgs/Header\nbuiltin_interfaces/Time stamp\nstring frame_id\n";

/// A file of channels and messages: topic, type, encoding, definition; topic, time, data.
pub(crate) struct Bag {
    writer: mcap::Writer<Cursor<Vec<u8>>>,
    channels: BTreeMap<String, u16>,
}

impl Bag {
    pub(crate) fn new() -> Self {
        Self::with(WriteOptions::new())
    }

    pub(crate) fn with(options: WriteOptions) -> Self {
        let writer = options.profile("ros2").create(Cursor::new(Vec::new())).unwrap();
        Self { writer, channels: BTreeMap::new() }
    }

    pub(crate) fn channel(
        &mut self,
        topic: &str,
        type_name: &str,
        encoding: &str,
        definition: &str,
    ) {
        self.channel_with(topic, type_name, encoding, definition, &BTreeMap::new());
    }

    /// One with metadata of its own, as another publisher of the topic has.
    pub(crate) fn channel_with(
        &mut self,
        topic: &str,
        type_name: &str,
        encoding: &str,
        definition: &str,
        metadata: &BTreeMap<String, String>,
    ) {
        let schema = self.writer.add_schema(type_name, "ros2msg", definition.as_bytes()).unwrap();
        let id = self.writer.add_channel(schema, topic, encoding, metadata).unwrap();
        self.channels.insert(topic.to_owned(), id);
    }

    pub(crate) fn raw(&mut self, topic: &str, time_ns: u64, data: &[u8]) {
        let header = MessageHeader {
            channel_id: self.channels[topic],
            sequence: 0,
            log_time: time_ns,
            publish_time: time_ns - 5,
        };
        self.writer.write_to_known_channel(&header, data).unwrap();
    }

    pub(crate) fn message(&mut self, topic: &str, time_ns: u64, message: &impl Serialize) {
        let mut data = vec![0, 1, 0, 0];
        data.extend(to_vec::<_, LittleEndian>(message).unwrap());
        self.raw(topic, time_ns, &data);
    }

    pub(crate) fn import(self, mapping: &str) -> Result<Imported, ImportError> {
        let mapping: Mapping = mapping.parse().unwrap();
        import(Cursor::new(self.bytes()), "bag", &mapping)
    }

    pub(crate) fn bytes(mut self) -> Vec<u8> {
        self.writer.finish().unwrap();
        self.writer.into_inner().into_inner()
    }
}

pub(crate) fn header(time_ns: u64) -> Header {
    let stamp = Time {
        sec: i32::try_from(time_ns / 1_000_000_000).unwrap(),
        nanosec: u32::try_from(time_ns % 1_000_000_000).unwrap(),
    };
    let frame_id = "base".to_owned();
    Header { stamp, frame_id }
}

pub(crate) fn battery(time_ns: u64, voltage: f32, current: f32) -> BatteryState {
    BatteryState {
        header: header(time_ns),
        voltage,
        temperature: f32::NAN,
        current,
        charge: 1.0,
        capacity: 2.0,
        design_capacity: 3.0,
        percentage: 0.5,
        power_supply_status: 2,
        power_supply_health: 1,
        power_supply_technology: 2,
        present: true,
        cell_voltage: vec![3.7, 3.8, 3.9],
        cell_temperature: Vec::new(),
        location: "slot".to_owned(),
        serial_number: "42".to_owned(),
    }
}

fn vector(x: f64, y: f64, z: f64) -> Vector3 {
    Vector3 { x, y, z }
}

pub(crate) fn twist(v_mps: f64, omega_radps: f64) -> Twist {
    Twist { linear: vector(v_mps, 0.0, 0.0), angular: vector(0.0, 0.0, omega_radps) }
}

pub(crate) fn odometry(time_ns: u64, x: f64, yaw_rad: f64, v_mps: f64) -> Odometry {
    let orientation =
        Quaternion { x: 0.0, y: 0.0, z: (yaw_rad / 2.0).sin(), w: (yaw_rad / 2.0).cos() };
    Odometry {
        header: header(time_ns),
        child_frame_id: "base_link".to_owned(),
        pose: PoseWithCovariance {
            pose: Pose { position: vector(x, 2.0 * x, 0.0), orientation },
            covariance: [[0.1; 6]; 6],
        },
        twist: TwistWithCovariance { twist: twist(v_mps, 0.25), covariance: [[0.2; 6]; 6] },
    }
}
