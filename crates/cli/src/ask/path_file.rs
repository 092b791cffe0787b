//! Paths in files: CSV with a header, an order of VDA 5050, or a `nav_msgs/Path` as JSON.

use std::path::Path as FilePath;

use anyhow::Context as _;
use joulebus_plan::{Path, Point};
use joulebus_program::exit::UsageError;
use serde::Deserialize;

/// Maximum size of a path file.
const MAX_BYTES: u64 = 16 << 20;

/// The columns of a path file. Beside the first two, each may be missing.
const COLUMNS: [&str; 7] = ["x_m", "y_m", "speed_mps", "dwell_s", "load_w", "time_s", "charge_to"];

/// Reads a path with `speed_mps` where the file states no speed. Without one, the highest that the
/// model was trained on. And the state of charge to which the robot is charged behind it.
pub(super) fn read(file: &FilePath, speed_mps: Option<f64>) -> anyhow::Result<(Path, Option<f64>)> {
    let named = || format!("path {}", file.display());
    let text = joulebus_files::read_to_string(file, MAX_BYTES).with_context(named)?;
    parse(&text, speed_mps).map_err(|error| UsageError(format!("{}: {error}", named())).into())
}

/// A message that states a path, as JSON. Its shape says which.
#[derive(Deserialize)]
#[serde(untagged)]
enum Message {
    Order {
        nodes: Vec<Node>,
        edges: Vec<Edge>,
    },
    Poses {
        poses: Vec<Stamped>,
    },
    /// As rosbridge publishes it.
    Published {
        msg: Box<Message>,
    },
}

#[derive(Deserialize)]
#[serde(rename_all = "camelCase")]
struct Node {
    node_id: String,
    sequence_id: u64,
    node_position: Option<Position>,
}

#[derive(Deserialize)]
struct Position {
    x: f64,
    y: f64,
}

#[derive(Deserialize)]
#[serde(rename_all = "camelCase")]
struct Edge {
    edge_id: String,
    end_node_id: String,
    sequence_id: u64,
    max_speed: Option<f64>,
    trajectory: Option<serde::de::IgnoredAny>,
}

#[derive(Deserialize)]
struct Stamped {
    #[serde(default)]
    header: Header,
    pose: Pose,
}

#[derive(Deserialize)]
struct Pose {
    position: Position,
}

#[derive(Deserialize, Default)]
struct Header {
    #[serde(default)]
    stamp: Stamp,
}

/// A stamp of ROS 2, or of ROS 1.
#[derive(Deserialize, Default)]
struct Stamp {
    #[serde(default, alias = "secs")]
    sec: f64,
    #[serde(default, alias = "nsecs")]
    nanosec: f64,
}

impl Message {
    fn path(self, speed_mps: f64) -> Result<Path, String> {
        match self {
            Self::Published { msg } => msg.path(speed_mps),
            Self::Poses { poses } => Ok(of_poses(&poses, speed_mps)),
            Self::Order { nodes, edges } => of_order(nodes, &edges, speed_mps),
        }
    }
}

/// Poses of which all have one stamp, as those of a planner, have no times.
fn of_poses(poses: &[Stamped], speed_mps: f64) -> Path {
    let at = |pose: &Stamped| Point::new(pose.pose.position.x, pose.pose.position.y);
    let points: Vec<Point> = poses.iter().map(at).collect();
    let time_s =
        |Stamped { header: Header { stamp }, .. }: &Stamped| stamp.sec + 1e-9 * stamp.nanosec;
    let time_s: Vec<f64> = poses.iter().map(time_s).collect();
    let is_timed = time_s.windows(2).any(|pair| pair[0] != pair[1]);
    Path { time_s: if is_timed { time_s } else { Vec::new() }, ..Path::new(&points, speed_mps) }
}

/// The horizon of an order is part of the trip. Its speeds are limits, and so is one that is asked for.
fn of_order(mut nodes: Vec<Node>, edges: &[Edge], speed_mps: f64) -> Result<Path, String> {
    nodes.sort_by_key(|node| node.sequence_id);
    let mut path = Path::default();
    for Node { node_id, sequence_id, node_position } in nodes {
        let Some(Position { x, y }) = node_position else {
            return Err(format!("node {node_id:?} has no nodePosition: state x and y"));
        };
        let is_towards = |edge: &&Edge| {
            edge.end_node_id == node_id && edge.sequence_id.checked_add(1) == Some(sequence_id)
        };
        let edge = edges.iter().find(is_towards);
        if edge.is_none() && !path.points.is_empty() {
            let expected = sequence_id.saturating_sub(1);
            return Err(format!(
                "no edge leads to node {node_id:?}: state it, sequenceId {expected}"
            ));
        }
        if let Some(Edge { edge_id, .. }) = edge.filter(|edge| edge.trajectory.is_some()) {
            return Err(format!(
                "edge {edge_id:?} has a trajectory: only straight edges are read. State points of \
                 it as nodes"
            ));
        }
        path.points.push(Point::new(x, y));
        path.speed_mps.push(
            edge.and_then(|edge| edge.max_speed).map_or(speed_mps, |most| speed_mps.min(most)),
        );
    }
    Ok(path)
}

