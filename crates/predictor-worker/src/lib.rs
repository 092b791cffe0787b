//! joulebus-predictor-worker
