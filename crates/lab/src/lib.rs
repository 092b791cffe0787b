//! The laboratory: recorded trials, the simulated plant, training, evaluation, and the
//! model files of other programs.
#![forbid(unsafe_code)]

<<<<<<< HEAD
pub mod bootstrap;
=======
pub mod analyze;
pub mod data;
>>>>>>> fa8e001 (joulebus data info, check and convert: findings with file and row, the same bits in another form, resampling when asked; splits that know held readings)
pub mod evaluate;
pub mod linear;
pub mod metrics;
pub mod model_file;
mod noise;
pub mod plant;
pub mod rows;
pub mod score;
pub mod split;
pub mod train;
pub mod trial;
