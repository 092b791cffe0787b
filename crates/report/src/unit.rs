//! Power in the unit in which its numbers are short.

use super::document::{Cell, Column};

/// Watt, or milliwatt where a robot draws little.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Unit {
    Milliwatt,
    Watt,
}

impl Unit {
    /// Milliwatt below 20 W on average.
    pub(super) fn of(mean_power_w: f64) -> Self {
        if mean_power_w.abs() < 20.0 {
            Self::Milliwatt
        } else {
            Self::Watt
        }
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

    /// Watt in this unit.
    pub(super) fn scaled_w(self, value_w: f64) -> f64 {
        match self {
            Self::Milliwatt => value_w * 1e3,
            Self::Watt => value_w,
        }
    }

    /// A column of power: `column("mae", "MAE")` has the key `mae_mw`.
    pub(super) fn column(self, key: &str, title: &str) -> Column {
        Column::new(
            format!("{key}_{}", self.suffix()),
            format!("{title} ({})", self.name()),
        )
    }

    /// A place for watt; a difference of powers needs a decimal more than a power.
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
