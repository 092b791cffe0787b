//! joulebus-bus
