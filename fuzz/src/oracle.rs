//! The reference fleet of `crates/fleet/tests`.

#[path = "../../crates/fleet/tests/all/oracle/compare.rs"]
pub(crate) mod compare;
#[path = "../../crates/fleet/tests/all/oracle/experts.rs"]
mod experts;
#[path = "../../crates/fleet/tests/all/oracle/intake.rs"]
mod intake;
#[path = "../../crates/fleet/tests/all/oracle/robot.rs"]
mod robot;

pub(crate) use self::compare::compare;
pub(crate) use intake::Oracle;
