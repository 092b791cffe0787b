//! Messages that are only written.

use byteorder::LittleEndian;
use serde::Serialize;

use crate::{Header, RosError};

/// `diagnostic_msgs/DiagnosticArray`.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct DiagnosticArray {
    /// When this was true.
    pub header: Header,
    /// The states of parts of the system.
    pub status: Vec<DiagnosticStatus>,
}

/// `diagnostic_msgs/DiagnosticStatus`.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct DiagnosticStatus {
    /// 0 ok, 1 warn, 2 error, 3 stale.
    pub level: u8,
    /// The component whose state it is.
    pub name: String,
    /// The state in words.
    pub message: String,
    /// Hardware that it is about.
    pub hardware_id: String,
    /// Values of it.
    pub values: Vec<KeyValue>,
}

/// `diagnostic_msgs/KeyValue`.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
#[expect(missing_docs, reason = "named as in the definition")]
pub struct KeyValue {
    pub key: String,
    pub value: String,
}

/// `std_msgs/Float64`.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
#[expect(missing_docs, reason = "named as in the definition")]
pub struct Float64 {
    pub data: f64,
}

/// The fields of a message as little-endian CDR, without the encapsulation header, which is
/// `00 01 00 00`.
///
/// # Errors
/// [`RosError::Bytes`] for a message without CDR, such as a text beyond 4 GiB.
pub fn encode(message: &impl Serialize) -> Result<Vec<u8>, RosError> {
    cdr_encoding::to_vec::<_, LittleEndian>(message)
        .map_err(|error| RosError::Bytes(error.to_string()))
}

#[cfg(test)]
mod tests {
    use crate::{Message, RosType, Twist, Vector3};

    use super::*;

    #[test]
    fn what_is_encoded_is_decoded_again() {
        let vector = |x| Vector3 { x, y: 0.0, z: -1.5 };
        let twist = Twist { linear: vector(0.25), angular: vector(f64::MIN) };
        let bytes: Vec<u8> = [0, 1, 0, 0].into_iter().chain(encode(&twist).unwrap()).collect();
        assert_eq!(RosType::Twist.decode(&bytes), Ok(Message::Twist(twist)));
    }
}
