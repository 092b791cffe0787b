//! The power unit of a report.

use super::document::{Cell, Column};

/// Watt, or milliwatt for robots with a low consumption.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Unit {
    Milliwatt,
    Watt,
}

impl Unit {
    /// Milliwatt if the mean is below 20 W.
    pub(super) fn new(mean_power_w: f64) -> Self {
        if mean_power_w.abs() < 20.0 { Self::Milliwatt } else { Self::Watt }
    }

    pub(super) const fn name(self) -> &'static str {
        match self {
            Self::Milliwatt => "mW",
            Self::Watt => "W",
        }
    }

    const fn suffix(self) -> &'static str {
        match self {
            Self::Milliwatt => "mw",
            Self::Watt => "w",
        }
    }

    /// Converts watt to this unit.
    pub(super) fn scaled_w(self, value_w: f64) -> f64 {
        match self {
            Self::Milliwatt => value_w * 1e3,
            Self::Watt => value_w,
        }
    }

    /// A column of power: `column("mae", "MAE")` has the key `mae_mw`.
    pub(super) fn column(self, key: &str, title: &str) -> Column {
        Column::new(format!("{key}_{}", self.suffix()), format!("{title} ({})", self.name()))
    }

    /// A cell for a power. A difference of powers gets one more decimal than a power.
    pub(super) fn cell(self, value_w: f64, fine: bool) -> Cell {
        let decimals = match self {
            Self::Milliwatt => usize::from(fine),
            Self::Watt => 2 + usize::from(fine),
        };
        Cell::Number(self.scaled_w(value_w), decimals)
    }

    pub(super) fn range(self, ends_w: [f64; 2], fine: bool) -> Cell {
        let decimals = match self {
            Self::Milliwatt => usize::from(fine),
            Self::Watt => 2 + usize::from(fine),
        };
        Cell::Range(ends_w.map(|end| self.scaled_w(end)), decimals)
    }
}
