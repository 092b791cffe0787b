//! Several packs of one robot: what their messages say becomes what one battery would.

use crate::battery::CurrentMonitor;
use crate::front::{Mapped, SOC};
use crate::observation::Observation;

/// The packs of one robot, each with its energy from full to empty, Wh.
///
/// Power is the sum, and the charge is the energy in all packs as a share of what they hold. The
/// voltage is the mean, and the current is the power by that voltage. A pack of which a value is
/// unknown makes that value unknown, because half a battery must not pass for a whole one.
#[derive(Debug, Clone)]
pub struct Packs {
    capacities_wh: Vec<f64>,
    newest: Vec<Option<Newest>>,
    monitors: Vec<CurrentMonitor>,
}

#[derive(Debug, Clone, Copy)]
struct Newest {
    at_ns: u64,
    said: Mapped,
    /// It is in no sum yet.
    is_new: bool,
}

/// What packs make together.
#[derive(Debug, Clone, Copy)]
pub enum Packed {
    /// Other packs are yet to say something.
    Waits,
    /// The pack of this number has said nothing for too long.
    Missing(usize),
    /// All have.
    Whole(Mapped),
}

impl Packs {
    /// Packs of which nothing is known.
    #[must_use]
    pub fn new(capacities_wh: Vec<f64>) -> Self {
        let count = capacities_wh.len();
        Self {
            capacities_wh,
            newest: vec![None; count],
            monitors: vec![CurrentMonitor::new(); count],
        }
    }

    /// Takes what one pack says. Each sum has something new of every pack, none of it older than
    /// `holds_ns`.
    pub fn take(&mut self, pack: usize, mut said: Mapped, at_ns: u64, holds_ns: u64) -> Packed {
        let monitor = &mut self.monitors[pack];
        monitor.take(&said.seen);
        said.is_reserved &= !monitor.measures_one_ampere();
        let repeats = self.newest[pack].is_some_and(|newest| newest.is_new);
        self.newest[pack] = Some(Newest { at_ns, said, is_new: true });
        let is_old = |newest: &Newest| at_ns.saturating_sub(newest.at_ns) > holds_ns;
        let missing = self.newest.iter().position(|newest| newest.as_ref().is_none_or(is_old));
        let waits = !self.newest.iter().flatten().all(|newest| newest.is_new);
        match missing {
            Some(missing) if repeats => Packed::Missing(missing),
            None if !waits => {
                let parts: Vec<Mapped> =
                    self.newest.iter().flatten().map(|newest| newest.said).collect();
                self.newest.iter_mut().flatten().for_each(|newest| newest.is_new = false);
                Packed::Whole(whole(&self.capacities_wh, &parts))
            }
            _ => Packed::Waits,
        }
    }
}

/// The one battery that packs make, each with its energy from full to empty. One pack is that
/// battery.
#[must_use]
pub fn whole(capacities_wh: &[f64], parts: &[Mapped]) -> Mapped {
    if let [one] = parts {
        return *one;
    }
    let sum = |of: &dyn Fn(&Mapped) -> f64| parts.iter().map(of).sum::<f64>();
    let voltage_v = sum(&|part| part.seen.voltage_v) / parts.len() as f64;
    // A pack's monitor that measures nothing must not vanish among those that do.
    let flow_w = sum(&|part| match part.is_reserved {
        true => f64::NAN,
        false => part.seen.voltage_v * part.seen.current_a,
    });
    let is_product = parts.iter().any(|part| part.is_product);
    let capacity_wh: f64 = capacities_wh.iter().sum();
    let energies_wh = capacities_wh.iter().zip(parts).map(|(wh, part)| wh * part.seen.soc);
    // Beside a share, a percentage cannot be told.
    let in_range = parts.iter().filter(|part| SOC.contains(&part.seen.soc)).count();
    let soc = energies_wh.sum::<f64>() / capacity_wh;
    let charging = any_of(parts.iter().map(|part| part.seen.charging));
    // All are full only if none is not.
    let not_full = any_of(parts.iter().map(|part| part.full.map(|full| !full)));
    Mapped {
        seen: Observation {
            power_w: if is_product { flow_w } else { sum(&|part| part.seen.power_w) },
            voltage_v,
            current_a: flow_w / voltage_v,
            soc: if in_range == 0 || in_range == parts.len() { soc } else { f64::NAN },
            charging,
            ..Observation::at(0.0)
        },
        is_product,
        power_of: parts.first().map_or_else(Default::default, |part| part.power_of),
        is_reserved: false,
        full: not_full.map(|is_not| !is_not),
    }
}

