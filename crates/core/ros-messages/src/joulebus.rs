//! The messages of the package `joulebus_msgs`, which lies in `ros2/joulebus_msgs`.

use crate::declare::{Defined, messages};
use crate::{Header, Vector3};

/// [`Answer::verdict`]: unknown, yes, tight and no.
pub const VERDICTS: [u8; 4] = [0, 1, 2, 3];

/// The messages: the part of a file that defines each one, and its fields, `type name` each. Parts
/// are `package/msg/Name`, and `_Request` or `_Response` of a service.
#[must_use]
pub fn definitions() -> Vec<(&'static str, Vec<String>)> {
    fn of<T: Defined>() -> (&'static str, Vec<String>) {
        (T::FILE, T::fields())
    }
    vec![
        of::<Outlook>(),
        of::<Answer>(),
        of::<WhatIfRequest>(),
        of::<WhatIfResponse>(),
        of::<AcknowledgeRequest>(),
        of::<AcknowledgeResponse>(),
    ]
}

messages! {
    /// The energy that a robot will draw if it goes on as it does. NaN is unknown.
    pub struct Outlook: "joulebus_msgs/msg/Outlook" {
        /// Time of the robot's newest sample, and the robot's name.
        pub header: Header as "std_msgs/Header",
        /// Horizons, s.
        pub horizon_s: [f32; 4],
        /// Energy expected over each horizon, J.
        pub energy_j: [f32; 4],
        /// Its lower bounds, J.
        pub energy_lo_j: [f32; 4],
        /// Its upper bounds, J.
        pub energy_hi_j: [f32; 4],
        /// Usable energy in the battery, J.
        pub usable_j: f32,
        /// Time to empty, s.
        pub time_to_empty_s: f32,
        /// Its lower bound, s.
        pub time_to_empty_lo_s: f32,
        /// Its upper bound, s.
        pub time_to_empty_hi_s: f32,
        /// Learned capacity of the battery, J.
        pub capacity_j: f32,
        /// Its standard deviation, J.
        pub capacity_sd_j: f32,
        /// Time on the charger until the battery is at 80 %, s.
        pub time_to_80_s: f32,
        /// Time on the charger until the battery is full, s.
        pub time_to_full_s: f32,
    }

    /// What a plan costs a robot, and whether it makes it. NaN is unknown.
    pub struct Answer: "joulebus_msgs/msg/Answer" {
        /// Name of the robot.
        pub robot: String,
        /// One of [`VERDICTS`].
        pub verdict: u8,
        /// Why the verdict is unknown.
        pub reason: String,
        /// Time that the plan takes, s.
        pub duration_s: f32,
        /// Energy of the plan, J.
        pub energy_j: f32,
        /// Its lower bound, J.
        pub energy_lo_j: f32,
        /// Its upper bound, J.
        pub energy_hi_j: f32,
        /// Energy left at the end, J.
        pub left_j: f32,
        /// Its lower bound, J.
        pub left_lo_j: f32,
        /// Probability of finishing above the reserve. NaN where it is not known.
        pub probability: f32,
        /// A bound: the energy that is surely to spare above the reserve, J.
        pub margin_j: f32,
        /// The first leg or command whose end is not a sure yes. −1: none.
        pub limiting_leg: i32,
        /// Time until the robot must turn back, s. NaN with a yes.
        pub turn_back_s: f32,
        /// What weakens the answer.
        pub caveats: String,
    }

    /// What a plan costs robots: the request.
    pub struct WhatIfRequest: "joulebus_msgs/srv/WhatIf_Request" {
        /// Names of the robots.
        pub robots: Vec<String>,
        /// Coverage of the intervals.
        pub coverage: f32,
        /// A path to follow, m.
        pub path: Vec<Vector3> as "geometry_msgs/Point[]",
        /// Speed towards each point, m/s, or nothing.
        pub speed_mps: Vec<f64>,
        /// Time that the robots wait at each point, s, or nothing.
        pub dwell_s: Vec<f64>,
        /// Power that they draw in addition towards each point, W, or nothing.
        pub load_w: Vec<f64>,
        /// When they are at each point, s, or nothing.
        pub time_s: Vec<f64>,
        /// Whether the robots return to the first point.
        pub return_to_start: bool,
        /// Time at rest, s.
        pub idle_s: f32,
        /// Number of sequences of commands.
        pub candidates: u32,
        /// Time for which a command applies, s.
        pub period_s: f32,
        /// Linear velocities, m/s.
        pub v_mps: Vec<f32>,
        /// Angular velocities, rad/s.
        pub omega_radps: Vec<f32>,
    }

    /// What a plan costs robots: the response.
    pub struct WhatIfResponse: "joulebus_msgs/srv/WhatIf_Response" {
        /// Why there is no answer.
        pub refused: String,
        /// Tick of the worker.
        pub tick: u64,
        /// Its age, s.
        pub age_s: f32,
        /// One for each robot or candidate.
        pub answers: Vec<Answer>,
    }

    /// An alarm is acknowledged: the request.
    pub struct AcknowledgeRequest: "joulebus_msgs/srv/Acknowledge_Request" {
        /// Name of the robot.
        pub robot: String,
        /// Name of the alarm.
        pub alarm: String,
        /// Name of the person.
        pub by: String,
    }

    /// An alarm is acknowledged: the response.
    pub struct AcknowledgeResponse: "joulebus_msgs/srv/Acknowledge_Response" {
        /// Whether the worker has taken it.
        pub success: bool,
        /// Why not.
        pub message: String,
    }
}

