//! Forecasts against a slow reference that keeps every reading, and their promises.

use joulebus_energy::{
    Calibration, CommandModel, CommandSum, Commands, EnergyModel, EnergySample, EnergyState,
    ErrorBounds, HORIZONS_S, KNOTS, LEVELS, LEVELS_S, Learned, Metered, PlatformErrors, Quantity,
    RIDGE_TERMS, Ridge, SHADOWS, SHADOWS_S, TERMS,
};
use proptest::prelude::*;

/// A model with every term, drawn from `seed`.
fn model(numbers: &[f32], added_share: f32) -> EnergyModel {
    let mut weights = [0.0; TERMS];
    for (weight, number) in weights.iter_mut().zip(numbers) {
        *weight = number.abs();
    }
    weights[0] += 1.0;
    let row = |horizon: usize| {
        let mut row = [0.0; LEVELS];
        row[horizon % LEVELS] += 0.75;
        row[(horizon + 2) % LEVELS] += 0.25;
        row
    };
    let errors: [f32; KNOTS] = [-0.5, -0.3, -0.2, -0.1, 0.01, 0.1, 0.25, 0.3, 0.8];
    EnergyModel {
        command: CommandModel { weights, half_v_mps: 0.1, half_omega_radps: 0.5, mean_w: 5.0 },
        prior_s: [0.1, 0.2, 0.3, 5.0],
        added_shares: [added_share; HORIZONS_S.len()],
        weights: std::array::from_fn(row),
        calibrated: HORIZONS_S.len(),
        errors: std::array::from_fn(|place| errors.map(|error| error * (1.0 + place as f32))),
        mean_share: 0.3,
        v_mps: [-1.0, 1.0],
        omega_radps: [-2.0, 2.0],
        combined: Some([1.5, 20.0, 40.0, 25.0, 50.0]),
        ..EnergyModel::untrained(5.0)
    }
}

/// The same with a regression in which speed lowers the power, known bounds and a hotel load.
fn with_ridge(model: EnergyModel) -> EnergyModel {
    let recorded_w = Some([4.0, 14.0]);
    EnergyModel { ridge: Some(ridge()), recorded_w, hotel_w: Some(2.0), ..model }
}

fn ridge() -> Ridge {
    let inverse = std::array::from_fn(|row| {
        let mut inverse = [0.0; RIDGE_TERMS];
        inverse[row] = 0.5;
        inverse
    });
    Ridge {
        constant_w: 9.0,
        means: [0.3, 0.1, 0.6, 0.8, 0.7, 0.6, 0.2],
        scales: [0.3, 0.1, 0.3, 0.5, 0.8, 0.3, 0.2],
        weights: [-1.0, -0.5, 0.3, 1.5, 0.8, 0.2, -0.6],
        inverse,
        max_leverage: 60.0,
        left_out: 0.4,
    }
}

/// Keeps every sample, and computes everything from the beginning in double precision.
struct Reference<'a> {
    model: &'a EnergyModel,
    /// Power, elapsed time, and the command from then on.
    samples: Vec<EnergySample>,
}

fn command(sample: &EnergySample) -> (f64, f64) {
    (sample.v_mps.into(), sample.omega_radps.into())
}

