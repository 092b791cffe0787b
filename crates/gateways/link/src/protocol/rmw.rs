//! Names, attachments and graph tokens of `rmw_zenoh_cpp`, ROS 2's middleware over zenoh.
//!
//! Messages of a topic have the key `DOMAIN/TOPIC/TYPE/HASH`, with the type's name of DDS and the
//! hash of its definition. A token of liveliness stands for each node, publisher and subscription.
//! `ros2 node list` and `ros2 topic list` read these tokens.

use std::collections::VecDeque;

/// The prefix of all tokens.
const SPACE: &str = "@ros2_lv";
/// The default quality of service of publishers and services but for its depth: reliable, volatile,
/// keep last. A latched publisher is `transient_local`, which is 1 after the first colon.
const RELIABLE: &str = "::,10:,:,:,,";
/// ROS 2's profile of sensor data: best effort, volatile, keep the last 5.
const SENSOR_DATA: &str = "2::,5:,:,:,,";
/// Bytes of an attachment.
pub(crate) const ATTACHMENT_BYTES: usize = 33;

/// A topic or a service, its type by the name in DDS, and the hash of the type's definition.
#[derive(Debug, Clone, PartialEq, Eq, serde::Deserialize)]
pub(crate) struct Topic {
    pub(crate) topic: String,
    #[serde(rename = "type")]
    pub(crate) kind: String,
    pub(crate) hash: String,
    /// Number of messages that late subscribers get. 0: not latched.
    #[serde(default)]
    pub(crate) kept: usize,
}

/// Role of an endpoint.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Endpoint {
    Publisher,
    Subscription,
    Service,
}

impl Topic {
    /// The key of its messages.
    pub(crate) fn key(&self, domain_id: u16) -> String {
        format!("{domain_id}/{}/{}/{}", self.topic.trim_matches('/'), self.kind, self.hash)
    }

    /// The keys of its messages with any type and any hash: releases differ in them.
    pub(crate) fn keys(&self, domain_id: u16) -> String {
        format!("{domain_id}/{}/*/*", self.topic.trim_matches('/'))
    }

    /// The key by which late subscribers ask a latched publisher for its newest messages, and of
    /// the token by which they find it. It is that of an advanced publisher of zenoh-ext, whose
    /// messages are distinguished by time stamps.
    pub(crate) fn history_key(&self, domain_id: u16, session: &str) -> String {
        format!("{}/@adv/pub/{session}/uhlc/_", self.key(domain_id))
    }

    /// True if a message with this key has the type.
    pub(crate) fn is_type_of(&self, key: &str) -> bool {
        key.rsplit('/').nth(1) == Some(&self.kind)
    }
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
        let Topic { topic, kind: name, hash, kept } = topic;
        let latched = format!(":1:,{kept}:,:,:,,");
        let (kind, quality) = match endpoint {
            Endpoint::Publisher if *kept > 0 => ("MP", latched.as_str()),
            Endpoint::Publisher => ("MP", RELIABLE),
            Endpoint::Subscription => ("MS", SENSOR_DATA),
            Endpoint::Service => ("SS", RELIABLE),
        };
        let topic = topic.replace('/', "%");
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
    let (topic, kind, hash) = (parts.next()?, parts.next()?, parts.next()?);
    let (topic, kind, hash) = (topic.replace('%', "/"), kind.to_owned(), hash.to_owned());
    Some(Topic { topic, kind, hash, kept: 0 })
}

/// The newest messages of a latched publisher. The oldest is the first.
#[derive(Debug)]
pub(crate) struct History<T> {
    newest: VecDeque<T>,
    kept: usize,
}

impl<T: Clone> History<T> {
    pub(crate) const fn new(kept: usize) -> Self {
        Self { newest: VecDeque::new(), kept }
    }

    pub(crate) fn add(&mut self, message: T) {
        self.newest.push_back(message);
        let excess = self.newest.len().saturating_sub(self.kept);
        self.newest.drain(..excess);
    }

    /// The messages that a subscriber asks for: at most `_max` of its parameters.
    pub(crate) fn asked(&self, max: Option<&str>) -> Vec<T> {
        let max = max.and_then(|max| max.parse().ok()).unwrap_or(usize::MAX);
        let first = self.newest.len().saturating_sub(max);
        self.newest.range(first..).cloned().collect()
    }
}

