//! Exact quantiles of numbers that are read twice instead of kept.
//!
//! A first pass counts the numbers by the upper half of their bits, in the order of
//! [`f32::total_cmp`]. A second pass takes those that share the upper half of a wanted number, and
//! counts them by the lower half. That is as exact as sorting, in fixed memory.

use crate::metrics::ResidualQuantiles;

/// Values of half an f32.
const HALVES: usize = 1 << 16;

/// Quantiles of residuals, W, equal to [`ResidualQuantiles::new`] of all numbers that `each` gives,
/// to the bit. `each` is called twice and gives the same finite numbers both times, in any order.
///
/// # Errors
/// Those of `each`.
pub fn residual_quantiles<E>(
    mut each: impl FnMut(&mut dyn FnMut(f32)) -> Result<(), E>,
) -> Result<ResidualQuantiles, E> {
    let mut upper = vec![0_u64; HALVES];
    each(&mut |value| upper[usize::from(halves(value).0)] += 1)?;
    let count: u64 = upper.iter().sum();
    let Some(last) = count.checked_sub(1) else {
        return Ok(ResidualQuantiles::of_sorted(&[]));
    };
    let ranks = ResidualQuantiles::SHARES.map(|share| RankPosition::new(share, last));
    let mut wanted: Vec<Bucket> = Vec::new();
    for rank in ranks.iter().flat_map(|position| [position.below, position.above]) {
        let (half, _) = bucket(&upper, rank);
        if wanted.iter().all(|bucket| bucket.half != half) {
            wanted.push(Bucket { half, lower: vec![0; HALVES] });
        }
    }
    let mut bucket_of = vec![usize::MAX; HALVES];
    for (index, bucket) in wanted.iter().enumerate() {
        bucket_of[usize::from(bucket.half)] = index;
    }
    each(&mut |value| {
        let (half, low) = halves(value);
        if let Some(bucket) = wanted.get_mut(bucket_of[usize::from(half)]) {
            bucket.lower[usize::from(low)] += 1;
        }
    })?;
    let value = |rank: u64| {
        let (half, before) = bucket(&upper, rank);
        let own = wanted.iter().find(|bucket| bucket.half == half);
        own.map_or(f64::NAN, |own| own.value(rank - before))
    };
    Ok(ResidualQuantiles::at_shares(ranks.map(|position| {
        let [below, above] = [position.below, position.above].map(value);
        below + position.part * (above - below)
    })))
}

/// The position of a quantile between two ranks, as in [`quantile`](crate::metrics::quantile).
#[derive(Clone, Copy)]
struct RankPosition {
    below: u64,
    above: u64,
    part: f64,
}

impl RankPosition {
    fn new(share: f64, last: u64) -> Self {
        let position = share * last as f64;
        let below = (position.floor() as u64).min(last);
        Self { below, above: (below + 1).min(last), part: position - below as f64 }
    }
}

/// Numbers with the same upper half.
struct Bucket {
    half: u16,
    /// Counts by lower half.
    lower: Vec<u64>,
}

impl Bucket {
    /// The number of this rank within the bucket.
    fn value(&self, rank: u64) -> f64 {
        let (low, _) = bucket(&self.lower, rank);
        f64::from(number(self.half, low))
    }
}

/// The half that has the number of this rank, and the count of numbers before that half.
fn bucket(counts: &[u64], rank: u64) -> (u16, u64) {
    let mut before = 0;
    for (half, count) in (0..=u16::MAX).zip(counts) {
        if rank < before + count {
            return (half, before);
        }
        before += count;
    }
    (u16::MAX, before)
}

/// The halves of a number's bits, ordered as the numbers are.
const fn halves(value: f32) -> (u16, u16) {
    let bits = value.to_bits();
    let ordered = match bits >> 31 {
        0 => bits | 1 << 31,
        _ => !bits,
    };
    ((ordered >> 16) as u16, ordered as u16)
}

const fn number(half: u16, low: u16) -> f32 {
    let ordered = (half as u32) << 16 | low as u32;
    f32::from_bits(match ordered >> 31 {
        1 => ordered & !(1 << 31),
        _ => !ordered,
    })
}