impl Reference<'_> {
    /// A value of each horizon, interpolated at a duration and constant beyond the ends.
    fn at(duration_s: f64, of: impl Fn(usize) -> f64) -> f64 {
        let horizons_s = HORIZONS_S.map(f64::from);
        match horizons_s.iter().position(|known| *known > duration_s) {
            Some(0) => of(0),
            None => of(HORIZONS_S.len() - 1),
            Some(after) => {
                let (from, to) = (horizons_s[after - 1], horizons_s[after]);
                let share = (duration_s - from) / (to - from);
                of(after - 1) * (1.0 - share) + of(after) * share
            }
        }
    }

    fn command_w(&self, command: (f64, f64), before: Option<(f64, f64)>, dt_s: f64) -> f64 {
        let (v, omega) = command;
        let (dv, domega) = match before {
            Some(before) if dt_s > 0.0 && before.0.is_finite() && before.1.is_finite() => {
                ((v - before.0) / dt_s, (omega - before.1) / dt_s)
            }
            _ => (0.0, 0.0),
        };
        let CommandModel { weights, half_v_mps, half_omega_radps, .. } = &self.model.command;
        let terms = [
            1.0,
            v.abs(),
            v.powi(2),
            v.abs() / (v.abs() + f64::from(*half_v_mps)),
            omega.abs(),
            omega.powi(2),
            omega.abs() / (omega.abs() + f64::from(*half_omega_radps)),
            (v * omega).abs(),
            (v * dv).max(0.0),
            (omega * domega).max(0.0),
            dv.abs(),
            domega.abs(),
        ];
        let pairs = weights.iter().zip(terms);
        pairs.map(|(weight, of)| f64::from(*weight) * of).sum()
    }

    /// Power of the command of sample `place`, W.
    fn in_force_w(&self, place: usize) -> f64 {
        let sample = &self.samples[place];
        if !(sample.v_mps.is_finite() && sample.omega_radps.is_finite()) {
            return self.model.command.mean_w.into();
        }
        let before = place.checked_sub(1).map(|at| command(&self.samples[at]));
        self.command_w(command(sample), before, sample.elapsed_s.into())
    }

    /// Discounted energy, energy of the commands, and time.
    fn sums(&self, level_s: f64) -> [f64; 3] {
        let mut sums = [0.0; 3];
        for place in 0..self.samples.len() {
            let EnergySample { power_w, elapsed_s, .. } = self.samples[place];
            if place == 0 || elapsed_s <= 0.0 || !power_w.is_finite() {
                continue;
            }
            let later = &self.samples[place..];
            let counted = later.iter().map(|step| f64::from(step.elapsed_s).max(0.0));
            let kept: f64 = counted.map(|s| level_s / (level_s + s)).product();
            let elapsed_s = f64::from(elapsed_s);
            sums[0] += kept * f64::from(power_w) * elapsed_s;
            sums[1] += kept * self.in_force_w(place - 1) * elapsed_s;
            sums[2] += kept * elapsed_s;
        }
        sums
    }

    /// Steps with a velocity or a change beyond the training data's.
    fn steps_outside(&self, plan: &[(f32, f32)], period_s: f64) -> usize {
        let [_, faster_v, faster_omega, dv_limit, domega_limit] = match self.model.combined {
            Some(limits) => limits.map(|limit| 1.05 * f64::from(limit)),
            None => [0.0; 5],
        };
        let newest = self.samples.last();
        let mut before = newest.map(|sample| (sample.v_mps, sample.omega_radps));
        let mut count = 0;
        for (v, omega) in plan {
            let known = before.filter(|(v, omega)| v.is_finite() && omega.is_finite());
            let from = known.unwrap_or((*v, *omega));
            let dv = (f64::from(*v) - f64::from(from.0)) / period_s;
            let domega = (f64::from(*omega) - f64::from(from.1)) / period_s;
            before = Some((*v, *omega));
            let (v, omega) = (f64::from(*v), f64::from(*omega));
            let within = |x: f64, [lo, hi]: [f32; 2]| f64::from(lo) <= x && x <= f64::from(hi);
            let inside = within(v, self.model.v_mps)
                && within(omega, self.model.omega_radps)
                && v * dv <= faster_v
                && omega * domega <= faster_omega
                && dv.abs() <= dv_limit
                && domega.abs() <= domega_limit;
            count += usize::from(!inside);
        }
        count
    }

    /// How far the newest readings contradict a level.
    fn contradiction(&self, level: usize) -> f64 {
        let sums = LEVELS_S.map(|level_s| self.sums(level_s.into()));
        let mean_w = f64::from(self.model.command.mean_w);
        let mut contradiction = 0.0;
        for newer in 0..level.min(2) {
            let ([old_j, old_command_j, old_s], [new_j, new_command_j, new_s]) =
                (sums[level], sums[newer]);
            if old_s <= 0.0 {
                continue;
            }
            let errors = self.model.errors[newer];
            let spread = (f64::from(errors[7] - errors[1]) / 3.29).max(1e-3);
            let mean = 0.5 * ((new_j / new_s).abs() + (old_j / old_s).abs());
            let apart_w = (new_j - new_command_j) / new_s - (old_j - old_command_j) / old_s;
            contradiction += (apart_w / mean.max(0.01 * mean_w) / spread / 2.0).powi(4);
        }
        contradiction
    }

    /// The share of the robot's own mean in a forecast without commands.
    fn own_share(horizon_s: f64) -> f64 {
        let [at_1_s, at_10_s, at_100_s] = [0.15 / 0.8, 0.3 / 0.95, 0.5 / 0.98];
        match horizon_s {
            ..10.0 => at_1_s + (at_10_s - at_1_s) * ((horizon_s - 1.0) / 9.0).max(0.0),
            _ => at_10_s + (at_100_s - at_10_s) * ((horizon_s - 10.0) / 90.0).min(1.0),
        }
    }

    /// Weights of the levels. A level loses weight to those that the newest readings support.
    fn weights(&self, horizon_s: f64) -> [f64; LEVELS] {
        let mut weights: [f64; LEVELS] = std::array::from_fn(|index| {
            Self::at(horizon_s, |place| self.model.weights[place][index].into())
        });
        for (level, weight) in weights.iter_mut().enumerate().skip(1) {
            *weight /= 1.0 + self.contradiction(level);
        }
        let kept: f64 = weights.iter().sum();
        weights.map(|weight| weight / kept)
    }

    fn energy_j(&self, plan: &[(f32, f32)], period_s: f64, trust: f32) -> f64 {
        let duration_s = plan.len() as f64 * period_s;
        let mut before = self.samples.last().map(command);
        let mut command_j = 0.0;
        for (v, omega) in plan {
            let command = (f64::from(*v), f64::from(*omega));
            command_j += self.command_w(command, before, period_s) * period_s;
            before = Some(command);
        }
        let weights = self.weights(duration_s);
        let spread = Self::at(duration_s, |place| {
            let errors = self.model.errors[place];
            f64::from(errors[7] - errors[1]) / 3.29
        });
        let (mut with_j, mut level_w, mut own_w) = (0.0, 0.0, None);
        let (added, trust) = (f64::from(self.model.added_shares[0]), f64::from(trust));
        let mean_w = f64::from(self.model.command.mean_w);
        for (index, level_s) in LEVELS_S.into_iter().enumerate() {
            let [read_j, expected_j, time_s] = self.sums(level_s.into());
            let above_j = read_j - expected_j;
            let (ratio, above_w, read_w) = match time_s > 0.0 {
                true => (read_j / expected_j, above_j / time_s, read_j / time_s),
                false => (1.0, 0.0, mean_w),
            };
            let prior_s = f64::from(self.model.prior_s[index]);
            let deviation = (ratio - 1.0) / spread;
            let since_start = time_s / (time_s + 3.0);
            let square = deviation.powi(2) * time_s / (time_s + prior_s) * since_start.powi(2);
            let shrunk = time_s / (time_s + prior_s / (1.0 + square));
            let scaled = command_j * (1.0 + shrunk * (ratio - 1.0));
            let raised = command_j + shrunk * above_w * duration_s;
            let with_commands = (1.0 - added) * scaled + added * raised;
            with_j += weights[index] * with_commands;
            level_w += weights[index] * (mean_w + shrunk * (read_w - mean_w));
            own_w = Some(read_w).filter(|_| time_s > 0.0);
        }
        let apart_w = own_w.map_or(0.0, |own_w| own_w - level_w);
        let own = Self::own_share(duration_s) / (1.0 + self.contradiction(LEVELS - 1));
        trust * with_j + (1.0 - trust) * (level_w + own * apart_w) * duration_s
    }
}