#[cfg(test)]
mod tests {
    use std::fs;

    use super::*;

    /// The fields of a part of a file, without comments, constants and defaults.
    fn fields(text: &str) -> Vec<String> {
        let lines = text.lines().map(|line| line.split('#').next().unwrap_or_default());
        let lines = lines.filter(|line| !line.contains('='));
        let words = lines.map(|line| line.split_whitespace().take(2).collect::<Vec<_>>());
        words.filter(|words| !words.is_empty()).map(|words| words.join(" ")).collect()
    }

    #[test]
    fn the_package_for_ros_2_has_the_fields_of_these_messages() {
        let package = concat!(env!("CARGO_MANIFEST_DIR"), "/../../../ros2/joulebus_msgs");
        let listed = fs::read_to_string(format!("{package}/CMakeLists.txt")).unwrap();
        let (mut found, mut files) = (Vec::new(), 0);
        for folder in ["msg", "srv"] {
            for file in fs::read_dir(format!("{package}/{folder}")).unwrap() {
                let (path, text) = (file.unwrap().path(), |path| fs::read_to_string(path).unwrap());
                let (name, text) = (path.file_stem().unwrap().to_str().unwrap(), text(&path));
                assert!(listed.contains(&format!("{folder}/{name}.{folder}")), "{name}");
                files += 1;
                let parts: Vec<&str> = text.split("---\n").collect();
                let ends = if folder == "srv" { &["_Request", "_Response"][..] } else { &[""][..] };
                assert_eq!(parts.len(), ends.len(), "{name}");
                let parts = ends.iter().zip(parts);
                found.extend(parts.map(|(end, text)| {
                    (format!("joulebus_msgs/{folder}/{name}{end}"), fields(text))
                }));
            }
        }
        let expected = definitions().into_iter().map(|(name, fields)| (name.to_owned(), fields));
        let mut expected: Vec<_> = expected.collect();
        found.sort();
        expected.sort();
        assert_eq!(found, expected);
        assert_eq!(listed.matches("\n  msg/").count() + listed.matches("\n  srv/").count(), files);
        for (name, code) in ["UNKNOWN", "YES", "TIGHT", "NO"].iter().zip(VERDICTS) {
            let answer = fs::read_to_string(format!("{package}/msg/Answer.msg")).unwrap();
            assert!(answer.contains(&format!("uint8 {name}={code}\n")), "{name}");
        }
    }
}
