//! Splits what a broker sends into packets, in bounded memory.
//!
//! The bytes of a message that is too long are skipped. It is named by its topic, and the next
//! packet is read as usual.

use mqtt5_protocol::{FixedHeader, MqttError, Packet, PacketType};

/// Room for a message's topic and properties beside its payload, bytes.
const HEAD_BYTES: usize = 66 << 10;

/// A packet of the broker.
#[derive(Debug)]
pub(super) enum Incoming {
    Packet(Packet),
    /// A message of which only the topic was read.
    TooLong {
        topic: String,
    },
    /// A message that breaks the protocol.
    Malformed {
        topic: String,
    },
}

/// The bytes that were received and not yet read.
#[derive(Debug)]
pub(super) struct Inbox {
    version: u8,
    /// Maximum size of a packet, bytes.
    max_bytes: usize,
    bytes: Vec<u8>,
    /// Number of bytes that were read.
    at: usize,
    /// Number of bytes of the last packet that have not arrived and are to be skipped.
    skip: usize,
}

impl Inbox {
    /// Reads packets of `version` (4 is 3.1.1) with payloads up to `max_payload_bytes`.
    pub(super) const fn new(version: u8, max_payload_bytes: usize) -> Self {
        Self {
            version,
            max_bytes: max_payload_bytes + HEAD_BYTES,
            bytes: Vec::new(),
            at: 0,
            skip: 0,
        }
    }

    /// Adds received bytes. [`Inbox::next`] is to be called until it has none.
    pub(super) fn add(&mut self, received: &[u8]) {
        let skipped = self.skip.min(received.len());
        self.skip -= skipped;
        self.bytes.drain(..std::mem::take(&mut self.at));
        self.bytes.extend_from_slice(&received[skipped..]);
    }

    /// The next packet, once all of it is there.
    pub(super) fn next(&mut self) -> Result<Option<Incoming>, MqttError> {
        let bytes = &self.bytes[self.at..];
        let Some((head, length)) = lengths(bytes)? else {
            return Ok(None);
        };
        let kind = PacketType::from_u8(bytes[0] >> 4);
        let kind = kind.ok_or(MqttError::InvalidPacketType(bytes[0] >> 4))?;
        let (body, whole) = (&bytes[head..], head + length);
        if whole > self.max_bytes {
            if kind != PacketType::Publish {
                let (size, max) = (whole, self.max_bytes);
                return Err(MqttError::PacketTooLarge { size, max });
            }
            let Some(topic) = topic(body) else {
                return Ok(None);
            };
            self.skip = whole.saturating_sub(bytes.len());
            self.at += whole.min(bytes.len());
            return Ok(Some(Incoming::TooLong { topic }));
        }
        let Some(mut body) = body.get(..length) else {
            return Ok(None);
        };
        // A packet is at most `max_bytes` long here.
        let header = FixedHeader::new(kind, bytes[0] & 0xf, length as u32);
        let named = body;
        let read = Packet::decode_from_body_with_version(kind, &header, &mut body, self.version);
        let incoming = match read {
            Ok(packet) => Incoming::Packet(packet),
            // Its length is known, so that the next packet can be read.
            Err(_) if kind == PacketType::Publish => {
                Incoming::Malformed { topic: topic(named).unwrap_or_default() }
            }
            Err(error) => return Err(error),
        };
        self.at += whole;
        Ok(Some(incoming))
    }
}

/// Lengths of a packet's head and body, once the head is there.
fn lengths(bytes: &[u8]) -> Result<Option<(usize, usize)>, MqttError> {
    let mut length = 0;
    for (place, byte) in bytes.iter().skip(1).take(4).enumerate() {
        length |= usize::from(byte & 0x7f) << (7 * place);
        if byte & 0x80 == 0 {
            return Ok(Some((2 + place, length)));
        }
    }
    if bytes.len() > 4 {
        let what = "a length of more than four bytes".to_owned();
        return Err(MqttError::MalformedPacket(what));
    }
    Ok(None)
}

