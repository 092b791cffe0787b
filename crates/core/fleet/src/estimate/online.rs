//! Forecasts that learn online: the model's members combined per robot by its own readings.
//!
//! With A the model's autoregression, P the last reading, N the network, M the mean of the robot's
//! readings and r the mean size of their changes,
//!
//! ```text
//! u = (P − A, N − A, M − A, r)
//! S = A + θ·u                                          a stack
//! F = w_P P + w_N N + w_1 S_1 + w_2 S_2                the forecast
//! ```
//!
//! There are two stacks, which differ in their start: the confident one takes the network to be
//! nearly right, the sceptical one takes half of it and trusts the robot's mean earlier. θ follows
//! the readings y by recursive least squares with a bounded innovation and a covariance that is
//! pulled back to its start, so that it neither winds up nor stops learning:
//!
//! ```text
//! g = Σu / (r² + uᵀΣu)
//! θ ← θ + g · clamp(y − S, ±2.5 r)
//! Σ ← Σ − g (Σu)ᵀ,   Σ ← Σ + 0.002 (Σ₀ − Σ)
//! ```
//!
//! The weights w are those of [`Hedge`], whose documentation states and proves the bound on F
//! against each member. They are kept separately for readings with and without a new measurement
//! due: where none is, the last reading is nearly always exact, and only it and the stack take
//! part, the stacks as one by their weights for due readings.
//!
//! Coefficients are dimensionless and sizes are the robot's own, so that a model of another robot
//! and another power is corrected as well. The sceptical stack starts level with the confident one,
//! and behind it if the network reads no commands: what a network knows of power alone carries over
//! to other robots and floors, what it knows of commands depends on their mass and friction.
//! Where the forecasts of the platform's robots without the last reading began worse than the last
//! reading, network and stacks must earn their weights: the next robots start from their last
//! reading.

// Index loops: the compiler vectorises them.
#![allow(clippy::needless_range_loop)]

use joulebus_energy::{Shown, shown_start};
use joulebus_predictor::nan::canonical;
use joulebus_predictor::{FeatureSet, LAGS, Linear, Model};
use serde::{Deserialize, Serialize};

use crate::estimate::hedge::{Hedge, MEMBERS, dot};
use crate::layout::lanes::{self, Block as _, LANES, Lanes, block, each, put};

/// Deviations that the stack weighs: of the last reading, the network and the mean from the
/// autoregression, and the level.
const TERMS: usize = 4;
/// Numbers of a symmetric matrix of that size: row by row, from the diagonal on.
const PAIRS: usize = 10;
const PAIR: [[usize; 2]; PAIRS] =
    [[0, 0], [0, 1], [0, 2], [0, 3], [1, 1], [1, 2], [1, 3], [2, 2], [2, 3], [3, 3]];

/// The confident stack and the sceptical one.
const STACKS: usize = 2;
/// θ at the start, and the variances Σ₀, uncorrelated.
const START: [[f32; TERMS]; STACKS] = [[0.1, 0.95, 0.1, 0.0], [0.1, 0.5, 0.1, 0.0]];
const VARIANCE: [[f32; TERMS]; STACKS] = [[0.09, 0.04, 0.04, 0.25], [0.09, 0.04, 0.16, 0.25]];
const COVARIANCE: [[f32; PAIRS]; STACKS] = {
    let mut all = [[0.0; PAIRS]; STACKS];
    let mut at = 0;
    while at < STACKS * PAIRS {
        let (stack, pair) = (at / PAIRS, at % PAIRS);
        let [row, column] = PAIR[pair];
        if row == column {
            all[stack][pair] = VARIANCE[stack][row];
        }
        at += 1;
    }
    all
};
/// Share of the distance to Σ₀ that Σ returns with each reading.
const PULL: f32 = 0.002;
/// Largest innovation that θ follows, and largest deviation, in r.
const MAX_INNOVATION: f32 = 2.5;
const MAX_DEVIATION: f32 = 30.0;
/// θ stays within ±this.
const MAX_COEFFICIENT: f32 = 100.0;
/// Readings that the model's own error counts for in r.
const TRUST: f32 = 8.0;
/// Initial losses for readings with a new measurement due, in r². The last reading is a fallback.
const LOSS_LAST: f32 = 100.0;
const LOSS_NETWORK: f32 = 1.0;
/// The sceptical stack's, beside a network that reads commands and beside one that does not.
const LOSS_SCEPTIC: f32 = 0.0;
const LOSS_SCEPTIC_POWER_ONLY: f32 = 6.0;
/// Initial losses of the others if the robot starts from its last reading, in r². The last
/// reading's is then 0.
const LOSS_OTHERS: f32 = 5.0;
/// Readings by which the start of a robot is judged.
const FIRST: u8 = 30;
/// Δ is at least this, in r².
const COST: f32 = 2.0;
/// Share of the stack in the last reading's forecast if no measurement is due, because some
/// measurements come early.
const EARLY: f32 = 0.02;
/// Largest size that is believed, W.
const MAX_SIZE_W: f32 = 1e6;

