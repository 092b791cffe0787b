//! Names of topics and types in ROS 2 and in DDS.

use joulebus_ros_messages::RosType;

/// Maximum length of a topic, bytes. DDS allows 256 with its prefix.
const MAX_BYTES: usize = 250;

const TYPES: [(RosType, &str); 6] = [
    (RosType::BatteryState, "sensor_msgs/msg/BatteryState"),
    (RosType::Twist, "geometry_msgs/msg/Twist"),
    (RosType::TwistStamped, "geometry_msgs/msg/TwistStamped"),
    (RosType::Odometry, "nav_msgs/msg/Odometry"),
    (RosType::Bool, "std_msgs/msg/Bool"),
    (RosType::BatteryStateArray, "spot_msgs/msg/BatteryStateArray"),
];

/// The type called `name`. `msg/` may be left out.
pub(crate) fn read_type(name: &str) -> Result<RosType, String> {
    let is_it = |usual: &str| usual == name || usual.replacen("/msg/", "/", 1) == name;
    let found = TYPES.iter().find(|(_, usual)| is_it(usual));
    found.map(|(kind, _)| *kind).ok_or_else(|| {
        let all: Vec<&str> = TYPES.iter().map(|(_, name)| *name).collect();
        format!("is no type that is read, allowed are {}", all.join(", "))
    })
}

pub(crate) fn ros_type(kind: RosType) -> &'static str {
    let found = TYPES.iter().find(|(other, _)| *other == kind);
    found.map_or("", |(_, name)| name)
}

pub(crate) fn dds_type(name: &str) -> String {
    let mut parts = name.rsplitn(2, '/');
    let (last, package) = (parts.next().unwrap_or_default(), parts.next().unwrap_or_default());
    format!("{}::dds_::{last}_", package.replace('/', "::"))
}

pub(crate) fn dds_topic(topic: &str) -> String {
    format!("rt{topic}")
}

/// The ROS 2 topic with the DDS name `dds`. `None` for services, actions and other DDS topics.
pub(crate) fn ros_topic(dds: &str) -> Option<&str> {
    dds.strip_prefix("rt").filter(|topic| topic.starts_with('/'))
}

/// The name of the bridge's node in the graph: letters, digits and underscores.
pub(crate) fn node_name(bridge: &str) -> String {
    let letter = |letter: char| if letter.is_ascii_alphanumeric() { letter } else { '_' };
    format!("joulebus_{}", bridge.chars().map(letter).collect::<String>())
}

pub(crate) fn check_topic(topic: &str) -> Result<(), String> {
    let is_part = |part: &str| {
        let is_letter = |byte: u8| byte.is_ascii_alphanumeric() || byte == b'_';
        !part.is_empty()
            && part.bytes().all(is_letter)
            && !part.starts_with(|letter: char| letter.is_ascii_digit())
            && !part.contains("__")
    };
    let parts = topic.strip_prefix('/').filter(|_| topic.len() <= MAX_BYTES);
    let is_topic = parts.is_some_and(|parts| parts.split('/').all(is_part));
    is_topic.then_some(()).ok_or_else(|| {
        format!(
            "becomes {topic:?} for a robot, which is no topic of ROS 2. A topic begins with a slash, \
             and has at most {MAX_BYTES} bytes. Its parts are letters, digits and single \
             underscores, and do not begin with a digit"
        )
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn topics_are_those_that_ros_takes() {
        for topic in ["/a", "/robot_7/battery_state", "/Fleet/_hidden/x9"] {
            assert_eq!(check_topic(topic), Ok(()), "{topic}");
            assert_eq!(ros_topic(&dds_topic(topic)), Some(topic));
        }
        let long = format!("/{}", "x".repeat(250));
        for topic in
            ["", "/", "a", "/a/", "//a", "/7", "/a/7b", "/a-b", "/a b", "/a__b", "/ä", "~/a", &long]
        {
            assert!(check_topic(topic).is_err(), "{topic:?}");
        }
        for dds in ["rq/a/b", "rta", "ros_discovery_info", ""] {
            assert_eq!(ros_topic(dds), None, "{dds}");
        }
    }

    #[test]
    fn types_have_one_name_in_dds() {
        let battery = "sensor_msgs::msg::dds_::BatteryState_";
        let twist = "geometry_msgs::msg::dds_::TwistStamped_";
        for (name, dds) in
            [("sensor_msgs/msg/BatteryState", battery), ("geometry_msgs/TwistStamped", twist)]
        {
            assert_eq!(dds_type(ros_type(read_type(name).unwrap())), dds);
        }
        let refused = read_type("std_msgs/msg/Float64").unwrap_err();
        assert!(refused.contains("nav_msgs/msg/Odometry"), "{refused}");
    }
}
