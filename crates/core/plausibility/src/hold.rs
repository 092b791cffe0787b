//! Commands that apply long after their controller fell silent.

use serde::Deserialize;

use crate::observation::Observation;

/// Time for which a command applies if no other one comes, unless a file states otherwise, s.
pub const COMMAND_HOLDS_S: f64 = 0.5;

/// Behaviour of a robot whose command has expired.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Expired {
    /// Not known.
    #[default]
    Unknown,
    /// Its controller stops it: the command is 0.
    Stops,
}

/// Speeds that a command must have to be missed, m/s and rad/s.
const COMMANDED_MPS: f64 = 0.05;
const COMMANDED_RADPS: f64 = 0.2;
/// Measured speeds of a robot at rest.
const AT_REST_MPS: f64 = 0.01;
const AT_REST_RADPS: f64 = 0.02;
/// Maximum time that an unchanged command may move nothing, s.
const MAX_HOLD_S: f64 = 5.0;
/// Rows of motion that show that the measured speed works.
const MIN_MOTION: u64 = 20;

/// The longest time for which one command moved nothing.
#[derive(Debug, Clone, Copy, Default)]
pub(crate) struct Hold {
    command: Option<[u64; 2]>,
    since_s: Option<f64>,
    motion: u64,
    rows: u64,
    longest: Option<Held>,
}

/// A command that moved nothing.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Held {
    pub(crate) v_mps: f64,
    pub(crate) omega_radps: f64,
    pub(crate) held_s: f64,
    pub(crate) rows: u64,
}

impl Hold {
    pub(crate) fn take(&mut self, seen: &Observation) {
        let commands =
            seen.v_mps.abs() >= COMMANDED_MPS || seen.omega_radps.abs() >= COMMANDED_RADPS;
        let moves = seen.v_measured_mps.abs() > AT_REST_MPS
            || seen.omega_measured_radps.abs() > AT_REST_RADPS;
        let rests = seen.v_measured_mps.abs() <= AT_REST_MPS
            && (seen.omega_measured_radps.is_nan()
                || seen.omega_measured_radps.abs() <= AT_REST_RADPS);
        self.motion += u64::from(commands && moves);
        // By bits: an unknown part equals itself.
        let command = [seen.v_mps, seen.omega_radps].map(f64::to_bits);
        if !commands || !rests || self.command.is_some_and(|before| before != command) {
            self.since_s = None;
        }
        self.command = Some(command);
        if !(commands && rests) {
            return;
        }
        let since_s = match self.since_s {
            Some(since_s) => {
                self.rows += 1;
                since_s
            }
            None => {
                self.rows = 1;
                self.since_s = Some(seen.time_s);
                seen.time_s
            }
        };
        let held_s = seen.time_s - since_s;
        if self.longest.is_none_or(|longest| held_s > longest.held_s) {
            self.longest = Some(Held {
                v_mps: seen.v_mps,
                omega_radps: seen.omega_radps,
                held_s,
                rows: self.rows,
            });
        }
    }

    /// The longest, if it is too long.
    pub(crate) fn too_long(&self) -> Option<Held> {
        self.longest.filter(|held| held.held_s > MAX_HOLD_S && self.motion >= MIN_MOTION)
    }
}
