//! Tests of the judgement.

mod faults;
mod grid;
mod robot;
mod stamps;
