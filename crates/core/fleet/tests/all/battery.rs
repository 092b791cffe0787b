//! Batteries over a day: charged, measured, exchanged, left alone. The stated bounds contain the
//! truth with the stated frequency, and a sensor's value is believed only if it can be true.

use joulebus_fleet::{Fleet, FleetState, SavedBattery};
use joulebus_predictor::{Model, Persistence, ResidualStats};
use joulebus_settings::{Battery, ChargeReading, FleetSettings, OpenCircuit, Platform};
use joulebus_testkit_fleets::random::Noise;
use joulebus_testkit_fleets::{self as world, MS, Source};
use joulebus_wire::{Alarm, Budget, Sample, budget_flag, sample_flag};

const STEP_NS: u64 = 5_000 * MS;
const STEP_S: f64 = 5.0;
const START_NS: u64 = 60_000 * MS;
const CAPACITY_J: f64 = 36_000.0;
const POWER_MAX_W: f32 = 40.0;
const HOUR: u64 = 720;

fn battery() -> Battery {
    Battery {
        initial_soc: 0.9,
        initial_soc_lo: 0.8,
        charge_efficiency: 0.9,
        charge_power_w: Some(30.0),
        ..Battery::new(CAPACITY_J, 0.05)
    }
}

fn settings(battery: Battery, robots: u32) -> FleetSettings {
    let mut settings = world::settings(robots);
    settings.intake.leave_after_ns = 120_000 * MS;
    settings.intake.max_jump_ns = u64::MAX;
    settings.platforms = vec![Platform {
        name: "sturdy".to_owned(),
        robots: vec![0..=robots - 1],
        period_ns: STEP_NS,
        stale_after_ns: 4 * STEP_NS,
        hold_max_ns: 4 * STEP_NS,
        stuck_after_ns: 1_000 * STEP_NS,
        power_min_w: -POWER_MAX_W,
        power_max_w: POWER_MAX_W,
        battery: Some(battery),
        ..settings.platforms[0].clone()
    }];
    settings
}

fn fleet(battery: Battery, robots: u32) -> Fleet {
    let residual = ResidualStats { std_w: 0.1, q05_w: -0.15, q95_w: 0.17 };
    let model = Model::Persistence(Persistence::new(residual).expect("finite and in order"));
    Fleet::new(settings(battery, robots), vec![model]).expect("the settings are consistent")
}

/// A draw of a normal distribution.
fn normal(noise: &mut Noise) -> f64 {
    let uniform = |noise: &mut Noise| (noise.next_u64() >> 11) as f64 / (1u64 << 53) as f64;
    (0..12).map(|_| uniform(noise)).sum::<f64>() - 6.0
}

/// A true battery, and the readings of its robot's instruments.
#[derive(Debug, Clone, Copy)]
struct Truth {
    soc: f64,
    /// Error of the power monitor, relative, and of the measured state of charge.
    gain: f64,
    bias: f64,
}

impl Truth {
    fn drawn(noise: &mut Noise, battery: &Battery) -> Self {
        let sd = (battery.initial_soc - battery.initial_soc_lo) / 2.0;
        Self {
            soc: (battery.initial_soc + sd * normal(noise)).clamp(0.0, 1.0),
            gain: battery.counting_sd * normal(noise),
            bias: battery.sensor_sd * normal(noise),
        }
    }

    /// Draws `power_w` from the battery over a step. Negative power charges it. Returns the
    /// monitor's reading.
    fn step(&mut self, power_w: f64, efficiency: f64) -> f32 {
        let part = if power_w < 0.0 { efficiency } else { 1.0 };
        self.soc = (self.soc - part * power_w * STEP_S / CAPACITY_J).clamp(0.0, 1.0);
        (power_w * (1.0 + self.gain)) as f32
    }

    /// The measured state of charge, in steps of one percent.
    fn measured(&self) -> f32 {
        ((100.0 * (self.soc + self.bias)).round() / 100.0).clamp(0.0, 1.0) as f32
    }
}

/// A robot alone, its battery, and the time.
struct Bench {
    fleet: Fleet,
    source: Source,
    truth: Truth,
    step: u64,
}

impl Bench {
    fn new(battery: Battery) -> Self {
        Self {
            fleet: fleet(battery, 1),
            source: Source::new(1, 1),
            truth: Truth { soc: battery.initial_soc, gain: 0.0, bias: 0.0 },
            step: 0,
        }
    }

    fn now_ns(&self) -> u64 {
        START_NS + self.step * STEP_NS
    }

    fn send(&mut self, power_w: f64, change: impl Fn(Sample, &Truth) -> Sample) -> Budget {
        self.step += 1;
        let power_w = self.truth.step(power_w, battery().charge_efficiency);
        let now_ns = self.now_ns();
        let sample = Sample::new(0, self.step, now_ns).command(0.1, 0.0).reading(power_w, now_ns);
        let sample = change(sample, &self.truth);
        self.source.tick(&mut self.fleet, &[sample], now_ns);
        self.budget()
    }

    fn budget(&self) -> Budget {
        world::budget(&self.fleet, 0)
    }

    fn drive(&mut self, steps: u64, change: impl Fn(Sample, &Truth) -> Sample) -> Budget {
        for _ in 0..steps {
            self.send(4.0, &change);
        }
        self.budget()
    }

    /// Distance of the best estimate from the truth.
    fn off(&self, shown: &Budget) -> f64 {
        (f64::from(shown.soc) - self.truth.soc).abs()
    }

    fn raised(&self, alarm: Alarm) -> bool {
        world::diagnostic(&self.fleet, 0).alarms().has(alarm)
    }
}

fn plain(sample: Sample, _: &Truth) -> Sample {
    sample
}

fn charged(sample: Sample, _: &Truth) -> Sample {
    sample.with(sample_flag::CHARGING | sample_flag::FULL)
}

