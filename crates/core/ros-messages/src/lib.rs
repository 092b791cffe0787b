#![doc = include_str!("../README.md")]
#![forbid(unsafe_code)]

mod declare;
mod hashes;
mod joulebus;
mod published;

use cdr_encoding::from_bytes;
use serde::{Deserialize, Serialize};

use declare::{Defined, last_part, messages};
pub use hashes::type_hash;
pub use joulebus::{
    AcknowledgeRequest, AcknowledgeResponse, Answer, Outlook, VERDICTS, WhatIfRequest,
    WhatIfResponse, definitions,
};
pub use published::{DiagnosticArray, DiagnosticStatus, Float64, KeyValue, encode};

messages! {
    /// Time since 1970.
    #[derive(Copy, Eq, Default)]
    pub struct Time: "builtin_interfaces/msg/Time" {
        /// s.
        pub sec: i32,
        /// ns.
        pub nanosec: u32,
    }

    /// `rosgraph_msgs/Clock`.
    #[derive(Copy, Eq)]
    pub struct Clock: "rosgraph_msgs/msg/Clock" {
        /// Simulated time.
        pub clock: Time,
    }

    /// `std_msgs/Header`.
    #[derive(Eq)]
    pub struct Header: "std_msgs/msg/Header" {
        /// Measurement time.
        pub stamp: Time,
        /// Its frame of reference.
        pub frame_id: String,
    }

    /// `geometry_msgs/Vector3` and `geometry_msgs/Point`.
    #[derive(Copy)]
    #[expect(missing_docs, reason = "three coordinates")]
    pub struct Vector3: "geometry_msgs/msg/Vector3" {
        pub x: f64,
        pub y: f64,
        pub z: f64,
    }

    /// `geometry_msgs/Quaternion`.
    #[derive(Copy)]
    #[expect(missing_docs, reason = "four coordinates")]
    pub struct Quaternion: "geometry_msgs/msg/Quaternion" {
        pub x: f64,
        pub y: f64,
        pub z: f64,
        pub w: f64,
    }

    /// `geometry_msgs/Pose`.
    #[derive(Copy)]
    pub struct Pose: "geometry_msgs/msg/Pose" {
        /// m.
        pub position: Vector3 as "Point",
        /// A unit quaternion.
        pub orientation: Quaternion,
    }

    /// `geometry_msgs/Twist`.
    #[derive(Copy)]
    pub struct Twist: "geometry_msgs/msg/Twist" {
        /// m/s.
        pub linear: Vector3,
        /// rad/s.
        pub angular: Vector3,
    }

    /// `geometry_msgs/TwistStamped`.
    #[expect(missing_docs, reason = "named as in the definition")]
    pub struct TwistStamped: "geometry_msgs/msg/TwistStamped" {
        pub header: Header,
        pub twist: Twist,
    }

    /// `geometry_msgs/PoseWithCovariance`.
    #[expect(missing_docs, reason = "named as in the definition")]
    pub struct PoseWithCovariance: "geometry_msgs/msg/PoseWithCovariance" {
        pub pose: Pose,
        pub covariance: Covariance as "float64[36]",
    }

    /// `geometry_msgs/TwistWithCovariance`.
    #[expect(missing_docs, reason = "named as in the definition")]
    pub struct TwistWithCovariance: "geometry_msgs/msg/TwistWithCovariance" {
        pub twist: Twist,
        pub covariance: Covariance as "float64[36]",
    }

    /// `nav_msgs/Odometry`.
    #[expect(missing_docs, reason = "named as in the definition")]
    pub struct Odometry: "nav_msgs/msg/Odometry" {
        pub header: Header,
        pub child_frame_id: String,
        pub pose: PoseWithCovariance,
        pub twist: TwistWithCovariance,
    }

    /// `sensor_msgs/BatteryState`.
    pub struct BatteryState: "sensor_msgs/msg/BatteryState" {
        /// Measurement time.
        pub header: Header,
        /// Voltage, V.
        pub voltage: f32,
        /// Temperature, °C.
        pub temperature: f32,
        /// Current, A. Negative while discharging, by definition.
        pub current: f32,
        /// Charge, Ah.
        pub charge: f32,
        /// Capacity, Ah.
        pub capacity: f32,
        /// Design capacity, Ah.
        pub design_capacity: f32,
        /// State of charge, 0 to 1.
        pub percentage: f32,
        /// 1 charging, 2 discharging, 3 not charging, 4 full.
        pub power_supply_status: u8,
        /// See the definition.
        pub power_supply_health: u8,
        /// See the definition.
        pub power_supply_technology: u8,
        /// Whether there is a battery.
        pub present: bool,
        /// Cell voltages, V.
        pub cell_voltage: Vec<f32>,
        /// Cell temperatures, °C.
        pub cell_temperature: Vec<f32>,
        /// Location in the robot.
        pub location: String,
        /// Serial number.
        pub serial_number: String,
    }

    /// `spot_msgs/BatteryState`.
    pub struct SpotBattery: "spot_msgs/msg/BatteryState" {
        /// Measurement time.
        pub header: Header,
        /// The battery's name.
        pub identifier: String,
        /// State of charge, %.
        pub charge_percentage: f64,
        /// Time until it is empty.
        pub estimated_runtime: Time as "Duration",
        /// Current, A. Negative while discharging.
        pub current: f64,
        /// Voltage, V.
        pub voltage: f64,
        /// °C.
        pub temperatures: Vec<f64>,
        /// 0 unknown, 1 missing, 2 charging, 3 discharging, 4 booting.
        pub status: u8,
    }

    /// `spot_msgs/BatteryStateArray`.
    #[expect(missing_docs, reason = "named as in the definition")]
    pub struct BatteryStateArray: "spot_msgs/msg/BatteryStateArray" {
        pub battery_states: Vec<SpotBattery>,
    }

    /// `std_msgs/Bool`.
    #[derive(Copy, Eq)]
    #[expect(missing_docs, reason = "named as in the definition")]
    pub struct Bool: "std_msgs/msg/Bool" {
        pub data: bool,
    }
}

