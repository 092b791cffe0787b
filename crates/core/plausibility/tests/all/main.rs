//! Tests of the judgement.

mod grid;
mod robot;
mod stamps;
