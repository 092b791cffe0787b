//! Services of ROS 2: questions about plans and acknowledgements of alarms, as requests and
//! responses.

use joulebus_consumer::wire::Alarm;
use joulebus_plan::{Path, Plan, Point, Question, Reply, Row, Verdict};
use joulebus_ros_messages::{
    AcknowledgeRequest, AcknowledgeResponse, Answer, RosError, VERDICTS, WhatIfRequest,
    WhatIfResponse, decode, encode,
};

use crate::mapping::robots::Robots;
use crate::mapping::ros::names::dds_type;

#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub(crate) enum Service {
    WhatIf,
    Acknowledge,
}

#[derive(Debug, Clone, PartialEq)]
pub(crate) enum Request {
    Ask(Question),
    Acknowledge { robot: u32, alarm: Alarm, by: String },
}

impl Service {
    pub(crate) const ALL: [Self; 2] = [Self::WhatIf, Self::Acknowledge];

    pub(crate) const fn key(self) -> &'static str {
        match self {
            Self::WhatIf => "what_if",
            Self::Acknowledge => "acknowledge",
        }
    }

    pub(crate) const fn type_name(self) -> &'static str {
        match self {
            Self::WhatIf => "joulebus_msgs/srv/WhatIf",
            Self::Acknowledge => "joulebus_msgs/srv/Acknowledge",
        }
    }

    /// Topics and types in DDS of a service with this name: of requests, and of responses.
    pub(crate) fn topics(self, name: &str) -> [(String, String); 2] {
        let of = |prefix, suffix, part| {
            (format!("{prefix}{name}{suffix}"), dds_type(&format!("{}{part}", self.type_name())))
        };
        [of("rq", "Request", "_Request"), of("rr", "Reply", "_Response")]
    }

    /// Decodes a request: untrusted bytes with their encapsulation header.
    ///
    /// # Errors
    /// The fault of the request, in words.
    pub(crate) fn read(self, bytes: &[u8], robots: &Robots) -> Result<Request, String> {
        let wrong =
            |error: RosError| format!("the request does not fit {}: {error}", self.type_name());
        match self {
            Self::WhatIf => question(decode(bytes).map_err(wrong)?, robots).map(Request::Ask),
            Self::Acknowledge => acknowledgement(decode(bytes).map_err(wrong)?, robots),
        }
    }

    /// Encodes the response to a request that is refused, with the reason.
    ///
    /// # Errors
    /// A text that is too long.
    pub(crate) fn refused(self, why: String) -> Result<Vec<u8>, RosError> {
        match self {
            Self::WhatIf => {
                let (tick, age_s) = (0, f32::NAN);
                encode(&WhatIfResponse { refused: why, tick, age_s, answers: Vec::new() })
            }
            Self::Acknowledge => encode(&AcknowledgeResponse { success: false, message: why }),
        }
    }
}

/// Encodes that the worker has taken an acknowledgement.
pub(crate) fn acknowledged() -> Result<Vec<u8>, RosError> {
    encode(&AcknowledgeResponse { success: true, message: String::new() })
}

/// Encodes the answers, which were computed from the state of this tick and age.
pub(crate) fn answered(
    reply: &Reply,
    (tick, age_ns): (u64, u64),
    robots: &Robots,
) -> Result<Vec<u8>, RosError> {
    let answers = reply.rows.iter().map(|row| answer(row, robots)).collect();
    let age_s = age_ns as f32 * 1e-9;
    encode(&WhatIfResponse { refused: String::new(), tick, age_s, answers })
}

fn id(robots: &Robots, name: &str) -> Result<u32, String> {
    robots.id(name).ok_or_else(|| format!("there is no robot {name:?} in the bridge's file"))
}

