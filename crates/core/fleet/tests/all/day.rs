//! A day of simulated robots, whose truth is known, with all that a day has: lost samples, absences,
//! restarts of the worker, charging, a night, gauges that are wrong. What budgets and answers state
//! is compared with what happened.

use joulebus_energy::EnergyModel;
use joulebus_fleet::{Fleet, Ledger, SavedBattery};
use joulebus_plan::{Answer, Frames, PlanFleet, Platform as PlanPlatform, Verdict};
use joulebus_predictor::{FeatureSet, Model};
use joulebus_settings::{Battery, ChargeReading, FleetSettings, Platform};
use joulebus_statistics::poisson::upper_decay;
use joulebus_testkit_fleets::random::{self, Noise};
use joulebus_testkit_fleets::{self as world, MS, Source};
use joulebus_wire::{
    Budget, BudgetHeader, ChargeState, PlanState, PlanStateHeader, SCHEMA_VERSION, Sample,
    budget_flag, sample_flag,
};

const STEP_NS: u64 = 4_000 * MS;
const STEP_S: f64 = 4.0;
const START_NS: u64 = 60_000 * MS;
const HOUR: u64 = 900;
const DAY: u64 = 24 * HOUR;
/// Seven hours at the mean power.
const CAPACITY_J: f64 = 93_000.0;
const MEAN_W: f64 = 3.7;
/// In each of as many days as there are seeds.
const ROBOTS: usize = 100;
const SEEDS: [u64; 4] = [5, 6, 7, 8];
/// Charge when the charger reports full, with the deviation of that.
const FULL: (f64, f64) = (0.97, 0.01);

fn battery() -> Battery {
    Battery {
        initial_soc: 0.9,
        initial_soc_lo: 0.86,
        charge_reading: ChargeReading::Battery,
        charge_efficiency: 0.9,
        charge_power_w: Some(30.0),
        on_full_soc: FULL.0,
        counting_sd: 0.03,
        ..Battery::new(CAPACITY_J, 0.05)
    }
}

fn settings() -> FleetSettings {
    let settings = world::settings(ROBOTS as u32);
    let platform = Platform {
        robots: vec![0..=ROBOTS as u32 - 1],
        period_ns: STEP_NS,
        stale_after_ns: 10 * STEP_NS,
        hold_max_ns: 10 * STEP_NS,
        stuck_after_ns: 1_000 * STEP_NS,
        power_min_w: -30.0,
        battery: Some(battery()),
        ..settings.platforms[0].clone()
    };
    let intake = joulebus_settings::Intake {
        max_jump_ns: u64::MAX,
        leave_after_ns: 30 * STEP_NS,
        ..settings.intake
    };
    FleetSettings { platforms: vec![platform], intake, ..settings }
}

fn fleet() -> Fleet {
    let model = Model::Network(random::network(1, FeatureSet::Full));
    Fleet::new(settings(), vec![model]).expect("the settings are consistent")
}

fn uniform(noise: &mut Noise) -> f64 {
    (noise.next_u64() >> 11) as f64 / (1u64 << 53) as f64
}

fn normal(noise: &mut Noise) -> f64 {
    (0..12).map(|_| uniform(noise)).sum::<f64>() - 6.0
}

/// Draws of a normal distribution in any order, one in each of as many equal parts of it: a table of
/// shares then has little error of its own.
fn normals(noise: &mut Noise) -> Vec<f64> {
    let (mut below, mut all) = (0.0, Vec::new());
    for place in -40_000..40_000 {
        let value = f64::from(place) * 1e-4;
        below += 1e-4 * (-0.5 * value * value).exp() / std::f64::consts::TAU.sqrt();
        if below * ROBOTS as f64 >= all.len() as f64 + 0.5 {
            all.push(value);
        }
    }
    all.resize(ROBOTS, 0.0);
    for place in (1..ROBOTS).rev() {
        all.swap(place, (uniform(noise) * (place + 1) as f64) as usize);
    }
    all
}

/// What a robot is really like.
struct Robot {
    soc: f64,
    /// Error of its power monitor, relative.
    gain: f64,
    /// Its charge when it is full.
    full: f64,
    level: f64,
    mission: f64,
    mission_ends: u64,
    away_until: u64,
    /// Share of its samples that are lost.
    lost: f64,
    /// Error of its gauge. `None`: it has none. Infinite: it is stuck.
    gauge: Option<f64>,
    is_charging: bool,
    is_full: bool,
    left_j: f64,
    /// By its monitor.
    drawn_j: f64,
    saved: Option<Budget>,
}

