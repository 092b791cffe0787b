//! Names, attachments and graph tokens of `rmw_zenoh_cpp`, ROS 2's middleware over zenoh.
//!
//! Messages of a topic have the key `DOMAIN/TOPIC/TYPE/HASH`, with the type's name of DDS and the
//! hash of its definition. A token of liveliness stands for each node, publisher and subscription.
//! `ros2 node list` and `ros2 topic list` read these tokens.

/// The prefix of all tokens.
const SPACE: &str = "@ros2_lv";
/// A publisher's default quality of service but for its depth: reliable, volatile, keep last.
const RELIABLE: &str = "::,10:,:,:,,";
/// ROS 2's profile of sensor data: best effort, volatile, keep the last 5.
const SENSOR_DATA: &str = "2::,5:,:,:,,";
/// Types that are read or written, and the hashes of their definitions (RIHS01, ROS 2 Iron and
/// later).
const HASHES: [(&str, &str); 6] = [
    (
        "sensor_msgs::msg::dds_::BatteryState_",
        "4bee5dfce981c98faa6828b868307a0a73f992ed0789f374ee96c8f840e69741",
    ),
    (
        "geometry_msgs::msg::dds_::Twist_",
        "9c45bf16fe0983d80e3cfe750d6835843d265a9a6c46bd2e609fcddde6fb8d2a",
    ),
    (
        "geometry_msgs::msg::dds_::TwistStamped_",
        "5f0fcd4f81d5d06ad9b4c4c63e3ea51b82d6ae4d0558f1d475229b1121db6f64",
    ),
    (
        "nav_msgs::msg::dds_::Odometry_",
        "3cc97dc7fb7502f8714462c526d369e35b603cfc34d946e3f2eda2766dfec6e0",
    ),
    (
        "std_msgs::msg::dds_::Float64_",
        "705ba9c3d1a09df43737eb67095534de36fd426c0587779bda2bc51fe790182a",
    ),
    (
        "diagnostic_msgs::msg::dds_::DiagnosticArray_",
        "5a8a36efb05fb25070fa0fb3810290c0e6cd4862b54a8fb975a1ee8dc55a333e",
    ),
];

/// Bytes of an attachment.
pub(crate) const ATTACHMENT_BYTES: usize = 33;

/// A topic and its type, by its name in DDS.
#[derive(Debug, Clone, PartialEq, Eq, serde::Deserialize)]
pub(crate) struct Topic {
    pub(crate) topic: String,
    #[serde(rename = "type")]
    pub(crate) kind: String,
}

/// What an endpoint does.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Endpoint {
    Publisher,
    Subscription,
}

impl Topic {
    /// The key of its messages.
    pub(crate) fn key(&self, domain_id: u16) -> String {
        format!("{domain_id}/{}/{}/{}", self.topic.trim_matches('/'), self.kind, hash(&self.kind))
    }

    /// The keys of its messages with any type and any hash: releases differ in them.
    pub(crate) fn keys(&self, domain_id: u16) -> String {
        format!("{domain_id}/{}/*/*", self.topic.trim_matches('/'))
    }

    /// Whether a message with this key has the type.
    pub(crate) fn is_type_of(&self, key: &str) -> bool {
        key.rsplit('/').nth(1) == Some(&self.kind)
    }
}

fn hash(kind: &str) -> String {
    let found = HASHES.iter().find(|(name, _)| *name == kind);
    found.map_or_else(|| "TypeHashNotSupported".to_owned(), |(_, hash)| format!("RIHS01_{hash}"))
}

/// A node of the ROS graph.
#[derive(Debug, Clone, serde::Deserialize)]
pub(crate) struct Node {
    pub(crate) domain_id: u16,
    pub(crate) name: String,
    /// Id of the zenoh session.
    #[serde(skip)]
    pub(crate) session: String,
}

impl Node {
    fn token_of(&self, entity: usize, kind: &str) -> String {
        let Self { domain_id, name, session } = self;
        // The enclave and the namespace are `/`.
        format!("{SPACE}/{domain_id}/{session}/0/{entity}/{kind}/%/%/{name}")
    }