impl Time {
    /// Unix ns. `None` for 0, an unset stamp, and before 1970.
    pub fn unix_ns(self) -> Option<u64> {
        let sec = u64::try_from(self.sec).ok()?;
        let ns = sec * 1_000_000_000 + u64::from(self.nanosec);
        (ns > 0).then_some(ns)
    }
}

impl Clock {
    /// Its name in ROS 2.
    pub const NAME: &str = "rosgraph_msgs/msg/Clock";

    /// Simulated ns from 0. `None` for what is no time.
    pub fn sim_ns(self) -> Option<u64> {
        let sec = u64::try_from(self.clock.sec).ok().filter(|_| self.clock.nanosec < 1_000_000_000);
        sec.map(|sec| sec * 1_000_000_000 + u64::from(self.clock.nanosec))
    }
}

impl Quaternion {
    /// Yaw, rad. NaN if it is not a rotation.
    pub fn yaw_rad(&self) -> f64 {
        let norm = self.x * self.x + self.y * self.y + self.z * self.z + self.w * self.w;
        if norm.is_nan() || norm <= 1e-12 {
            return f64::NAN;
        }
        let sine = 2.0 * (self.w * self.z + self.x * self.y) / norm;
        let cosine = 1.0 - 2.0 * (self.y * self.y + self.z * self.z) / norm;
        sine.atan2(cosine)
    }
}

/// Six by six, row by row.
pub type Covariance = [[f64; 6]; 6];

impl BatteryStateArray {
    /// The packs, as `sensor_msgs` has them.
    pub fn packs(&self) -> impl Iterator<Item = BatteryState> + '_ {
        self.battery_states.iter().map(|pack| BatteryState {
            header: pack.header.clone(),
            voltage: pack.voltage as f32,
            temperature: f32::NAN,
            current: pack.current as f32,
            charge: f32::NAN,
            capacity: f32::NAN,
            design_capacity: f32::NAN,
            percentage: (pack.charge_percentage / 100.0) as f32,
            power_supply_status: match pack.status {
                2 => 1,
                3 => 2,
                _ => 0,
            },
            power_supply_health: 0,
            power_supply_technology: 0,
            present: pack.status != 1,
            cell_voltage: Vec::new(),
            cell_temperature: Vec::new(),
            location: String::new(),
            serial_number: pack.identifier.clone(),
        })
    }
}

