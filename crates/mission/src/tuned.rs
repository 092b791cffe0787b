//! Settings of the policies: what was tried, and what was chosen.

use crate::policy::Policy;

/// The settings that are compared, chosen on seeds 1001 to 1012 (`joulebus mission --tune --seeds 12`): of
/// those with the fewest stranded robots the one with the most tasks.
pub const CHOSEN: [Policy; 4] = [
    Policy::Threshold {
        begin: 0.6,
        go: 0.3,
    },
    Policy::Distance { power_w: 6.5 },
    Policy::Network { margin: 1.6 },
    Policy::Joulebus { coverage: 0.98 },
];

/// The settings that `--tune` tries.
#[must_use]
pub fn tried() -> Vec<Policy> {
    let mut policies = Vec::new();
    for begin in [0.5, 0.55, 0.6] {
        policies.extend([0.3, 0.35].map(|go| Policy::Threshold { begin, go }));
    }
    let powers_w = [5.5, 5.75, 6.0, 6.25, 6.5, 6.75];
    policies.extend(powers_w.map(|power_w| Policy::Distance { power_w }));
    let margins = [1.2, 1.4, 1.5, 1.6];
    policies.extend(margins.map(|margin| Policy::Network { margin }));
    let coverages = [0.8, 0.9, 0.95, 0.98];
    policies.extend(coverages.map(|coverage| Policy::Joulebus { coverage }));
    policies
}
