//! joulebus-predictor