fn samples() -> impl Strategy<Value = Vec<EnergySample>> {
    let speeds = (-0.5f32..0.5, -2.0f32..2.0);
    let sample = (0.0f32..30.0, 0.01f32..0.3, speeds, 0u8..40);
    let sample = sample.prop_map(|(power_w, elapsed_s, (v_mps, omega_radps), kind)| EnergySample {
        power_w: if kind == 0 { f32::NAN } else { power_w },
        elapsed_s: if kind == 1 { 0.0 } else { elapsed_s },
        v_mps: if kind == 2 { f32::NAN } else { v_mps },
        omega_radps,
    });
    prop::collection::vec(sample, 1..80)
}

fn plan() -> impl Strategy<Value = Vec<(f32, f32)>> {
    prop::collection::vec((-0.5f32..0.5, -2.0f32..2.0), 1..60)
}

fn commands<'a>(period_s: f32, v_mps: &'a [f32], omega_radps: &'a [f32]) -> Commands<'a> {
    Commands { period_s, v_mps, omega_radps }
}

fn split(plan: &[(f32, f32)]) -> (Vec<f32>, Vec<f32>) {
    plan.iter().copied().unzip()
}

fn observed(model: &EnergyModel, samples: &[EnergySample]) -> EnergyState {
    let mut state = EnergyState::new(3);
    for sample in samples {
        state.observe(model, sample);
    }
    state
}

