//! What a dataset can teach, before anything is trained (arXiv 2603.13908, section 4).

mod autocorrelation;

pub use autocorrelation::{Autocorrelation, autocorrelation};
