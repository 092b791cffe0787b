//! The reference fleet of `crates/core/fleet/tests`.

#[path = "../../crates/core/fleet/tests/all/oracle/compare.rs"]
pub(crate) mod compare;
#[path = "../../crates/core/fleet/tests/all/oracle/experts.rs"]
mod experts;
#[path = "../../crates/core/fleet/tests/all/oracle/intake.rs"]
mod intake;
#[path = "../../crates/core/fleet/tests/all/oracle/robot.rs"]
mod robot;

pub(crate) use self::compare::compare;
pub(crate) use intake::Oracle;