/// The members that a platform's robots combine, prepared for the tick.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Members {
    /// The autoregression A: bias, W, and weights of the last readings, newest first.
    bias_w: f32,
    lags: [f32; LAGS],
    /// r of an unknown robot, W.
    change_w: f32,
    /// Minimum r, W.
    floor_w: f32,
    /// Variance of the network's residuals, W².
    variance: f32,
    /// Initial loss of the sceptical stack, in r².
    pub sceptic_loss: f32,
}

/// Mean absolute value of a normal distribution with unit deviation.
const MEAN_OF_NORMAL: f32 = 0.8;

impl Members {
    /// `None` without a network. `sigma_w` is the deviation of its residuals, `resolution_w` the
    /// power monitor's, both above 0, W.
    pub(crate) fn new(model: &Model, sigma_w: f32, resolution_w: f32) -> Option<Self> {
        let Model::Network(network) = model else {
            return None;
        };
        let (bias_w, lags) = match model.linear() {
            Some(Linear { feature_set: FeatureSet::PowerOnly, bias_w, weights, .. }) => {
                let first = FeatureSet::PowerOnly.first();
                (*bias_w, std::array::from_fn(|lag| weights[first + lag]))
            }
            // Model files without an autoregression: the last reading in its place.
            _ => (0.0, [1.0, 0.0, 0.0, 0.0, 0.0]),
        };
        let change_w = (MEAN_OF_NORMAL * sigma_w).max(resolution_w);
        Some(Self {
            bias_w,
            lags,
            change_w,
            floor_w: resolution_w,
            variance: sigma_w * sigma_w,
            sceptic_loss: if network.feature_set().needs_command() {
                LOSS_SCEPTIC
            } else {
                LOSS_SCEPTIC_POWER_ONLY
            },
        })
    }

    #[inline(always)]
    fn autoregression(&self, lag_w: &[f32; LAGS]) -> f32 {
        let [a, b, c, d, e] = self.lags;
        let [first, second, third, fourth, fifth] = *lag_w;
        ((((self.bias_w + a * first) + b * second) + c * third) + d * fourth) + e * fifth
    }
}

/// The initial loss of the sceptical stack of each robot of a block, in r².
pub(crate) const SCEPTIC_LOSSES: Lanes<f32> = [LOSS_SCEPTIC; LANES];

/// `value` within ±`most`. Without the check of `clamp`, whose branch would keep loops from
/// becoming vectors.
#[inline(always)]
fn within(value: f32, most: f32) -> f32 {
    value.max(-most).min(most)
}

block! {
    /// A robot's learned forecast state.
    #[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
    pub struct Learned: UNKNOWN;

    /// [`Learned`] of a block.
    #[derive(Clone, Copy)]
    pub(crate) struct LearnedColumns {
        /// The network's own forecast of the next reading, W. NaN before the first.
        pub network_w: f32 = f32::NAN,
        /// Mean of the readings, W. The newest counts 1/256 at least.
        pub mean_w: f32 = f32::NAN,
        /// Mean size of the changes between new measurements, W.
        pub change_w: f32 = f32::NAN,
        /// Weights of the last reading, the network and the stacks if a new measurement is due:
        /// non-negative, with sum 1.
        pub weights: [f32; 3] = [f32::NAN; 3],
        /// Weights of the last reading and the stacks if the last reading will be held.
        pub held_weights: [f32; 2] = [f32::NAN; 2],
        /// Gains within the stacks, on the deviations of the last reading, the network and the mean
        /// of the readings from the model's autoregression: their mean by the stacks' weights.
        pub gains: [f32; 3] = [f32::NAN; 3],
        /// Level that the stacks add, W.
        pub level_w: f32 = f32::NAN,
    }
}

impl LearnedColumns {
    /// The state of robots that do not learn.
    pub(crate) const NONE: Self = Self::all(&Learned::UNKNOWN);
}

