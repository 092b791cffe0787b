//! Linear baselines: least squares over any subset of the network's features.
//!
//! The columns are centred and scaled to unit deviation, and the normal equations are solved by
//! nalgebra's Cholesky factorisation in double precision, without regularisation but in
//! [`Moments::fit_ridge`]. A column that is constant or linearly dependent on the columns before it
//! is dropped and reported, so that a fit never fails because of it and coefficients stay finite.

use std::fmt;

use joulebus_predictor::{FEATURE_NAMES, FEATURES, FeatureSet, Features, LAGS};
use nalgebra::{Cholesky, DMatrix, DVector, SMatrix, SVector};
use serde::Serialize;

use joulebus_dataset::rows::Row;

/// Position of the newest reading in [`Features`].
const NEWEST: usize = FeatureSet::PowerOnly.first();
/// The features and the target reading.
const COLUMNS: usize = FEATURES + 1;
const TARGET: usize = FEATURES;
/// Minimum share of a column's variance that the columns before it do not explain. Features are
/// single precision, so a share below the square of their rounding error is noise.
const MIN_OWN_VARIANCE: f64 = 1e-10;

/// Penalties of a ridge regression to choose from, as shares of a column's squares.
const PENALTIES: [f64; 7] = [0.0, 1e-4, 1e-3, 1e-2, 0.1, 1.0, 10.0];
/// Parts of the cross-validation that chooses.
const FIFTHS: usize = 5;

type Columns = SVector<f64, COLUMNS>;

/// A subset of the features.
///
/// ```
/// use joulebus_train::linear::Terms;
/// assert_eq!(Terms::VELOCITIES.to_string(), "velocities");
/// assert_eq!(Terms::velocities_and_lags(2).to_string(), "velocities + 2 lags");
/// assert_eq!(Terms::lags(5).to_string(), "AR(5)");
/// assert_eq!(Terms::AR5_AND_VELOCITIES.to_string(), "AR(5) + velocities");
/// ```
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct Terms(u32);

impl Terms {
    /// v, ω, their derivatives and magnitudes: the features of the command.
    pub const VELOCITIES: Terms = Terms((1 << NEWEST) - 1);
    /// The last five readings.
    pub const AR5: Terms = Terms::lags(LAGS);
    /// The features of the paper's network.
    pub const AR5_AND_VELOCITIES: Terms = Terms::velocities_and_lags(LAGS);

    /// The last `count` readings, at most [`LAGS`].
    pub const fn lags(count: usize) -> Terms {
        let count = if count < LAGS { count } else { LAGS };
        Terms(((1 << count) - 1) << NEWEST)
    }

    /// The velocities and the last `count` readings.
    pub const fn velocities_and_lags(count: usize) -> Terms {
        Terms(Terms::VELOCITIES.0 | Terms::lags(count).0)
    }

    /// The features at these positions in [`Features`]. Other positions are ignored.
    pub fn new(features: &[usize]) -> Terms {
        let known = features.iter().filter(|feature| **feature < FEATURES);
        Terms(known.fold(0, |bits, feature| bits | 1 << feature))
    }

    /// True if the feature at this position is in the subset.
    pub const fn has(self, feature: usize) -> bool {
        feature < FEATURES && self.0 >> feature & 1 == 1
    }

    /// Positions of the features, ascending.
    pub fn features(self) -> impl Iterator<Item = usize> + Clone {
        (0..FEATURES).filter(move |feature| self.has(*feature))
    }

    /// Number of features.
    pub const fn count(self) -> usize {
        self.0.count_ones() as usize
    }

    /// The union of both.
    pub const fn or(self, other: Terms) -> Terms {
        Terms(self.0 | other.0)
    }

    const fn with(self, feature: usize) -> Terms {
        Terms(self.0 | 1 << feature)
    }
}