fn with_soc(sample: Sample, truth: &Truth) -> Sample {
    sample.state_of_charge(truth.measured())
}

fn assert_in_order(budget: &Budget) {
    let shares = [0.0, budget.soc_lo, budget.soc, budget.soc_hi, 1.0];
    assert!(shares.is_sorted(), "{budget:?}");
    let [sd, bias_sd] = [budget.soc_sd, budget.sensor_bias_sd];
    assert!(sd >= 0.0 && bias_sd >= 0.0, "{budget:?}");
    let known = budget_flag::BATTERY | budget_flag::LEDGER;
    assert_eq!(budget.flags & known, known, "{budget:?}");
}

/// Share of robots and hours whose truth is within the bounds, and the bounds' mean width, for
/// robots with random errors over a day of driving, charging, silence, an exchanged battery, and a
/// restarted worker.
fn day(battery: Battery, robots: u32, measures: bool) -> (f64, f64) {
    let mut noise = Noise(7);
    let mut fleet = fleet(battery, robots);
    let (mut source, mut epoch) = (Source::new(1, 1), 1);
    let mut truths: Vec<Truth> = (0..robots).map(|_| Truth::drawn(&mut noise, &battery)).collect();
    let (mut inside, mut width, mut judged) = (0.0, 0.0, 0.0);
    let mut samples = Vec::new();
    for step in 1..=24 * HOUR {
        let (now_ns, hour) = (START_NS + step * STEP_NS, step / HOUR);
        samples.clear();
        for (robot, truth) in truths.iter_mut().enumerate() {
            // Two hours of driving, one on the charger, each at its own time.
            let phase = (step + 31 * robot as u64) % (3 * HOUR);
            let charging = phase >= 2 * HOUR;
            let load_w = 2.0 + 1.5 * ((step + robot as u64) as f64 * 0.01).sin();
            let full = truth.soc >= 0.999;
            let power_w = match (charging, full) {
                (true, true) => 0.0,
                (true, false) => -12.0,
                _ => load_w,
            };
            let read_w = truth.step(power_w, battery.charge_efficiency);
            if measures && hour == 13 && step % HOUR == 0 && robot % 5 == 0 {
                // Another battery, while the robot is switched off.
                truth.soc = 0.95;
            }
            // Silent for a while: within the fleet, and away from it.
            let away = hour == 7 && step % HOUR < 12 || hour == 13 && step % HOUR < 60;
            if away && robot % 5 == 0 {
                continue;
            }
            let mut sample = Sample::new(robot as u32, step, now_ns).reading(read_w, now_ns);
            if charging {
                sample = sample.with(sample_flag::CHARGING);
            }
            if charging && full {
                sample = sample.with(sample_flag::FULL);
            }
            if measures {
                sample = sample.state_of_charge(truth.measured());
            }
            samples.push(sample);
        }
        source.tick(&mut fleet, &samples, now_ns);
        if step == 10 * HOUR {
            epoch += 1;
            fleet = restarted(&fleet, battery, robots);
            source = Source::new(1, epoch);
        }
        // The first measured values after an exchange are doubted for a while.
        if step % HOUR == HOUR / 2 {
            for place in 0..fleet.len() {
                let budget = fleet.budget(place);
                assert_in_order(&budget);
                let truth = truths[budget.robot as usize].soc as f32;
                let holds = budget.soc_lo <= truth && truth <= budget.soc_hi;
                inside += f64::from(u8::from(holds));
                width += f64::from(budget.soc_hi - budget.soc_lo);
                judged += 1.0;
            }
        }
    }
    (inside / judged, width / judged)
}

/// A fleet with the state that a worker saves of this one.
fn restarted(before: &Fleet, battery: Battery, robots: u32) -> Fleet {
    let mut after = fleet(battery, robots);
    for place in 0..before.len() {
        let budget = before.budget(place);
        let ledger = joulebus_fleet::Ledger::restored(
            (budget.drawn_uj, budget.drawn_remainder),
            budget.forecast_uj,
            budget.metered_ns,
            budget.unmetered_ns,
            budget.stamp_ns,
        );
        assert!(after.restore(budget.robot, ledger, true, SavedBattery::new(&budget, 0)));
    }
    after
}

#[test]
fn over_a_day_the_bounds_hold_the_truth_as_often_as_they_claim() {
    let metered = Battery { charge_reading: ChargeReading::Battery, ..battery() };
    let cases = [
        ("counted, charge metered", metered, false, 0.30),
        ("measured, charge metered", metered, true, 0.19),
        ("counted, charge unknown", battery(), false, 0.45),
        ("measured, charge unknown", battery(), true, 0.20),
    ];
    for (what, battery, measures, widest) in cases {
        let (inside, width) = day(battery, 200, measures);
        println!("{what}: {inside:.3} inside, {width:.3} wide");
        assert!(inside >= 0.95, "{what}: {inside}");
        assert!(width <= widest, "{what}: {width}");
    }
}

#[test]
fn a_metered_charge_is_counted_with_its_sign_and_efficiency() {
    for (reading, sign) in [(ChargeReading::Battery, 1.0), (ChargeReading::Charger, -1.0)] {
        let mut bench = Bench::new(Battery {
            charge_reading: reading,
            initial_soc: 0.5,
            initial_soc_lo: 0.5,
            counting_sd: 0.0,
            ..battery()
        });
        let before = bench.drive(100, plain);
        for _ in 0..200 {
            bench.send(-10.0, |mut sample, _| {
                sample.power_w *= sign;
                sample.with(sample_flag::CHARGING)
            });
        }
        let after = bench.drive(1, plain);
        // The step between two kinds of readings is half of each.
        let most = 2.0 * 14.0 * STEP_S / CAPACITY_J;
        assert!(bench.off(&after) < most, "{reading:?}: {after:?}");
        assert!(after.soc > before.soc + 0.2, "{after:?}");
        assert_eq!(after.metered_ns + after.unmetered_ns, 300 * STEP_NS);
        assert_in_order(&after);
    }
}

