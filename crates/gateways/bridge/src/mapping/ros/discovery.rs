//! Announcements of other participants: topics of robots that the mapping does not have, or of
//! another type. It also announces this participant as a node of the graph.

use serde::Serialize;

use crate::mapping::account::{Account, Reason};
use crate::mapping::robots::Robots;
use crate::mapping::ros::incoming::RosRoute;
use crate::mapping::ros::names::{dds_type, node_name, ros_topic, ros_type};

/// The DDS topic of the graph, and its type.
pub(crate) const GRAPH: (&str, &str) =
    ("ros_discovery_info", "rmw_dds_common::msg::dds_::ParticipantEntitiesInfo_");

/// `rmw_dds_common/ParticipantEntitiesInfo` of ROS 2 Iron and later: the participant with its
/// nodes, which `ros2 node list` reads.
#[derive(Debug, Serialize)]
pub(crate) struct ParticipantEntities {
    participant: [u8; 16],
    nodes: Vec<NodeEntities>,
}

#[derive(Debug, Serialize)]
struct NodeEntities {
    namespace: &'static str,
    name: String,
    readers: Vec<[u8; 16]>,
    writers: Vec<[u8; 16]>,
}

impl ParticipantEntities {
    /// A participant with one node, which has all its readers and writers.
    pub(crate) fn new(
        participant: [u8; 16],
        bridge: &str,
        (readers, writers): (Vec<[u8; 16]>, Vec<[u8; 16]>),
    ) -> Self {
        let node = NodeEntities { namespace: "/", name: node_name(bridge), readers, writers };
        Self { participant, nodes: vec![node] }
    }
}

/// Counts an announced writer, if none of its messages are read.
pub(crate) fn announced(
    routes: &[RosRoute],
    robots: &Robots,
    (topic, kind): (&str, &str),
    account: &mut Account,
) {
    let Some(topic) = ros_topic(topic) else {
        return;
    };
    for route in routes {
        let Some(Some(robot)) = route.pattern.matches(topic) else {
            continue;
        };
        if robots.id(robot).is_none() {
            account.count(&route.name, Reason::UnknownRobot, robot);
        } else if kind != dds_type(ros_type(route.kind)) {
            let name = format!("{kind} of {robot}");
            account.count(&route.name, Reason::WrongType, &name);
        }
    }
}

#[cfg(test)]
mod tests {
    use joulebus_ros_messages::RosType;

    use super::*;
    use crate::mapping::ros::incoming::BatteryFields;
    use crate::mapping::topic::{Pattern, Template};
    use crate::mapping::units::Quantity;

    #[test]
    fn robots_without_a_name_and_topics_of_another_type_are_counted() {
        let text = "/fleet/{robot}/cmd_vel";
        let routes = [RosRoute {
            name: text.to_owned(),
            topic: Template::parse(text, "lab", true).unwrap(),
            pattern: Pattern::parse(text).unwrap(),
            kind: RosType::Twist,
            battery: BatteryFields {
                discharge_is_positive: false,
                percentage: Quantity::Share.si(),
                power_of: None,
                pack: None,
            },
            says: None,
        }];
        let mut robots = Robots::default();
        robots.add("r{id}", "1-2").unwrap();
        let twist = "geometry_msgs::msg::dds_::Twist_";
        for (topic, kind, expected) in [
            ("rt/fleet/r1/cmd_vel", twist, None),
            ("rt/fleet/r9/cmd_vel", twist, Some(("unknown_robot", "r9"))),
            ("rt/fleet/r1/cmd_vel", "x::Stamped_", Some(("wrong_type", "x::Stamped_ of r1"))),
            ("rt/fleet/r9/odom", twist, None),
            ("rq/fleet/r9/cmd_vel", twist, None),
        ] {
            let mut account = Account::default();
            announced(&routes, &robots, (topic, kind), &mut account);
            let found = account.records();
            let found = found.first().map(|refusal| (refusal.reason, refusal.names[0].as_str()));
            assert_eq!(found, expected, "{topic} {kind}");
        }
    }
}