impl fmt::Display for Terms {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        let lags = (0..=LAGS).rev().find(|count| {
            let lags = Terms::lags(*count);
            *self == lags || *self == Terms::velocities_and_lags(*count)
        });
        let with_velocities = self.0 & Terms::VELOCITIES.0 == Terms::VELOCITIES.0;
        match (lags, with_velocities) {
            (Some(0), true) => out.write_str("velocities"),
            (Some(LAGS), true) => write!(out, "AR({LAGS}) + velocities"),
            (Some(1), true) => out.write_str("velocities + 1 lag"),
            (Some(lags), true) => write!(out, "velocities + {lags} lags"),
            (Some(0), false) => out.write_str("constant"),
            (Some(lags), false) => write!(out, "AR({lags})"),
            (None, _) => {
                let names: Vec<&str> = self.features().map(|i| FEATURE_NAMES[i]).collect();
                out.write_str(&names.join(" + "))
            }
        }
    }
}

/// Errors of a fit.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
#[allow(missing_docs)] // The messages name the fields.
pub enum LinearError {
    #[error(
        "{terms} needs at least {allowed} rows with every number known, found {found} of {rows}. \
            Name more or longer recordings, or fewer features"
    )]
    TooFewRows { terms: Terms, found: usize, rows: usize, allowed: usize },
    #[error("moments of {taken} were computed, {asked} needs others. Compute them for both")]
    NotTaken { taken: Terms, asked: Terms },
}

/// Reason that a feature has no coefficient.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
#[non_exhaustive]
pub enum Dropped {
    /// Constant in all rows.
    Constant,
    /// Linearly dependent on the features before it.
    Dependent,
    /// Unknown in all rows.
    Missing,
}

/// Means and products of the features and readings of some rows: the input of a fit. Moments of
/// parts can be merged, and one set of moments gives the fit of any subset of its features, as an
/// ablation on the same rows needs.
#[derive(Clone, Debug, PartialEq)]
pub struct Moments {
    terms: Terms,
    rows: usize,
    count: usize,
    /// Means of the features, and of the reading at [`TARGET`].
    mean: Columns,
    /// Minimum and maximum: equal for a constant column.
    least: Columns,
    greatest: Columns,
    /// Sums of products of deviations from the means. Only the lower triangle is read.
    products: SMatrix<f64, COLUMNS, COLUMNS>,
}

impl Moments {
    /// Moments of no rows.
    pub fn new(terms: Terms) -> Moments {
        Moments {
            terms,
            rows: 0,
            count: 0,
            mean: Columns::zeros(),
            least: Columns::repeat(f64::INFINITY),
            greatest: Columns::repeat(f64::NEG_INFINITY),
            products: SMatrix::zeros(),
        }
    }

    /// Moments of the rows in which every feature of `terms` and the reading are finite. The others
    /// are counted ([`Moments::unusable_rows`]).
    pub fn of(rows: &[Row], terms: Terms) -> Moments {
        let usable = || {
            let values = rows.iter().map(|row| values(row, terms));
            values.filter(|values| values.iter().all(|value| value.is_finite()))
        };
        let mut moments = Moments::new(terms);
        moments.rows = rows.len();
        for values in usable() {
            moments.count += 1;
            moments.mean += values;
            moments.least = moments.least.inf(&values);
            moments.greatest = moments.greatest.sup(&values);
        }
        if moments.count == 0 {
            return moments;
        }
        moments.mean /= moments.count as f64;
        for values in usable() {
            let apart = values - moments.mean;
            moments.products.ger(1.0, &apart, &apart, 1.0);
        }
        moments
    }

