//! Time to empty of simulated batteries whose truth is known.

use joulebus_fleet::Fleet;
use joulebus_predictor::{FeatureSet, Model};
use joulebus_settings::{Battery, FleetSettings, Platform};
use joulebus_testkit_fleets::random::{self, Noise};
use joulebus_testkit_fleets::{self as world, MS, Source, budget};
use joulebus_wire::{Budget, Sample, sample_flag};

const STEP_NS: u64 = 2_000 * MS;
const STEP_S: f64 = 2.0;
const START_NS: u64 = 60_000 * MS;
/// One hour and a half at the platform's mean.
const CAPACITY_J: f64 = 20_000.0;
/// The mean of the network's energy model, whose 90 % interval is 0.1 wide on each side.
const MEAN_W: f64 = 3.7;
const ROBOTS: u32 = 24;

fn fleet(robots: u32) -> Fleet {
    let settings = world::settings(robots);
    let platform = Platform {
        robots: vec![0..=robots - 1],
        period_ns: STEP_NS,
        stale_after_ns: 30 * STEP_NS,
        hold_max_ns: 30 * STEP_NS,
        battery: Some(Battery {
            initial_soc: 0.95,
            initial_soc_lo: 0.93,
            counting_sd: 0.0,
            ..Battery::new(CAPACITY_J, 0.05)
        }),
        ..settings.platforms[0].clone()
    };
    let intake = joulebus_settings::Intake {
        max_jump_ns: u64::MAX,
        leave_after_ns: 60 * STEP_NS,
        ..settings.intake
    };
    let settings = FleetSettings { platforms: vec![platform], intake, ..settings };
    let model = Model::Network(random::network(1, FeatureSet::Full));
    Fleet::new(settings, vec![model]).expect("the settings are consistent")
}

fn between(noise: &mut Noise, from: f64, to: f64) -> f64 {
    from + (to - from) * (noise.next_u64() >> 11) as f64 / (1u64 << 53) as f64
}

fn normal(noise: &mut Noise) -> f64 {
    (0..12).map(|_| between(noise, 0.0, 1.0)).sum::<f64>() - 6.0
}

/// The power of each step until the battery is empty. Robots differ by 3 %, missions of two to
/// eight minutes by 10 %, and steps by 10 %.
fn drawn_w(noise: &mut Noise) -> Vec<f64> {
    let usable_j = CAPACITY_J * (0.9 + 0.01 * normal(noise));
    let level = 1.0 + 0.03 * normal(noise);
    let (mut drawn_w, mut sum_j, mut mission, mut left) = (Vec::new(), 0.0, 1.0, 0);
    while sum_j < usable_j {
        if left == 0 {
            left = between(noise, 60.0, 240.0) as usize;
            mission = 1.0 + 0.1 * normal(noise);
        }
        left -= 1;
        let power_w = MEAN_W * level * mission * (1.0 + 0.1 * normal(noise));
        sum_j += power_w * STEP_S;
        drawn_w.push(power_w);
    }
    drawn_w
}

fn sample(robot: u32, step: usize, power_w: f64) -> Sample {
    let now_ns = START_NS + step as u64 * STEP_NS;
    Sample::new(robot, step as u64, now_ns).command(0.0, 0.0).reading(power_w as f32, now_ns)
}

#[derive(Default)]
struct Judged {
    errors: Vec<f64>,
    inside: usize,
    width: f64,
}

impl Judged {
    fn add(&mut self, shown: &Budget, true_s: f64) {
        let [found_s, lo_s, hi_s] =
            [shown.time_to_empty_s, shown.time_to_empty_lo_s, shown.time_to_empty_hi_s]
                .map(f64::from);
        self.errors.push((found_s / true_s - 1.0).abs());
        self.inside += usize::from((lo_s..=hi_s).contains(&true_s));
        self.width += (hi_s - lo_s) / found_s;
    }

    /// Median error, share inside and mean width.
    fn figures(&mut self) -> [f64; 3] {
        self.errors.sort_by(f64::total_cmp);
        let count = self.errors.len() as f64;
        [self.errors[self.errors.len() / 2], self.inside as f64 / count, self.width / count]
    }
}

#[test]
fn the_time_to_empty_of_simulated_batteries_holds_in_the_first_minute_and_later() {
    let mut noise = Noise(34);
    let all: Vec<Vec<f64>> = (0..ROBOTS).map(|_| drawn_w(&mut noise)).collect();
    let (mut fleet, mut source) = (fleet(ROBOTS), Source::new(1, 1));
    let mut judged: [Judged; 3] = Default::default();
    let steps = all.iter().map(Vec::len).max().unwrap_or(0);
    for step in 0..steps {
        let going = all.iter().enumerate().filter(|(_, drawn_w)| step < drawn_w.len());
        let frame: Vec<Sample> =
            going.map(|(robot, drawn_w)| sample(robot as u32, step, drawn_w[step])).collect();
        source.tick(&mut fleet, &frame, START_NS + step as u64 * STEP_NS);
        for (robot, drawn_w) in all.iter().enumerate() {
            let left_s = drawn_w.len().saturating_sub(step + 1) as f64 * STEP_S;
            // Ten minutes before the end a robot is called back.
            if step < 3 || step % 15 != 3 || left_s < 600.0 {
                continue;
            }
            let at_s = step as f64 * STEP_S;
            let place = usize::from(at_s > 60.0) + usize::from(at_s > 1_200.0);
            judged[place].add(&budget(&fleet, robot as u32), left_s);
        }
    }
    let limits = [0.15, 0.12, 0.12];
    let (mut inside, mut count) = (0, 0);
    for (judged, limit) in judged.iter_mut().zip(limits) {
        let [error, share, width] = judged.figures();
        println!("median error {error:.3}, inside {share:.3}, width {width:.2}");
        assert!(error <= limit && width < 0.3, "{error}, {width}");
        inside += judged.inside;
        count += judged.errors.len();
    }
    let share = f64::from(inside as u32) / f64::from(count as u32);
    // Nine of ten are stated, and more are inside: these robots vary less than the model's errors.
    // All of them would mean that the bounds are empty words.
    assert!((0.95..0.995).contains(&share), "{share}");
}

#[test]
fn what_a_robot_draws_on_its_charger_shows_nothing_of_its_work() {
    let (mut fleet, mut source) = (fleet(1), Source::new(1, 1));
    let mut send = |step: usize, power_w: f64, flags: u32| {
        let sample = sample(0, step, power_w).with(flags);
        source.tick(&mut fleet, &[sample], sample.stamp_ns);
        let shown = budget(&fleet, 0);
        f64::from(shown.usable_j) / f64::from(shown.time_to_empty_s)
    };
    let mut before_w = 0.0;
    for step in 0..200 {
        before_w = send(step, 4.4, 0);
    }
    for step in 200..900 {
        send(step, 0.4, sample_flag::CHARGING);
    }
    let after_w = send(900, 4.4, 0);
    assert!((after_w / before_w - 1.0).abs() < 0.01, "{before_w} W before, {after_w} W after");
}
