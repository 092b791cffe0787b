//! joulebus
