//! joulebus-publisher