#[test]
fn a_full_battery_is_as_full_as_the_config_states_and_only_on_the_charger() {
    let mut bench = Bench::new(Battery { on_full_soc: 0.97, ..battery() });
    bench.drive(300, plain);
    let full = bench.send(2.0, charged);
    assert!((full.soc - 0.97).abs() < 1e-6, "{full:?}");
    assert!(full.soc_lo > 0.94, "{full:?}");
    let refused = bench.fleet.drops().total();
    bench.send(2.0, |sample, _| sample.with(sample_flag::FULL));
    assert_eq!(bench.fleet.drops().total(), refused + 1);
}

#[test]
fn a_measured_state_of_charge_narrows_the_bounds_but_not_below_its_own_error() {
    let mut counted = Bench::new(battery());
    let mut measured = Bench::new(battery());
    let without = counted.drive(2 * HOUR, plain);
    let with = measured.drive(2 * HOUR, with_soc);
    let width = |budget: &Budget| f64::from(budget.soc_hi - budget.soc_lo);
    let [narrow, wide] = [width(&with), width(&without)];
    assert!(narrow < 0.8 * wide, "{with:?}, {without:?}");
    // A prior and a sensor of 5 % each give 3.5 %, however often the sensor reports.
    assert!(with.soc_sd > 0.03, "{with:?}");
    assert!(measured.off(&with) < 0.02, "{with:?}");
    assert!(with.flags & budget_flag::MEASURED != 0);
    assert!(without.flags & budget_flag::MEASURED == 0);
}

#[test]
fn the_sensors_error_is_learned_where_the_charger_reports_full() {
    let mut bench = Bench::new(battery());
    bench.truth.bias = 0.06;
    bench.drive(HOUR, with_soc);
    bench.truth.soc = 1.0;
    bench.send(2.0, charged);
    // Above its upper end a sensor is useless: its error shows below.
    let after = bench.drive(2 * HOUR, with_soc);
    assert!(after.sensor_bias > 0.02, "{after:?}");
    assert!(bench.off(&after) < 0.04, "{after:?}, {:?}", bench.truth);
}

#[test]
fn a_measured_state_of_charge_out_of_range_is_refused_and_counted() {
    for (soc, reason) in [
        (f32::NAN, "NotFinite"),
        (f32::INFINITY, "NotFinite"),
        (-0.06, "BatteryOutOfRange"),
        (1.06, "BatteryOutOfRange"),
        (87.0, "BatteryOutOfRange"),
    ] {
        let mut bench = Bench::new(battery());
        let before = bench.drive(10, with_soc);
        let shown = bench.send(4.0, |sample, _| sample.state_of_charge(soc));
        let drops = bench.fleet.drops();
        let drops: Vec<_> = drops.iter().map(|drop| (drop.0.name(), drop.1)).collect();
        assert_eq!(drops, [(reason, 1)], "{soc}");
        assert!(shown.soc <= before.soc, "{soc}");
        assert_in_order(&shown);
    }
    for return_j in [f32::NAN, -1.0, f32::INFINITY, 1e10] {
        let mut bench = Bench::new(battery());
        bench.send(4.0, |sample, _| sample.return_energy(return_j));
        assert_eq!(bench.fleet.drops().total(), 1, "{return_j}");
    }
    let mut bench = Bench::new(battery());
    bench.drive(10, |sample, _| sample.state_of_charge(1.04));
    // A little more than full is full.
    assert_eq!(bench.fleet.drops().total(), 0);
}

#[test]
fn a_stuck_sensor_is_noticed_and_the_count_goes_on() {
    for stuck in [0.9, 0.6, 1.0] {
        let mut bench = Bench::new(battery());
        bench.drive(100, with_soc);
        bench.drive(5 * HOUR / 2, |sample, _| sample.state_of_charge(stuck));
        let shown = bench.budget();
        let truth = bench.truth.soc as f32;
        assert!(truth < 0.1, "the battery is nearly empty: {truth}");
        assert!(bench.raised(Alarm::SocImplausible), "{stuck}: {shown:?}");
        let bounds = shown.soc_lo..=shown.soc_hi;
        assert!(bounds.contains(&truth), "{stuck}: {shown:?}, {truth}");
        assert!(bench.raised(Alarm::BatteryLow), "{stuck}: {shown:?}");
    }
}

#[test]
fn a_jumping_sensor_is_not_followed() {
    for every in [1, 2, 7, 11] {
        let mut bench = Bench::new(battery());
        bench.drive(100, with_soc);
        let jump = std::cell::Cell::new(0u64);
        bench.drive(HOUR, |sample, truth| {
            jump.set(jump.get() + 1);
            let off = [0.0, 0.4, -0.4, 0.2, -0.3][(jump.get() / every % 5) as usize];
            sample.state_of_charge((truth.measured() + off).clamp(0.0, 1.0))
        });
        let (shown, truth) = (bench.budget(), bench.truth.soc as f32);
        let bounds = shown.soc_lo..=shown.soc_hi;
        assert!(bounds.contains(&truth), "{every}: {shown:?}, {truth}");
        assert_eq!(shown.battery_changes, 0, "{every}");
        let back = bench.drive(200, with_soc);
        assert!(!bench.raised(Alarm::SocImplausible), "{every}: {back:?}");
    }
}