    /// The token of the node.
    pub(crate) fn token(&self) -> String {
        self.token_of(0, "NN")
    }

    /// The token of one of its endpoints. Numbers begin with 1.
    pub(crate) fn endpoint(&self, number: usize, endpoint: Endpoint, topic: &Topic) -> String {
        let (kind, quality) = match endpoint {
            Endpoint::Publisher => ("MP", RELIABLE),
            Endpoint::Subscription => ("MS", SENSOR_DATA),
        };
        let Topic { topic, kind: name } = topic;
        let (topic, hash) = (topic.replace('/', "%"), hash(name));
        format!("{}/{topic}/{name}/{hash}/{quality}", self.token_of(number, kind))
    }

    /// The tokens of all publishers of the domain.
    pub(crate) fn publishers(&self) -> String {
        format!("{SPACE}/{}/*/*/*/MP/**", self.domain_id)
    }
}

/// The topic that the token of a publisher announces.
pub(crate) fn announced(token: &str) -> Option<Topic> {
    let mut parts = token.split('/').skip(9);
    let (topic, kind) = (parts.next()?, parts.next()?);
    Some(Topic { topic: topic.replace('%', "/"), kind: kind.to_owned() })
}

/// What each message carries: its number, the time at which it was sent, and the publisher's id,
/// the hash of its token.
pub(crate) fn attachment(number: i64, unix_ns: i64, publisher: u128) -> [u8; ATTACHMENT_BYTES] {
    let mut bytes = [0; ATTACHMENT_BYTES];
    bytes[..8].copy_from_slice(&number.to_le_bytes());
    bytes[8..16].copy_from_slice(&unix_ns.to_le_bytes());
    bytes[16] = 16;
    bytes[17..].copy_from_slice(&publisher.to_le_bytes());
    bytes
}

#[cfg(test)]
mod tests {
    use super::*;

    fn twist() -> Topic {
        let kind = "geometry_msgs::msg::dds_::Twist_".to_owned();
        Topic { topic: "/robot1/cmd_vel".to_owned(), kind }
    }

    #[test]
    fn keys_and_tokens_are_those_of_rmw_zenoh() {
        let hash = "RIHS01_9c45bf16fe0983d80e3cfe750d6835843d265a9a6c46bd2e609fcddde6fb8d2a";
        let key = twist().key(7);
        assert_eq!(key, format!("7/robot1/cmd_vel/geometry_msgs::msg::dds_::Twist_/{hash}"));
        assert!(twist().is_type_of(&key));
        // ROS 2 Humble has no hashes.
        assert!(
            twist().is_type_of(
                "7/robot1/cmd_vel/geometry_msgs::msg::dds_::Twist_/TypeHashNotSupported"
            )
        );
        assert!(!twist().is_type_of("7/robot1/cmd_vel/geometry_msgs::msg::dds_::TwistStamped_/x"));
        let node = Node { domain_id: 7, name: "joulebus".to_owned(), session: "a1b2".to_owned() };
        assert_eq!(node.token(), "@ros2_lv/7/a1b2/0/0/NN/%/%/joulebus");
        let publisher = node.endpoint(3, Endpoint::Publisher, &twist());
        assert_eq!(
            publisher,
            format!(
                "@ros2_lv/7/a1b2/0/3/MP/%/%/joulebus/%robot1%cmd_vel/geometry_msgs::msg::dds_::Twist_/{hash}/::,10:,:,:,,"
            )
        );
        assert_eq!(announced(&publisher), Some(twist()));
        assert_eq!(announced(&node.token()), None);
        let subscription = node.endpoint(4, Endpoint::Subscription, &twist());
        assert!(subscription.ends_with("/2::,5:,:,:,,"), "{subscription}");
    }

    #[test]
    fn an_attachment_has_numbers_in_little_endian_and_an_id_with_its_length() {
        let bytes = attachment(1, 0x0102, 0xa0);
        let mut expected = [0; ATTACHMENT_BYTES];
        (expected[0], expected[8], expected[9]) = (1, 2, 1);
        (expected[16], expected[17]) = (16, 0xa0);
        assert_eq!(bytes, expected);
    }
}