proptest! {
    #[test]
    fn a_forecast_is_the_slow_references(
        weights in prop::collection::vec(0.0f32..3.0, TERMS),
        added_share in 0.0f32..=1.0,
        samples in samples(),
        plan in plan(),
        period_s in 0.01f32..2.0,
    ) {
        let model = model(&weights, added_share);
        let state = observed(&model, &samples);
        let reference = Reference { model: &model, samples };
        let (v_mps, omega_radps) = split(&plan);
        let commands = Commands { period_s, v_mps: &v_mps, omega_radps: &omega_radps };
        let expected_j = reference.energy_j(&plan, period_s.into(), state.learned.command_trust);
        let found_j = f64::from(model.forecast(&state, commands).energy_j);
        prop_assert!((found_j - expected_j).abs() <= 2e-4 * expected_j.abs().max(1.0), "{found_j} {expected_j}");
    }

    /// A step is outside if a velocity or a change is beyond the training data's. Each step counts
    /// alone, however its sums are added in parts.
    #[test]
    fn steps_outside_the_training_data_are_counted_as_the_slow_reference_does(
        samples in samples(), plan in plan(), period_s in 0.02f32..0.5, cut in 0usize..60,
        combined in prop::option::of(prop::array::uniform5(0.0f32..20.0)),
    ) {
        let model = EnergyModel { v_mps: [-0.4, 0.3], omega_radps: [-1.0, 1.8], combined, ..model(&[0.5; TERMS], 0.0) };
        let state = observed(&model, &samples);
        let reference = Reference { model: &model, samples };
        let (v_mps, omega_radps) = split(&plan);
        let part = |from: usize, to: usize| Commands {
            period_s, v_mps: &v_mps[from..to], omega_radps: &omega_radps[from..to],
        };
        let expected = reference.steps_outside(&plan, period_s.into());
        prop_assert_eq!(model.forecast(&state, part(0, plan.len())).steps_outside, expected);
        let mut sum = CommandSum::new(&state, period_s);
        let cut = cut.min(plan.len());
        sum.add(&model, part(0, cut));
        sum.add(&model, part(cut, plan.len()));
        prop_assert_eq!(sum.steps_outside(), expected);
    }

    #[test]
    fn the_power_of_the_steps_adds_up_to_the_energy(
        samples in samples(), plan in plan(), added_share in 0.0f32..=1.0,
    ) {
        let model = with_ridge(model(&[0.5; TERMS], added_share));
        let state = observed(&model, &samples);
        let (v_mps, omega_radps) = split(&plan);
        let commands = Commands { period_s: 0.1, v_mps: &v_mps, omega_radps: &omega_radps };
        let mut power_w = vec![f32::NAN; plan.len()];
        model.power_w(&state, commands, &mut power_w);
        let sum_j: f64 = power_w.iter().map(|power_w| f64::from(*power_w) * 0.1).sum();
        let energy_j = f64::from(model.forecast(&state, commands).energy_j);
        prop_assert!((sum_j - energy_j).abs() <= 1e-5 * energy_j.abs().max(1.0));
    }

    /// The gradient equals finite differences, away from the corners at rest and at equal commands.
    #[test]
    fn the_gradient_is_that_of_differences(
        samples in samples(),
        plan in prop::collection::vec((0.05f32..0.5, -2.0f32..-0.1), 1..12),
        step in 0usize..12,
    ) {
        let model = with_ridge(model(
            &[0.7, 0.3, 2.0, 1.0, 0.4, 0.2, 0.6, 0.9, 0.05, 0.02, 0.03, 0.01], 0.4,
        ));
        // Neither a bound nor the border of the training is near.
        let ridge = Some(Ridge { max_leverage: 1e6, ..ridge() });
        let model =
            EnergyModel { ridge, recorded_w: Some([-1e3, 1e3]), omega_radps: [-9.0, 9.0], ..model };
        let state = observed(&model, &samples);
        let step = step % plan.len();
        let (v_mps, omega_radps) = split(&plan);
        let (mut by_v, mut by_omega) = (vec![f32::NAN; plan.len()], vec![f32::NAN; plan.len()]);
        let commands = Commands { period_s: 0.1, v_mps: &v_mps, omega_radps: &omega_radps };
        model.gradient(&state, commands, &mut by_v, &mut by_omega);
        let near = |one: f32, other: f32| (one - other).abs() < 4e-3;
        let clear = |columns: &[f32], before: f32| {
            let earlier = step.checked_sub(1).map_or(before, |at| columns[at]);
            !near(columns[step], earlier)
                && columns.get(step + 1).is_none_or(|next| !near(*next, columns[step]))
        };
        let (before_v, before_omega) = state.command();
        for (slope, column, before) in [(by_v[step], 0, before_v), (by_omega[step], 1, before_omega)] {
            let moved = |by: f32| {
                let (mut v_mps, mut omega_radps) = (v_mps.clone(), omega_radps.clone());
                [&mut v_mps, &mut omega_radps][column][step] += by;
                let commands = Commands { period_s: 0.1, v_mps: &v_mps, omega_radps: &omega_radps };
                f64::from(model.forecast(&state, commands).energy_j)
            };
            if clear([&v_mps, &omega_radps][column], before) {
                let expected = (moved(1e-3) - moved(-1e-3)) / 2e-3;
                let energy_j = moved(0.0).abs();
                let rounding = 1e-6 * energy_j / 1e-3 + 0.02 * expected.abs() + 1e-3;
                prop_assert!((f64::from(slope) - expected).abs() <= rounding, "{slope} {expected}");
            }
        }
    }

    #[test]
    fn quantiles_ascend_and_probabilities_are_their_inverse(
        samples in samples(), plan in plan(), p in 0.001f32..0.999, more in 0.0f32..1.0,
    ) {
        let model = model(&[0.5; TERMS], 0.0);
        let state = observed(&model, &samples);
        let (v_mps, omega_radps) = split(&plan);
        let commands = Commands { period_s: 0.5, v_mps: &v_mps, omega_radps: &omega_radps };
        let forecast = model.forecast(&state, commands);
        let (lower, upper) = (forecast.quantile_j(p).unwrap(), forecast.quantile_j(p + more * (0.999 - p)).unwrap());
        prop_assert!(lower <= upper);
        // An error is small beside the energy that it is added to.
        let back = forecast.probability_below(lower, 0.0).unwrap();
        prop_assert!((back - p).abs() < 2e-2, "{p} {back}");
    }

    /// Beside drawn errors of an amount, whatever their size beside those of the energy.
    #[test]
    fn an_uncertain_amount_has_the_mean_of_its_probabilities(
        samples in samples(), plan in plan(), share in -2.0f32..2.0, sd in 0.0f32..4.0,
    ) {
        let model = model(&[0.5; TERMS], 0.0);
        let state = observed(&model, &samples);
        let (v_mps, omega_radps) = split(&plan);
        let commands = Commands { period_s: 0.5, v_mps: &v_mps, omega_radps: &omega_radps };
        let forecast = model.forecast(&state, commands);
        let [low_j, high_j] = [0.05, 0.95].map(|p| forecast.quantile_j(p).unwrap());
        let spread_j = (high_j - low_j) / 3.29;
        let (about_j, sd_j) = (forecast.energy_j + share * spread_j, sd * spread_j);
        let found = forecast.probability_below(about_j, sd_j).unwrap();
        let (mut mean, mut weight) = (0.0, 0.0);
        for place in -400..=400 {
            let deviations = place as f32 / 100.0;
            let density = (-0.5 * deviations * deviations).exp();
            mean += density * forecast.probability_below(about_j + deviations * sd_j, 0.0).unwrap();
            weight += density;
        }
        prop_assert!((found - mean / weight).abs() < 0.02, "{found} {}", mean / weight);
    }

    #[test]
    fn samples_without_information_leave_numbers_finite(
        kinds in prop::collection::vec(0usize..6, 1..200),
    ) {
        let model = model(&[0.5; TERMS], 0.5);
        let mut state = EnergyState::new(0);
        for kind in kinds {
            let odd = [f32::NAN, f32::INFINITY, f32::NEG_INFINITY, -1.0, 0.0, 1e30][kind];
            for sample in [
                EnergySample { power_w: odd, elapsed_s: 0.03, v_mps: 0.1, omega_radps: 0.0 },
                EnergySample { power_w: 3.0, elapsed_s: odd.min(10.0), v_mps: 0.1, omega_radps: 0.0 },
                EnergySample { power_w: 3.0, elapsed_s: 0.03, v_mps: odd.min(10.0), omega_radps: odd.min(10.0) },
            ] {
                state.observe(&model, &sample);
            }
            state.observe(&model, &EnergySample { power_w: 3.0, elapsed_s: 0.1, v_mps: 0.1, omega_radps: 0.0 });
            let plan = Commands { period_s: 0.1, v_mps: &[0.1; 20], omega_radps: &[0.0; 20] };
            prop_assert!(model.forecast(&state, plan).energy_j.is_finite(), "{state:?}");
        }
    }

    #[test]
    fn a_state_is_its_array(samples in samples()) {
        let state = observed(&model(&[0.5; TERMS], 0.0), &samples);
        let numbers = state.metered.to_array();
        let again = Metered::from_array(&numbers).to_array();
        prop_assert_eq!(numbers.map(f32::to_bits), again.map(f32::to_bits));
        let groups = state.learned.to_groups();
        let again = Learned::from_groups(&groups).to_groups();
        let bits = |groups: [[f32; SHADOWS]; Learned::GROUPS]| groups.as_flattened().iter().map(|x| x.to_bits()).collect::<Vec<_>>();
        prop_assert_eq!(bits(groups), bits(again));
    }

    #[test]
    fn a_model_is_its_text(weights in prop::collection::vec(0.0f32..3.0, TERMS), share in 0.0f32..=1.0) {
        let model = model(&weights, share);
        prop_assert_eq!(EnergyModel::from_text(&model.to_text()), Ok(model));
    }
}

#[test]
fn a_state_is_small_and_has_no_padding() {
    let columns = 4 * Metered::FLOATS + size_of::<Learned>();
    assert_eq!(size_of::<EnergyState>(), columns + size_of::<ErrorBounds>());
    assert!(columns <= 216 - 24, "{columns}");
}

#[test]
fn a_new_robot_draws_what_its_platform_does() {
    let model = model(&[0.5; TERMS], 0.0);
    let plan = commands(0.5, &[0.0; 4], &[0.0; 4]);
    let forecast = model.forecast(&EnergyState::new(0), plan);
    assert!((forecast.energy_j - 2.0 * model.command.weights[0]).abs() < 1e-4);
    assert!(forecast.quantile_j(0.95) > forecast.quantile_j(0.05));
}

