//! Edits are tried on what was read before they are told.

use crate::edit::Edit;
use crate::finding::Finding;
use crate::judge::{Judge, Known, TimeUnit};
use crate::observation::Observation;

impl Edit {
    /// Applies it to an observation. What is unknown stays so.
    fn apply(&self, seen: &mut Observation, rows: &Rows<impl Sized>) {
        match self {
            Self::Turn => {
                seen.current_a = -seen.current_a;
                if rows.turns_power {
                    seen.power_w = -seen.power_w;
                }
            }
            Self::Unit { quantity, factor, .. } => *seen.value_mut(*quantity) *= factor,
            Self::Time { unit_s, .. } => seen.time_s *= unit_s,
            Self::Missing { quantity, value, .. } => {
                let found = seen.value_mut(*quantity);
                if (*found - value).abs() <= 1e-6 * value.abs() {
                    *found = f64::NAN;
                }
            }
        }
        if rows.is_product && !seen.power_w.is_nan() {
            seen.power_w = seen.voltage_v * seen.current_a;
        }
    }

    fn known(&self, known: Known) -> Known {
        match self {
            Self::Unit { quantity, .. } => known.stated(*quantity),
            Self::Time { .. } => known.timed(TimeUnit::Named),
            Self::Turn => known.turned(!known.is_turned()),
            Self::Missing { .. } => known,
        }
    }
}

/// What was read, on which edits are tried.
#[derive(Debug, Clone, Copy)]
pub struct Rows<R> {
    rows: R,
    known: Known,
    is_product: bool,
    turns_power: bool,
}

/// Edits of other findings that are tried together with one.
const MAX_TOGETHER: usize = 8;

impl<R: Iterator<Item = Observation> + Clone> Rows<R> {
    /// Rows in the order in which they came, and what is known of their source. `is_product`: power
    /// is voltage times current.
    pub fn new(rows: R, known: Known, is_product: bool) -> Self {
        let products = rows.clone().map(|seen| seen.power_w * seen.current_a);
        let turns_power = products.filter(|product| !product.is_nan()).sum::<f64>() >= 0.0;
        Self { rows, known, is_product, turns_power }
    }

    /// The edits of a finding that leave it no more, and bring no other error: by themselves, or
    /// with those of `all` other findings. None if the rows do not show it without them. `column`
    /// is the source's name for a finding's quantity.
    pub fn working(
        &self,
        finding: &Finding,
        all: &[Finding],
        column: impl Fn(&Finding) -> Option<String>,
    ) -> Vec<Edit> {
        let edits = |of: &Finding| of.edits(column(of).as_deref());
        let own = edits(finding);
        if own.is_empty() || !self.judged(&[]).iter().any(|found| found.is_like(finding)) {
            return Vec::new();
        }
        let others = all.iter().filter(|other| !other.is_like(finding));
        let mut together: Vec<Vec<Edit>> = vec![Vec::new()];
        for candidates in others.map(edits).filter(|edits| !edits.is_empty()) {
            let with: Vec<Vec<Edit>> = together
                .iter()
                .flat_map(|before| {
                    let with =
                        |edit: &Edit| [before.as_slice(), std::slice::from_ref(edit)].concat();
                    candidates.iter().map(with).collect::<Vec<_>>()
                })
                .collect();
            together.extend(with);
            together.truncate(MAX_TOGETHER);
        }
        let works = |edit: &Edit| {
            together.iter().any(|others| {
                let left = self.judged(&[std::slice::from_ref(edit), others.as_slice()].concat());
                let is_new =
                    |left: &Finding| left.is_error() && !all.iter().any(|one| one.is_like(left));
                !left.iter().any(|left| left.is_like(finding) || is_new(left))
            })
        };
        own.into_iter().filter(works).collect()
    }

    /// Findings with edits.
    fn judged(&self, edits: &[Edit]) -> Vec<Finding> {
        let known = edits.iter().fold(self.known, |known, edit| edit.known(known));
        let mut judge = Judge::new(known);
        for mut seen in self.rows.clone() {
            edits.iter().for_each(|edit| edit.apply(&mut seen, self));
            judge.take(&seen);
        }
        judge.findings()
    }
}