/// Weights as in [`Learned`], with and without a new measurement due, and the confident stack's
/// part of both stacks'.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Weights {
    pub due: [f32; 3],
    pub held: [f32; 2],
    pub confidence: f32,
}

block! {
    /// One robot's.
    #[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
    pub(crate) struct Online: NONE;

    /// Learned state of the robots of a block.
    #[derive(Debug, Clone, Copy, Default, Serialize, Deserialize)]
    #[repr(align(16))]
    pub(crate) struct OnlineLanes {
        theta: [[f32; TERMS]; STACKS] = START,
        covariance: [[f32; PAIRS]; STACKS] = COVARIANCE,
        /// The network's forecast of the next reading, W, if the robot has a forecast.
        pub network_w: f32 = f32::NAN,
        /// Mean of the readings so far, W. The newest counts 1/256 at least.
        pub mean_w: f32 = 0.0,
        /// r: mean size of their changes, W.
        change_w: f32 = 0.0,
        /// [`Hedge`] for readings with a measurement due, and without.
        due_above: [f32; MEMBERS - 1] = [0.0; MEMBERS - 1],
        due_cost: f32 = 0.0,
        held_above: f32 = 0.0,
        held_cost: f32 = 0.0,
        /// Readings so far, up to 255.
        seen: u8 = 0,
        /// True if it starts from its last reading.
        from_last: bool = false,
        /// Squared error of the stacks above that of the last reading, over its first readings with
        /// a measurement due, W², and their number.
        excess: f32 = 0.0,
        judged: u8 = 0,
    }
}

/// The members' forecasts, and the stack's inputs.
struct MemberForecasts {
    members_w: [f32; MEMBERS],
    stacks_w: [f32; STACKS],
    /// Both stacks as one.
    both_w: f32,
    u: [f32; TERMS],
}

block! {
    /// The update of the stack by a reading.
    #[derive(Debug, Clone, Copy)]
    pub(crate) struct RlsUpdate: NONE;

    /// [`RlsUpdate`]s of a block.
    #[derive(Clone, Copy)]
    pub(crate) struct RlsUpdateLanes {
        u: [f32; TERMS] = [0.0; TERMS],
        innovation_w: [f32; STACKS] = [0.0; STACKS],
        /// r².
        square: f32 = 1.0,
        pub due: bool = false,
        /// Squared error of the stacks above that of the last reading, W².
        excess: f32 = 0.0,
    }
}

impl Online {
    /// Before the first reading. `from_last`: network and stacks must earn their weights.
    pub(crate) fn new(members: &Members, from_last: bool) -> Self {
        Self { change_w: members.change_w, from_last, ..Self::NONE }
    }

    /// The forecast after the readings `lag_w`, newest first, given the network's finite forecast
    /// `network_w`. `due` states whether a new measurement is due.
    #[inline(always)]
    pub(crate) fn forecast(
        &self,
        members: &Members,
        lag_w: &[f32; LAGS],
        network_w: f32,
        due: bool,
    ) -> f32 {
        let forecasts = self.member_forecasts(members, lag_w, network_w, due);
        let hedge = self.hedge(members.sceptic_loss, due);
        dot(&hedge.weights(), &forecasts.members_w)
    }

    #[inline(always)]
    fn member_forecasts(
        &self,
        members: &Members,
        lag_w: &[f32; LAGS],
        network_w: f32,
        due: bool,
    ) -> MemberForecasts {
        let a_w = members.autoregression(lag_w);
        let (last_w, most_w) = (lag_w[0], MAX_DEVIATION * self.change_w);
        let deviation = |watts: f32| within(watts - a_w, most_w);
        let u = [deviation(last_w), deviation(network_w), deviation(self.mean_w), self.change_w];
        let stacks_w = each(self.theta, |[p, n, m, level]| {
            a_w + ((p * u[0] + n * u[1]) + (m * u[2] + level * u[3]))
        });
        let confidence = self.hedge(members.sceptic_loss, true).confidence();
        let both_w = stacks_w[1] + confidence * (stacks_w[0] - stacks_w[1]);
        let stack_w = if due { stacks_w[0] } else { both_w };
        let early_w = if due | self.from_last { 0.0 } else { EARLY * (stack_w - last_w) };
        MemberForecasts {
            members_w: [last_w + early_w, network_w, stack_w, stacks_w[1]],
            stacks_w,
            both_w,
            u,
        }
    }

