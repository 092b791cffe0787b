//! joulebus-lab
