//! Settings of the policies: the candidates, and the chosen ones.

use crate::policy::Policy;

/// The settings that are compared, chosen on seeds 1001 to 1016
/// (`joulebus mission --tune --seeds 16`). Of those that strand at most one of the 320 robots they
/// do the most tasks.
pub const CHOSEN: [Policy; 4] = [
    Policy::Threshold { begin: 0.55, go: 0.3 },
    Policy::Distance { power_w: 5.0, reserve: 0.15 },
    Policy::Network { margin: 1.2, reserve: 0.15 },
    Policy::Joulebus { coverage: 0.98, reserve: 0.025 },
];

/// The settings that `--tune` tries: around the best of each policy, which must not lie at an edge.
pub fn tried() -> Vec<Policy> {
    let mut policies = Vec::new();
    for begin in [0.5, 0.55, 0.6] {
        policies.extend([0.25, 0.3, 0.35].map(|go| Policy::Threshold { begin, go }));
    }
    for reserve in [0.1, 0.15, 0.2, 0.25] {
        let powers_w = [4.5, 5.0, 5.5];
        policies.extend(powers_w.map(|power_w| Policy::Distance { power_w, reserve }));
    }
    for reserve in [0.1, 0.15, 0.2, 0.25] {
        let margins = [1.0, 1.2, 1.4];
        policies.extend(margins.map(|margin| Policy::Network { margin, reserve }));
    }
    for reserve in [0.0, 0.025, 0.05, 0.1] {
        let coverages = [0.9, 0.95, 0.98, 0.995];
        policies.extend(coverages.map(|coverage| Policy::Joulebus { coverage, reserve }));
    }
    policies
}
