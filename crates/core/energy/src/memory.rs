//! The memory of a platform: what its robots have shown of themselves, for the next one.
//!
//! **Groups.** A robot belongs to one of [`GROUPS`] groups by its id, for ever. Each group has sums
//! of its own, and each known group counts alike. So one robot moves one group, however long it
//! runs and however often it comes back. While fewer than [`QUORUM`] groups are known, the trained
//! model takes the part of the missing ones. So one robot weighs an eighth of any number at most.
//!
//! Sums are integers until they are added, so the result does not depend on the order in which
//! robots are processed.

// Several arrays are indexed alike.
#![allow(clippy::needless_range_loop)]

use std::fmt;
use std::marker::PhantomData;

use serde::de::{Deserialize, Deserializer, IgnoredAny, SeqAccess, Visitor};

/// Groups of robots.
pub const GROUPS: usize = 32;
/// Groups that speak for a platform. The trained model stands for the missing ones.
const QUORUM: f32 = 8.0;

/// Quantities that are remembered: the place of each in [`Shown`].
pub const SHOWN: usize = 4;
/// Seconds of a robot: their number, and their power in the platform's trained mean.
pub(crate) const POWER: usize = 0;
/// The first readings of a robot: their number, and the [excess](Memory::start_excess).
const START: usize = 1;
/// Squares of the energy that the commands explained, and its products with what was to explain.
pub(crate) const TRUST: usize = 2;
/// Seconds of a robot with a known level: their number, and its power in that of its commands.
pub(crate) const LEVEL: usize = 3;

/// Weight and sum of each quantity.
pub type Shown<T = i64> = [[T; 2]; SHOWN];

/// A weight or sum of 1, as an integer.
const UNIT: f32 = 65536.0;
/// Largest number that a robot may show.
const MAX: [f32; SHOWN] = [64.0, 2.0, 4.0, 64.0];
/// Largest weight that a group remembers. Older parts fade: two hours of a robot, four starts. A
/// level is a mean already, so the newest ones count.
const MEMORY: [f32; SHOWN] = [7_200.0, 4.0, 4.0, 3.0];
/// Weight with which a group counts half: 2 s of a robot, one start.
const HALF: [f32; SHOWN] = [2.0, 1.0, 0.1, 0.1];

/// A weight and a number as [`Shown`] has them. None of either if they are not finite.
pub(crate) fn shown(quantity: usize, weight: f32, number: f32) -> [i64; 2] {
    if !(weight.is_finite() && number.is_finite()) {
        return [0; 2];
    }
    let most = MAX[quantity];
    [(UNIT * weight.clamp(0.0, most)) as i64, (UNIT * number.clamp(-most, most)) as i64]
}

/// Squares and products as [`TRUST`] has them. Both are reduced alike, so their ratio stays.
pub(crate) fn shown_trust(square: f32, product: f32) -> [i64; 2] {
    let most = MAX[TRUST];
    let keeps = most / square.max(product.abs()).max(most);
    shown(TRUST, keeps * square, keeps * product)
}

/// The first readings of a robot, whose forecasts without the last reading had this excess.
pub fn shown_start(excess: f32) -> Shown {
    let mut all = Shown::default();
    all[START] = shown(START, 1.0, excess);
    all
}

/// Reads what groups have shown. Files of an older version lack the last quantity, or have another
/// in its place, and one more behind it.
pub(crate) fn read_groups<'de, T, D>(from: D) -> Result<[Shown<T>; GROUPS], D::Error>
where
    T: Deserialize<'de> + Default,
    D: Deserializer<'de>,
{
    struct Group<T>(Shown<T>);
    struct Visit<T>(PhantomData<T>);
    impl<'de, T: Deserialize<'de> + Default> Visitor<'de> for Visit<T> {
        type Value = Group<T>;

        fn expecting(&self, to: &mut fmt::Formatter<'_>) -> fmt::Result {
            write!(to, "{SHOWN} pairs of numbers")
        }

        fn visit_seq<A: SeqAccess<'de>>(self, mut pairs: A) -> Result<Group<T>, A::Error> {
            let mut shown = Shown::default();
            for pair in &mut shown {
                *pair = pairs.next_element()?.unwrap_or_default();
            }
            while pairs.next_element::<IgnoredAny>()?.is_some() {}
            Ok(Group(shown))
        }
    }
    impl<'de, T: Deserialize<'de> + Default> Deserialize<'de> for Group<T> {
        fn deserialize<D: Deserializer<'de>>(from: D) -> Result<Self, D::Error> {
            from.deserialize_tuple(SHOWN, Visit(PhantomData))
        }
    }
    <[Group<T>; GROUPS]>::deserialize(from).map(|groups| groups.map(|group| group.0))
}