    /// Adds the rows of other moments of the same terms. Merging in the same order gives the same
    /// bits.
    ///
    /// # Errors
    /// [`LinearError::NotTaken`].
    pub fn merge(&mut self, other: &Moments) -> Result<(), LinearError> {
        if self.terms != other.terms {
            return Err(LinearError::NotTaken { taken: other.terms, asked: self.terms });
        }
        self.rows += other.rows;
        if other.count == 0 {
            return Ok(());
        }
        let share = other.count as f64 / (self.count + other.count) as f64;
        let weight = self.count as f64 * share;
        let apart = other.mean - self.mean;
        self.products += other.products;
        self.products.ger(weight, &apart, &apart, 1.0);
        self.mean += apart * share;
        self.least = self.least.inf(&other.least);
        self.greatest = self.greatest.sup(&other.greatest);
        self.count += other.count;
        Ok(())
    }

    /// Number of rows.
    pub const fn rows(&self) -> usize {
        self.rows
    }

    /// Number of rows in which a feature or the reading is not finite.
    pub const fn unusable_rows(&self) -> usize {
        self.rows - self.count
    }

    /// Least squares over `terms`, a subset of the terms of these moments.
    ///
    /// # Errors
    /// [`LinearError`]: fewer usable rows than coefficients, or features that the moments lack.
    pub fn fit(&self, terms: Terms) -> Result<Linear, LinearError> {
        if terms.features().any(|feature| !self.terms.has(feature)) {
            return Err(LinearError::NotTaken { taken: self.terms, asked: terms });
        }
        let allowed = terms.count() + 1;
        if self.count < allowed {
            return Err(LinearError::TooFewRows {
                terms,
                found: self.count,
                rows: self.rows,
                allowed,
            });
        }
        Ok(self.fitted(terms, 0.0))
    }

    /// Ridge regression over `terms` on the rows of some parts. Its penalty, a share of the scaled
    /// columns' squares, is that of the least squared error on each fifth of the parts with
    /// coefficients of the others.
    ///
    /// # Errors
    /// As [`Moments::fit`].
    pub fn fit_ridge(parts: &[&Moments], terms: Terms) -> Result<Linear, LinearError> {
        let merged = |is_in: &dyn Fn(usize) -> bool| -> Result<Moments, LinearError> {
            let taken = parts.first().map_or(terms, |part| part.terms);
            let mut merged = Moments::new(taken);
            for (_, part) in parts.iter().enumerate().filter(|(at, _)| is_in(*at)) {
                merged.merge(part)?;
            }
            Ok(merged)
        };
        let mut errors = [0.0; PENALTIES.len()];
        for fifth in 0..FIFTHS.min(parts.len()) {
            let (own, others) =
                (merged(&|at| at % FIFTHS == fifth)?, merged(&|at| at % FIFTHS != fifth)?);
            if others.fit(terms).is_ok() {
                for (error, penalty) in errors.iter_mut().zip(PENALTIES) {
                    *error += own.squared_error(&others.fitted(terms, penalty));
                }
            }
        }
        let all = merged(&|_| true)?;
        all.fit(terms)?;
        let chosen = PENALTIES.iter().zip(errors).min_by(|(_, a), (_, b)| a.total_cmp(b));
        Ok(all.fitted(terms, chosen.map_or(0.0, |(penalty, _)| *penalty)))
    }

    /// Sum of the squared residuals of a model on these rows, whose moments have its features.
    fn squared_error(&self, linear: &Linear) -> f64 {
        let mut at_means = self.mean[TARGET] - linear.intercept_w;
        let mut sum = self.product(TARGET, TARGET);
        for (feature, coefficient) in &linear.coefficients {
            at_means -= coefficient * self.mean[*feature];
            sum -= 2.0 * coefficient * self.product(*feature, TARGET);
            let others = linear.coefficients.iter();
            let products =
                others.map(|(other, by)| coefficient * by * self.product(*feature, *other));
            sum += products.sum::<f64>();
        }
        sum + self.count as f64 * at_means * at_means
    }

