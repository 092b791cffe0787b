//! What charges teach: the capacity of a battery, its wear, and the time on the charger.

use joulebus_fleet::{Fleet, FleetState, Ledger, SavedBattery};
use joulebus_settings::{Battery, ChargeReading, Platform};
use joulebus_testkit_fleets::{self as world, MS, Source};
use joulebus_wire::{Alarm, Budget, Sample, Statement, sample_flag};

const STEP_NS: u64 = 5_000 * MS;
const STEP_S: f64 = 5.0;
const CAPACITY_J: f64 = 36_000.0;
const DRIVE_W: f64 = 10.0;

/// A robot, and its battery as it is.
struct Bench {
    fleet: Fleet,
    source: Source,
    step: u64,
    /// Of the capacity, J, and its charge.
    true_j: f64,
    soc: f64,
    gauge: Gauge,
}

#[derive(Clone, Copy, PartialEq)]
enum Gauge {
    None,
    /// The true charge in steps of 1 %.
    True,
    /// The true charge, bent by so much in the middle.
    Bent(f64),
    /// What the budget says.
    Mirror,
    /// The true charge, and in turn that of another battery, which rests.
    Two(f64),
}

fn fleet(charge_reading: ChargeReading) -> Fleet {
    let mut settings = world::settings(2);
    settings.intake.leave_after_ns = 3_600_000 * MS;
    settings.intake.max_jump_ns = u64::MAX;
    settings.platforms.truncate(1);
    let battery = Battery {
        charge_reading,
        charge_efficiency: 1.0,
        initial_soc_lo: 0.95,
        ..Battery::new(CAPACITY_J, 0.05)
    };
    settings.platforms[0] = Platform {
        robots: vec![0..=1],
        period_ns: STEP_NS,
        stale_after_ns: 4 * STEP_NS,
        hold_max_ns: 4 * STEP_NS,
        stuck_after_ns: 1_000 * STEP_NS,
        power_min_w: -100.0,
        power_max_w: 100.0,
        battery: Some(battery),
        ..settings.platforms[0].clone()
    };
    let model = world::models().swap_remove(0);
    Fleet::new(settings, vec![model]).expect("consistent settings")
}

impl Bench {
    fn new(share: f64, gauge: Gauge) -> Self {
        let (fleet, true_j) = (fleet(ChargeReading::Battery), share * CAPACITY_J);
        Self { fleet, source: Source::new(1, 1), step: 20_000, true_j, soc: 1.0, gauge }
    }

    fn now_ns(&self) -> u64 {
        self.step * STEP_NS
    }

    fn send(&mut self, power_w: f64, flags: u32) -> Budget {
        self.step += 1;
        self.soc = (self.soc - power_w * STEP_S / self.true_j).clamp(0.0, 1.0);
        let now_ns = self.now_ns();
        let sample = Sample::new(0, self.step, now_ns).command(0.1, 0.0);
        let sample = sample.reading(power_w as f32, now_ns).with(flags);
        let percent = |soc: f64| ((100.0 * soc).round() / 100.0).clamp(0.0, 1.0) as f32;
        let sample = match self.gauge {
            Gauge::None => sample,
            Gauge::True => sample.state_of_charge(percent(self.soc)),
            Gauge::Bent(by) => {
                let bent = self.soc + by * (std::f64::consts::PI * self.soc).sin();
                sample.state_of_charge(percent(bent))
            }
            Gauge::Two(other) if self.step.is_multiple_of(2) => {
                sample.state_of_charge(percent(other))
            }
            Gauge::Two(_) => sample.state_of_charge(percent(self.soc)),
            Gauge::Mirror => match self.fleet.is_empty() {
                true => sample,
                false => sample.state_of_charge(percent(self.budget().soc.into())),
            },
        };
        self.source.tick(&mut self.fleet, &[sample], now_ns);
        self.budget()
    }

    /// Drives until so much is left.
    fn drive(&mut self, to: f64) -> Budget {
        while self.soc > to {
            self.send(DRIVE_W, 0);
        }
        self.budget()
    }

    /// Charges to full. The last fifth takes twice as long, and the last tenth four times. Returns
    /// the seconds from 20 % and from 80 % on.
    fn charge(&mut self) -> (f64, f64) {
        let (mut all_s, mut top_s) = (0.0, 0.0);
        while self.soc < 1.0 {
            let power_w = match self.soc {
                soc if soc < 0.8 => 40.0,
                soc if soc < 0.9 => 20.0,
                _ => 10.0,
            };
            all_s += if self.soc >= 0.2 { STEP_S } else { 0.0 };
            top_s += if self.soc >= 0.8 { STEP_S } else { 0.0 };
            self.send(-power_w, sample_flag::CHARGING);
        }
        for _ in 0..5 {
            self.send(0.0, sample_flag::CHARGING | sample_flag::FULL);
        }
        (all_s, top_s)
    }

    fn state(&mut self, statement: Statement) -> Budget {
        self.fleet.take_statement(0, statement, self.now_ns());
        self.fleet.tick(self.now_ns(), false);
        self.budget()
    }