#[test]
fn what_is_not_known_has_no_interval() {
    let trained = model(&[0.5; TERMS], 0.0);
    let state = observed(&trained, &[]);
    let plan = |period_s: f32| commands(period_s, &[0.0; 4], &[0.0; 4]);
    let median_j = |model: &EnergyModel, s| model.forecast(&state, plan(s)).quantile_j(0.5);
    assert!(median_j(&trained, 1.0).is_some());
    // Beyond the longest horizon it is extrapolated.
    assert!(median_j(&trained, 80.0).is_some());
    // Without training.
    let untrained = EnergyModel::untrained(4.0);
    assert_eq!(untrained.check(), Ok(()));
    assert!(median_j(&untrained, 1.0).is_none());
    let forecast = untrained.forecast(&state, plan(1.0));
    assert!(forecast.probability_below(9.0, 1.0).is_none());
    // A command that is not a number.
    let unknown = commands(1.0, &[0.0, f32::NAN], &[0.0; 2]);
    let forecast = trained.forecast(&state, unknown);
    assert!(forecast.energy_j.is_nan() && forecast.quantile_j(0.5).is_none());
    // Values that are no probabilities.
    for p in [0.0, 1.0, -1.0, f32::NAN] {
        assert_eq!(trained.forecast(&state, plan(1.0)).quantile_j(p), None);
    }
}

#[test]
fn a_sum_of_parts_gives_the_bits_of_the_whole_plan_and_of_its_beginnings() {
    let model = model(&[0.5; TERMS], 0.3);
    let state = observed(&model, &[]);
    let numbers = |most: usize| (0..200).map(move |step| (step * step % most) as f32);
    let v: Vec<f32> = numbers(23).map(|number| 0.1 * number - 1.1).collect();
    let omega: Vec<f32> = numbers(17).map(|number| 0.1 * number).collect();
    let part = |from: usize, to: usize| commands(0.07, &v[from..to], &omega[from..to]);
    let mut sum = CommandSum::new(&state, 0.07);
    let mut done = 0;
    for end in [0, 1, 2, 50, 50, 123, 200] {
        sum.add(&model, part(done, end));
        done = end;
        let whole = model.forecast(&state, part(0, end));
        let found = model.forecast_of(&state, &sum);
        assert_eq!(found.energy_j.to_bits(), whole.energy_j.to_bits());
        assert_eq!(format!("{found:?}"), format!("{whole:?}"));
        assert_eq!((sum.steps(), sum.duration_s()), (end, whole.duration_s));
    }
    assert!(sum.steps_outside() > 0);
}

#[test]
fn commands_outside_the_training_data_are_named() {
    let model = model(&[0.5; TERMS], 0.0);
    let state = EnergyState::new(0);
    for (v_mps, outside) in [(0.9, 0), (1.1, 1), (-1.1, 1)] {
        let v_mps = [0.0, v_mps];
        let plan = commands(0.1, &v_mps, &[0.0; 2]);
        assert_eq!(model.forecast(&state, plan).steps_outside, outside);
    }
}

#[test]
fn commands_that_change_faster_than_any_in_training_are_named() {
    let model =
        EnergyModel { combined: Some([0.3, 3.0, 4.0, 5.0, 10.0]), ..model(&[0.5; TERMS], 0.0) };
    let outside = |model: &EnergyModel, v_mps: &[f32], omega_radps: &[f32]| {
        let plan = commands(0.1, v_mps, omega_radps);
        model.forecast(&EnergyState::new(0), plan).steps_outside
    };
    // Nothing changes.
    assert_eq!(outside(&model, &[0.5; 3], &[0.5; 3]), 0);
    // A change within, also by the longer steps of a recording; and one beyond.
    assert_eq!(outside(&model, &[0.0, 0.39, 0.0], &[0.0; 3]), 0);
    assert_eq!(outside(&model, &[0.0, 0.52, 0.0], &[0.0; 3]), 0);
    assert_eq!(outside(&model, &[0.0, 0.6, 0.6], &[0.0; 3]), 1);
    assert_eq!(outside(&model, &[0.0; 3], &[0.0, 1.2, 0.0]), 2);
    // Braking is no acceleration.
    assert_eq!(outside(&model, &[0.9, 0.5, 0.1], &[0.0; 3]), 0);
    assert_eq!(outside(&model, &[0.1, 0.5, 0.9], &[0.0; 3]), 1);
    // Each velocity is within: their product is not compared.
    assert_eq!(outside(&model, &[0.9; 3], &[1.5; 3]), 0);
    // A file of an older version has no maxima of changes, so no change is inside.
    let older = EnergyModel { combined: None, ..model.clone() };
    assert_eq!(outside(&older, &[0.5; 3], &[0.0; 3]), 0);
    assert_eq!(outside(&older, &[0.5, 0.5, 0.4], &[0.0; 3]), 1);
    assert_eq!(outside(&older, &[0.1; 3], &[0.1; 3]), 0);
    assert!(!older.to_text().contains("combined"), "the same bytes");
    assert_eq!(EnergyModel::from_text(&older.to_text()), Ok(older));
    // If commands have no effect, their changes have none either.
    let constant = EnergyModel { combined: None, ..EnergyModel::untrained(3.0) };
    assert_eq!(outside(&constant, &[0.0, 9.0, 0.0], &[1.0; 3]), 0);
}