    /// Learns the reading that the forecast after `lag_w` was made for.
    #[inline(always)]
    pub(crate) fn learn(
        &mut self,
        members: &Members,
        lag_w: &[f32; LAGS],
        due: bool,
        reading_w: f32,
    ) {
        let update = self.update_weights(members, lag_w, due, reading_w);
        if self.judges(due) {
            self.judge(&update);
        }
        self.update_rls(&update);
    }

    /// True if a reading is one of those by which the start is judged.
    #[inline(always)]
    pub(crate) const fn judges(&self, due: bool) -> bool {
        due & (self.seen < FIRST)
    }

    /// Judges the start by a reading.
    pub(crate) fn judge(&mut self, update: &RlsUpdate) {
        self.excess += update.excess;
        self.judged = self.judged.saturating_add(1);
    }

    /// Updates the weights: the first part of [`Online::learn`], before [`Online::update_rls`]. It
    /// stores no bytes beside the numbers: with them the loop over robots becomes no vectors.
    #[inline(always)]
    pub(crate) fn update_weights(
        &mut self,
        members: &Members,
        lag_w: &[f32; LAGS],
        due: bool,
        reading_w: f32,
    ) -> RlsUpdate {
        let forecasts = self.member_forecasts(members, lag_w, self.network_w, due);
        let (members_w, u) = (forecasts.members_w, forecasts.u);
        let square = self.change_w * self.change_w;
        let wrong = |watts: f32| (watts - reading_w) * (watts - reading_w);
        let excess = wrong(forecasts.both_w) - wrong(lag_w[0]);
        let mut hedge = self.hedge(members.sceptic_loss, due);
        hedge.learn(each(members_w, |member_w| member_w - reading_w), COST * square);
        for member in 0..MEMBERS - 1 {
            put(&mut self.due_above[member], due, hedge.above[member]);
        }
        put(&mut self.due_cost, due, hedge.cost);
        put(&mut self.held_above, !due, hedge.above[0]);
        put(&mut self.held_cost, !due, hedge.cost);
        let most_w = MAX_INNOVATION * self.change_w;
        let innovation_w = each(forecasts.stacks_w, |stack_w| within(reading_w - stack_w, most_w));
        RlsUpdate { u, innovation_w, square, due, excess }
    }

    /// A step of the recursive least squares, if a measurement was due.
    #[inline(always)]
    pub(crate) fn update_rls(&mut self, update: &RlsUpdate) {
        let RlsUpdate { u, innovation_w, square, due, .. } = *update;
        // No loop: one around loops keeps the loop over robots from becoming vectors.
        const { assert!(STACKS == 2) };
        self.update_stack(0, u, innovation_w[0], square, due);
        self.update_stack(1, u, innovation_w[1], square, due);
    }

    #[inline(always)]
    fn update_stack(
        &mut self,
        stack: usize,
        u: [f32; TERMS],
        innovation_w: f32,
        square: f32,
        due: bool,
    ) {
        let c = &self.covariance[stack];
        let product = [
            (c[0] * u[0] + c[1] * u[1]) + (c[2] * u[2] + c[3] * u[3]),
            (c[1] * u[0] + c[4] * u[1]) + (c[5] * u[2] + c[6] * u[3]),
            (c[2] * u[0] + c[5] * u[1]) + (c[7] * u[2] + c[8] * u[3]),
            (c[3] * u[0] + c[6] * u[1]) + (c[8] * u[2] + c[9] * u[3]),
        ];
        let spread =
            (product[0] * u[0] + product[1] * u[1]) + (product[2] * u[2] + product[3] * u[3]);
        let gain = 1.0 / (square + spread);
        for row in 0..TERMS {
            let theta = self.theta[stack][row] + product[row] * (gain * innovation_w);
            let theta = theta.clamp(-MAX_COEFFICIENT, MAX_COEFFICIENT);
            put(&mut self.theta[stack][row], due, theta);
        }
        for pair in 0..PAIRS {
            let [row, column] = PAIR[pair];
            let less = self.covariance[stack][pair] - product[row] * (product[column] * gain);
            let pulled = less + PULL * (COVARIANCE[stack][pair] - less);
            put(&mut self.covariance[stack][pair], due, pulled);
        }
    }

    /// Updates mean and size with a reading. `last_w` is the previous reading, NaN if it does not
    /// directly precede this one. `due` states whether a new measurement was due.
    #[inline(always)]
    pub(crate) fn read(&mut self, members: &Members, last_w: f32, due: bool, reading_w: f32) {
        let seen = f32::from(self.seen);
        self.mean_w += (reading_w - self.mean_w) / (1.0 + seen);
        let size_w = (reading_w - last_w).abs().min(MAX_SIZE_W);
        let change_w = self.change_w + (size_w - self.change_w) / (1.0 + TRUST + seen);
        let counts = due & !last_w.is_nan();
        put(&mut self.change_w, counts, change_w.max(members.floor_w));
        self.seen = self.seen.saturating_add(1);
    }