impl Robot {
    /// Robots work until this much is left. Each has its own time of day.
    fn works(number: usize, step: u64) -> bool {
        (step + 37 * number as u64) % (8 * HOUR) < 5 * HOUR
    }

    fn is_off(step: u64) -> bool {
        (15 * HOUR..21 * HOUR).contains(&step)
    }

    /// Power out of the battery over the next step, W.
    fn power_w(&mut self, number: usize, step: u64, noise: &mut Noise) -> f64 {
        self.is_charging = !Self::works(number, step);
        if step >= self.mission_ends {
            self.mission_ends = step + 30 + (uniform(noise) * 90.0) as u64;
            self.mission = 1.0 + 0.1 * normal(noise);
        }
        match (self.is_charging, self.soc >= self.full) {
            (true, true) => 0.0,
            (true, false) => -12.0,
            _ => MEAN_W * self.level * self.mission * (1.0 + 0.1 * normal(noise)),
        }
    }

    /// The monitor reads `power_w`, of which it is wrong.
    fn draw(&mut self, power_w: f64) {
        self.drawn_j += power_w * STEP_S;
        let stored = if power_w < 0.0 { 0.9 } else { 1.0 };
        self.soc -= stored * power_w * (1.0 + self.gain) * STEP_S / CAPACITY_J;
        self.soc = self.soc.clamp(0.0, if self.is_charging { self.full } else { 1.0 });
        self.is_full = self.is_charging && self.soc >= self.full;
    }
}

/// The answer to standing still, from a battery with this reserve.
fn answered(
    battery: Battery,
    energy: EnergyModel,
    (state, budget): (&PlanState, &Budget),
    duration_s: f32,
    step: u64,
) -> Option<Answer> {
    let (reserve, capacity_j) = (battery.reserve, battery.capacity_j);
    let above = |share: f32| ((f64::from(share) - reserve).max(0.0) * capacity_j) as f32;
    let budget =
        Budget { usable_j: above(budget.soc), usable_lo_j: above(budget.soc_lo), ..*budget };
    let platform = Platform { battery: Some(battery), ..settings().platforms[0].clone() };
    let fleet = PlanFleet::of(vec![PlanPlatform::new(platform, energy, 0)], 0);
    let sent_ns = START_NS + step * STEP_NS;
    let schema = SCHEMA_VERSION;
    let header =
        PlanStateHeader { schema, period_ns: STEP_NS, sent_ns, tick: 1, ..Default::default() };
    let of = BudgetHeader { schema, sent_ns, tick: 1, ..Default::default() };
    let budget = Some((&of, &budget));
    let frames = Frames { header: &header, state, budget, now_ns: sent_ns };
    Some(fleet.robot(&frames)?.idle(duration_s, 0.9).expect("it may be asked"))
}

/// A question that was answered, and the step at which its plan ends.
struct Asked {
    robot: usize,
    ends: u64,
    reserve: f64,
    stated: f64,
    is_yes: bool,
    duration_s: f64,
    /// Energy drawn before.
    drawn_j: f64,
    /// Its energy, with the 90 % interval.
    energy_j: [f64; 3],
}

/// Longest plans of each length, s.
const LENGTHS_S: [f64; 4] = [60.0, 150.0, 1_200.0, 3_600.0];

/// Plans of a length: their number, how many lay inside the interval, the sum of its relative widths,
/// wrong and right yeses.
#[derive(Default, Clone, Copy)]
struct Length {
    plans: f64,
    inside: f64,
    width: f64,
    yes: [u64; 2],
}

/// Prints the table of lengths. Intervals hold at least nearly what they state. Wrong yeses are at most
/// as frequent as stated and five points. The longest intervals are at most 2.5 times as wide as those
/// about 100 s.
fn assert_lengths(lengths: &[Length; 4]) {
    println!("| up to s | plans | inside % | width | yes | wrong | at most % |");
    println!("|{}", "---|".repeat(7));
    for (length, longest_s) in lengths.iter().zip(LENGTHS_S) {
        let Length { plans, inside, width, yes: [wrong, right] } = length;
        let bound = 100.0 * upper_decay(*wrong, *right, 0.975);
        let (inside, width, yes) = (100.0 * inside / plans, width / plans, wrong + right);
        println!(
            "| {longest_s} | {plans} | {inside:.1} | {width:.3} | {yes} | {wrong} | {bound:.1} |"
        );
    }
    let holds = |Length { plans, inside, yes: [wrong, right], .. }: &Length| {
        let bound = upper_decay(*wrong, *right, 0.975);
        *inside >= 0.85 * plans && wrong + right >= 200 && bound <= 0.15
    };
    assert!(lengths.iter().all(holds));
    let width = |length: usize| lengths[length].width / lengths[length].plans;
    assert!(width(3) <= 2.5 * width(1), "{} {}", width(3), width(1));
}