    fn fitted(&self, terms: Terms, penalty: f64) -> Linear {
        let (kept, scaled) = self.solve(terms, penalty);
        let coefficients: Vec<(usize, f64)> = kept
            .used
            .iter()
            .zip(&scaled)
            .map(|(&feature, scaled)| (feature, scaled / self.scale(feature)))
            .collect();
        let at_means: f64 = coefficients
            .iter()
            .map(|(feature, coefficient)| coefficient * self.mean[*feature])
            .sum();
        Linear {
            terms,
            intercept_w: self.mean[TARGET] - at_means,
            coefficients,
            dropped: kept.dropped,
            rows: self.count,
            unusable_rows: self.unusable_rows(),
        }
    }

    /// The features used, and the coefficients of their scaled columns.
    fn solve(&self, terms: Terms, penalty: f64) -> (Kept, DVector<f64>) {
        let mut kept = Kept::default();
        let mut cholesky = Cholesky::pack_dirty(DMatrix::zeros(0, 0));
        for feature in terms.features() {
            let changes = self.least[feature] < self.greatest[feature];
            if !changes {
                kept.dropped.push((feature, Dropped::Constant));
                continue;
            }
            let place = kept.used.len();
            let others = kept.used.iter();
            let correlations = others.map(|other| self.correlation(feature, *other));
            let column = DVector::from_iterator(place + 1, correlations.chain([1.0 + penalty]));
            let grown = cholesky.insert_column(place, column);
            // NaN if rounding makes it negative.
            let own = grown.l_dirty()[(place, place)].powi(2);
            let adds_information = own > MIN_OWN_VARIANCE;
            if !adds_information {
                kept.dropped.push((feature, Dropped::Dependent));
                continue;
            }
            cholesky = grown;
            kept.used.push(feature);
        }
        let target = |feature: &usize| self.product(*feature, TARGET) / self.scale(*feature);
        let targets = DVector::from_iterator(kept.used.len(), kept.used.iter().map(target));
        let scaled = cholesky.solve(&targets);
        (kept, scaled)
    }

    /// Root of the sum of squared deviations.
    fn scale(&self, at: usize) -> f64 {
        self.products[(at, at)].sqrt()
    }

    fn product(&self, i: usize, j: usize) -> f64 {
        self.products[(i.max(j), i.min(j))]
    }

    fn correlation(&self, i: usize, j: usize) -> f64 {
        self.product(i, j) / (self.scale(i) * self.scale(j))
    }
}

#[derive(Default)]
struct Kept {
    used: Vec<usize>,
    dropped: Vec<(usize, Dropped)>,
}

/// The features of `terms` and the reading. Other features are 0.
fn values(row: &Row, terms: Terms) -> Columns {
    Columns::from_fn(|at, _| match at {
        TARGET => f64::from(row.target_w),
        feature if terms.has(feature) => f64::from(row.features[feature]),
        _ => 0.0,
    })
}

/// A fitted linear model: its forecast is the intercept plus a coefficient times each feature.
#[derive(Clone, Debug, PartialEq)]
pub struct Linear {
    terms: Terms,
    intercept_w: f64,
    coefficients: Vec<(usize, f64)>,
    dropped: Vec<(usize, Dropped)>,
    rows: usize,
    unusable_rows: usize,
}

impl Linear {
    /// Least squares over `terms` on some rows. Rows with a number that is not finite are left out
    /// and counted. A feature that is finite in no row (such as velocities that were not recorded)
    /// is dropped and reported instead.
    ///
    /// # Errors
    /// [`LinearError::TooFewRows`].
    pub fn fit(rows: &[Row], terms: Terms) -> Result<Linear, LinearError> {
        let (terms_there, missing) = KnownFeatures::new(rows, terms).split(terms);
        let mut linear = Moments::of(rows, terms_there).fit(terms_there)?;
        linear.miss(terms, &missing);
        Ok(linear)
    }

    /// Persistence as a linear model.
    pub fn persistence() -> Linear {
        Linear {
            terms: Terms::lags(1),
            intercept_w: 0.0,
            coefficients: vec![(NEWEST, 1.0)],
            dropped: Vec::new(),
            rows: 0,
            unusable_rows: 0,
        }
    }

