//! Faults of simulated robots in command-line syntax.

use std::str::FromStr;

use joulebus_plant::Fault;

use joulebus_source::rate::number;

/// Syntax of `--fault`.
pub(super) const HELP: &str = "ROBOT=KIND[@SECONDS]";

/// A fault of a simulated robot, from a time on.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct FaultArgument {
    pub(crate) robot: u32,
    pub(super) fault: Fault,
    /// When it begins, s after the start.
    pub(super) from_s: f64,
}

impl FromStr for FaultArgument {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let shape = || format!("{text:?}: write {HELP}, for example 3=load:1.5@10");
        let (robot, rest) = text.split_once('=').ok_or_else(shape)?;
        let (kind, from) = rest.split_once('@').unwrap_or((rest, "0"));
        let robot = robot.parse().map_err(|_| format!("{robot:?} is not a robot id"))?;
        let fault = match kind.split_once(':') {
            Some(("load", value)) => Fault::ExtraLoad { power_w: number(value, -1e6, 1e6, "W")? },
            Some(("noise", value)) => Fault::Noise { std_w: number(value, 0.0, 1e6, "W")? },
            None if kind == "stuck" => Fault::StuckSensor,
            _ => {
                let known = "load:WATT, noise:WATT (standard deviation), stuck";
                return Err(format!("{kind:?} is not a fault, known are: {known}"));
            }
        };
        Ok(Self { robot, fault, from_s: number(from, 0.0, 1e8, "s")? })
    }
}

/// The fault in a plant whose power is multiplied by `scale` afterwards.
pub(super) fn divided(fault: Fault, scale: f64) -> Fault {
    match fault {
        Fault::ExtraLoad { power_w } => Fault::ExtraLoad { power_w: power_w / scale },
        Fault::Noise { std_w } => Fault::Noise { std_w: std_w / scale },
        fault => fault,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn faults_are_parsed_as_documented() {
        let load = Fault::ExtraLoad { power_w: 1.5 };
        for (text, expected) in [
            ("3=load:1.5@10", Some((3, load, 10.0))),
            ("3=load:1.5", Some((3, load, 0.0))),
            ("0=stuck@0.5", Some((0, Fault::StuckSensor, 0.5))),
            ("7=noise:0.2", Some((7, Fault::Noise { std_w: 0.2 }, 0.0))),
            ("7=noise:-0.2", None),
            ("7=load", None),
            ("7=load:NaN", None),
            ("7=stuck:1", None),
            ("7=broken", None),
            ("stuck", None),
            ("-1=stuck", None),
            ("7=stuck@-1", None),
            ("7=stuck@", None),
        ] {
            let read = text.parse::<FaultArgument>().ok();
            let read = read.map(|read| (read.robot, read.fault, read.from_s));
            assert_eq!(read, expected, "{text}");
        }
    }
}