/// The topic at the begin of a message's body, once all of it is there.
fn topic(body: &[u8]) -> Option<String> {
    let (length, rest) = body.split_first_chunk()?;
    let topic = rest.get(..usize::from(u16::from_be_bytes(*length)))?;
    Some(String::from_utf8_lossy(topic).into_owned())
}

#[cfg(test)]
mod tests {
    use mqtt5_protocol::QoS;
    use mqtt5_protocol::packet::MqttPacket as _;
    use mqtt5_protocol::packet::publish::PublishPacket;
    use proptest::prelude::*;

    use super::*;

    fn message(version: u8, topic: &str, bytes: usize) -> Vec<u8> {
        let mut message = PublishPacket::new(topic, vec![b'7'; bytes], QoS::AtMostOnce);
        message.protocol_version = version;
        let mut encoded = Vec::new();
        message.encode(&mut encoded).unwrap();
        encoded
    }

    /// Topic and length of the payload of each message. `None`: it was skipped.
    fn read(inbox: &mut Inbox, bytes: &[u8], chunk: usize) -> Vec<(String, Option<usize>)> {
        let (mut read, mut held) = (Vec::new(), 0);
        for chunk in bytes.chunks(chunk) {
            inbox.add(chunk);
            while let Some(incoming) = inbox.next().unwrap() {
                read.push(match incoming {
                    Incoming::Packet(Packet::Publish(publish)) => {
                        (publish.topic_name, Some(publish.payload.len()))
                    }
                    Incoming::TooLong { topic } | Incoming::Malformed { topic } => (topic, None),
                    other => panic!("{other:?}"),
                });
            }
            held = held.max(inbox.bytes.capacity());
        }
        assert!(held <= 2 * (inbox.max_bytes + chunk), "{held} bytes");
        read
    }

    #[test]
    fn messages_of_any_length_are_read_or_skipped_in_bounded_memory() {
        for (version, chunk) in [(4, 1_000), (5, 65_536), (5, 70_001)] {
            let mut inbox = Inbox::new(version, 10_000);
            let mut bytes = message(version, "a", 10_000);
            // The longest packet that there can be.
            bytes.extend(message(version, "b/\u{fc}", (256 << 20) - 100));
            bytes.extend(message(version, "c", 0));
            // Bytes that are no text.
            bytes.extend([0x30, 4, 0, 2, 0xff, 0xfe]);
            bytes.extend(message(version, &"d".repeat(65_535), 10_000));
            let expected = [
                ("a".to_owned(), Some(10_000)),
                ("b/\u{fc}".to_owned(), None),
                ("c".to_owned(), Some(0)),
                ("\u{fffd}\u{fffd}".to_owned(), None),
                ("d".repeat(65_535), Some(10_000)),
            ];
            assert_eq!(read(&mut inbox, &bytes, chunk), expected);
        }
    }

    #[test]
    fn what_is_no_packet_is_refused() {
        for bytes in [
            &[0x00, 0x00][..],
            &[0x30, 0xff, 0xff, 0xff, 0xff],
            // A CONNACK of 256 MB.
            &[0x20, 0xff, 0xff, 0xff, 0x7f],
            &[0x90, 1, 0],
        ] {
            let mut inbox = Inbox::new(5, 1_000);
            inbox.add(bytes);
            assert!(inbox.next().is_err(), "{bytes:?}");
        }
    }

    proptest! {
        #[test]
        fn no_bytes_make_it_panic(
            version in 4..6_u8,
            kind in 1..16_u8,
            flags in 0..16_u8,
            body in proptest::collection::vec(0..64_u8, 0..90),
            cut in 1..100_usize,
        ) {
            let mut bytes = vec![kind << 4 | flags, body.len() as u8];
            bytes.extend(body);
            let mut inbox = Inbox::new(version, 1_000);
            for chunk in bytes.chunks(cut) {
                inbox.add(chunk);
                let _ = inbox.next();
            }
        }
    }
}