    fn budget(&self) -> Budget {
        world::budget(&self.fleet, 0)
    }

    /// The learned capacity as a share of the stated one, 1 before anything is learned.
    fn learned(&self) -> f64 {
        self.budget().learned_capacity_j().map_or(1.0, |(joules, _)| f64::from(joules) / CAPACITY_J)
    }

    fn is_worn(&self) -> bool {
        world::diagnostic(&self.fleet, 0).alarms().has(Alarm::BatteryWorn)
    }
}

#[test]
fn a_worn_battery_is_learned_from_its_charges_counts_in_budgets_and_raises_an_alarm() {
    for (share, gauge) in [(0.6, Gauge::True), (0.6, Gauge::Bent(0.03)), (1.2, Gauge::True)] {
        let mut bench = Bench::new(share, gauge);
        let mut before = 1.0;
        for cycle in 0..14 {
            let empty = bench.drive(0.15);
            // Before that the sensor gets the blame.
            assert!(cycle < 6 || (empty.soc - 0.15).abs() < 0.06, "cycle {cycle}: {empty:?}");
            bench.charge();
            let now = bench.learned();
            println!("{share}, cycle {cycle}: {now:.3}");
            assert!((now / before - 1.0).abs() < 0.1 + 1e-4, "{before} to {now}");
            before = now;
        }
        assert!((before / share - 1.0).abs() < 0.05, "{before} of {share}");
        assert_eq!(bench.is_worn(), share < 0.8);
        // The energy left is the charge times it, with its error.
        let half = bench.drive(0.5);
        let (capacity_j, sd_j) = half.learned_capacity_j().expect("learned");
        assert!((half.left_j / (half.soc * capacity_j) - 1.0).abs() < 1e-4, "{half:?}");
        let usable_j = (0.5 - 0.05) * bench.true_j;
        let range = [half.usable_lo_j, half.usable_j].map(f64::from);
        assert!(range[0] < usable_j && (range[1] / usable_j - 1.0).abs() < 0.1, "{half:?}");
        let of_charge_j = (half.soc_lo - 0.05) * capacity_j;
        let by_capacity_j = of_charge_j - half.usable_lo_j;
        assert!(by_capacity_j > 0.2 * sd_j && by_capacity_j < 2.0 * sd_j, "{half:?}");
        let lasts_s = usable_j / DRIVE_W;
        let [lo_s, hi_s] = [half.time_to_empty_lo_s, half.time_to_empty_hi_s].map(f64::from);
        assert!(lo_s < lasts_s && lasts_s < hi_s, "{lasts_s} s of {half:?}");
        // Another battery begins anew.
        bench.state(Statement::Exchanged);
        let other = bench.send(DRIVE_W, 0);
        assert_eq!((other.learned_capacity_j(), bench.is_worn()), (None, false));
    }
}

#[test]
fn persons_teach_the_capacity_where_no_gauge_does() {
    let mut bench = Bench::new(0.7, Gauge::None);
    for _ in 0..8 {
        bench.charge();
        bench.drive(0.3);
        bench.state(Statement::Charge(0.3));
        bench.drive(0.29);
    }
    assert!((bench.learned() / 0.7 - 1.0).abs() < 0.06, "{}", bench.learned());
}

/// A wrong gauge, a robot with the number of another, and forged messages.
#[test]
fn nothing_moves_the_capacity_by_more_than_a_tenth_a_drive_and_nothing_without_energy() {
    let mut bench = Bench::new(1.0, Gauge::True);
    bench.send(0.0, 0);
    for _ in 0..40 {
        bench.state(Statement::Full);
        bench.state(Statement::Charge(0.2));
    }
    assert_eq!(bench.budget().learned_capacity_j(), None);
    let mut seed = 7u64;
    let (mut before, mut drives, mut moved) = (1.0, 0, 0);
    for _ in 0..60 {
        seed = seed.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1);
        // Another robot has its number, its gauge lies, or somebody states anything.
        bench.true_j = [0.3, 1.0, 4.0][(seed >> 33) as usize % 3] * CAPACITY_J;
        bench.gauge = [Gauge::True, Gauge::Bent(-0.2), Gauge::None][(seed >> 40) as usize % 3];
        let to = [0.6, 0.3, 0.05][(seed >> 50) as usize % 3];
        let mut watch = |bench: &Bench| {
            let now = bench.learned();
            assert!((now / before - 1.0f64).abs() < 0.1 + 1e-4, "{before} to {now}");
            assert!((0.1..=1.5).contains(&now), "{now}");
            moved += u32::from(now.to_bits() != before.to_bits());
            before = now;
        };
        while bench.soc > to {
            bench.send(DRIVE_W, 0);
            watch(&bench);
        }
        if seed >> 60 & 1 == 1 {
            bench.state(Statement::Charge(0.1));
            watch(&bench);
        }
        drives += 1;
        for _ in 0..4 {
            bench.soc = 1.0;
            bench.send(-40.0, sample_flag::CHARGING | sample_flag::FULL);
            watch(&bench);
        }
    }
    assert!(moved > 10 && moved <= 2 * drives, "{moved} of {drives}");
}