/// The group of a robot. Multiplied by the golden ratio, neighbouring and equally spaced ids are
/// mostly in different groups.
pub const fn group_of(robot: u32) -> usize {
    (robot.wrapping_mul(0x9e37_79b9) >> (u32::BITS - GROUPS.ilog2())) as usize
}

/// What the robots of a platform have shown together. Each number is the trained model's until they
/// have, and moves to theirs as more of them become known.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Memory {
    /// Known robots, at most [`GROUPS`].
    pub robots: f32,
    /// Mean power of the robots, in the platform's trained mean: 1/4 to 4.
    pub power: f32,
    /// Trust in commands of a robot that has shown nothing yet, 0 to 1.
    pub command_trust: f32,
    /// Mean squared error of the robots' first forecasts without the last reading, above that of
    /// the last reading, in the model's variance: −2 to 2.
    pub start_excess: f32,
    /// Median of the robots' mean powers, in the platform's trained mean. 0 before the first robot.
    /// It is only told: one robot of two kinds may move it far.
    pub drawn: f32,
    /// Median of the robots' powers, in those of their commands by the model. 0 while fewer than
    /// eight are known.
    pub level: f32,
    /// Relative standard deviation of these powers between robots: 2.5 to 40 %.
    pub spread: f32,
}

impl Memory {
    /// Before the first robot.
    pub const TRAINED: Self = Self {
        robots: 0.0,
        power: 1.0,
        command_trust: 1.0,
        start_excess: 0.0,
        drawn: 0.0,
        level: 0.0,
        spread: SPREAD,
    };

    /// Of the remembered weights and sums of each group.
    pub(crate) fn of(groups: &[Shown<f32>; GROUPS]) -> Self {
        let power = Known::new(groups, POWER);
        let trust = Known::new(groups, TRUST);
        let trusts = |[square, product]: [f32; 2]| trusted(product, square, 1.0);
        // A damaged file may have a sum without its weight.
        let means = |quantity: usize, [weight, sum]: [f32; 2]| {
            let most = MAX[quantity];
            (sum / weight.max(f32::MIN_POSITIVE)).clamp(-most, most)
        };
        let all = |quantity: usize| groups.each_ref().map(|shown| means(quantity, shown[quantity]));
        let ratio = |quantity: usize| Known::new(groups, quantity).mean_ratio(all(quantity));
        let (levels, of_levels) = (Known::new(groups, LEVEL), all(LEVEL));
        let level = levels.median(&of_levels);
        // The geometric mean of the sizes of what is normal, in its standard deviation.
        const SIZE: f32 = 0.53;
        let apart = of_levels.map(|of_group| {
            let share = of_group / level.max(f32::MIN_POSITIVE);
            (2.0 - 4.0 / (1.0 + share.max(0.0))).abs() / (SIZE * SPREAD)
        });
        Self {
            robots: power.sum,
            drawn: power.median(&all(POWER)),
            level: if levels.missing() > 0.5 { 0.0 } else { level },
            spread: SPREAD * levels.mean_ratio(apart),
            power: ratio(POWER),
            command_trust: trust.mean(1.0, groups.each_ref().map(|shown| trusts(shown[TRUST]))),
            start_excess: Known::new(groups, START)
                .mean(0.0, groups.each_ref().map(|shown| means(START, shown[START]))),
        }
    }

    /// True if the next robot starts from its last reading.
    pub fn starts_from_last(&self) -> bool {
        /// Excess from which the trained model is worse than nothing.
        const WORSE: f32 = 0.3;
        self.start_excess > WORSE
    }
}