fn question(request: WhatIfRequest, robots: &Robots) -> Result<Question, String> {
    let WhatIfRequest { path, speed_mps, dwell_s, load_w, time_s, v_mps, omega_radps, .. } =
        request;
    let names = request.robots.iter();
    let ids = names.map(|name| id(robots, name)).collect::<Result<Vec<u32>, String>>()?;
    let commands = v_mps.len().max(omega_radps.len());
    let given = [!path.is_empty(), request.idle_s != 0.0, commands > 0];
    if given.iter().filter(|is_given| **is_given).count() != 1 {
        return Err("give one of path, idle_s, or v_mps with omega_radps".to_owned());
    }
    for (name, is_given) in [
        ("return_to_start", request.return_to_start),
        ("speed_mps", !speed_mps.is_empty()),
        ("dwell_s", !dwell_s.is_empty()),
        ("load_w", !load_w.is_empty()),
        ("time_s", !time_s.is_empty()),
    ] {
        if is_given && path.is_empty() {
            return Err(format!("{name} belongs to a path"));
        }
    }
    let plan = match (ids.as_slice(), path.as_slice()) {
        ([], _) => return Err("name at least one robot".to_owned()),
        (_, [first, ..]) => {
            let count = path.len();
            if !(speed_mps.is_empty() || speed_mps.len() == count) {
                let found = speed_mps.len();
                return Err(format!("speed_mps has {found} values, allowed: none or {count}"));
            }
            let back_to = request.return_to_start.then(|| Point::new(first.x, first.y));
            let points = path.iter().map(|point| Point::new(point.x, point.y)).collect();
            let speed_mps =
                if speed_mps.is_empty() { vec![f64::INFINITY; count] } else { speed_mps };
            let path = Path { points, speed_mps, dwell_s, load_w, time_s, ..Path::default() };
            Plan::Follow { robots: ids, path, back_to }
        }
        ([robot], []) if commands > 0 => {
            if v_mps.len() != omega_radps.len() {
                let (v, omega) = (v_mps.len(), omega_radps.len());
                return Err(format!("v_mps has {v} values and omega_radps {omega}: as many each"));
            }
            let (robot, candidates) = (*robot, request.candidates as usize);
            Plan::WhatIf { robot, candidates, period_s: request.period_s, v_mps, omega_radps }
        }
        (_, []) if commands > 0 => return Err("commands are of one robot".to_owned()),
        _ => Plan::Idle { robots: ids, duration_s: request.idle_s },
    };
    Ok(Question { plan, coverage: request.coverage, ..Question::default() })
}

fn acknowledgement(request: AcknowledgeRequest, robots: &Robots) -> Result<Request, String> {
    let AcknowledgeRequest { robot, alarm: name, by } = request;
    let robot = id(robots, &robot)?;
    let alarm = Alarm::ALL.into_iter().find(|alarm| alarm.name() == name).ok_or_else(|| {
        let all = Alarm::ALL.map(Alarm::name).join(", ");
        format!("{name:?} is no alarm of a robot. Allowed are {all}")
    })?;
    Ok(Request::Acknowledge { robot, alarm, by })
}

fn answer(row: &Row, robots: &Robots) -> Answer {
    let answer = &row.answer;
    let [unknown, yes, tight, no] = VERDICTS;
    let (verdict, reason) = match answer.verdict {
        Verdict::Yes => (yes, String::new()),
        Verdict::Tight => (tight, String::new()),
        Verdict::No => (no, String::new()),
        Verdict::Unknown(reason) => (unknown, reason.to_string()),
        _ => (unknown, answer.verdict.to_string()),
    };
    let nan = |value: Option<f32>| value.unwrap_or(f32::NAN);
    Answer {
        robot: robots.name(row.robot).unwrap_or_default().to_owned(),
        verdict,
        reason,
        duration_s: answer.duration_s,
        energy_j: nan(answer.energy.map(|energy| energy.mean_j)),
        energy_lo_j: nan(answer.energy.map(|energy| energy.lo_j)),
        energy_hi_j: nan(answer.energy.map(|energy| energy.hi_j)),
        left_j: nan(answer.left.map(|left| left.mean_j)),
        left_lo_j: nan(answer.left.map(|left| left.lo_j)),
        probability: nan(answer.probability),
        margin_j: nan(answer.margin_j),
        limiting_leg: answer.limiting_leg.and_then(|leg| i32::try_from(leg).ok()).unwrap_or(-1),
        turn_back_s: nan(row.turn_back_s),
        caveats: answer.caveats.to_string(),
    }
}

#[cfg(test)]
mod tests {
    use joulebus_ros_messages::Vector3;

    use super::*;

    fn robots() -> Robots {
        let mut robots = Robots::default();
        robots.add("r{id}", "1-3").unwrap();
        robots
    }

    fn asked() -> WhatIfRequest {
        WhatIfRequest {
            robots: vec!["r2".to_owned()],
            coverage: 0.9,
            path: Vec::new(),
            speed_mps: Vec::new(),
            dwell_s: Vec::new(),
            load_w: Vec::new(),
            time_s: Vec::new(),
            return_to_start: false,
            idle_s: 0.0,
            candidates: 1,
            period_s: 0.0,
            v_mps: Vec::new(),
            omega_radps: Vec::new(),
        }
    }

    fn path() -> Vec<Vector3> {
        [1.0, 2.0].map(|x| Vector3 { x, y: 0.5, z: 9.0 }).to_vec()
    }