/// A supported message type.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum RosType {
    /// [`BatteryState`].
    BatteryState,
    /// [`BatteryStateArray`].
    BatteryStateArray,
    /// [`Twist`].
    Twist,
    /// [`TwistStamped`].
    TwistStamped,
    /// [`Odometry`].
    Odometry,
    /// [`Bool`].
    Bool,
}

/// A decoded message.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[serde(untagged)]
#[expect(missing_docs, reason = "named as their types")]
pub enum Message {
    BatteryState(Box<BatteryState>),
    BatteryStateArray(BatteryStateArray),
    Twist(Twist),
    TwistStamped(TwistStamped),
    Odometry(Box<Odometry>),
    Bool(Bool),
}

/// Errors of decoding a channel or a message.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
#[allow(missing_docs)] // The messages name the fields.
pub enum RosError {
    /// An unsupported type.
    #[error(
        "type {found:?}, supported are sensor_msgs/msg/BatteryState, geometry_msgs/msg/Twist, \
         geometry_msgs/msg/TwistStamped, nav_msgs/msg/Odometry, std_msgs/msg/Bool and \
         spot_msgs/msg/BatteryStateArray"
    )]
    Type { found: String },
    /// Another encoding of messages or definitions.
    #[error("encoding {found:?}, supported is {allowed:?}")]
    Encoding { found: String, allowed: &'static str },
    /// The definition in the file has other fields.
    #[error("its definition has {found:?} where {expected:?} is expected")]
    Definition { found: String, expected: String },
    /// The bytes are not plain CDR.
    #[error("begins with {found:02x?}. Plain CDR begins with 00 00 or 00 01")]
    Encapsulation { found: Vec<u8> },
    /// The bytes do not match the definition.
    #[error("{0}")]
    Bytes(String),
}

impl RosType {
    /// The type of a channel's messages.
    ///
    /// # Errors
    /// [`RosError`]: another type, another encoding, or a definition with other fields.
    pub fn new(
        message_encoding: &str,
        type_name: &str,
        schema_encoding: &str,
        definition: &[u8],
    ) -> Result<Self, RosError> {
        let kind =
            Self::named(type_name).ok_or_else(|| RosError::Type { found: type_name.to_owned() })?;
        if message_encoding != "cdr" {
            return Err(RosError::Encoding { found: message_encoding.to_owned(), allowed: "cdr" });
        }
        // Recorders that found no definition leave it empty. The length of every message must still
        // match.
        if definition.is_empty() {
            return Ok(kind);
        }
        if schema_encoding != "ros2msg" {
            return Err(RosError::Encoding {
                found: schema_encoding.to_owned(),
                allowed: "ros2msg",
            });
        }
        check_definition(&String::from_utf8_lossy(definition), kind)?;
        Ok(kind)
    }

    /// The type of this name, with `msg/` (ROS 2) or without.
    fn named(type_name: &str) -> Option<Self> {
        Some(match type_name.replacen("/msg/", "/", 1).as_str() {
            "sensor_msgs/BatteryState" => Self::BatteryState,
            "spot_msgs/BatteryStateArray" => Self::BatteryStateArray,
            "geometry_msgs/Twist" => Self::Twist,
            "geometry_msgs/TwistStamped" => Self::TwistStamped,
            "nav_msgs/Odometry" => Self::Odometry,
            "std_msgs/Bool" => Self::Bool,
            _ => return None,
        })
    }

