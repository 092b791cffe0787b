//! The baseline that repeats the last reading.

use hmac_sha256::Hash as Sha256;

use crate::card::ResidualStats;
use crate::error::ModelError;
use crate::file::leading_u64;

/// The baseline that repeats the last reading.
///
/// [`Model`](crate::Model) has an example.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Persistence {
    pub(crate) residual: ResidualStats,
    pub(crate) hash: u64,
}

impl Persistence {
    /// Persistence with its residuals on the platform's data, which set the width of the first
    /// intervals.
    ///
    /// # Errors
    /// [`ModelError::Field`] if residuals are not finite or inconsistent.
    pub fn new(residual: ResidualStats) -> Result<Persistence, ModelError> {
        residual.check()?;
        let mut digest = Sha256::new();
        digest.update(b"persistence");
        for value in [residual.std_w, residual.q05_w, residual.q95_w] {
            digest.update(value.to_le_bytes());
        }
        Ok(Persistence { residual, hash: leading_u64(&digest.finalize()) })
    }
}
