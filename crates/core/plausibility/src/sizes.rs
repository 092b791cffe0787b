//! A histogram of magnitudes in bounded memory.

/// Buckets per decade.
const PER_DECADE: f64 = 2.0;
/// Decades below 1.
const BELOW: f64 = 10.0;
const BUCKETS: usize = 40;

/// Histogram of orders of magnitude. Zeros are not counted.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Sizes {
    counts: [u32; BUCKETS],
    sums: [f64; BUCKETS],
    count: u64,
}

impl Default for Sizes {
    fn default() -> Self {
        Self::new()
    }
}

impl Sizes {
    pub(crate) const fn new() -> Self {
        Self { counts: [0; BUCKETS], sums: [0.0; BUCKETS], count: 0 }
    }

    pub(crate) fn add(&mut self, value: f64) {
        let size = value.abs();
        if !(size > 0.0 && size.is_finite()) {
            return;
        }
        let bucket = ((size.log10() + BELOW) * PER_DECADE).floor();
        let bucket = bucket.clamp(0.0, (BUCKETS - 1) as f64) as usize;
        self.counts[bucket] = self.counts[bucket].saturating_add(1);
        self.sums[bucket] += size;
        self.count += 1;
    }

    /// Two groups of magnitudes with tens between them, if there are no others: the number of
    /// each, and its mean.
    pub(crate) fn groups(&self) -> Option<[(u64, f64); 2]> {
        const BETWEEN: usize = 3;
        let kept: Vec<usize> = (0..BUCKETS).filter(|at| self.counts[*at] > 0).collect();
        let mut apart = kept.windows(2).filter(|pair| pair[1] - pair[0] > BETWEEN);
        let (Some(pair), None) = (apart.next(), apart.next()) else {
            return None;
        };
        let group = |from: usize, to: usize| {
            let count = self.counts[from..to].iter().map(|count| u64::from(*count)).sum();
            (count, self.sums[from..to].iter().sum::<f64>() / count as f64)
        };
        Some([group(0, pair[1]), group(pair[1], BUCKETS)])
    }

    pub(crate) const fn count(&self) -> u64 {
        self.count
    }

    /// The mean magnitude of the bucket with the median. `None` without values.
    pub(crate) fn usual(&self) -> Option<f64> {
        self.quantile(0.5)
    }

    /// The mean magnitude of the bucket with this share of the values up to it.
    pub(crate) fn quantile(&self, share: f64) -> Option<f64> {
        let all: u64 = self.counts.iter().map(|count| u64::from(*count)).sum();
        let mut below = 0;
        for (count, sum) in self.counts.iter().zip(&self.sums) {
            below += u64::from(*count);
            if *count > 0 && below as f64 >= share * all as f64 {
                return Some(sum / f64::from(*count));
            }
        }
        None
    }
}
