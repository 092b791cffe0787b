//! joulebus-benches
