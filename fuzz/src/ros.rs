//! Messages of ROS 2 as they come from a network: CDR with its encapsulation header.

use joulebus_ros_messages::{RosType, encode};

const TYPES: [RosType; 4] =
    [RosType::BatteryState, RosType::Twist, RosType::TwistStamped, RosType::Odometry];

/// The first byte chooses the type.
pub(crate) fn run(bytes: &[u8]) -> bool {
    let Some((which, payload)) = bytes.split_first() else {
        return false;
    };
    let kind = TYPES[usize::from(*which) % TYPES.len()];
    let Ok(message) = kind.decode(payload) else {
        return false;
    };
    let body = encode(&message).expect("as long as what it was decoded from");
    let again = kind.decode(&[&[0, 1, 0, 0], &body[..]].concat());
    // NaN is not equal to itself.
    assert_eq!(format!("{again:?}"), format!("{:?}", Ok::<_, ()>(message)));
    true
}
