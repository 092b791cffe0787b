// A stub of what this example needs of Open-RMF (rmf_battery::MotionPowerSink and DevicePowerSink,
// rmf_traffic::Trajectory), written for it: the shape of the interface without the library, so that
// the example builds anywhere. In an adapter of yours, include Open-RMF's headers instead. Its
// trajectory has positions and velocities as Eigen vectors and times of rmf_traffic.
#ifndef JOULEBUS_EXAMPLE_MOTION_POWER_SINK_HPP
#define JOULEBUS_EXAMPLE_MOTION_POWER_SINK_HPP

#include <array>
#include <vector>

namespace rmf_traffic {

/// Positions (x in m, y in m, yaw in rad) and velocities at times, between which a robot moves
/// smoothly.
class Trajectory {
public:
    struct Waypoint {
        /// From the beginning of the trajectory, s.
        double time_s;
        std::array<double, 3> position;
        std::array<double, 3> velocity;
    };
    std::vector<Waypoint> waypoints;
};

} // namespace rmf_traffic

namespace rmf_battery {

/// What moving costs.
class MotionPowerSink {
public:
    virtual ~MotionPowerSink() = default;
    /// The change in state of charge, 0 to 1, of a trajectory.
    virtual double compute_change_in_charge(const rmf_traffic::Trajectory &trajectory) const = 0;
};

/// What the devices of a robot cost that stands still.
class DevicePowerSink {
public:
    virtual ~DevicePowerSink() = default;
    /// The change in state of charge, 0 to 1, of a time, s.
    virtual double compute_change_in_charge(double run_time_s) const = 0;
};

} // namespace rmf_battery

#endif
