//! The reference fleet of `crates/fleet/tests`.

#[path = "../../crates/fleet/tests/oracle/compare.rs"]
pub(crate) mod compare;
#[path = "../../crates/fleet/tests/oracle/experts.rs"]
mod experts;
#[path = "../../crates/fleet/tests/oracle/intake.rs"]
mod intake;
#[path = "../../crates/fleet/tests/oracle/robot.rs"]
mod robot;
#[path = "../../crates/fleet/tests/world/mod.rs"]
pub(crate) mod world;

pub(crate) use self::compare::compare;
pub(crate) use intake::Oracle;
