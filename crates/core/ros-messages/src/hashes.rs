//! Hashes of definitions (REP 2011, `RIHS01`), as ROS 2 has them since Iron.

/// Types, and the hashes of their definitions.
const HASHES: [(&str, &str); 12] = [
    (
        "sensor_msgs/msg/BatteryState",
        "4bee5dfce981c98faa6828b868307a0a73f992ed0789f374ee96c8f840e69741",
    ),
    (
        "spot_msgs/msg/BatteryStateArray",
        "5d85b5a60b6c7d65449204eb9ec85de487bf67a71009b4b862f2009a744972cc",
    ),
    ("geometry_msgs/msg/Twist", "9c45bf16fe0983d80e3cfe750d6835843d265a9a6c46bd2e609fcddde6fb8d2a"),
    (
        "geometry_msgs/msg/TwistStamped",
        "5f0fcd4f81d5d06ad9b4c4c63e3ea51b82d6ae4d0558f1d475229b1121db6f64",
    ),
    ("nav_msgs/msg/Odometry", "3cc97dc7fb7502f8714462c526d369e35b603cfc34d946e3f2eda2766dfec6e0"),
    ("rosgraph_msgs/msg/Clock", "692f7a66e93a3c83e71765d033b60349ba68023a8c689a79e48078bcb5c58564"),
    ("std_msgs/msg/Float64", "705ba9c3d1a09df43737eb67095534de36fd426c0587779bda2bc51fe790182a"),
    ("std_msgs/msg/Bool", "feb91e995ff9ebd09c0cb3d2aed18b11077585839fb5db80193b62d74528f6c9"),
    (
        "diagnostic_msgs/msg/DiagnosticArray",
        "5a8a36efb05fb25070fa0fb3810290c0e6cd4862b54a8fb975a1ee8dc55a333e",
    ),
    (
        "joulebus_msgs/msg/Outlook",
        "8c8d5c99ebddd5b7457cc239a5ee6b4de59568e877089fc4ca0d5db30fe4f08d",
    ),
    (
        "joulebus_msgs/srv/WhatIf",
        "1dd096f85b331685d816febe21ea18fcd3a433398d8c0c7955f6645ed49feb72",
    ),
    (
        "joulebus_msgs/srv/Acknowledge",
        "2a26f7dd41d060ed87ec033354c998e87175cadbf0c14a4adc32bc7b640456fc",
    ),
];

/// The hash of a type's definition, with its version.
#[must_use]
pub fn type_hash(name: &str) -> String {
    let found = HASHES.iter().find(|(known, _)| *known == name);
    found.map_or_else(|| "TypeHashNotSupported".to_owned(), |(_, hash)| format!("RIHS01_{hash}"))
}