/// Relative standard deviation between the levels of robots that have shown none.
const SPREAD: f32 = 0.1;

/// How well each group is known, 0 to 1.
struct Known {
    weights: [f32; GROUPS],
    sum: f32,
}

impl Known {
    fn new(groups: &[Shown<f32>; GROUPS], quantity: usize) -> Self {
        let known = |weight: f32| weight / (weight + HALF[quantity]);
        let weights = groups.each_ref().map(|shown| known(shown[quantity][0]));
        Self { sum: weights.iter().sum(), weights }
    }

    /// Weight of the trained number.
    fn missing(&self) -> f32 {
        (QUORUM - self.sum).max(0.0)
    }

    /// The mean of numbers that have bounds of their own. `trained` is that of missing groups.
    fn mean(&self, trained: f32, numbers: [f32; GROUPS]) -> f32 {
        let mut sum = self.missing() * trained;
        for group in 0..GROUPS {
            sum += self.weights[group] * numbers[group];
        }
        sum / self.sum.max(QUORUM)
    }

    /// The median of the groups that are known by more than half. 0 without one.
    fn median(&self, numbers: &[f32; GROUPS]) -> f32 {
        let (mut known, mut count) = ([f32::INFINITY; GROUPS], 0);
        for group in 0..GROUPS {
            if self.weights[group] > 0.5 {
                known[count] = numbers[group];
                count += 1;
            }
        }
        known.sort_unstable_by(f32::total_cmp);
        if count == 0 { 0.0 } else { 0.5 * (known[(count - 1) / 2] + known[count / 2]) }
    }

    /// The mean of ratios, of which no robot that draws four times as much moves more than
    /// [`Known::MOVES`].
    ///
    /// A logarithm counts whole up to a distance from the trained one, and in part beyond it. The
    /// more groups are known, the greater are both. With 29 the result is the geometric mean. Fewer
    /// cannot be believed wholly: if all of them change one after the other, one of them moves the
    /// mean by its part of the change at least.
    fn mean_ratio(&self, ratios: [f32; GROUPS]) -> f32 {
        /// Largest ratio, and the inverse of the least.
        const MAX: f32 = 4.0;
        let (number, ln_max) = (self.sum.max(QUORUM), libm::logf(MAX));
        let share = (number * Self::MOVES / ln_max).min(1.0);
        let slope = share * share * share;
        let whole = 0.5 * ln_max * share * (1.0 + share) / (1.0 + share + share * share);
        let mut sum = 0.0;
        for group in 0..GROUPS {
            #[expect(clippy::manual_clamp, reason = "it would keep a NaN")]
            let ln = libm::logf(ratios[group].max(1.0 / MAX).min(MAX));
            let near = ln.max(-whole).min(whole);
            sum += self.weights[group] * (near + slope * (ln - near));
        }
        libm::expf(sum / number)
    }

    /// Logarithm of 1.05, less the rounding.
    const MOVES: f32 = 0.0487;
}

/// Trust in commands after sums of products and squares, from `prior` on.
pub(crate) fn trusted(product: f32, square: f32, prior: f32) -> f32 {
    /// Weight of the prior, in the unit of the sums.
    const PRIOR: f32 = 0.2;
    ((PRIOR * prior + product) / (PRIOR + square)).clamp(0.0, 1.0)
}

/// Adds what a group has shown to what is remembered of it.
pub(crate) fn add(seen: &mut Shown<f32>, shown: &Shown) {
    for quantity in 0..SHOWN {
        for (seen, shown) in seen[quantity].iter_mut().zip(shown[quantity]) {
            *seen += shown as f32 / UNIT;
        }
        let (weight, most) = (seen[quantity][0], MEMORY[quantity]);
        if weight > most {
            seen[quantity] = seen[quantity].map(|number| number * (most / weight));
        }
    }
}