/// A state of charge to which a robot is charged.
pub(super) fn charge_to(text: &str) -> Result<f64, String> {
    let found = text.parse().ok().filter(|share| (0.0..=1.0).contains(share));
    found.ok_or_else(|| format!("{text}, allowed: 0 to 1"))
}

fn parse(text: &str, speed_mps: Option<f64>) -> Result<(Path, Option<f64>), String> {
    let text = text.trim_start_matches('\u{feff}');
    if text.trim_start().starts_with('{') {
        let expected = "expected an order of VDA 5050 with nodes and edges, or a nav_msgs/Path with \
                        poses, as JSON";
        let message: Message =
            serde_json::from_str(text).map_err(|error| format!("{error}: {expected}"))?;
        let path = message.path(speed_mps.unwrap_or(f64::INFINITY))?;
        if path.points.is_empty() {
            return Err("has no points: the first is where the robot is".to_owned());
        }
        return Ok((path, None));
    }
    let lines = text.lines().zip(1..);
    let mut lines = lines.filter(|(line, _)| !line.trim().is_empty());
    let expected =
        format!("expected the columns x_m,y_m and, if wanted, {}", COLUMNS[2..].join(","));
    let (head, _) = lines.next().ok_or_else(|| format!("is empty: {expected}"))?;
    let names: Vec<&str> = head.split(',').map(str::trim).collect();
    let column = |name: &str| names.iter().position(|found| *found == name);
    let twice = (1..names.len()).find(|at| names[..*at].contains(&names[*at]));
    if let Some(at) = twice {
        return Err(format!("line 1 has {:?} twice: {expected}", names[at]));
    }
    let unknown = names.iter().find(|name| !COLUMNS.contains(name));
    let (Some(x), Some(y), None) = (column("x_m"), column("y_m"), unknown) else {
        return Err(format!("line 1 is {head:?}: {expected}"));
    };
    let (mut path, mut charge_to) = (Path::default(), None);
    for (line, number) in lines {
        let cells: Vec<&str> = line.split(',').map(str::trim).collect();
        if cells.len() != names.len() {
            let (found, allowed) = (cells.len(), names.len());
            return Err(format!("line {number} has {found} values, the header {allowed}"));
        }
        let value = |at: usize| {
            let parsed = cells[at].parse::<f64>().ok().filter(|value| value.is_finite());
            parsed.ok_or_else(|| {
                format!("line {number}: {} = {:?} is no number", names[at], cells[at])
            })
        };
        if charge_to.is_some() {
            return Err(format!("line {number} comes after charge_to, which is of the last point"));
        }
        if let Some(at) = column("charge_to").filter(|at| !cells[*at].is_empty()) {
            let to = self::charge_to(cells[at]);
            charge_to = Some(to.map_err(|error| format!("line {number}: charge_to = {error}"))?);
        }
        path.points.push(Point::new(value(x)?, value(y)?));
        let stated = column("speed_mps").filter(|at| !cells[*at].is_empty());
        let speed_mps = speed_mps.unwrap_or(f64::INFINITY);
        path.speed_mps.push(stated.map_or(Ok(speed_mps), value)?);
        for (name, values) in [("dwell_s", &mut path.dwell_s), ("load_w", &mut path.load_w)] {
            if let Some(at) = column(name) {
                values.push(if cells[at].is_empty() { 0.0 } else { value(at)? });
            }
        }
        if let Some(at) = column("time_s") {
            path.time_s.push(value(at)?);
        }
    }
    if path.points.is_empty() {
        return Err("has a header, but no points: the first is where the robot is".to_owned());
    }
    Ok((path, charge_to))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn columns_are_found_by_name_and_may_be_left_out() {
        let text = "y_m, x_m ,speed_mps\n\n1,2,\r\n-3.5,4e-1,0.2\n";
        let (path, _) = parse(text, None).expect("valid");
        assert_eq!(path.points, [Point::new(2.0, 1.0), Point::new(0.4, -3.5)]);
        assert_eq!(path.speed_mps, [f64::INFINITY, 0.2]);
        assert_eq!(parse(text, Some(0.1)).expect("valid").0.speed_mps, [0.1, 0.2]);
        let (path, _) = parse("x_m,y_m\n0,0\n1,1", Some(0.3)).expect("valid");
        assert_eq!(path.speed_mps, [0.3, 0.3]);
        assert!(path.dwell_s.is_empty() && path.load_w.is_empty() && path.time_s.is_empty());
        let path =
            parse("x_m,y_m,dwell_s,load_w,time_s,charge_to\n0,0,,,3,\n1,1,5,-2.5,9,.8", None);
        let (path, charge_to) = path.expect("valid");
        assert_eq!(charge_to, Some(0.8));
        assert_eq!((path.dwell_s, path.load_w), (vec![0.0, 5.0], vec![0.0, -2.5]));
        assert_eq!(path.time_s, [3.0, 9.0]);
    }

    #[test]
    fn orders_of_vda_5050_and_paths_of_ros_are_recognised_by_their_shape() {
        let order = r#"{"headerId": 1, "orderId": "o", "nodes": [
            {"nodeId": "b", "sequenceId": 2, "released": true,
             "nodePosition": {"x": 2.0, "y": -1.0, "theta": 0.5, "mapId": "hall"}, "actions": []},
            {"nodeId": "a", "sequenceId": 0, "released": true, "nodePosition": {"x": 0, "y": 0}},
            {"nodeId": "a", "sequenceId": 4, "released": false, "nodePosition": {"x": 0, "y": 0}}],
            "edges": [
            {"edgeId": "ab", "sequenceId": 1, "startNodeId": "a", "endNodeId": "b", "maxSpeed": 0.3},
            {"edgeId": "ba", "sequenceId": 3, "startNodeId": "b", "endNodeId": "a"}]}"#;
        assert_eq!(parse(order, Some(0.2)).expect("valid").0.speed_mps, [0.2; 3]);
        let (path, _) = parse(order, None).expect("valid");
        assert_eq!(
            path.points,
            [(0.0, 0.0), (2.0, -1.0), (0.0, 0.0)].map(|(x, y)| Point::new(x, y))
        );
        assert_eq!(path.speed_mps, [f64::INFINITY, 0.3, f64::INFINITY]);
        let poses = |stamps: [&str; 2], names: [&str; 2]| {
            let [sec, nanosec] = names;
            let pose = |x, stamp| {
                format!(
                    r#"{{"header": {{"stamp": {{"{sec}": {stamp}, "{nanosec}": 500000000}}}},
                    "pose": {{"position": {{"x": {x}, "y": 1.0, "z": 0}}, "orientation": {{}}}}}}"#
                )
            };
            format!(r#"{{"poses": [{}, {}]}}"#, pose(0, stamps[0]), pose(3, stamps[1]))
        };
        let timed = poses(["7", "9"], ["sec", "nanosec"]);
        let (path, _) = parse(&timed, None).expect("valid");
        assert_eq!((&path.points[1], &path.time_s), (&Point::new(3.0, 1.0), &vec![7.5, 9.5]));
        let published = format!(r#"{{"op": "publish", "topic": "/plan", "msg": {timed}}}"#);
        assert_eq!(parse(&published, None).expect("valid").0, path);
        let planned = poses(["7", "7"], ["secs", "nsecs"]);
        assert!(parse(&planned, None).expect("valid").0.time_s.is_empty());
    }

    #[test]
    fn wrong_files_are_refused_with_the_line() {
        for (text, expected) in [
            (r#"{"points": []}"#, "VDA 5050"),
            (r#"{"poses": []}"#, "no points"),
            (r#"{"nodes": [], "edges": []}"#, "no points"),
            (
                r#"{"nodes": [{"nodeId": "a", "sequenceId": 0, "nodePosition": {"x": 1, "y": 2}},
                {"nodeId": "b", "sequenceId": 2, "nodePosition": {"x": 1, "y": 2}}],
                "edges": [{"edgeId": "e", "sequenceId": 18446744073709551615, "endNodeId": "b"}]}"#,
                "no edge leads to node \"b\"",
            ),
            (r#"{"nodes": [{"nodeId": "a", "sequenceId": 0}], "edges": []}"#, "nodePosition"),
            (
                r#"{"nodes": [{"nodeId": "a", "sequenceId": 2, "nodePosition": {"x": 1, "y": 2}}],
                "edges": [{"edgeId": "e", "sequenceId": 1, "endNodeId": "a", "trajectory": {}}]}"#,
                "trajectory",
            ),
            ("", "empty"),
            ("0,0\n1,1\n", "x_m,y_m"),
            ("x_m,y_m,z_m\n0,0,0\n", "x_m,y_m"),
            ("x_m,y_m,x_m\n0,0,1\n", "\"x_m\" twice"),
            ("x_m,y_m\n", "no points"),
            ("x_m,y_m\n0,0\n1\n", "line 3"),
            ("x_m,y_m\n0,0\n1,one\n", "line 3: y_m"),
            ("x_m,y_m\nNaN,0\n", "line 2: x_m"),
            ("x_m,y_m,speed_mps\n0,0,fast\n", "line 2: speed_mps"),
            ("x_m,y_m,time_s\n0,0,\n", "line 2: time_s"),
            ("x_m,y_m,dwell_s\n0,0,inf\n", "line 2: dwell_s"),
            ("x_m,y_m,charge_to\n0,0,80\n", "line 2: charge_to = 80"),
            ("x_m,y_m,charge_to\n0,0,.8\n1,0,.8\n", "line 3 comes after charge_to"),
        ] {
            let error = parse(text, None).expect_err(text);
            assert!(error.contains(expected), "{text:?}: {error}");
        }
    }
}