/// Stated probabilities in tenths, with what happened.
#[derive(Default, Clone, Copy)]
struct Tenth {
    count: f64,
    stated: f64,
    happened: f64,
}

/// Adds what happened to robots of which the same was stated.
fn add(tenths: &mut [Tenth; 10], stated: f64, happened: impl IntoIterator<Item = bool>) {
    let tenth = &mut tenths[((10.0 * stated) as usize).min(9)];
    for happened in happened {
        tenth.count += 1.0;
        tenth.stated += stated;
        tenth.happened += f64::from(u8::from(happened));
    }
}

/// Prints the table, and compares stated with happened.
fn assert_calibrated(tenths: &[Tenth; 10], most: f64) {
    println!("| stated % | happened % | plans |\n|---|---|---|");
    let shares = tenths.map(|tenth| [tenth.stated, tenth.happened].map(|sum| sum / tenth.count));
    for ([stated, happened], tenth) in shares.iter().zip(tenths) {
        println!("| {:.1} | {:.1} | {} |", 100.0 * stated, 100.0 * happened, tenth.count);
    }
    for ([stated, happened], tenth) in shares.iter().zip(tenths) {
        assert!(tenth.count >= 300.0, "{} plans", tenth.count);
        assert!((stated - happened).abs() < most, "{stated:.3} stated, {happened:.3} happened");
    }
}

struct Day {
    fleet: Fleet,
    source: Source,
    noise: Noise,
    robots: Vec<Robot>,
    asked: Vec<Asked>,
    tenths: [Tenth; 10],
    lengths: [Length; 4],
    inside: [usize; 2],
    rises: usize,
}

impl Day {
    fn new(seed: u64) -> Self {
        let mut noise = Noise(seed);
        let battery = battery();
        let initial_sd = (battery.initial_soc - battery.initial_soc_lo) / 2.0;
        let [charges, gains, fulls] = std::array::from_fn(|_| normals(&mut noise));
        let robot = |number: usize| Robot {
            soc: battery.initial_soc + initial_sd * charges[number],
            gain: battery.counting_sd * gains[number],
            full: FULL.0 + FULL.1 * fulls[number],
            level: 1.0 + 0.03 * normal(&mut Noise(seed + number as u64)),
            mission: 1.0,
            mission_ends: 0,
            away_until: 0,
            lost: [0.0, 0.01, 0.1][number % 3],
            gauge: match number % 20 {
                7 => Some(0.05 * normal(&mut Noise(number as u64))),
                13 => Some(f64::INFINITY),
                _ => None,
            },
            is_charging: false,
            is_full: false,
            left_j: f64::INFINITY,
            drawn_j: 0.0,
            saved: None,
        };
        Self {
            robots: (0..ROBOTS).map(robot).collect(),
            fleet: fleet(),
            source: Source::new(1, 1),
            noise,
            asked: Vec::new(),
            tenths: [Tenth::default(); 10],
            lengths: [Length::default(); 4],
            inside: [0; 2],
            rises: 0,
        }
    }

    fn run(&mut self) {
        for step in 0..DAY {
            self.step(step);
            self.watch(step);
            if [3, 11, 22].map(|hour| hour * HOUR + 77).contains(&step) {
                self.restart(2 + step);
            }
            for _ in 0..4 {
                self.ask(step);
            }
            self.judge(step);
        }
    }

    fn step(&mut self, step: u64) {
        let now_ns = START_NS + step * STEP_NS;
        let mut samples = Vec::new();
        for (number, robot) in self.robots.iter_mut().enumerate() {
            if Robot::is_off(step) {
                // Somebody charges them in the night, and nobody says so.
                robot.soc = (robot.soc + 0.0002).min(robot.full);
                continue;
            }
            let power_w = robot.power_w(number, step, &mut self.noise);
            robot.draw(power_w);
            let noise = &mut self.noise;
            if robot.away_until <= step && uniform(noise) < 1.0 / 3_000.0 && !robot.is_charging {
                robot.away_until = step + 5 + (uniform(noise) * 70.0) as u64;
            }
            let is_away = step < robot.away_until && !robot.is_charging;
            if is_away || uniform(noise) < robot.lost {
                continue;
            }
            let mut sample = Sample::new(number as u32, step, now_ns)
                .command(0.0, 0.0)
                .reading(power_w as f32, now_ns);
            if robot.is_charging {
                sample = sample.with(sample_flag::CHARGING);
            }
            if robot.is_full {
                sample = sample.with(sample_flag::FULL);
            }
            if let Some(error) = robot.gauge {
                let shown = if error.is_finite() { robot.soc + error } else { 0.7 };
                sample = sample
                    .state_of_charge((100.0 * shown).round().clamp(0.0, 100.0) as f32 / 100.0);
            }
            samples.push(sample);
        }
        self.source.tick(&mut self.fleet, &samples, now_ns);
    }