#[test]
fn an_answer_names_the_quantity_outside_and_the_speed_at_which_it_would_be_inside() {
    let changes = Some([1.5, 3.0, 40.0, 25.0, 50.0]);
    let model = with_ridge(EnergyModel { combined: changes, ..model(&[0.5; TERMS], 0.0) });
    let outside = |v_mps: &[f32], omega_radps: &[f32]| {
        let plan = commands(0.1, v_mps, omega_radps);
        model.forecast(&EnergyState::new(0), plan).outside
    };
    assert_eq!(outside(&[0.5; 3], &[0.5; 3]), None);
    for (v_mps, omega_radps, quantity, value, known, inside_at_mps) in [
        // Too fast at one step of several, in an arc, and on the spot.
        ([1.0, 1.3, 1.3], [0.0; 3], Quantity::Velocity, 1.3, [-1.0, 1.0], Some(1.0)),
        ([-1.25; 3], [0.0; 3], Quantity::Velocity, -1.25, [-1.0, 1.0], Some(1.0)),
        ([0.5; 3], [2.5; 3], Quantity::AngularVelocity, 2.5, [-2.0, 2.0], Some(0.4)),
        ([0.0; 3], [2.5; 3], Quantity::AngularVelocity, 2.5, [-2.0, 2.0], None),
        // Products of a speed and its change grow as its square.
        ([0.1, 0.7, 0.7], [0.0; 3], Quantity::Acceleration, 4.2, [0.0, 3.15], Some(0.606_2)),
    ] {
        let found = outside(&v_mps, &omega_radps).expect("outside");
        assert_eq!(found.quantity, quantity);
        let near = |one: f32, other: f32| (one - other).abs() < 1e-3;
        assert!(near(found.value, value), "{found:?}");
        assert!(near(found.known[0], known[0]) && near(found.known[1], known[1]), "{found:?}");
        let speeds = found.inside_at_mps.zip(inside_at_mps);
        assert_eq!(found.inside_at_mps.is_some(), inside_at_mps.is_some(), "{found:?}");
        assert!(speeds.is_none_or(|(found, expected)| near(found, expected)), "{found:?}");
    }
    // Both within, and together farther than any command of the training.
    let found = outside(&[0.98; 2], &[1.98; 2]).expect("outside");
    assert!(found.quantity == Quantity::Together && found.value > 1.0, "{found:?}");
    let speed_mps = found.inside_at_mps.expect("slower is inside");
    let share = speed_mps / 0.98;
    assert_eq!(outside(&[speed_mps; 2], &[share * 1.98; 2]), None, "{found:?}");
    assert!(outside(&[f32::NAN; 2], &[0.0; 2]).is_some());
}

#[test]
fn a_robot_without_readings_is_forecast_by_the_regression_and_one_with_many_by_its_level() {
    let base = model(&[0.5; TERMS], 0.0);
    let model = EnergyModel { hotel_w: None, ..with_ridge(base.clone()) };
    let ridge = model.ridge.clone().expect("it has one");
    let energy_j = |model: &EnergyModel, state: &EnergyState| {
        let forecast = model.forecast(state, commands(0.5, &[0.3; 10], &[0.8; 10]));
        let [lo_j, hi_j] = [0.05, 0.95].map(|p| forecast.quantile_j(p).expect("known"));
        (forecast.energy_j, (hi_j - lo_j) / forecast.energy_j)
    };
    let fresh = EnergyState::new(0);
    let deviations = ridge.deviations(&model.command, 0.3, 0.8);
    let (found_j, wide) = energy_j(&model, &fresh);
    assert!((found_j - 5.0 * ridge.power_w(&deviations)).abs() < 1e-3, "{found_j}");
    assert!(wide >= 2.0 * 0.99 * ridge.left_out * 0.7, "{wide}");
    // A minute of readings: the level counts six times as much, ten minutes: nearly alone.
    let mut last = f32::INFINITY;
    for duration_s in [0.0, 5.0, 60.0, 600.0] {
        let state = driven(&model, duration_s, |_| 9.0);
        let apart = (energy_j(&model, &state).0 - energy_j(&base, &state).0).abs();
        assert!(apart < last, "{duration_s} s: {apart} {last}");
        last = apart;
    }
    assert!(last < 0.05 * found_j, "{last}");
}

#[test]
fn commands_outside_the_training_are_bounded_by_what_was_recorded() {
    let model = EnergyModel { hotel_w: None, ..with_ridge(model(&[0.5; TERMS], 0.0)) };
    let fresh = EnergyState::new(0);
    let bounds = |state: &EnergyState, v_mps: f32| {
        model.forecast(state, commands(0.5, &[v_mps; 10], &[0.0; 10])).outside_w.expect("known")
    };
    // The regression's error reaches farther, the farther the command is, up to what was recorded.
    let widths = [1.2, 2.0, 3.0].map(|v_mps| {
        let [lowest, expected, highest] = bounds(&fresh, v_mps);
        assert!(lowest <= expected && expected <= highest);
        assert!(lowest >= 4.0f32.min(expected) && highest <= 14.0f32.max(expected), "{v_mps}");
        (highest - lowest) / expected
    });
    assert!(widths[0] > 0.0 && widths[2] >= widths[0], "{widths:?}");
    // A robot that has drawn more than any in training may draw it again.
    let strong = driven(&model, 30.0, |_| 60.0);
    assert!(bounds(&strong, 1.2)[2] > 55.0);
    let inside = model.forecast(&fresh, commands(0.5, &[0.3; 10], &[0.5; 10]));
    assert_eq!((inside.steps_outside, inside.outside_w), (0, None));
}

/// Robots whose power is redrawn every second: their errors are far above or far below the model's.
#[test]
fn intervals_widen_and_narrow_with_the_errors_of_a_platform() {
    let model = model(&[0.0; TERMS], 0.0);
    let plan = commands(0.1, &[0.0; 10], &[0.0; 10]);
    let width = |state: &EnergyState| {
        let forecast = model.forecast(state, plan);
        let [hi_j, lo_j] = [0.95, 0.05].map(|p| forecast.quantile_j(p).unwrap());
        (hi_j - lo_j) / forecast.energy_j
    };
    let drive = |power_w: fn(usize) -> f32| {
        let (mut state, mut platform) = (EnergyState::new(0), Calibration::new(&model));
        for step in 0..3_000 {
            let sample = EnergySample { v_mps: 0.0, ..at_rest(power_w(step / 10)) };
            let errors = state.observe_among(&model, platform.platform(), &sample);
            platform.add(&errors.counted(0));
        }
        state
    };
    let steady = drive(|_| 5.0);
    let erratic = drive(|second| if second * 7 % 5 < 2 { 2.0 } else { 12.0 });
    let (wide, narrow) = (width(&erratic), width(&steady));
    assert!(wide > 1.3 * narrow, "{wide} {narrow}");
    for state in [steady, erratic] {
        let mut times = state.metered.shadow_s.iter().zip(SHADOWS_S);
        assert!(times.all(|(since_s, horizon_s)| *since_s < horizon_s));
    }
}

