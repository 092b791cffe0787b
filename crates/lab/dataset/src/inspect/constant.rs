//! Columns that never change.

use crate::trial::{Column, Trial};

/// The value of a column, in SI units, if there are at least two recorded values and all are equal.
pub(super) fn only_value(trial: &Trial, column: Column) -> Option<f64> {
    let mut known = trial.column(column)?.iter().filter(|value| !value.is_nan());
    let first = known.next()?;
    let mut others = 0;
    let same = known.all(|value| {
        others += 1;
        value == first
    });
    (same && others > 0).then_some(*first)
}