    /// Another worker continues from what this one saved.
    fn restart(&mut self, epoch: u64) {
        let mut after = fleet();
        for budget in self.robots.iter().filter_map(|robot| robot.saved) {
            let drawn = (budget.drawn_uj, budget.drawn_remainder);
            let times = (budget.metered_ns, budget.unmetered_ns, budget.stamp_ns);
            let ledger = Ledger::restored(drawn, budget.forecast_uj, times.0, times.1, times.2);
            after.restore(budget.robot, ledger, true, SavedBattery::new(&budget, 0));
        }
        (self.fleet, self.source) = (after, Source::new(1, epoch));
    }

    /// Energy left never rises without charge, and the truth is inside the bounds.
    fn watch(&mut self, step: u64) {
        for place in 0..self.fleet.len() {
            let budget = self.fleet.budget(place);
            let robot = &mut self.robots[budget.robot as usize];
            // As the worker saves it: the account begins at the last sample.
            if robot.saved.is_none_or(|saved| saved.stamp_ns != budget.stamp_ns) {
                robot.saved = Some(budget);
            }
            let is_known = budget.flags & budget_flag::CHARGE != 0;
            let left_j = f64::from(budget.left_j);
            // A ledger's numbers have single precision.
            let rises = is_known && left_j > robot.left_j + 0.02;
            let charges = robot.is_charging || budget.charge_state() != ChargeState::Discharging;
            let may_rise = charges || robot.gauge.is_some() || Robot::is_off(step);
            if rises && !may_rise {
                println!("step {step}: {left_j} J after {} J, {budget:?}", robot.left_j);
                self.rises += 1;
            }
            robot.left_j = if may_rise || !is_known { f64::INFINITY } else { left_j };
            if is_known && (step + 11 * place as u64).is_multiple_of(150) {
                let bounds = f64::from(budget.soc_lo)..=f64::from(budget.soc_hi);
                self.inside[usize::from(bounds.contains(&robot.soc))] += 1;
            }
        }
    }

    /// Asks a robot about a plan of 10 s to an hour. Its energy is about what
    /// the robot can spare: the reserve is chosen so.
    fn ask(&mut self, step: u64) {
        let number = (uniform(&mut self.noise) * ROBOTS as f64) as usize;
        let duration_s = 10.0 * 360f64.powf(uniform(&mut self.noise));
        let place = world::place(&self.fleet, number as u32);
        let ends = step + (duration_s / STEP_S).round().max(1.0) as u64;
        let works = (step..=ends).all(|step| Robot::works(number, step) && !Robot::is_off(step));
        let (Some(place), true, true) = (place, works, ends < DAY) else {
            return;
        };
        let (state, budget) = (self.fleet.plan_state(place), self.fleet.budget(place));
        if budget.flags & budget_flag::CHARGE == 0 || self.robots[number].gauge.is_some() {
            return;
        }
        let steps_s = (ends - step) as f64 * STEP_S;
        let spread = 5.0 * uniform(&mut self.noise) - 2.5;
        let wanted = f64::from(budget.soc) - MEAN_W * steps_s / CAPACITY_J;
        let sd = f64::from(budget.soc_sd) + 0.1 * MEAN_W * steps_s / CAPACITY_J;
        let reserve = wanted + spread * sd;
        if !(0.01..0.95).contains(&reserve) {
            return;
        }
        let battery = Battery { reserve, ..battery() };
        let energy = self.fleet.energy_model(0).expect("there is one").clone();
        let answer = answered(battery, energy, (&state, &budget), steps_s as f32, step);
        let answer = answer.expect("it is there");
        let Some(probability) = answer.probability else {
            return;
        };
        let energy = answer.energy.expect("it is known with a probability");
        self.asked.push(Asked {
            robot: number,
            ends,
            reserve,
            stated: probability.into(),
            is_yes: answer.verdict == Verdict::Yes,
            duration_s: steps_s,
            drawn_j: self.robots[number].drawn_j,
            energy_j: [energy.lo_j, energy.mean_j, energy.hi_j].map(f64::from),
        });
    }