    /// Decodes a message.
    ///
    /// # Errors
    /// [`RosError`].
    pub fn decode(self, data: &[u8]) -> Result<Message, RosError> {
        Ok(match self {
            Self::BatteryState => Message::BatteryState(Box::new(decode(data)?)),
            Self::BatteryStateArray => Message::BatteryStateArray(decode(data)?),
            Self::Twist => Message::Twist(decode(data)?),
            Self::TwistStamped => Message::TwistStamped(decode(data)?),
            Self::Odometry => Message::Odometry(Box::new(decode(data)?)),
            Self::Bool => Message::Bool(decode(data)?),
        })
    }

    /// Name and fields of the type and of nested types, `type name` each, as far as they determine
    /// the layout.
    fn definition(self) -> Vec<(&'static str, Vec<String>)> {
        fn of<T: Defined>() -> (&'static str, Vec<String>) {
            (last_part(T::FILE), T::fields())
        }
        let (header, vector, twist) = (of::<Header>, of::<Vector3>, of::<Twist>);
        match self {
            Self::BatteryState => vec![of::<BatteryState>(), header()],
            Self::BatteryStateArray => {
                vec![of::<BatteryStateArray>(), of::<SpotBattery>(), header()]
            }
            Self::Bool => vec![of::<Bool>()],
            Self::Twist => vec![twist(), vector()],
            Self::TwistStamped => vec![of::<TwistStamped>(), header(), twist(), vector()],
            Self::Odometry => vec![
                of::<Odometry>(),
                header(),
                of::<PoseWithCovariance>(),
                of::<Pose>(),
                ("Point", vector().1),
                of::<Quaternion>(),
                of::<TwistWithCovariance>(),
                twist(),
                vector(),
            ],
        }
    }
}

/// Compares the definition in a file with the built-in one.
fn check_definition(text: &str, kind: RosType) -> Result<(), RosError> {
    let mut sections: Vec<(String, Vec<String>)> = Vec::new();
    let expected = kind.definition();
    sections.push((expected[0].0.to_owned(), Vec::new()));
    for line in text.lines() {
        let line = line.split('#').next().unwrap_or_default().trim();
        if let Some(name) = line.strip_prefix("MSG:") {
            sections.push((last_part(name.trim()).to_owned(), Vec::new()));
        } else if !line.is_empty() && !line.starts_with("===") && !is_constant(line) {
            let mut words = line.split_whitespace();
            let (kind, name) = (words.next(), words.next());
            let field =
                format!("{} {}", last_part(kind.unwrap_or_default()), name.unwrap_or_default());
            if let Some((_, fields)) = sections.last_mut() {
                fields.push(field);
            }
        }
    }
    for (name, fields) in expected {
        // Files may omit the definitions of types that they have elsewhere.
        let Some((_, found)) = sections.iter().find(|(section, _)| *section == name) else {
            continue;
        };
        for at in 0..fields.len().max(found.len()) {
            let [found, expected] =
                [found, &fields].map(|of| of.get(at).map_or("the end", String::as_str).to_owned());
            if found != expected {
                return Err(RosError::Definition { found, expected });
            }
        }
    }
    Ok(())
}

/// A constant: `uint8 UNKNOWN=0`, or with spaces about the equals sign.
fn is_constant(line: &str) -> bool {
    line.contains('=')
}

/// Decodes a message: four bytes of encapsulation header, then the fields.
///
/// # Errors
/// [`RosError`].
pub fn decode<'a, T: Deserialize<'a>>(data: &'a [u8]) -> Result<T, RosError> {
    let Some((head, body)) = data.split_at_checked(4) else {
        let found = data.to_vec();
        return Err(RosError::Encapsulation { found });
    };
    let decoded = match head[..2] {
        [0, 0] => from_bytes::<T, byteorder::BigEndian>(body),
        [0, 1] => from_bytes::<T, byteorder::LittleEndian>(body),
        _ => {
            let found = head.to_vec();
            return Err(RosError::Encapsulation { found });
        }
    };
    let (message, read) = decoded.map_err(|error| RosError::Bytes(error.to_string()))?;
    // Writers may pad to a multiple of four.
    match body.len() - read {
        0..=3 => Ok(message),
        left => Err(RosError::Bytes(format!("{left} bytes follow the last field"))),
    }
}