#[test]
fn a_model_out_of_range_is_refused_by_name() {
    let good = model(&[0.5; TERMS], 0.0);
    let spoil: [fn(&mut EnergyModel); 13] = [
        |model| model.ridge = Some(Ridge { max_leverage: 0.0, ..ridge() }),
        |model| model.recorded_w = Some([3.0, f32::NAN]),
        |model| model.hotel_w = Some(-1.0),
        |model| model.command.weights[3] = f32::NAN,
        |model| model.command.weights[0] = 0.0,
        |model| model.command.half_v_mps = 0.0,
        |model| model.command.mean_w = -1.0,
        |model| model.weights[2][0] += 0.1,
        |model| model.calibrated = 7,
        |model| model.errors[5][3] = f32::INFINITY,
        |model| model.v_mps = [1.0, f32::NAN],
        |model| model.combined = Some([0.0, -1.0, 0.0, 0.0, 0.0]),
        |model| model.combined = Some([0.0, 0.0, 0.0, f32::INFINITY, 0.0]),
    ];
    for spoil in spoil {
        let mut model = good.clone();
        spoil(&mut model);
        let message = model.check().unwrap_err().to_string();
        assert!(message.contains("allowed is"), "{message}");
        assert!(EnergyModel::from_text(&model.to_text()).is_err());
    }
    assert!(EnergyModel::from_text("{}").is_err());
}

/// Drives 2 s, rests 2 s, and so on, 30 times a second; `power_w` of the command's speed.
fn driven(model: &EnergyModel, duration_s: f32, power_w: impl Fn(f32) -> f32) -> EnergyState {
    let mut state = EnergyState::new(0);
    for sample in 0..(duration_s * 30.0) as u32 {
        let v_mps = if sample % 120 < 60 { 0.4 } else { 0.0 };
        let before = sample.saturating_sub(1);
        let v_before = if before % 120 < 60 { 0.4 } else { 0.0 };
        let sample = EnergySample {
            power_w: power_w(v_before),
            elapsed_s: 1.0 / 30.0,
            v_mps,
            omega_radps: 0.0,
        };
        state.observe(model, &sample);
    }
    state
}

/// Power of driving: 1 W at rest, 9 W at 0.4 m/s.
fn driving_model() -> EnergyModel {
    let mut weights = [0.0; TERMS];
    weights[1] = 20.0;
    let mut model = model(&weights, 0.0);
    model.prior_s = [0.05, 0.05, 0.05, 10.0];
    model
}

fn at_rest_j(model: &EnergyModel, state: &EnergyState) -> f32 {
    let plan = commands(0.5, &[0.0; 20], &[0.0; 20]);
    model.forecast(state, plan).energy_j
}

#[test]
fn commands_are_trusted_as_far_as_they_explain_the_robots_power() {
    let model = driving_model();
    // Twice the platform's power, under every command.
    let follows = driven(&model, 60.0, |v_mps| 2.0 * (1.0 + 20.0 * v_mps));
    assert!(follows.learned.command_trust > 0.95, "{follows:?}");
    let rest_j = at_rest_j(&model, &follows);
    assert!((10.0..40.0).contains(&rest_j), "20 J are right: {rest_j}");
    // Wheels that spin, or a robot that is pushed: its power does not depend on its commands.
    let ignores = driven(&model, 60.0, |_| 7.0);
    assert!(ignores.learned.command_trust < 0.1, "{ignores:?}");
    let rest_j = at_rest_j(&model, &ignores);
    assert!((60.0..80.0).contains(&rest_j), "70 J are right: {rest_j}");
}

#[test]
fn trust_in_commands_returns() {
    let model = driving_model();
    let mut state = driven(&model, 120.0, |_| 7.0);
    let later = driven(&model, 180.0, |v_mps| 1.0 + 20.0 * v_mps);
    assert!(state.learned.command_trust < 0.1, "{state:?}");
    for sample in 0..30 * 180 {
        let v_mps = |sample: u32| if sample % 120 < 60 { 0.4 } else { 0.0 };
        let read = EnergySample {
            power_w: 1.0 + 20.0 * v_mps(sample + 119),
            elapsed_s: 1.0 / 30.0,
            v_mps: v_mps(sample),
            omega_radps: 0.0,
        };
        state.observe(&model, &read);
    }
    assert!(state.learned.command_trust > 0.8, "{state:?}");
    assert!(later.learned.command_trust > 0.95, "{later:?}");
}

/// A robot of another kind than the platform's is not held to the platform's level; one that is
/// only a little different is.
#[test]
fn a_level_far_from_the_platforms_is_believed_sooner() {
    let mut model = model(&[0.0; TERMS], 0.0);
    model.prior_s = [0.05, 0.05, 10.0, 10.0];
    model.command.mean_w = model.command.weights[0];
    let error_after_s = |times: f32| {
        let drawn_w = times * model.command.weights[0];
        let state = driven(&model, 8.0, |_| drawn_w);
        let plan = commands(0.5, &[0.0; 20], &[0.0; 20]);
        let drawn_j = 10.0 * drawn_w;
        let held_j = 10.0 * model.command.weights[0];
        (model.forecast(&state, plan).energy_j - drawn_j) / (held_j - drawn_j)
    };
    assert!(error_after_s(1.05) > 0.4, "{}", error_after_s(1.05));
    assert!(error_after_s(5.0) < 0.2, "{}", error_after_s(5.0));
}

#[test]
fn a_robot_that_goes_on_draws_its_mean_at_every_horizon() {
    let model = EnergyModel::untrained(30.0);
    let state = driven(&model, 60.0, |_| 7.0);
    let prepared = model.outlook([1.0, 10.0, 60.0, 300.0]);
    let outlook = prepared.of(&state, &PlatformErrors::TRAINED, 7.0);
    for (energy_j, horizon_s) in outlook.energy_j.into_iter().zip([1.0, 10.0, 60.0, 300.0]) {
        assert!((energy_j / horizon_s - 7.0).abs() < 0.1, "{outlook:?}");
    }
    // The errors of a model without training are unknown.
    let bounds = outlook.lo_j.into_iter().chain(outlook.hi_j);
    assert_eq!((prepared.bounded(), bounds.filter(|joules| joules.is_nan()).count()), (0, 8));
}

