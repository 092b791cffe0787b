//! joulebus-fleet
