//! joulebus-config