    /// After [`Online::read`] of the last of the first readings: their excess for the platform's
    /// [memory](joulebus_energy::Memory::start_excess), if a forecast of any was scored.
    #[inline(always)]
    pub(crate) fn shown_start(&self, members: &Members) -> Option<Shown> {
        let is_last = (self.seen == FIRST) & (self.judged > 0);
        is_last.then(|| shown_start(self.excess / (f32::from(self.judged) * members.variance)))
    }

    /// The weights' state for readings with or without a measurement due. It is the initial state
    /// if nothing was learned there.
    #[inline(always)]
    fn hedge(&self, sceptic_loss: f32, due: bool) -> Hedge {
        let square = self.change_w * self.change_w;
        let cost = if due { self.due_cost } else { self.held_cost };
        let started = cost > 0.0;
        let last = if due { self.due_above[0] } else { self.held_above };
        let familiar = if due { LOSS_LAST } else { 0.0 };
        let last_start = if self.from_last { -LOSS_OTHERS } else { familiar };
        let network_start = if self.from_last { 0.0 } else { LOSS_NETWORK };
        let network = if started { self.due_above[1] } else { network_start * square };
        let sceptic = if started { self.due_above[2] } else { sceptic_loss * square };
        Hedge {
            above: [
                if started { last } else { last_start * square },
                if due { network } else { f32::INFINITY },
                if due { sceptic } else { f32::INFINITY },
            ],
            cost: if started { cost } else { COST * square },
            of_all: due,
        }
    }

    /// Weights of the members now.
    #[inline(always)]
    pub(crate) fn weights(&self, sceptic_loss: f32) -> Weights {
        let hedge = self.hedge(sceptic_loss, true);
        let [last, network, confident, sceptic] = hedge.weights();
        Weights {
            // A rounded sum may exceed 1.
            due: [last, network, (confident + sceptic).min(1.0)],
            held: self.hedge(sceptic_loss, false).weights_of_two(),
            confidence: hedge.confidence(),
        }
    }

    #[inline(always)]
    pub(crate) fn learned(&self, weights: &Weights) -> Learned {
        let gain = |term: usize| {
            let [confident, sceptic] = [self.theta[0][term], self.theta[1][term]];
            sceptic + weights.confidence * (confident - sceptic)
        };
        Learned {
            network_w: canonical(self.network_w),
            mean_w: canonical(self.mean_w),
            change_w: canonical(self.change_w),
            weights: each(weights.due, canonical),
            held_weights: each(weights.held, canonical),
            gains: each([gain(0), gain(1), gain(2)], canonical),
            level_w: canonical(gain(3) * self.change_w),
        }
    }
}

impl OnlineLanes {
    /// Stores what [`Online::update_weights`] changes.
    #[inline(always)]
    pub(crate) fn set_losses(&mut self, lane: usize, mask: bool, robot: &Online) {
        for member in 0..MEMBERS - 1 {
            put(&mut self.due_above[member][lane], mask, robot.due_above[member]);
        }
        put(&mut self.due_cost[lane], mask, robot.due_cost);
        put(&mut self.held_above[lane], mask, robot.held_above);
        put(&mut self.held_cost[lane], mask, robot.held_cost);
    }

    /// Stores what [`Online::update_rls`] changes.
    #[inline(always)]
    pub(crate) fn set_stacks(&mut self, lane: usize, mask: bool, robot: &Online) {
        for stack in 0..STACKS {
            let (theta, covariance) = (robot.theta[stack], robot.covariance[stack]);
            for term in 0..TERMS {
                put(&mut self.theta[stack][term][lane], mask, theta[term]);
            }
            for pair in 0..PAIRS {
                put(&mut self.covariance[stack][pair][lane], mask, covariance[pair]);
            }
        }
    }

    /// Stores what [`Online::read`] changes.
    #[inline(always)]
    pub(crate) fn set_sizes(&mut self, lane: usize, mask: bool, robot: &Online) {
        put(&mut self.mean_w[lane], mask, robot.mean_w);
        put(&mut self.change_w[lane], mask, robot.change_w);
        put(&mut self.seen[lane], mask, robot.seen);
    }