    /// Whether the plans that end now left the reserve untouched.
    fn judge(&mut self, step: u64) {
        let (ended, asked): (Vec<Asked>, Vec<Asked>) =
            std::mem::take(&mut self.asked).into_iter().partition(|asked| asked.ends == step);
        self.asked = asked;
        for asked in ended {
            let robot = &self.robots[asked.robot];
            let happened = robot.soc > asked.reserve;
            add(&mut self.tenths, asked.stated, [happened]);
            let length = LENGTHS_S.iter().position(|longest_s| asked.duration_s <= *longest_s);
            let Some(length) = length.map(|place| &mut self.lengths[place]) else { continue };
            let ([lo_j, mean_j, hi_j], drawn_j) = (asked.energy_j, robot.drawn_j - asked.drawn_j);
            length.plans += 1.0;
            length.inside += f64::from(u8::from((lo_j..=hi_j).contains(&drawn_j)));
            length.width += (hi_j - lo_j) / mean_j;
            if asked.is_yes {
                length.yes[usize::from(happened)] += 1;
            }
        }
    }
}

#[test]
fn over_a_day_energy_left_never_rises_bounds_hold_and_probabilities_are_what_happens() {
    let (mut tenths, mut rises) = ([Tenth::default(); 10], 0);
    let (mut inside, mut lengths) = ([0; 2], [Length::default(); 4]);
    for seed in SEEDS {
        let mut day = Day::new(seed);
        day.run();
        rises += day.rises;
        for (all, of) in tenths.iter_mut().zip(day.tenths) {
            all.count += of.count;
            all.stated += of.stated;
            all.happened += of.happened;
        }
        inside = [0, 1].map(|at| inside[at] + day.inside[at]);
        for (all, of) in lengths.iter_mut().zip(day.lengths) {
            all.plans += of.plans;
            all.inside += of.inside;
            all.width += of.width;
            all.yes = [0, 1].map(|at| all.yes[at] + of.yes[at]);
        }
    }
    let [outside, inside] = inside.map(|count| count as f64);
    let inside = inside / (inside + outside);
    println!("{inside:.4} inside, {rises} rises");
    assert_eq!(rises, 0, "energy left rises without charge");
    assert!(inside >= 0.95, "{inside}");
    assert_lengths(&lengths);
    assert_calibrated(&tenths, 0.03);
}

/// Robots that are full, and then drive at a power that their monitors read exactly but for their
/// relative error. What they draw is certain, so that the battery's errors are all there is.
mod certain {
    use super::*;

    /// Five minutes, the longest horizon, take a quarter of it.
    const SMALL_J: f64 = 4.0 * MEAN_W * 300.0;
    const QUARTER: u64 = 75;

    fn small(reserve: f64) -> Battery {
        Battery { capacity_j: SMALL_J, reserve, ..battery() }
    }

    /// Energy is as forecast, to a thousandth.
    fn energy() -> EnergyModel {
        let errors = [-2.0, -1.5, -1.0, -0.5, 0.0, 0.5, 1.0, 1.5, 2.0].map(|part| part * 1e-3);
        let model = EnergyModel::untrained(MEAN_W as f32);
        EnergyModel { calibrated: 6, errors: [errors; 6], ..model }
    }

    pub(super) struct Fleet {
        pub fleet: joulebus_fleet::Fleet,
        source: Source,
        pub step: u64,
        robots: u32,
    }

    impl Fleet {
        pub(super) fn new(robots: u32) -> Self {
            let mut settings = settings();
            settings.platforms[0].battery = Some(small(0.0));
            let model = Model::Network(random::network(1, FeatureSet::Full));
            let fleet = joulebus_fleet::Fleet::new(settings, vec![model]);
            let fleet = fleet.expect("the settings are consistent");
            let mut new = Self { fleet, source: Source::new(1, 1), step: 0, robots };
            // Its network has all its readings, and then it is full.
            new.drive(30, 0);
            new.drive(1, sample_flag::CHARGING | sample_flag::FULL);
            new
        }

