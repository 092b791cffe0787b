//! The bridge's file as TOML structures. Unknown keys are refused, with their line.

use std::collections::BTreeMap;

use joulebus_plausibility::{COMMAND_HOLDS_S, Expired};
use serde::Deserialize;
use toml::{Spanned, Value};

use crate::mapping::observation::PowerOf;
use crate::mapping::outgoing::What;
use crate::mapping::ros::outgoing::RosWhat;

/// A text with its position in the file.
pub(super) type Text = Spanned<String>;

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct BridgeFile {
    #[serde(default)]
    pub(super) bridge: BridgeSection,
    /// Name and id, or a name with `{id}` and a range.
    pub(super) robots: BTreeMap<Text, Value>,
    pub(super) mqtt: Option<MqttSection>,
    pub(super) ros2: Option<Ros2Section>,
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub(super) struct BridgeSection {
    /// Name of the source, stable over restarts.
    pub(super) name: String,
    pub(super) command_holds_s: f64,
    pub(super) command_expired: Expired,
    pub(super) reading_holds_s: f64,
    pub(super) silent_after_s: f64,
    /// Findings that are not told.
    pub(super) accept: Vec<Text>,
}

impl Default for BridgeSection {
    fn default() -> Self {
        Self {
            name: "bridge".to_owned(),
            command_holds_s: COMMAND_HOLDS_S,
            command_expired: Expired::Unknown,
            reading_holds_s: 2.0,
            silent_after_s: 3.0,
            accept: Vec::new(),
        }
    }
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct MqttSection {
    /// Host and port.
    pub(super) broker: Text,
    pub(super) client_id: Option<Text>,
    pub(super) username: Option<String>,
    /// File with the password, mode 0600.
    pub(super) password_file: Option<Text>,
    /// Version of MQTT. Without it 5, and 3.1.1 with a broker that does not know 5.
    pub(super) version: Option<Text>,
    pub(super) tls: Option<TlsSection>,
    #[serde(default = "keep_alive_s")]
    pub(super) keep_alive_s: u64,
    #[serde(default = "max_payload_bytes")]
    pub(super) max_payload_bytes: u32,
    #[serde(default)]
    pub(super) read: Vec<ReadSection>,
    #[serde(default)]
    pub(super) vda5050: Vec<Vda5050Section>,
    pub(super) vizier: Option<VizierSection>,
    #[serde(default)]
    pub(super) write: Vec<WriteSection>,
}

/// Files of TLS, in PEM.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct TlsSection {
    /// Authorities that the broker's certificate may be of.
    pub(super) ca: Text,
    /// What the bridge shows the broker.
    pub(super) certificate: Option<Text>,
    /// The certificate's key, mode 0600.
    pub(super) key: Option<Text>,
}

const fn keep_alive_s() -> u64 {
    10
}

const fn max_payload_bytes() -> u32 {
    65_536
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct ReadSection {
    pub(super) topic: Text,
    /// Position of the robot's name in the document.
    pub(super) robot_at: Option<String>,
    pub(super) fields: FieldsSection,
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct Vda5050Section {
    pub(super) topic: Text,
    /// Sign of `batteryCurrent`, which the standard does not state.
    pub(super) current: Option<CurrentWord>,
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct VizierSection {
    #[serde(default = "one_second")]
    pub(super) every_s: f64,
    /// Topic of the robots' commands.
    #[serde(default = "vizier_commands")]
    pub(super) commands: Text,
    /// Fields of a status, if it is not that of a GTernal.
    pub(super) fields: Option<FieldsSection>,
}

const fn one_second() -> f64 {
    1.0
}

fn vizier_commands() -> Text {
    Spanned::new(0..0, "matlab_api/{robot}".to_owned())
}

#[derive(Debug, Default, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub(super) struct FieldsSection {
    pub(super) v: Option<NumberSection>,
    pub(super) vy: Option<NumberSection>,
    pub(super) omega: Option<NumberSection>,
    pub(super) power: Option<NumberSection>,
    pub(super) power_of: Option<PowerWord>,
    pub(super) power_of_current: bool,
    pub(super) voltage: Option<NumberSection>,
    pub(super) current: Option<NumberSection>,
    pub(super) soc: Option<NumberSection>,
    pub(super) charging: Option<FlagSection>,
    pub(super) full: Option<FlagSection>,
}

#[derive(Debug, Clone, Copy, Deserialize)]
#[serde(rename_all = "snake_case")]
pub(super) enum PowerWord {
    Load,
    Battery,
}

impl From<PowerWord> for PowerOf {
    fn from(word: PowerWord) -> Self {
        match word {
            PowerWord::Load => Self::Load,
            PowerWord::Battery => Self::Battery,
        }
    }
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct NumberSection {
    pub(super) at: Text,
    pub(super) unit: Option<Text>,
    #[serde(default)]
    pub(super) negate: bool,
    /// Values that mean "not known".
    #[serde(default)]
    pub(super) unknown: Vec<Value>,
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct FlagSection {
    pub(super) at: Text,
    /// Values that mean yes.
    pub(super) is: Option<Vec<Value>>,
    #[serde(default)]
    pub(super) unknown: Vec<Value>,
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct WriteSection {
    pub(super) topic: Text,
    pub(super) what: What,
    pub(super) every_s: Option<f64>,
    pub(super) retain: Option<bool>,
    pub(super) fields: Option<BTreeMap<Text, OutgoingValueSection>>,
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct OutgoingValueSection {
    pub(super) value: Text,
    pub(super) unit: Option<Text>,
    #[serde(default)]
    pub(super) negate: bool,
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct Ros2Section {
    /// Overrides `ROS_DOMAIN_ID`.
    pub(super) domain_id: Option<u16>,
    /// Addresses of this host to use.
    #[serde(default)]
    pub(super) networks: Vec<Text>,
    #[serde(default)]
    pub(super) read: Vec<RosReadSection>,
    #[serde(default)]
    pub(super) write: Vec<RosWriteSection>,
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct RosReadSection {
    pub(super) topic: Text,
    #[serde(rename = "type")]
    pub(super) kind: Text,
    /// Sign of a battery's current.
    pub(super) current: Option<CurrentWord>,
    pub(super) percentage_unit: Option<Text>,
    pub(super) power_of: Option<PowerWord>,
    pub(super) power_of_current: Option<bool>,
}

#[derive(Debug, Clone, Copy, Deserialize)]
#[serde(rename_all = "snake_case")]
pub(super) enum CurrentWord {
    /// The sign of the message's definition.
    DischargeNegative,
    DischargePositive,
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct RosWriteSection {
    pub(super) what: RosWhat,
    pub(super) topic: Option<Text>,
    pub(super) every_s: Option<f64>,
    pub(super) value: Option<Text>,
    pub(super) unit: Option<Text>,
    #[serde(default)]
    pub(super) negate: bool,
}
