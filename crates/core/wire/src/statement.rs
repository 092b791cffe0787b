//! What a person states of a robot.

/// A person's statement of a robot, which the next tick takes.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Statement {
    /// The power that it draws is its new normal: the level that it had is forgotten.
    NewNormal,
    /// Its battery was measured: state of charge, 0 to 1.
    Charge(f32),
    /// Its battery is full.
    Full,
    /// Its battery was exchanged.
    Exchanged,
}

impl Statement {
    /// The code and the value in shared memory.
    #[must_use]
    pub const fn encode(self) -> (u32, f32) {
        match self {
            Self::NewNormal => (0, 0.0),
            Self::Charge(soc) => (1, soc),
            Self::Full => (2, 0.0),
            Self::Exchanged => (3, 0.0),
        }
    }

    /// From shared memory. `None` for a code of a newer version, or no state of charge.
    #[must_use]
    pub fn decode(code: u32, value: f32) -> Option<Self> {
        match code {
            0 => Some(Self::NewNormal),
            1 => (0.0..=1.0).contains(&value).then_some(Self::Charge(value)),
            2 => Some(Self::Full),
            3 => Some(Self::Exchanged),
            _ => None,
        }
    }

    /// True if it is of the battery.
    #[must_use]
    pub const fn is_of_battery(self) -> bool {
        !matches!(self, Self::NewNormal)
    }
}

impl std::fmt::Display for Statement {
    fn fmt(&self, out: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::NewNormal => write!(out, "its power is its new normal"),
            Self::Charge(soc) => write!(out, "battery at {:.0} %", 100.0 * soc),
            Self::Full => write!(out, "battery full"),
            Self::Exchanged => write!(out, "battery exchanged"),
        }
    }
}