#[test]
fn a_sensor_that_jumps_up_and_stays_is_doubted_one_that_jumps_down_is_believed_after_a_minute() {
    let mut bench = Bench::new(battery());
    bench.drive(HOUR, with_soc);
    let (before, truth) = (bench.budget(), bench.truth.soc as f32);
    let shown = bench.drive(100, |sample, _| sample.state_of_charge(1.0));
    assert!(bench.raised(Alarm::SocImplausible));
    assert!(shown.soc_hi < before.soc_hi, "{shown:?}, {truth}");
    // The counted charge is lower, and safe to plan with.
    assert_eq!(shown.flags & budget_flag::CONTRADICTED, 0);
    let shown = bench.drive(3, |sample, _| sample.state_of_charge(0.1));
    assert!(shown.soc > 0.3, "{shown:?}");
    assert_ne!(shown.flags & budget_flag::CONTRADICTED, 0);
    let shown = bench.drive(30, |sample, _| sample.state_of_charge(0.1));
    assert!(shown.soc < 0.15, "{shown:?}");
    assert_eq!(shown.flags & budget_flag::CONTRADICTED, 0);
    assert_eq!(shown.battery_changes, 1);
}

#[test]
fn an_exchanged_battery_is_noticed_after_a_gap_and_at_once_if_the_robot_reports_it() {
    let mut bench = Bench::new(battery());
    let before = bench.drive(2 * HOUR, with_soc);
    assert!(before.soc < 0.2, "{before:?}");
    bench.step += 60;
    bench.truth.soc = 0.95;
    let shown = bench.drive(6, with_soc);
    assert!(shown.soc > 0.9 && shown.battery_changes == 1, "{shown:?}");
    // Without a measured value, as full as the first.
    bench.drive(HOUR, plain);
    let shown = bench.send(4.0, |sample, _| sample.with(sample_flag::SWAPPED));
    assert!((shown.soc - 0.9).abs() < 1e-3, "{shown:?}");
    assert_eq!(shown.battery_changes, 2, "{shown:?}");
    // In the middle of driving: once it is clear that the value moves with the energy drawn.
    bench.drive(2 * HOUR, with_soc);
    bench.truth.soc = 0.95;
    let shown = bench.drive(60, with_soc);
    assert_eq!(shown.battery_changes, 3, "{shown:?}");
    assert!(bench.off(&shown) < 0.1, "{shown:?}");
}

#[test]
fn a_voltage_gives_the_state_of_charge_where_nothing_else_does() {
    let volts = [9.0, 10.8, 11.1, 11.4, 12.6];
    let table = OpenCircuit::new(&volts, 0.1, 0.08).expect("rising");
    let mut bench = Bench::new(Battery {
        open_circuit: Some(table),
        initial_soc: 0.75,
        initial_soc_lo: 0.45,
        ..battery()
    });
    bench.truth.soc = 0.6;
    let voltage = |soc: f64| {
        let part = 4.0 * soc;
        let from = (part as usize).min(3);
        volts[from] + (part - from as f64) * (volts[from + 1] - volts[from])
    };
    let shown = bench.drive(200, |sample, truth| {
        let current_a = 0.35;
        let voltage_v = voltage(truth.soc) - 0.1 * current_a;
        sample.battery(voltage_v as f32, current_a as f32)
    });
    assert!(bench.off(&shown) < 0.05, "{shown:?}, {:?}", bench.truth);
    assert!(shown.soc_sd > 0.04, "{shown:?}");
    assert!(shown.flags & budget_flag::MEASURED != 0, "{shown:?}");
    // Far outside the table a voltage gives no charge.
    let before = bench.budget();
    let shown = bench.drive(10, |sample, _| sample.battery(3.0, 0.3));
    assert!((shown.soc - before.soc).abs() < 0.01, "{shown:?}");
}

#[test]
fn levels_are_raised_below_their_thresholds_and_cleared_a_band_above() {
    let mut bench = Bench::new(Battery {
        charge_reading: ChargeReading::Battery,
        initial_soc: 0.4,
        initial_soc_lo: 0.4,
        counting_sd: 0.0,
        low: 0.3,
        critical: 0.2,
        level_band: 0.05,
        ..battery()
    });
    let mut changes = Vec::new();
    let mut seen = [false; 2];
    for step in 0..800 {
        let charging = step >= 400;
        let shown = match charging {
            true => bench.send(-5.0, |sample, _| sample.with(sample_flag::CHARGING)),
            false => bench.send(5.0, plain),
        };
        let now = [Alarm::BatteryLow, Alarm::BatteryCritical].map(|alarm| bench.raised(alarm));
        if now != seen {
            changes.push((now, (100.0 * shown.soc).round()));
            seen = now;
        }
        let level = world::diagnostic(&bench.fleet, 0).level();
        let expected = match now {
            [_, true] => joulebus_wire::Level::Error,
            [true, _] => joulebus_wire::Level::Warn,
            _ => joulebus_wire::Level::Ok,
        };
        assert_eq!(level, expected, "step {step}");
    }
    let expected = [
        ([true, false], 30.0),
        ([true, true], 20.0),
        ([true, false], 25.0),
        ([false, false], 35.0),
    ];
    assert_eq!(changes, expected);
}

#[test]
fn a_robot_cannot_return_when_less_than_it_needs_is_certainly_left() {
    // By the config: 9 kJ of 36.
    let mut bench = Bench::new(Battery { return_j: Some(9_000.0), ..battery() });
    let steps = (0..10_000).find(|_| {
        bench.send(4.0, plain);
        bench.raised(Alarm::CannotReturn)
    });
    assert!(steps.is_some());
    let shown = bench.budget();
    let least_j = f64::from(shown.soc_lo) * CAPACITY_J;
    // Sooner, by at most the error with which the monitor will count the return.
    let counting_j = 2.0 * battery().counting_sd * 9_000.0;
    assert!((9_000.0..9_000.0 + counting_j).contains(&least_j), "{shown:?}");
    assert!(least_j > 9_050.0, "{shown:?}");
    // Well before the best estimate does.
    assert!(shown.soc > 0.3, "{shown:?}");
    // By the planner, sample by sample: the robot is near its charger after all.
    bench.send(4.0, |sample, _| sample.return_energy(500.0));
    assert!(!bench.raised(Alarm::CannotReturn));
    bench.send(4.0, |sample, _| sample.return_energy(30_000.0));
    assert!(bench.raised(Alarm::CannotReturn));
    // Without either there is no statement.
    let mut bench = Bench::new(battery());
    bench.drive(3 * HOUR, plain);
    assert!(bench.raised(Alarm::BatteryCritical) && !bench.raised(Alarm::CannotReturn));
}