/// True if robots could have shown this.
pub(crate) fn is_sound(seen: &Shown<f32>) -> bool {
    (0..SHOWN).all(|quantity| {
        let [weight, sum] = seen[quantity];
        (0.0..=1.001 * MEMORY[quantity]).contains(&weight) && sum.abs() <= 1e6
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn of(robots: impl IntoIterator<Item = (u32, f32)>, seconds: i64) -> Memory {
        let mut groups = [Shown::default(); GROUPS];
        for (robot, power) in robots {
            let mut new = Shown::default();
            new[POWER] = shown(POWER, 1.0, power).map(|number| number * seconds);
            add(&mut groups[group_of(robot)], &new);
        }
        Memory::of(&groups)
    }

    #[test]
    fn eight_robots_with_equally_spaced_ids_are_in_six_groups_or_more() {
        for spacing in [1, 2, 10, 64, 100, 1000] {
            for first in [0, 7, 1_000, 4_000_000_000] {
                let mut groups: Vec<usize> = (0..8)
                    .map(|n: u32| group_of(n.wrapping_mul(spacing).wrapping_add(first)))
                    .collect();
                groups.sort_unstable();
                groups.dedup();
                assert!(
                    groups.len() >= if spacing == 1 { 8 } else { 6 },
                    "{spacing}, {first}: {groups:?}"
                );
            }
        }
    }

    #[test]
    fn a_fleet_that_draws_something_else_is_believed_as_more_of_its_robots_are_known() {
        assert_eq!(of([], 1), Memory::TRAINED);
        for power in [0.03, 0.3, 0.5, 0.83, 1.4, 3.0, 20.0f32] {
            let limited = power.clamp(0.25, 4.0);
            let whole = of((0..100).map(|robot| (robot, power)), 7_200).power;
            assert!((whole / limited - 1.0).abs() < 0.02, "{power}: {whole}");
            let eight = of((0..8).map(|robot| (robot, power)), 7_200).power;
            let near = limited.ln().abs() < 0.18;
            assert!(!near || (eight / limited - 1.0).abs() < 0.01, "{power}: {eight}");
            let mut before = 1.0;
            for robots in [1, 2, 4, 8, 16, 24] {
                let found = of((0..robots).map(|robot| (robot, power)), 7_200).power;
                let apart = |found: f32| (found.ln() - limited.ln()).abs();
                assert!(apart(found) <= apart(before) + 1e-4, "{robots} at {power}: {found}");
                before = found;
            }
        }
    }

    #[test]
    fn in_any_fleet_one_robot_at_four_times_its_power_moves_the_mean_by_a_twentieth() {
        let mut state = 1u32;
        let mut unit = || {
            state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            (state >> 8) as f32 / (1 << 24) as f32
        };
        for case in 0..4_000 {
            let robots = 1 + case % 41;
            // Two halves that draw alike, up to thirty times apart, or all of them anything.
            let clusters = [0, 1].map(|_| libm::expf(4.0 * unit() - 2.0));
            let (split, spread) = (unit(), if case % 3 == 0 { 3.0 } else { 0.05 });
            let mut fleet: Vec<(u32, f32)> = (0..robots)
                .map(|robot| {
                    let cluster = clusters[usize::from(unit() < split)];
                    (robot, cluster * libm::expf(spread * (unit() - 0.5)))
                })
                .collect();
            let seconds = [1, 10, 100, 7_200][case as usize / 41 % 4];
            let usual = of(fleet.iter().copied(), seconds).power;
            let moved = (unit() * robots as f32) as usize % fleet.len();
            for factor in [0.25, 4.0] {
                let before = fleet[moved].1;
                fleet[moved].1 *= factor;
                let by = of(fleet.iter().copied(), seconds).power / usual;
                fleet[moved].1 = before;
                assert!((1.0 / 1.05..=1.05).contains(&by), "{fleet:?}, {moved} by {factor}: {by}");
            }
        }
    }

    #[test]
    fn a_monitor_at_any_power_moves_the_mean_of_usual_robots_by_a_twentieth() {
        let spread = |robot: u32| 0.9 + 0.02 * (robot * 7 % 11) as f32;
        for others in [0, 1, 3, 7, 12, 31, 40] {
            let fleet = |last: f32, hours: i64| {
                let all = (0..others).map(|robot| (robot, spread(robot)));
                let long = std::iter::repeat_n((others, last), hours as usize);
                of(all.chain(long), 3_600).power
            };
            for (hours, factor) in [-4.0, 0.0, 0.25, 4.0, 60.0].map(|factor| (100, factor)) {
                let by = (fleet(factor, hours) / fleet(1.0, 1) - 1.0).abs();
                assert!(by <= 0.05, "{others} and one at {factor}: {by}");
            }
        }
    }

    fn among(robots: impl IntoIterator<Item = (u32, f32)>) -> Memory {
        let mut groups = [Shown::default(); GROUPS];
        for (robot, level) in robots {
            let mut new = Shown::default();
            new[LEVEL] = shown(LEVEL, 1.0, level).map(|number| 3 * number);
            add(&mut groups[group_of(robot)], &new);
        }
        Memory::of(&groups)
    }

    #[test]
    fn levels_of_eight_robots_have_a_median_and_a_spread_and_one_robot_decides_neither() {
        let ripple = |robot: u32, spread: f32| 1.0 + spread * ((robot * 7 % 11) as f32 - 5.0) / 3.3;
        let robots = |count: u32, spread: f32| {
            (0..count).map(move |robot| (robot, 0.6 * ripple(robot, spread)))
        };
        assert_eq!(among(robots(7, 0.02)).level, 0.0, "too few");
        for (count, spread, expected) in
            [(8, 0.02, 0.08), (20, 0.02, 0.06), (32, 0.02, 0.04), (32, 0.1, 0.1), (32, 0.3, 0.3)]
        {
            let usual = among(robots(count, spread));
            assert!((usual.level / 0.6 - 1.0).abs() < 0.05 + spread / 3.0, "{usual:?}");
            let found = usual.spread / expected;
            assert!((0.7..1.4).contains(&found), "{count}, {spread}: {usual:?}");
            for factor in [0.0, 0.25, 4.0, 1e9] {
                let all = robots(count, spread);
                let moved = among(all.map(|(id, at)| (id, if id == 3 { factor * at } else { at })));
                let [level, by] = [moved.level / usual.level, moved.spread / usual.spread];
                assert!((level - 1.0).abs() <= spread, "{count}, {spread}, {factor}: {moved:?}");
                assert!((0.8..1.25).contains(&by), "{count}, {spread}, {factor}: {by}");
            }
        }
    }

    #[test]
    fn a_large_product_is_reduced_with_its_square() {
        for [square, product] in [[40.0, 20.0], [3.0, -60.0], [1.0, 0.5]] {
            let [weight, sum] = shown_trust(square, product).map(|number| number as f32);
            assert!((sum / weight - product / square).abs() < 1e-3, "{square} {product}");
        }
        assert_eq!(shown_trust(f32::NAN, 1.0), [0; 2]);
        assert_eq!(shown_trust(1.0, f32::INFINITY), [0; 2]);
    }

    #[test]
    fn one_robot_alone_changes_no_start_and_three_of_a_fleet_do() {
        let starts = |robots: &[(u32, f32)]| {
            let mut groups = [Shown::default(); GROUPS];
            for (robot, excess) in robots {
                for _ in 0..100 {
                    add(&mut groups[group_of(*robot)], &shown_start(*excess));
                }
            }
            Memory::of(&groups).starts_from_last()
        };
        assert!(!starts(&[]) && !starts(&[(3, 1e9)]) && !starts(&[(3, f32::NAN), (4, 0.1)]));
        assert!(starts(&[(0, 2.0), (1, 2.0), (2, 2.0)]));
        let fleet: Vec<(u32, f32)> = (0..12).map(|robot| (robot, -0.1)).collect();
        let with = |other: (u32, f32)| [fleet.clone(), vec![other]].concat();
        assert!(!starts(&fleet) && !starts(&with((12, 50.0))));
    }

    #[test]
    fn what_a_robot_cannot_have_shown_is_not_added() {
        assert_eq!(shown(POWER, 1.0, f32::NAN), [0; 2]);
        assert_eq!(shown(TRUST, f32::INFINITY, 1.0), [0; 2]);
        let mut seen = Shown::default();
        for _ in 0..10_000 {
            add(&mut seen, &shown_start(f32::MAX));
        }
        assert!(is_sound(&seen), "{seen:?}");
        seen[START][0] = f32::NAN;
        assert!(!is_sound(&seen));
    }
}
