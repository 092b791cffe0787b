//! joulebus-tests