/// Encodes the attachment of a message: its number, the time at which it was sent, and the
/// publisher's id, the hash of its token.
pub(crate) fn attachment(number: i64, unix_ns: i64, publisher: u128) -> [u8; ATTACHMENT_BYTES] {
    let mut bytes = [0; ATTACHMENT_BYTES];
    bytes[..8].copy_from_slice(&number.to_le_bytes());
    bytes[8..16].copy_from_slice(&unix_ns.to_le_bytes());
    bytes[16] = 16;
    bytes[17..].copy_from_slice(&publisher.to_le_bytes());
    bytes
}

/// Encodes the attachment of a response: the number and the id of its request, and the time at
/// which it is sent. `None` if the request has no such attachment.
pub(crate) fn response(request: &[u8], unix_ns: i64) -> Option<[u8; ATTACHMENT_BYTES]> {
    let mut bytes: [u8; ATTACHMENT_BYTES] = request.try_into().ok()?;
    bytes[8..16].copy_from_slice(&unix_ns.to_le_bytes());
    Some(bytes)
}

/// The id of the publisher or client in an attachment, which is none of other lengths.
pub(crate) fn sender(attached: &[u8]) -> &[u8] {
    attached.get(17..ATTACHMENT_BYTES).unwrap_or_default()
}

#[cfg(test)]
mod tests {
    use super::*;

    const HASH: &str = "RIHS01_9c45bf16fe0983d80e3cfe750d6835843d265a9a6c46bd2e609fcddde6fb8d2a";

    fn twist() -> Topic {
        let kind = "geometry_msgs::msg::dds_::Twist_".to_owned();
        Topic { topic: "/robot1/cmd_vel".to_owned(), kind, hash: HASH.to_owned(), kept: 0 }
    }

    #[test]
    fn keys_and_tokens_are_those_of_rmw_zenoh() {
        let hash = HASH;
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
        let latched = Topic { kept: 3, ..twist() };
        let publisher = node.endpoint(3, Endpoint::Publisher, &latched);
        assert!(publisher.ends_with(&format!("{hash}/:1:,3:,:,:,,")), "{publisher}");
        assert_eq!(latched.history_key(7, "a1b2"), format!("{key}/@adv/pub/a1b2/uhlc/_"));
        let subscription = node.endpoint(4, Endpoint::Subscription, &twist());
        assert!(subscription.ends_with("/2::,5:,:,:,,"), "{subscription}");
        // The example of the design of rmw_zenoh.
        let (topic, kind) = ("/add_two_ints", "example_interfaces::srv::dds_::AddTwoInts_");
        let [topic, kind, hash] = [topic, kind, "RIHS01_e118"].map(str::to_owned);
        let node = Node { domain_id: 2, name: "server".to_owned(), session: "aac3".to_owned() };
        let service = node.endpoint(10, Endpoint::Service, &Topic { topic, kind, hash, kept: 0 });
        assert_eq!(
            service,
            "@ros2_lv/2/aac3/0/10/SS/%/%/server/%add_two_ints/\
             example_interfaces::srv::dds_::AddTwoInts_/RIHS01_e118/::,10:,:,:,,"
        );
    }

    #[test]
    fn late_subscribers_get_the_newest_messages_and_no_more_than_they_ask_for() {
        let mut history = History::new(3);
        assert_eq!(history.asked(None), [0; 0]);
        (1..=5).for_each(|message| history.add(message));
        for (max, expected) in [
            (None, &[3, 4, 5][..]),
            (Some("2"), &[4, 5]),
            (Some("0"), &[]),
            (Some("9"), &[3, 4, 5]),
            (Some("x"), &[3, 4, 5]),
        ] {
            assert_eq!(history.asked(max), expected, "{max:?}");
        }
    }

    #[test]
    fn an_attachment_has_numbers_in_little_endian_and_an_id_with_its_length() {
        let bytes = attachment(1, 0x0102, 0xa0);
        let mut expected = [0; ATTACHMENT_BYTES];
        (expected[0], expected[8], expected[9]) = (1, 2, 1);
        (expected[16], expected[17]) = (16, 0xa0);
        assert_eq!(bytes, expected);
        (expected[8], expected[9]) = (3, 0);
        assert_eq!(response(&bytes, 3), Some(expected));
        assert_eq!(response(&bytes[1..], 3), None);
    }
}