    fn read(service: Service, request: &impl serde::Serialize) -> Result<Request, String> {
        let body = encode(request).unwrap();
        let bytes: Vec<u8> = [0, 1, 0, 0].into_iter().chain(body).collect();
        service.read(&bytes, &robots())
    }

    #[test]
    fn a_request_is_a_path_a_time_at_rest_or_commands() {
        let idle = WhatIfRequest { idle_s: 60.0, ..asked() };
        let plan = Plan::Idle { robots: vec![2], duration_s: 60.0 };
        let question = Question { plan, ..Question::default() };
        assert_eq!(read(Service::WhatIf, &idle), Ok(Request::Ask(question)));
        let robots = ["r3", "r1"].map(str::to_owned).to_vec();
        let followed = WhatIfRequest { robots, path: path(), return_to_start: true, ..asked() };
        let Ok(Request::Ask(question)) = read(Service::WhatIf, &followed) else {
            panic!("{followed:?}")
        };
        let points = vec![Point::new(1.0, 0.5), Point::new(2.0, 0.5)];
        let path = Path::new(&points, f64::INFINITY);
        let back_to = Some(Point::new(1.0, 0.5));
        assert_eq!(question.plan, Plan::Follow { robots: vec![3, 1], path, back_to });
        let (v_mps, omega_radps) = (vec![0.1, 0.2], vec![0.0, 0.5]);
        let commands = WhatIfRequest { v_mps, omega_radps, period_s: 0.5, ..asked() };
        let Ok(Request::Ask(question)) = read(Service::WhatIf, &commands) else {
            panic!("{commands:?}")
        };
        assert!(matches!(question.plan, Plan::WhatIf { robot: 2, candidates: 1, .. }));
    }

    #[test]
    fn what_is_wrong_with_a_request_is_reported() {
        let named = |name: &str| vec![name.to_owned()];
        let two = || ["r1", "r2"].map(str::to_owned).to_vec();
        for (request, expected) in [
            (asked(), "give one of path"),
            (WhatIfRequest { path: path(), idle_s: 1.0, ..asked() }, "give one of path"),
            (WhatIfRequest { robots: named("r9"), idle_s: 1.0, ..asked() }, "no robot \"r9\""),
            (WhatIfRequest { robots: Vec::new(), idle_s: 1.0, ..asked() }, "at least one robot"),
            (WhatIfRequest { return_to_start: true, idle_s: 1.0, ..asked() }, "belongs to a path"),
            (WhatIfRequest { speed_mps: vec![1.0], idle_s: 1.0, ..asked() }, "speed_mps belongs"),
            (WhatIfRequest { idle_s: f32::NAN, path: path(), ..asked() }, "give one of path"),
            (WhatIfRequest { path: path(), speed_mps: vec![1.0], ..asked() }, "none or 2"),
            (WhatIfRequest { v_mps: vec![0.1], ..asked() }, "as many each"),
            (
                WhatIfRequest {
                    robots: two(),
                    v_mps: vec![0.1],
                    omega_radps: vec![0.0],
                    ..asked()
                },
                "of one robot",
            ),
        ] {
            let refused = read(Service::WhatIf, &request).unwrap_err();
            assert!(refused.contains(expected), "{refused}");
        }
        let refused = Service::WhatIf.read(&[0, 1, 0, 0, 9], &robots()).unwrap_err();
        assert!(refused.contains("does not fit joulebus_msgs/srv/WhatIf"), "{refused}");
        let of = |alarm: &str| {
            let [robot, alarm, by] = ["r1", alarm, "Ada"].map(str::to_owned);
            read(Service::Acknowledge, &AcknowledgeRequest { robot, alarm, by })
        };
        let (alarm, by) = (Alarm::StuckSensor, "Ada".to_owned());
        assert_eq!(of("StuckSensor"), Ok(Request::Acknowledge { robot: 1, alarm, by }));
        assert!(of("WorkerGone").unwrap_err().contains("Allowed are "));
    }

    #[test]
    fn a_service_has_two_topics_in_dds() {
        let [(asks, request), (replies, response)] = Service::WhatIf.topics("/joulebus/what_if");
        assert_eq!(
            (asks.as_str(), replies.as_str()),
            ("rq/joulebus/what_ifRequest", "rr/joulebus/what_ifReply")
        );
        assert_eq!(request, "joulebus_msgs::srv::dds_::WhatIf_Request_");
        assert_eq!(response, "joulebus_msgs::srv::dds_::WhatIf_Response_");
    }
}