#[test]
fn levels_of_a_silent_robot_are_raised_as_its_budget_falls() {
    let mut bench = Bench::new(battery());
    let before = bench.drive(HOUR / 2, plain);
    // Spent in 50 s at the greatest power.
    let spare_j = f64::from(before.soc_lo) * CAPACITY_J - 50.0 * f64::from(POWER_MAX_W);
    let needed_j = spare_j / (1.0 + 2.0 * battery().counting_sd);
    bench.send(4.0, |sample, _| sample.return_energy(needed_j as f32));
    assert!(!bench.raised(Alarm::CannotReturn));
    let raised: Vec<bool> = (0..20)
        .map(|_| {
            bench.step += 1;
            bench.fleet.tick(bench.now_ns(), false);
            let shown = bench.budget();
            let raised = bench.raised(Alarm::CannotReturn);
            // The error of counting the return is part of it, and the row has f32.
            let spare_j = f64::from(shown.soc_lo) * CAPACITY_J - needed_j;
            let counting_j = 2.0 * battery().counting_sd * needed_j;
            let is_right = raised == (spare_j < 0.0) || (-0.1..counting_j).contains(&spare_j);
            assert!(is_right, "{shown:?}");
            raised
        })
        .collect();
    assert!(!raised[5] && raised[19], "{raised:?}");
    // The robot is back, and its consumption in between is unknown.
    bench.send(4.0, |sample, _| sample.return_energy(needed_j as f32));
    assert!(bench.raised(Alarm::CannotReturn));
}

#[test]
fn a_restarted_worker_continues_and_the_gap_is_charged_at_maximum_power() {
    let mut bench = Bench::new(battery());
    bench.truth.bias = 0.03;
    let before = bench.drive(HOUR, with_soc);
    bench.fleet = restarted(&bench.fleet, battery(), 1);
    bench.source = Source::new(1, 2);
    bench.step += 2;
    let after = bench.send(4.0, plain);
    let dark_s = 3.0 * STEP_S;
    let lowest = f64::from(before.soc_lo) - dark_s * f64::from(POWER_MAX_W) / CAPACITY_J;
    let off = (f64::from(after.soc_lo) - lowest).abs();
    assert!(off < 1e-4, "{after:?}, {before:?}");
    assert!(after.soc_hi <= before.soc_hi + 1e-6 + 0.1, "{after:?}");
    assert_eq!(after.flags & budget_flag::MEASURED, budget_flag::MEASURED);
    assert_eq!(after.sensor_bias, before.sensor_bias);
    // A saved state that no worker can have written is not believed.
    let mut nonsense = before;
    nonsense.soc_lo = 0.99;
    let mut fleet = fleet(battery(), 1);
    let ledger = bench.fleet.ledger(0).expect("it has one");
    fleet.restore(0, ledger, false, SavedBattery::new(&nonsense, 0));
    let mut source = Source::new(1, 3);
    let sample = Sample::new(0, 1, bench.now_ns() + STEP_NS).reading(4.0, bench.now_ns());
    source.tick(&mut fleet, &[sample], sample.stamp_ns);
    assert_charge_is_unknown(&world::budget(&fleet, 0));
}

/// Everything that a charge would give is NaN, without its flag.
fn assert_charge_is_unknown(budget: &Budget) {
    let values = [budget.soc, budget.soc_lo, budget.soc_hi, budget.left_j, budget.usable_j];
    let all = values.into_iter().chain([budget.usable_lo_j, budget.time_to_empty_s]);
    assert!(all.into_iter().all(f32::is_nan), "{budget:?}");
    let flags = budget_flag::BATTERY | budget_flag::CHARGE | budget_flag::TIME_TO_EMPTY;
    assert_eq!(budget.flags & flags, budget_flag::BATTERY, "{budget:?}");
}

#[test]
fn a_robot_that_runs_after_a_gap_that_would_have_emptied_it_has_an_unknown_charge() {
    let mut bench = Bench::new(battery());
    bench.drive(HOUR / 2, plain);
    // A night with the worker stopped: 36 kJ at 4 W last two and a half hours.
    bench.fleet = restarted(&bench.fleet, battery(), 1);
    bench.source = Source::new(1, 2);
    bench.step += 10 * HOUR;
    assert_charge_is_unknown(&bench.send(4.0, plain));
    assert!(!bench.raised(Alarm::BatteryCritical));
    assert_charge_is_unknown(&bench.drive(10, plain));
    // The next worker does not know more.
    bench.fleet = restarted(&bench.fleet, battery(), 1);
    bench.source = Source::new(1, 3);
    assert_charge_is_unknown(&bench.send(4.0, plain));
    let swapped = bench.send(4.0, |sample, _| sample.with(sample_flag::SWAPPED));
    assert!((swapped.soc - 0.9).abs() < 0.01, "{swapped:?}");
    assert!(swapped.flags & budget_flag::CHARGE != 0, "{swapped:?}");
    // A nearly empty battery stays so over a short gap.
    bench.drive(HOUR * 2, plain);
    let low = bench.budget();
    assert!(low.soc < 0.15 && bench.raised(Alarm::BatteryLow), "{low:?}");
    bench.step += HOUR / 20;
    let back = bench.send(4.0, plain);
    assert!(back.soc < low.soc && bench.raised(Alarm::BatteryLow), "{back:?}");
}