        pub(super) fn drive(&mut self, steps: u64, flags: u32) {
            for _ in 0..steps {
                self.step += 1;
                let now_ns = START_NS + self.step * STEP_NS;
                let sample = |robot| {
                    Sample::new(robot, self.step, now_ns)
                        .command(0.0, 0.0)
                        .reading(MEAN_W as f32, now_ns)
                        .with(flags)
                };
                let samples: Vec<Sample> = (0..self.robots).map(sample).collect();
                self.source.tick(&mut self.fleet, &samples, now_ns);
            }
        }

        /// Answer about the next steps.
        pub(super) fn ask(&self, robot: u32, steps: u64, reserve: f64) -> Answer {
            let (state, budget) =
                (world::plan_state(&self.fleet, robot), world::budget(&self.fleet, robot));
            let duration_s = (steps as f64 * STEP_S) as f32;
            let rows = (&state, &budget);
            answered(small(reserve), energy(), rows, duration_s, self.step).expect("it is there")
        }
    }

    /// Probability that a normal value with this mean and deviation is above a limit.
    fn above(mean: f64, sd: f64, limit: f64) -> f64 {
        let lowest = ((limit - mean) / sd).max(-8.0);
        let density = |at: f64| (-0.5 * at * at).exp() / std::f64::consts::TAU.sqrt();
        (0..16_000).map(|n| lowest + 1e-3 * (f64::from(n) + 0.5)).map(|at| 1e-3 * density(at)).sum()
    }

    #[test]
    fn a_plan_states_before_it_what_the_budget_says_after_the_expected_energy() {
        for before in [3, QUARTER, 2 * QUARTER] {
            for sigmas in [-2.5, -1.0, -0.3, 0.0, 0.6, 1.3, 2.0, 4.0] {
                let mut fleet = Fleet::new(1);
                fleet.drive(before, 0);
                let ask = |reserve| fleet.ask(0, QUARTER, reserve);
                let shown = world::budget(&fleet.fleet, 0);
                let reserve = f64::from(shown.soc) - 0.25 - sigmas * 0.02;
                if reserve < 0.01 {
                    continue;
                }
                let answer = ask(reserve);
                fleet.drive(QUARTER, 0);
                let after = world::budget(&fleet.fleet, 0);
                assert!((shown.soc - after.soc - 0.25).abs() < 1e-4, "{after:?}");
                let stated = f64::from(answer.probability.unwrap_or_else(|| panic!("{answer:?}")));
                let found = above(after.soc.into(), after.soc_sd.into(), reserve);
                println!(
                    "after {before} steps, reserve {reserve:.3}: {stated:.4}, then {found:.4}"
                );
                assert!((stated - found).abs() < 0.01, "{stated} before, {found} after");
                let is_yes = answer.verdict == Verdict::Yes;
                let is_certain = f64::from(after.soc_lo) > reserve;
                assert!(!is_yes || is_certain, "{answer:?}, {after:?}");
                // The verdict adds up the errors that the probability adds as squares.
                let margin = f64::from(after.soc_lo) - reserve;
                assert!(is_yes || margin < 0.015, "{answer:?}, {after:?}");
            }
        }
    }

    #[test]
    fn of_plans_up_to_a_quarter_of_the_battery_as_many_succeed_as_stated() {
        let mut tenths = [Tenth::default(); 10];
        for seed in SEEDS {
            let mut noise = Noise(seed);
            let [fulls, gains] = std::array::from_fn(|_| normals(&mut noise));
            let mut fleet = Fleet::new(1);
            for driven in 1..3 * QUARTER {
                fleet.drive(1, 0);
                let steps = 3 + (uniform(&mut noise) * (QUARTER - 3) as f64) as u64;
                let part = |steps: u64| 0.25 * steps as f64 / QUARTER as f64;
                let shown = world::budget(&fleet.fleet, 0);
                let spread = 5.0 * uniform(&mut noise) - 2.5;
                let wanted = f64::from(shown.soc) - part(steps);
                let reserve = wanted + spread * f64::from(shown.soc_sd);
                if reserve < 0.01 {
                    continue;
                }
                let answer = fleet.ask(0, steps, reserve);
                let stated = f64::from(answer.probability.unwrap_or_else(|| panic!("{answer:?}")));
                // To the worker all robots are the same one.
                let happened = (0..ROBOTS).map(|robot| {
                    let gain = battery().counting_sd * gains[robot];
                    let drawn = part(driven + steps) * (1.0 + gain);
                    FULL.0 + FULL.1 * fulls[robot] - drawn > reserve
                });
                add(&mut tenths, stated, happened);
            }
        }
        assert_calibrated(&tenths, 0.02);
    }
}