    /// Records that `terms` were requested, of which `missing` are unknown in all rows.
    pub fn miss(&mut self, terms: Terms, missing: &[usize]) {
        self.terms = terms;
        let missing = missing.iter().map(|feature| (*feature, Dropped::Missing));
        self.dropped.extend(missing);
        self.dropped.sort_unstable_by_key(|(feature, _)| *feature);
    }

    /// The forecast for a row of features, W. NaN where a feature with a coefficient is NaN. Other
    /// features are ignored.
    pub fn predict(&self, features: &Features) -> f64 {
        let terms = self.coefficients.iter();
        terms.fold(self.intercept_w, |sum, (feature, coefficient)| {
            sum + coefficient * f64::from(features[*feature])
        })
    }

    /// The forecast for each row, W.
    pub fn predict_rows(&self, rows: &[Row]) -> Vec<f64> {
        rows.iter().map(|row| self.predict(&row.features)).collect()
    }

    /// The requested features.
    pub const fn terms(&self) -> Terms {
        self.terms
    }

    /// The forecast where every feature is 0, W.
    pub const fn intercept_w(&self) -> f64 {
        self.intercept_w
    }

    /// Position of each feature used, and its coefficient in W per unit of the feature.
    pub fn coefficients(&self) -> &[(usize, f64)] {
        &self.coefficients
    }

    /// Position of each requested feature that is not used, and why.
    pub fn dropped(&self) -> &[(usize, Dropped)] {
        &self.dropped
    }

    /// Rows that it was fitted on.
    pub const fn rows(&self) -> usize {
        self.rows
    }

    /// Rows that could not be used.
    pub const fn unusable_rows(&self) -> usize {
        self.unusable_rows
    }

    /// The same as plain numbers with names.
    pub fn report(&self) -> LinearReport {
        let name = |feature: usize| FEATURE_NAMES[feature];
        let coefficients = self.coefficients.iter();
        LinearReport {
            terms: self.terms.to_string(),
            intercept_w: self.intercept_w,
            coefficients: coefficients.map(|(i, value)| (name(*i), *value)).collect(),
            dropped: self.dropped.iter().map(|(i, why)| (name(*i), *why)).collect(),
            rows: self.rows,
            unusable_rows: self.unusable_rows,
        }
    }
}

/// Features that are finite in at least one row.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct KnownFeatures(Terms);

impl KnownFeatures {
    /// No features.
    pub const NONE: KnownFeatures = KnownFeatures(Terms(0));

    /// The known features of some rows. Only those of `asked` are checked.
    pub fn new(rows: &[Row], asked: Terms) -> KnownFeatures {
        let is_known = |feature: &usize| {
            let mut rows = rows.iter();
            rows.any(|row| row.features[*feature].is_finite())
        };
        let known = asked.features().filter(is_known);
        KnownFeatures(known.fold(Terms(0), Terms::with))
    }

    /// The union of both.
    pub const fn or(self, other: KnownFeatures) -> KnownFeatures {
        KnownFeatures(Terms(self.0.0 | other.0.0))
    }

    /// The known ones of some terms, and the positions of the others.
    pub fn split(self, terms: Terms) -> (Terms, Vec<usize>) {
        let missing = terms.features().filter(|feature| !self.0.has(*feature));
        (Terms(terms.0 & self.0.0), missing.collect())
    }
}

/// A fitted linear model as names and numbers.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct LinearReport {
    /// The requested features.
    pub terms: String,
    /// The forecast where every feature is 0, W.
    pub intercept_w: f64,
    /// Name of each feature used, and its coefficient in W per unit of the feature.
    pub coefficients: Vec<(&'static str, f64)>,
    /// Name of each requested feature that is not used, and why.
    pub dropped: Vec<(&'static str, Dropped)>,
    /// Rows that it was fitted on.
    pub rows: usize,
    /// Rows that could not be used.
    pub unusable_rows: usize,
}