#[test]
fn a_gauge_that_mirrors_our_own_count_teaches_nothing() {
    let mut bench = Bench::new(0.7, Gauge::Mirror);
    for _ in 0..5 {
        while bench.fleet.is_empty() || bench.budget().soc > 0.2 {
            bench.send(DRIVE_W, 0);
        }
        bench.send(DRIVE_W, 0);
        bench.soc = 0.5;
        bench.charge();
    }
    assert_eq!(bench.budget().learned_capacity_j(), None);
    assert_eq!(bench.budget().capacity_weight.to_bits(), 0);
}

#[test]
fn two_batteries_in_turn_and_clocks_that_jump_teach_no_other_capacity() {
    for other in [0.05, 0.5, 1.0] {
        let mut bench = Bench::new(0.7, Gauge::Two(other));
        for _ in 0..10 {
            bench.drive(0.15);
            bench.charge();
        }
        let learned = bench.learned();
        println!("beside one at {other}: {learned:.3}");
        assert!((0.66..=1.0).contains(&learned), "{other}: {learned}");
    }
    // Its clock jumps by an hour in the middle of each drive.
    let mut bench = Bench::new(0.7, Gauge::True);
    for cycle in 0..12 {
        bench.drive(0.6);
        bench.step += 720;
        let drive = bench.drive(0.15);
        assert!((drive.soc - 0.15).abs() < 0.1, "cycle {cycle}: {drive:?}");
        bench.charge();
    }
    assert!((bench.learned() / 0.7 - 1.0).abs() < 0.06, "{}", bench.learned());
}

#[test]
fn the_time_on_the_charger_is_that_of_earlier_charges() {
    // A metered charge, and a measured one that is not metered.
    let metered = Bench::new(1.0, Gauge::None);
    let measured = Bench { fleet: fleet(ChargeReading::Load), ..Bench::new(1.0, Gauge::True) };
    let mut budget = Budget::default();
    for (mut bench, within) in [(measured, 0.12), (metered, 0.05)] {
        bench.drive(0.15);
        assert_eq!(bench.budget().charging_s(0.2, 1.0), None);
        let mut took = (0.0, 0.0);
        for _ in 0..3 {
            bench.drive(0.15);
            took = bench.charge();
        }
        budget = bench.budget();
        let [all_s, top_s] = [0.2, 0.8].map(|from| budget.charging_s(from, 1.0).expect("charged"));
        println!("{all_s:.0} of {:.0} s, {top_s:.0} of {:.0} s", took.0, took.1);
        let off = (all_s / took.0 - 1.0).abs().max((top_s / took.1 - 1.0).abs());
        assert!(off < within, "{off}");
    }
    assert_eq!(budget.charging_s(0.9, 0.8), Some(0.0));
    assert_eq!(budget.charging_s(f64::NAN, 0.8), None);
    // Below 80 % a tenth that was never charged is as fast as its neighbours.
    let low_s = budget.charging_s(0.0, 0.1).expect("as the next ones");
    let next_s = budget.charging_s(0.3, 0.4).expect("charged");
    assert!((low_s / next_s - 1.0).abs() < 0.1, "{low_s} {next_s}");
}

#[test]
fn what_is_learned_outlasts_a_takeover_with_its_bits_and_a_restart() {
    let mut bench = Bench::new(0.7, Gauge::True);
    for _ in 0..3 {
        bench.drive(0.2);
        bench.charge();
    }
    bench.drive(0.6);
    let mut bytes = Vec::new();
    bench.fleet.state().encode_into(&mut bytes);
    let mut other = Bench::new(0.7, Gauge::True);
    other.fleet.restore_state(&FleetState::decode(&bytes).expect("its own")).expect("the same");
    (other.step, other.soc, other.source) = (bench.step, bench.soc, bench.source.clone());
    for bench in [&mut bench, &mut other] {
        bench.drive(0.2);
        bench.charge();
    }
    assert_eq!(format!("{:?}", bench.budget()), format!("{:?}", other.budget()));
    let saved = bench.drive(0.5);
    let ledger = Ledger::restored(
        (saved.drawn_uj, saved.drawn_remainder),
        saved.forecast_uj,
        saved.metered_ns,
        saved.unmetered_ns,
        saved.stamp_ns,
    );
    bench.fleet = fleet(ChargeReading::Battery);
    bench.fleet.restore(0, ledger, true, SavedBattery::new(&saved, 0));
    bench.source = Source::new(1, 2);
    let after = bench.send(DRIVE_W, 0);
    let [of_saved, of_after] =
        [saved, after].map(|budget| budget.learned_capacity_j().expect("learned"));
    assert!((of_after.0 / of_saved.0 - 1.0).abs() < 1e-5, "{saved:?} {after:?}");
    assert!((of_after.1 / of_saved.1 - 1.0).abs() < 1e-4, "{saved:?} {after:?}");
    assert_eq!(saved.charge_rate, after.charge_rate);
}