#[test]
fn without_trust_in_commands_a_plan_is_the_outlook_without_the_last_reading() {
    let model = EnergyModel { calibrated: 4, ..driving_model() };
    let mut state = driven(&model, 20.0, |v_mps| 2.0 + 30.0 * v_mps);
    state.learned.command_trust = 0.0;
    state.bounds = ErrorBounds { lower: [-2.0, -1.5, -3.0], upper: [2.0, 3.0, 4.0] };
    let platform = PlatformErrors {
        outlooks: state.bounds,
        shares: PlatformErrors::TRAINED
            .shares
            .map(|[_, level, own]| [0.0, level / (level + own), own / (level + own)]),
        ..PlatformErrors::TRAINED
    };
    // The errors are known up to 30 s.
    let horizons_s = [1.0, 10.0, 30.0, 300.0];
    let outlook = model.outlook(horizons_s).of(&state, &platform, 1e9);
    let near = |found: f32, expected: f32| (found - expected).abs() <= 1e-5 * expected.abs();
    for (place, horizon_s) in horizons_s.into_iter().enumerate() {
        let plan = model.forecast(&state, commands(horizon_s, &[0.3], &[1.0]));
        assert!(
            near(outlook.energy_j[place], plan.energy_j),
            "{horizon_s} s: {outlook:?} {plan:?}"
        );
        let bounds = [(outlook.lo_j[place], 0.05), (outlook.hi_j[place], 0.95)];
        for (found, p) in bounds {
            let expected = plan.quantile_j(p).expect("of any length");
            assert!(near(found, expected), "{horizon_s} s: {found} {expected}");
        }
    }
    let prepared = [model.outlook([10.0, 30.0]), model.outlook([30.0, 60.0])];
    assert_eq!(prepared.map(|outlook| outlook.is_extrapolated()), [false, true]);
    // A new robot draws what its platform does.
    let new =
        model.outlook(horizons_s).of(&EnergyState::new(0), &PlatformErrors::TRAINED, f32::NAN);
    assert!(new.energy_j.into_iter().zip(horizons_s).all(|(joules, s)| near(joules, 5.0 * s)));
}

/// A robot at rest, with samples of this power.
fn at_rest(power_w: f32) -> EnergySample {
    EnergySample { power_w, elapsed_s: 0.1, v_mps: 0.2, omega_radps: 0.0 }
}

#[test]
fn a_shadow_forecast_is_judged_with_the_trust_and_the_shares_that_it_was_made_with() {
    let model = model(&[0.5; TERMS], 0.0);
    let mut made = EnergyState::new(0);
    (0..40).for_each(|_| made.observe(&model, &at_rest(9.0)));
    // What the robot and its platform show before it ends has no part in it.
    let mut shown = made;
    shown.learned.command_trust = 0.0;
    let mut platform = PlatformErrors::TRAINED;
    platform.shares = [[1.0, 0.0, 0.0]; SHADOWS];
    let (mut ended, mut apart) = (0, 0);
    for step in 0..1_200 {
        let sample = at_rest(if step % 7 < 3 { 2.0 } else { 14.0 });
        let before = shown;
        let errors = made.observe_among(&model, &PlatformErrors::TRAINED, &sample);
        let found = shown.observe_among(&model, &platform, &sample);
        for shadow in 0..SHADOWS {
            if errors.classes[shadow].is_some() {
                assert_eq!(errors.classes[shadow], found.classes[shadow], "shadow {shadow}");
                let ahead = SHADOWS + shadow;
                assert_eq!(errors.classes[ahead], found.classes[ahead], "shadow {shadow}");
                ended |= 1 << shadow;
            }
        }
        // Those that are made now are made alike again, with the trust that is shown now.
        let with =
            |state: &EnergyState| [state.learned.shadow_trust, state.learned.shadow_outlook_w];
        let is_made = with(&shown) != with(&before);
        apart += usize::from(is_made && with(&shown) != with(&made));
        shown.learned = Learned { command_trust: 0.0, ..made.learned };
    }
    assert_eq!(ended, 7, "all three have ended");
    assert!(apart > 0, "what is shown counts for the next ones");
}

#[test]
fn a_probability_is_exact_where_quantiles_have_kinks() {
    for errors in [
        [-0.5, -0.02, -0.015, -0.01, 0.0, 0.3, 0.31, 0.32, 0.33],
        [-0.16, -0.1, -0.08, -0.04, 0.0, 0.04, 0.08, 0.1, 0.16],
        [-0.3, -0.3, -0.3, -0.01, 0.0, 0.0, 0.0, 0.5, 0.9],
    ] {
        let model = EnergyModel { errors: [errors; 6], ..model(&[0.5; TERMS], 0.0) };
        let state = observed(&model, &[]);
        let forecast = model.forecast(&state, commands(0.5, &[0.0; 4], &[0.0; 4]));
        for share in [-0.4f32, -0.02, 0.0, 0.05, 0.3, 0.5] {
            for sd in [1e-4f32, 0.01, 0.05, 0.2, 1.0] {
                let (about_j, sd_j) = (forecast.energy_j * (1.0 + share), forecast.energy_j * sd);
                let found = forecast.probability_below(about_j, sd_j).expect("known");
                let (mut mean, mut weight) = (0.0, 0.0);
                for place in -5_000..=5_000 {
                    let deviations = place as f32 * 1e-3;
                    let density = f64::from(-0.5 * deviations * deviations).exp();
                    let below = forecast.probability_below(about_j + deviations * sd_j, 0.0);
                    mean += density * f64::from(below.expect("known"));
                    weight += density;
                }
                let expected = mean / weight;
                let off = (f64::from(found) - expected).abs();
                assert!(off < 0.004, "{errors:?} {share} {sd}: {found} for {expected}");
            }
        }
    }
}