#[test]
fn a_robot_whose_account_was_given_up_has_an_unknown_battery_until_it_is_known_again() {
    let mut settings = settings(battery(), 5);
    settings.capacity = 2;
    let new = || {
        let residual = ResidualStats { std_w: 0.1, q05_w: -0.15, q95_w: 0.17 };
        let model = Model::Persistence(Persistence::new(residual).expect("finite and in order"));
        Fleet::new(settings.clone(), vec![model]).expect("the settings are consistent")
    };
    let (mut fleet, mut source) = (new(), Source::new(1, 1));
    let mut now_ns = START_NS;
    let mut send = |fleet: &mut Fleet, robot, change: &dyn Fn(Sample) -> Sample| {
        // Everybody else has left.
        now_ns += settings.intake.leave_after_ns + STEP_NS;
        fleet.tick(now_ns, false);
        let sample = change(Sample::new(robot, now_ns / STEP_NS, now_ns).reading(4.0, now_ns));
        source.tick(fleet, &[sample], now_ns);
        let shown = world::budget(fleet, robot);
        (shown.soc_lo, shown.soc, shown.soc_hi)
    };
    let is_new =
        |(lo, soc, _): (f32, f32, f32)| (soc - 0.9).abs() < 1e-3 && (lo - 0.8).abs() < 1e-3;
    for robot in 0..4 {
        assert!(is_new(send(&mut fleet, robot, &|sample| sample)), "robot {robot}");
    }
    // There are places for two accounts, and 3 is in the fleet.
    assert_eq!(fleet.accounts_given_up(), 1);
    // A standby, and the verification of a capture, know it too.
    let mut bytes = Vec::new();
    fleet.state().encode_into(&mut bytes);
    let mut standby = new();
    standby.restore_state(&FleetState::decode(&bytes).unwrap()).unwrap();
    // A later run is reported.
    let mut later = new();
    later.lose(0);
    for mut fleet in [fleet, standby, later] {
        assert!(send(&mut fleet, 0, &|sample| sample).1.is_nan());
        assert!(is_new(send(&mut fleet, 4, &|sample| sample)), "never seen");
        assert!(send(&mut fleet, 0, &|sample| sample).0.is_nan(), "its account is unknown");
        let (lo, soc, hi) = send(&mut fleet, 0, &|sample| sample.state_of_charge(0.6));
        assert!(lo > 0.4 && (soc - 0.6).abs() < 0.05 && hi < 0.8, "{lo} to {hi}");
        assert!(is_new(send(&mut fleet, 0, &|sample| sample.with(sample_flag::SWAPPED))));
    }
}

/// A robot of 10 samples a second with a battery of 5 Wh.
mod gaps {
    use super::*;

    const PERIOD_NS: u64 = 100 * MS;
    const SMALL_J: f64 = 18_000.0;
    const LEAVES_NS: u64 = 30_000 * MS;

    pub(super) fn small() -> Battery {
        Battery {
            initial_soc: 1.0,
            initial_soc_lo: 0.98,
            low: 0.1,
            critical: 0.05,
            ..Battery::new(SMALL_J, 0.05)
        }
    }

    pub(super) fn fleet_of(battery: Battery) -> Fleet {
        let mut settings = settings(battery, 8);
        settings.intake.leave_after_ns = LEAVES_NS;
        let platform = &mut settings.platforms[0];
        platform.period_ns = PERIOD_NS;
        platform.stale_after_ns = 10 * PERIOD_NS;
        let is_signed = matches!(battery.charge_reading, ChargeReading::Battery);
        platform.power_min_w = if is_signed { -20.0 } else { 0.0 };
        platform.power_max_w = 20.0;
        let residual = ResidualStats { std_w: 0.1, q05_w: -0.15, q95_w: 0.17 };
        let model = Model::Persistence(Persistence::new(residual).expect("finite and in order"));
        Fleet::new(settings, vec![model]).expect("the settings are consistent")
    }

    /// A fleet, its source and the time.
    pub(super) struct Line {
        pub fleet: Fleet,
        source: Source,
        battery: Battery,
        pub step: u64,
        epoch: u64,
    }

    impl Line {
        pub(super) fn new(battery: Battery) -> Self {
            let fleet = fleet_of(battery);
            Self { fleet, source: Source::new(1, 1), battery, step: 0, epoch: 1 }
        }

        pub(super) fn now_ns(&self) -> u64 {
            START_NS + self.step * PERIOD_NS
        }

        /// Sends the samples of one period.
        pub(super) fn send(&mut self, samples: &[(u32, f32)], flags: u32) {
            self.step += 1;
            let now_ns = self.now_ns();
            let sample = |(robot, power_w): &(u32, f32)| {
                Sample::new(*robot, self.step, now_ns).reading(*power_w, now_ns).with(flags)
            };
            let samples: Vec<Sample> = samples.iter().map(sample).collect();
            self.source.tick(&mut self.fleet, &samples, now_ns);
        }

        /// Robot 0 sends a sample without a reading.
        pub(super) fn send_without_reading(&mut self, change: impl Fn(Sample) -> Sample) {
            self.step += 1;
            let now_ns = self.now_ns();
            let sample = change(Sample::new(0, self.step, now_ns));
            self.source.tick(&mut self.fleet, &[sample], now_ns);
        }

        /// A tick that comes late for the next sample, by a share of a period.
        pub(super) fn late(&mut self, share: f64) {
            let late_ns = ((1.0 + share) * PERIOD_NS as f64) as u64;
            self.fleet.tick(self.now_ns() + late_ns, false);
        }

        /// Nobody sends for a while.
        pub(super) fn silence(&mut self, seconds: u64) {
            for _ in 0..10 * seconds {
                self.step += 1;
                self.fleet.tick(self.now_ns(), false);
            }
        }

        pub(super) fn restart(&mut self) {
            let mut after = fleet_of(self.battery);
            for place in 0..self.fleet.len() {
                let budget = self.fleet.budget(place);
                let ledger = self.fleet.ledger(budget.robot).expect("it is there");
                let silent_ns = self.now_ns() - budget.stamp_ns;
                let saved = SavedBattery::new(&budget, silent_ns.saturating_sub(PERIOD_NS));
                assert!(after.restore(budget.robot, ledger, false, saved));
            }
            self.epoch += 1;
            (self.fleet, self.source) = (after, Source::new(1, self.epoch));
        }