/// True if any is, false if none is, unknown if one may be.
fn any_of(mut all: impl Iterator<Item = Option<bool>> + Clone) -> Option<bool> {
    if all.clone().any(|one| one == Some(true)) {
        return Some(true);
    }
    all.all(|one| one == Some(false)).then_some(false)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::front::{Field, PowerOf, Said};

    fn pack(volt: f64, ampere: f64, soc: f64) -> Said {
        let said = Said { product_of: Some(PowerOf::Battery), ..Said::default() };
        said.with(Field::Voltage, volt).with(Field::Current, ampere).with(Field::Soc, soc)
    }

    fn map(said: Said) -> Mapped {
        said.map(|_, _| {})
    }

    #[test]
    fn packs_are_summed_and_what_one_does_not_know_is_unknown() {
        let left = Said { full: Some(true), charging: Some(true), ..pack(24.0, 2.0, 0.9) };
        let nan = f64::NAN;
        // The other pack, and the power, voltage and charge of both, and whether they are full.
        for (right, power_w, volt, soc, full) in [
            (pack(26.0, 1.0, 0.3), 74.0, 25.0, 0.45, None),
            (Said { full: Some(false), ..pack(24.0, -2.0, 0.5) }, 0.0, 24.0, 0.6, Some(false)),
            (Said { full: Some(true), ..pack(24.0, nan, 0.5) }, nan, 24.0, 0.6, Some(true)),
            (Said { written_a: -1.0, ..pack(24.0, 1.0, 0.5) }, nan, 24.0, 0.6, None),
            (pack(24.0, 1.0, nan), 72.0, 24.0, nan, None),
            (pack(24.0, 1.0, 96.0), 72.0, 24.0, nan, None),
            (Said { present: Some(false), ..pack(0.0, 0.0, 0.0) }, nan, nan, nan, None),
        ] {
            let found = whole(&[100.0, 300.0], &[map(left), map(right)]);
            let seen = found.seen;
            for (one, expected) in [
                (seen.power_w, power_w),
                (seen.voltage_v, volt),
                (seen.soc, soc),
                (seen.current_a, power_w / volt),
            ] {
                assert!(
                    (one - expected).abs() < 1e-12 || one.is_nan() && expected.is_nan(),
                    "{found:?}"
                );
            }
            assert_eq!((seen.charging, found.full), (Some(true), full), "{right:?}");
        }
        // Two percentages stay one, so that whoever judges them sees it.
        let found = whole(&[1.0, 1.0], &[map(pack(24.0, 1.0, 90.0)), map(pack(24.0, 1.0, 80.0))]);
        assert_eq!(
            (found.seen.soc, found.is_product, found.power_of),
            (85.0, true, PowerOf::Battery)
        );
    }

    #[test]
    fn a_sum_has_something_new_of_each_pack_and_a_missing_one_is_named() {
        let mut packs = Packs::new(vec![1.0, 1.0]);
        let mut take = |pack: usize, at_ns| match packs.take(pack, map(pack_of(pack)), at_ns, 100) {
            Packed::Waits => "waits".to_owned(),
            Packed::Missing(pack) => format!("missing {pack}"),
            Packed::Whole(found) => format!("{} W", found.seen.power_w),
        };
        for (pack, at_ns, expected) in [
            (0, 0, "waits"),
            (0, 10, "missing 1"),
            (1, 20, "72 W"),
            (1, 30, "waits"),
            (1, 40, "waits"),
            (0, 50, "72 W"),
            (0, 60, "waits"),
            // The other one has said nothing for too long, and then is there again.
            (0, 200, "missing 1"),
            (1, 310, "waits"),
            (1, 320, "missing 0"),
            (0, 330, "72 W"),
        ] {
            assert_eq!(take(pack, at_ns), expected, "pack {pack} at {at_ns}");
        }
    }

    #[test]
    fn a_pack_whose_coarse_monitor_measures_one_ampere_keeps_its_power() {
        for (others, power_w) in
            [([-0.9, -1.1], 48.0), ([-0.93, -1.17], f64::NAN), ([-1.0; 2], f64::NAN)]
        {
            let mut packs = Packs::new(vec![1.0, 1.0]);
            let mut found = f64::NAN;
            for (at_ns, written_a) in (0..).zip(others.into_iter().chain([-1.0])) {
                for number in 0..2 {
                    let said = map(Said { written_a, ..pack(24.0, -written_a, 0.5) });
                    if let Packed::Whole(whole) = packs.take(number, said, at_ns, 100) {
                        found = whole.seen.power_w;
                    }
                }
            }
            assert!(found == power_w || found.is_nan() && power_w.is_nan(), "{others:?}: {found}");
        }
        let one = map(Said { written_a: -1.0, ..pack(24.0, 1.0, 0.5) });
        assert!(whole(&[1.0], &[one]).is_reserved, "whoever takes one battery judges its monitor");
    }

    fn pack_of(place: usize) -> Said {
        pack(24.0, [1.0, 2.0][place], 0.5)
    }
}