    /// Judges the starts of a block by its readings, where the mask is set.
    #[inline(always)]
    pub(crate) fn judge(&mut self, mask: &Lanes<bool>, updates: &RlsUpdateLanes) {
        let mut judges = [false; LANES];
        for lane in 0..LANES {
            judges[lane] = mask[lane] & updates.due[lane] & (self.seen[lane] < FIRST);
        }
        if lanes::any(&judges) {
            for lane in (0..LANES).filter(|lane| judges[*lane]) {
                let mut robot = self.get(lane);
                robot.judge(&updates.get(lane));
                self.set(lane, true, robot);
            }
        }
    }

    /// True if the robot in a lane has just read the last of its first readings.
    #[inline(always)]
    pub(crate) fn has_started(&self, lane: usize) -> bool {
        self.seen[lane] == FIRST
    }
}

const _: () = assert!(size_of::<OnlineLanes>() <= 156 * crate::layout::lanes::LANES);

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    const MEMBERS: Members = Members {
        bias_w: 0.0,
        lags: [1.0, 0.0, 0.0, 0.0, 0.0],
        change_w: 0.8,
        floor_w: 0.01,
        variance: 1.0,
        sceptic_loss: LOSS_SCEPTIC,
    };

    /// A robot that draws `power_w`, beside a network that forecasts `network_w`. Returns the mean
    /// squared error of the forecasts over the last fifth, and over all that count.
    fn run(
        online: &mut Online,
        steps: u32,
        power_w: impl Fn(u32) -> f32,
        network_w: impl Fn(u32) -> f32,
    ) -> f32 {
        let (mut lag_w, mut sum, mut count) = ([f32::NAN; LAGS], 0.0, 0.0);
        for step in 0..steps {
            let reading_w = power_w(step);
            if !lag_w[LAGS - 1].is_nan() {
                online.network_w = network_w(step);
                let forecast_w = online.forecast(&MEMBERS, &lag_w, online.network_w, true);
                if step > steps / 5 * 4 {
                    sum += (forecast_w - reading_w).powi(2);
                    count += 1.0;
                }
                online.learn(&MEMBERS, &lag_w, true, reading_w);
            }
            online.read(&MEMBERS, lag_w[0], true, reading_w);
            lag_w.rotate_right(1);
            lag_w[0] = reading_w;
        }
        sum / count
    }

    #[test]
    fn a_gain_and_a_level_are_learned_and_followed_when_they_change() {
        let mut online = Online::new(&MEMBERS, false);
        let power_w = |step: u32| 30.0 + 8.0 * (step as f32 * 1.37).sin();
        for (gain, level) in [(1.0, 0.0), (1.3, -4.0), (0.8, 6.0), (-1.0, 20.0)] {
            let error = run(&mut online, 5_000, power_w, |step| gain * power_w(step) + level);
            // The readings alone hardly help: their variance is 32.
            assert!(error < 1.0, "gain {gain}, level {level}: {error}, {online:?}");
        }
    }

    /// A robot of 3 W under a model whose network is hundreds of watts off.
    #[test]
    fn a_robot_that_starts_from_its_last_reading_trusts_no_wrong_network() {
        let power_w = |step: u32| 3.0 + 0.05 * (step as f32 * 0.37).sin();
        for every in [1, 3] {
            let [usual, from_last] = [false, true].map(|from_last| {
                let mut online = Online::new(&MEMBERS, from_last);
                let (mut lag_w, mut squares) = ([f32::NAN; LAGS], 0.0);
                for step in 0..30 {
                    let (due, reading_w) = (step % every == 0, power_w(step / every * every));
                    if !lag_w[LAGS - 1].is_nan() {
                        online.network_w = 240.0;
                        let forecast_w = online.forecast(&MEMBERS, &lag_w, 240.0, due);
                        squares += (forecast_w - reading_w).powi(2);
                        online.learn(&MEMBERS, &lag_w, due, reading_w);
                    }
                    online.read(&MEMBERS, lag_w[0], due, reading_w);
                    lag_w.rotate_right(1);
                    lag_w[0] = reading_w;
                }
                squares
            });
            assert!(from_last < 0.2 * usual, "{from_last} and {usual} W²");
        }
    }

    #[test]
    fn the_first_readings_are_judged_once_and_alike_from_either_start() {
        let power_w = |step: u32| 30.0 + 2.0 * (step as f32 * 0.9).sin();
        for (network_w, is_worse) in [(200.0, true), (30.0, false)] {
            let shown = [false, true].map(|from_last| {
                let mut online = Online::new(&MEMBERS, from_last);
                let mut shown = Vec::new();
                for step in 0..300 {
                    run_from(&mut online, step, power_w, network_w);
                    shown.extend(online.shown_start(&MEMBERS));
                }
                assert_eq!(shown.len(), 1);
                shown[0]
            });
            // The stacks' weights differ a little by the start.
            let excess = shown.map(|shown| shown.as_flattened().iter().sum::<i64>() - 65_536);
            assert_eq!(excess.map(|excess| excess > 20_000), [is_worse; 2], "{excess:?}");
        }
    }

    /// One reading of a robot whose network forecasts the same power for ever.
    fn run_from(online: &mut Online, step: u32, power_w: impl Fn(u32) -> f32, network_w: f32) {
        let mut lag_w = [f32::NAN; LAGS];
        for (back, lag_w) in (1..).zip(&mut lag_w) {
            *lag_w = step.checked_sub(back).map_or(f32::NAN, &power_w);
        }
        if !lag_w[LAGS - 1].is_nan() {
            online.network_w = network_w;
            online.learn(&MEMBERS, &lag_w, true, power_w(step));
        }
        online.read(&MEMBERS, lag_w[0], true, power_w(step));
    }

    #[test]
    fn standing_still_for_a_day_winds_nothing_up() {
        let mut online = Online::new(&MEMBERS, false);
        run(&mut online, 30 * 3600 * 24, |_| 30.0, |_| 30.5);
        let pairs = online.covariance.as_flattened().iter();
        for (pair, start) in pairs.zip(COVARIANCE.as_flattened()) {
            assert!(pair.abs() <= 0.26 && (*start == 0.0 || *pair >= 0.0), "{online:?}");
        }
        let power_w = |step: u32| 30.0 + 8.0 * (step as f32 * 1.37).sin();
        let error = run(&mut online, 2_000, power_w, |step| power_w(step) + 0.5);
        assert!(error < 1.0, "{error}, {online:?}");
    }

    /// The quantities in the bound of [`Hedge`], of the readings with or without a measurement due.
    #[derive(Default)]
    struct Phase {
        /// Squared error of the published forecast relative to each participating member's, the
        /// newest with weight 1, minus the remaining initial losses.
        regret: Option<[f64; super::MEMBERS]>,
        largest: f64,
        floor: f64,
    }

    impl Phase {
        fn take(
            &mut self,
            hedge: &Hedge,
            square: f32,
            forecasts: &MemberForecasts,
            forecast_w: f32,
            reading_w: f32,
        ) {
            let memory = f64::from(crate::estimate::hedge::MEMORY);
            let wrong = |watts: f32| (f64::from(watts) - f64::from(reading_w)).powi(2);
            let least = hedge.above.iter().fold(0.0f32, |least, above| least.min(*above));
            let [last, network, sceptic] = hedge.above;
            let start = [last, network, 0.0, sceptic].map(|loss| -f64::from(loss - least));
            let before = self.regret.unwrap_or(start);
            let mut regret = [f64::NEG_INFINITY; super::MEMBERS];
            for (place, member_w) in forecasts.members_w.iter().enumerate() {
                if hedge.weights()[place] > 0.0 {
                    regret[place] = memory * before[place] + wrong(forecast_w) - wrong(*member_w);
                    // Between two members, or one and the reading.
                    self.largest = self.largest.max(4.0 * wrong(*member_w));
                }
            }
            self.regret = Some(regret);
            self.floor = self.floor.max(f64::from(COST * square));
        }

        fn check(&self, cost: f32, log: f32) -> Result<(), TestCaseError> {
            let cost = f64::from(cost);
            let rounding = 1e-3 * (self.floor + self.largest);
            for regret in self.regret.into_iter().flatten() {
                prop_assert!(regret <= 2.0 * cost + rounding, "{regret} above {cost}");
            }
            let most =
                2.0 * self.largest * f64::from(log) / f64::from(crate::estimate::hedge::MEMORY);
            prop_assert!(cost <= most.max(self.floor) + self.largest + rounding, "{cost}");
            Ok(())
        }
    }

    /// Plays a robot against readings and a network of `next`, which knows everything, and checks
    /// the bound of the published forecast, with and without a measurement due.
    fn holds_its_bound(
        steps: usize,
        mut next: impl FnMut(usize, &Online, &[f32; LAGS]) -> (bool, f32, f32),
    ) -> Result<(), TestCaseError> {
        let (mut online, mut lag_w) = (Online::new(&MEMBERS, false), [3.0; LAGS]);
        let mut phases = [Phase::default(), Phase::default()];
        for _ in 0..LAGS {
            online.read(&MEMBERS, f32::NAN, true, 3.0);
        }
        for step in 0..steps {
            let (due, network_w, reading_w) = next(step, &online, &lag_w);
            online.network_w = network_w;
            let forecast_w = online.forecast(&MEMBERS, &lag_w, network_w, due);
            let forecasts = online.member_forecasts(&MEMBERS, &lag_w, network_w, due);
            let (hedge, square) =
                (online.hedge(MEMBERS.sceptic_loss, due), online.change_w * online.change_w);
            let phase = &mut phases[usize::from(due)];
            phase.take(&hedge, square, &forecasts, forecast_w, reading_w);
            online.learn(&MEMBERS, &lag_w, due, reading_w);
            let cost = if due { online.due_cost } else { online.held_cost };
            phase.check(cost, hedge.log())?;
            online.read(&MEMBERS, lag_w[0], due, reading_w);
            lag_w.rotate_right(1);
            lag_w[0] = reading_w;
        }
        Ok(())
    }

    proptest! {
        #[test]
        fn what_is_published_holds_its_bound_against_each_member_for_any_readings(
            steps in prop::collection::vec(
                (any::<bool>(), -50.0f32..50.0, -50.0f32..50.0, -3i32..2), 1..400
            ),
        ) {
            holds_its_bound(steps.len(), |step, _, _| {
                let (due, network_w, reading_w, exponent) = steps[step];
                let scale = 10f32.powi(exponent);
                (due, scale * network_w, scale * reading_w)
            })?;
        }

        /// An adversary that sees weights and forecasts. In bursts it chooses the reading that the
        /// most trusted member is farthest from, or the one on the other side of the published
        /// forecast.
        #[test]
        fn what_is_published_holds_its_bound_against_an_adversary(
            period in 1usize..5,
            burst in 1usize..60,
            wait in 1usize..400,
            distance in 0.05f32..40.0,
            mirrored in any::<bool>(),
        ) {
            holds_its_bound(3_000, |step, online, lag_w| {
                let due = step % period == 0;
                let network_w = lag_w[0] + if step % 2 == 0 { distance } else { -distance };
                let forecasts = online.member_forecasts(&MEMBERS, lag_w, network_w, due);
                let weights = online.hedge(MEMBERS.sceptic_loss, due).weights();
                let trusted = (0..super::MEMBERS).max_by(|a, b| weights[*a].total_cmp(&weights[*b])).unwrap_or(0);
                let forecast_w = dot(&weights, &forecasts.members_w);
                let trusted_w = forecasts.members_w[trusted];
                let reading_w = if step % (burst + wait) >= burst {
                    lag_w[0]
                } else if mirrored {
                    forecast_w - distance * (trusted_w - lag_w[0]).signum()
                } else {
                    trusted_w + distance * (lag_w[0] - trusted_w).signum()
                };
                (due, network_w, reading_w.clamp(-1e3, 1e3))
            })?;
        }

        #[test]
        fn whatever_comes_forecasts_stay_finite(
            steps in prop::collection::vec((-1.0f32..1.0, -1.0f32..1.0, -8i32..7, any::<bool>()), 6..400),
        ) {
            let mut online = Online::new(&MEMBERS, false);
            let mut lag_w = [1.0; LAGS];
            for (reading, network, exponent, due) in steps {
                let scale = 10f32.powi(exponent);
                let reading_w = reading * scale;
                online.network_w = network * scale * scale;
                let forecast_w = online.forecast(&MEMBERS, &lag_w, online.network_w, due);
                prop_assert!(forecast_w.is_finite(), "{online:?}");
                online.learn(&MEMBERS, &lag_w, due, reading_w);
                online.read(&MEMBERS, lag_w[0], due, reading_w);
                lag_w.rotate_right(1);
                lag_w[0] = reading_w;
                let learned = online.learned(&online.weights(MEMBERS.sceptic_loss));
                let shares = learned.weights.iter().chain(&learned.held_weights);
                for share in shares {
                    prop_assert!((0.0..=1.0).contains(share), "{learned:?}");
                }
                for (pair, [row, column]) in PAIR.into_iter().enumerate() {
                    if row == column {
                        for stack in 0..STACKS {
                            let allowed = -1e-3..=VARIANCE[stack][row] + 1e-3;
                            let found = online.covariance[stack][pair];
                            prop_assert!(allowed.contains(&found), "{online:?}");
                        }
                    }
                }
            }
        }
    }
}