        pub(super) fn left_j(&self, robot: u32) -> f64 {
            f64::from(world::budget(&self.fleet, robot).left_j)
        }
    }
}

#[test]
fn lost_samples_are_settled_when_they_are_over_and_energy_left_never_rises() {
    use gaps::{Line, small};
    // 6 W for 20 minutes, then 3 W and 8 W for four each: one robot sends all, one loses a tenth.
    let mut line = Line::new(small());
    let mut before_j = [f64::INFINITY; 2];
    for (power_w, minutes) in [(6.0, 20), (3.0, 4), (8.0, 4)] {
        for tenth in 0..minutes * 600 {
            let all = [(0, power_w), (1, power_w)];
            line.send(&all[..if tenth % 10 == 9 { 1 } else { 2 }], 0);
            for robot in 0..2 {
                let left_j = line.left_j(robot);
                let before_j = &mut before_j[robot as usize];
                assert!(left_j <= *before_j, "robot {robot}: {left_j} after {before_j}");
                *before_j = left_j;
            }
        }
        let [all_j, some_j] = [0, 1].map(|robot| line.left_j(robot));
        println!("{power_w} W: {all_j:.0} J, {some_j:.0} J with lost samples");
        assert!((all_j - some_j).abs() < 5.0, "{all_j} {some_j}");
    }
}

#[test]
fn losing_one_sample_in_a_hundred_costs_no_accuracy_though_the_power_alternates() {
    use gaps::{Line, small};
    let mut line = Line::new(Battery { counting_sd: 0.0, ..small() });
    for minute in 0..40 {
        let power_w = if minute % 2 == 0 { 12.0 } else { 1.5 };
        for tenth in 0..600 {
            let all = [(0, power_w), (1, power_w)];
            line.send(&all[..if tenth % 100 == 57 { 1 } else { 2 }], 0);
        }
    }
    let [all_j, some_j] = [0, 1].map(|robot| line.left_j(robot));
    assert!((all_j - some_j).abs() < 5.0, "{all_j} {some_j}");
    // Its bounds do not pretend that the lost time was metered.
    let [all, some] = [0, 1].map(|robot| world::budget(&line.fleet, robot));
    assert!(some.soc_sd >= all.soc_sd && some.soc_lo < all.soc_lo, "{some:?}");
}

#[test]
fn an_absence_is_valued_at_the_mean_before_it_whatever_the_first_reading_is() {
    use gaps::{Line, small};
    // The worker restarts never, or so many seconds after the last sample.
    for restarts_s in [None, Some(0), Some(3), Some(20)] {
        let mut line = Line::new(small());
        let ones = [(0, 6.0), (1, 6.0), (2, 6.0)];
        for _ in 0..3_000 {
            line.send(&ones, 0);
        }
        let before_j = line.left_j(0);
        line.silence(restarts_s.unwrap_or(0));
        if restarts_s.is_some() {
            line.restart();
        }
        line.silence(45 - restarts_s.unwrap_or(0));
        assert!(line.fleet.is_empty(), "they have left");
        line.send(&[(0, 6.0), (1, 1.0), (2, 15.0)], 0);
        for robot in 0..3 {
            let drawn_j = before_j - line.left_j(robot);
            assert!((drawn_j - 45.1 * 6.0).abs() < 1.0, "robot {robot}: {drawn_j} J");
            let shown = world::budget(&line.fleet, robot);
            // One reading stands for a period.
            assert!((f64::from(shown.mean_power_w) - 6.0).abs() < 0.1, "{shown:?}");
        }
        // Nor does a second silence count with it: the mean is of the whole time before.
        line.silence(10);
        let drawn_j = before_j - line.left_j(2);
        assert!((drawn_j - 55.0 * 6.0).abs() < 3.0, "{drawn_j} J");
    }
}

#[test]
fn an_absence_is_valued_by_the_time_off_the_charger_only() {
    use gaps::{Line, small};
    let readings = [
        (ChargeReading::Battery, -12.0),
        (ChargeReading::Charger, 12.0),
        (ChargeReading::Load, 1.0),
    ];
    for (charge_reading, charge_w) in readings {
        let (initial_soc, initial_soc_lo, charge_power_w) = (0.5, 0.48, Some(12.0));
        let battery =
            Battery { charge_reading, initial_soc, initial_soc_lo, charge_power_w, ..small() };
        let mut line = Line::new(battery);
        let send = |line: &mut Line, seconds: u64, power_w: f32, flags: u32| {
            (0..10 * seconds).for_each(|_| line.send(&[(0, power_w)], flags));
        };
        // A robot that joins on its charger has no mean yet.
        send(&mut line, 30, charge_w, sample_flag::CHARGING);
        assert!(world::budget(&line.fleet, 0).mean_power_w.is_nan());
        send(&mut line, 60, 6.0, 0);
        send(&mut line, 300, charge_w, sample_flag::CHARGING);
        assert!((world::budget(&line.fleet, 0).mean_power_w - 6.0).abs() < 0.01);
        send(&mut line, 30, 6.0, 0);
        let before_j = line.left_j(0);
        line.silence(200);
        line.send(&[(0, 6.0)], 0);
        let drawn_j = before_j - line.left_j(0);
        assert!((drawn_j - 200.1 * 6.0).abs() < 2.0, "{charge_reading:?}: {drawn_j} J");
    }
}

