//! Errors of models and rollouts.

use joulebus_energy::EnergyModelError;
use safetensors::SafeTensorError;
use thiserror::Error;

/// Reason that bytes or parameters are not a model that this build can execute. The caller adds the
/// file name.
///
/// ```
/// use joulebus_predictor::{ModelError, Network};
///
/// let refused = Network::from_safetensors(b"no model");
/// assert!(matches!(refused, Err(ModelError::Container(_))));
/// ```
#[derive(Debug, Error)]
#[non_exhaustive]
#[allow(missing_docs)] // The messages name the fields.
pub enum ModelError {
    /// Larger than any model of this kind.
    #[error(
        "the file has {found} bytes, a model has at most {allowed}. Check that it is a model file"
    )]
    TooLarge { found: usize, allowed: usize },
    /// The container is corrupt or of another format.
    #[error("not a complete safetensors file ({0}). Copy or train the model again")]
    Container(#[from] SafeTensorError),
    /// A metadata entry is absent.
    #[error("metadata has no `{field}`. This is not a joulebus model")]
    MissingField { field: &'static str },
    /// A value that this build does not accept.
    #[error("`{field}` is {found}, allowed: {allowed}")]
    Field { field: String, found: String, allowed: String },
    /// A tensor is absent.
    #[error("tensor `{tensor}` is missing")]
    MissingTensor { tensor: String },
    /// A tensor that belongs to no layer.
    #[error("tensor `{tensor}` belongs to no layer. A model has exactly {allowed} tensors")]
    UnexpectedTensor { tensor: String, allowed: usize },
    /// A tensor has another type or shape.
    #[error("tensor `{tensor}` is {found}, allowed: {allowed}")]
    Shape { tensor: String, found: String, allowed: String },
    /// A weight or bias is NaN or infinite.
    #[error("tensor `{tensor}` has {value} at position {index}, allowed: finite numbers")]
    NotFinite { tensor: String, index: usize, value: f32 },
    /// The contents differ from the digest.
    #[error(
        "contents have SHA-256 {found}, metadata says {stated}. The file was modified or corrupted"
    )]
    Checksum { found: String, stated: String },
    /// The energy model cannot be read, or a value of it is out of range.
    #[error("`energy`: {0}")]
    Energy(#[from] EnergyModelError),
}

impl ModelError {
    pub(crate) fn field(
        field: impl Into<String>,
        found: &(impl ToString + ?Sized),
        allowed: impl Into<String>,
    ) -> ModelError {
        ModelError::Field { field: field.into(), found: found.to_string(), allowed: allowed.into() }
    }
}

/// Errors of rollouts.
///
/// ```
/// # use joulebus_predictor::{LAGS, Model, Persistence, ReadingAge, ResidualStats, RolloutStart};
/// use joulebus_predictor::{RolloutError, Rollouts};
///
/// # let model = Model::Persistence(Persistence::new(ResidualStats::default())?);
/// # let age = ReadingAge::UNKNOWN;
/// # let start = RolloutStart { command: None, lag_w: [4.0; LAGS], reading_age: age };
/// // One candidate of one robot is one lane.
/// let (v_mps, omega_radps) = (&[0.2; 10], &[0.0; 10]);
/// let rollouts =
///     Rollouts { starts: &[start], candidates: 1, steps: 10, step_s: 0.5, v_mps, omega_radps };
/// let refused = model.rollout(&rollouts, 0..2, &mut [0.0; 2], None);
/// assert_eq!(refused, Err(RolloutError::Lanes { start: 0, end: 2, allowed: 1 }));
/// # Ok::<(), joulebus_predictor::ModelError>(())
/// ```
#[derive(Clone, Copy, Debug, PartialEq, Error)]
#[non_exhaustive]
#[allow(missing_docs)] // The messages name the fields.
pub enum RolloutError {
    /// The time step is not positive and finite.
    #[error("step_s is {found}, allowed: positive and finite seconds")]
    Step { found: f32 },
    /// Lanes out of range.
    #[error(
        "lanes {start}..{end} were asked for, allowed: parts of 0..{allowed} (robots x candidates)"
    )]
    Lanes { start: usize, end: usize, allowed: usize },
    /// The length of a slice does not match the shape.
    #[error(transparent)]
    Length(#[from] LengthError),
}

/// A slice has another length than the others require.
///
/// [`Model::predict_columns`](crate::Model::predict_columns) has an example.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Error)]
#[error("{column} has {found} values, allowed: {allowed}")]
#[allow(missing_docs)] // The messages name the fields.
pub struct LengthError {
    pub column: &'static str,
    pub found: usize,
    pub allowed: usize,
}
