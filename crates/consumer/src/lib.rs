//! joulebus-consumer