#[test]
fn a_metered_charge_stays_known_if_a_tick_is_late_or_a_reading_is_missing() {
    use gaps::{Line, small};
    for (charge_reading, charge_w) in
        [(ChargeReading::Battery, -12.0), (ChargeReading::Charger, 12.0)]
    {
        for measured in [false, true] {
            let (initial_soc, initial_soc_lo) = (0.3, 0.28);
            let battery = Battery {
                charge_reading,
                initial_soc,
                initial_soc_lo,
                low: 0.4,
                charge_power_w: None,
                sensor_sd: 0.05,
                ..small()
            };
            let mut line = Line::new(battery);
            (0..600).for_each(|_| line.send(&[(0, charge_w)], sample_flag::CHARGING));
            let before = world::budget(&line.fleet, 0);
            let raised =
                |line: &Line| world::diagnostic(&line.fleet, 0).alarms().has(Alarm::BatteryLow);
            let check = |line: &Line, what: &str| {
                let now = world::budget(&line.fleet, 0);
                let moved = (now.soc - before.soc).abs().max((now.soc_hi - before.soc_hi).abs());
                let moved = moved.max((now.soc_lo - before.soc_lo).abs());
                assert!(moved < 0.005, "{charge_reading:?}, {what}: {now:?} after {before:?}");
                assert!(raised(line), "{what}");
            };
            check(&line, "before");
            line.late(0.1);
            check(&line, "a late tick");
            line.send(&[(0, charge_w)], sample_flag::CHARGING);
            check(&line, "the next sample");
            for _ in 0..3 {
                line.send_without_reading(|sample| {
                    let sample = sample.with(sample_flag::CHARGING);
                    if measured { sample.state_of_charge(0.33) } else { sample }
                });
                if !measured {
                    check(&line, "a sample without a reading");
                }
            }
            line.send(&[(0, charge_w)], sample_flag::CHARGING);
            if measured {
                let now = world::budget(&line.fleet, 0);
                assert!((now.soc - before.soc).abs() < 0.02, "{now:?} after {before:?}");
            } else {
                check(&line, "the reading after it");
            }
            // Without any for long, everything may have happened.
            (0..20).for_each(|_| {
                line.send_without_reading(|sample| sample.with(sample_flag::CHARGING));
            });
            let unknown = world::budget(&line.fleet, 0);
            assert!(unknown.soc_hi > 0.99, "{unknown:?}");
        }
    }
}

#[test]
fn an_absence_before_which_no_power_is_known_costs_half_of_the_most_and_is_uncertain() {
    use gaps::{Line, small};
    let mut line = Line::new(small());
    line.send_without_reading(|sample| sample);
    let before = world::budget(&line.fleet, 0);
    line.silence(20);
    let silent = world::budget(&line.fleet, 0);
    // Its sample has none either, and it leaves, and comes back.
    line.send_without_reading(|sample| sample);
    line.silence(45);
    assert!(line.fleet.is_empty(), "it has left");
    line.send_without_reading(|sample| sample);
    let after = world::budget(&line.fleet, 0);
    for (now, seconds) in [(silent, 20.0), (after, 65.2)] {
        let drawn_j = f64::from(before.left_j - now.left_j);
        assert!((drawn_j - 10.0 * seconds).abs() < 2.0, "{seconds} s: {drawn_j} J");
        let sd_j =
            18_000.0 * f64::from(now.soc_sd * now.soc_sd - before.soc_sd * before.soc_sd).sqrt();
        assert!(sd_j > 3.0 * seconds, "{seconds} s: ± {sd_j} J");
        assert!(now.soc_lo < before.soc_lo - (20.0 * seconds - 30.0) as f32 / 18_000.0, "{now:?}");
    }
}

#[test]
fn a_charge_is_unknown_if_an_absence_would_have_drawn_all_that_was_left_then() {
    use gaps::{Line, small};
    let mut line = Line::new(small());
    // 16 % are left of what was full when the robot joined.
    for _ in 0..(0.84 * 18_000.0 / 0.6) as u64 {
        line.send(&[(0, 6.0)], 0);
    }
    // The mean draws 54 % meanwhile.
    line.silence((0.54f64 * 18_000.0 / 6.0) as u64);
    line.send(&[(0, 6.0)], 0);
    assert_charge_is_unknown(&world::budget(&line.fleet, 0));
    assert!(!world::diagnostic(&line.fleet, 0).alarms().has(Alarm::BatteryCritical));
    // A battery that has enough for the absence is known after it.
    let mut line = Line::new(small());
    for _ in 0..3_000 {
        line.send(&[(0, 6.0)], 0);
    }
    line.silence((0.54f64 * 18_000.0 / 6.0) as u64);
    line.send(&[(0, 6.0)], 0);
    let shown = world::budget(&line.fleet, 0);
    assert!((f64::from(shown.soc) - 0.36).abs() < 0.01, "{shown:?}");
}

#[test]
fn a_battery_that_stays_full_tells_no_more_with_every_sample() {
    let full = |sample: Sample, truth: &Truth| charged(with_soc(sample, truth), truth);
    let run = |steps: u64| {
        let mut bench = Bench::new(battery());
        (bench.truth.soc, bench.truth.bias) = (1.0, -0.03);
        for _ in 0..steps {
            bench.send(0.0, full);
        }
        bench
    };
    // With the sensor's step of 1 % a sample a second more or less tells nothing.
    let [short, long] = [20, 1_000].map(|steps| run(steps).budget());
    assert!(long.soc_sd > 0.004, "{long:?}");
    assert!((0.5..2.0).contains(&(long.soc_sd / short.soc_sd)), "{long:?} {short:?}");
    assert!(long.sensor_bias_sd < 0.03, "{long:?}");
    // The errors of charge and sensor stay one error: where the one is wrong, the other is.
    assert!(long.sensor_covariance < -0.5 * long.soc_sd * long.sensor_bias_sd, "{long:?}");
    // Away from the charger and back it is full again, at once.
    let mut bench = run(50);
    bench.drive(HOUR / 4, with_soc);
    let back = bench.send(0.0, full);
    assert!((back.soc - 1.0).abs() < 0.02, "{back:?}");
}
