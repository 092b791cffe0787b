// Answers Open-RMF's questions what a trajectory and a time at rest cost a battery by what joulebus
// has learned of the very robot, instead of by mass, friction and inertia of its type. Says what
// the battery has, and when tasks must be planned again because a charge was cancelled. The
// interface is a stub (motion_power_sink.hpp).
//
//     ./rmf_adapter fleet.toml ROBOT
#include <algorithm>
#include <chrono>
#include <cmath>
#include <cstdlib>
#include <iostream>
#include <joulebus.hpp>
#include <limits>
#include <optional>
#include <tuple>
#include <utility>
#include <vector>

#include "motion_power_sink.hpp"

namespace {

/// The charge that one robot loses, moving or at rest. As of the newest frame, so a planner of
/// tasks sees today's load. Belongs to the thread that made it.
class JoulebusPowerSink : public rmf_battery::MotionPowerSink, public rmf_battery::DevicePowerSink {
public:
    /// `coverage`: the answer is the upper end of the interval. A planner that must not strand asks
    /// for 0.99.
    JoulebusPowerSink(joulebus::Questions questions, std::uint32_t robot, const joulebus_platform &platform,
                      float coverage)
        : questions_(std::move(questions)), robot_(robot), platform_(platform), coverage_(coverage) {}

    /// The share of the battery that the trajectory takes at most. NaN where that is unknown, which
    /// no planner takes for enough.
    double compute_change_in_charge(const rmf_traffic::Trajectory &trajectory) const override {
        const auto &waypoints = trajectory.waypoints;
        if (waypoints.size() < 2 || !(platform_.capacity_j > 0.0)) {
            return waypoints.size() < 2 ? 0.0 : std::numeric_limits<double>::quiet_NaN();
        }
        const double duration_s = waypoints.back().time_s - waypoints.front().time_s;
        const double steps = std::max(1.0, std::round(duration_s / platform_.period_s));
        if (!(duration_s > 0.0 && steps <= 1e6)) {
            return std::numeric_limits<double>::quiet_NaN();
        }
        const auto count = static_cast<std::size_t>(steps);
        std::vector<float> v_mps(count), omega_radps(count);
        for (std::size_t step = 0, leg = 1; step < count; step++) {
            const double time_s = waypoints.front().time_s + (static_cast<double>(step) + 0.5) * duration_s / steps;
            while (leg + 1 < waypoints.size() && waypoints[leg].time_s < time_s) {
                leg++;
            }
            std::tie(v_mps[step], omega_radps[step]) = command(waypoints[leg - 1], waypoints[leg], time_s);
        }
        const auto period_s = static_cast<float>(duration_s / steps);
        const joulebus::Candidates plan{1, count, period_s, v_mps, omega_radps};
        std::vector<joulebus::Answer> answer(1);
        auto done = questions_.what_if(robot_, plan, coverage_, answer);
        if (!done) {
            std::cerr << "no answer: " << done.error().message << '\n';
            return std::numeric_limits<double>::quiet_NaN();
        }
        const auto most_j = answer.front().energy_hi_j();
        return most_j ? *most_j / platform_.capacity_j : std::numeric_limits<double>::quiet_NaN();
    }

    /// The share that a time at rest takes at most, by the power that is measured at rest.
    double compute_change_in_charge(double run_time_s) const override {
        const auto answer = at_rest(run_time_s);
        return share(answer ? answer->energy_hi_j() : std::nullopt);
    }

    /// The share that the battery has at least: for the adapter's `update_battery_soc`. Measured,
    /// also while a charge goes on or was cancelled.
    double state_of_charge() const {
        const auto answer = at_rest(platform_.period_s);
        const bool is_known = answer && (answer->flags & JOULEBUS_ANSWER_LEFT) != 0;
        return share(is_known ? std::optional<float>(answer->left_lo_j) : std::nullopt);
    }

private:
    double share(std::optional<float> energy_j) const {
        return energy_j && platform_.capacity_j > 0.0 ? *energy_j / platform_.capacity_j
                                                      : std::numeric_limits<double>::quiet_NaN();
    }

    std::optional<joulebus::Answer> at_rest(double duration_s) const {
        auto question = joulebus::Question::idle({robot_}, static_cast<float>(duration_s));
        auto done = questions_.ask(question.coverage(coverage_));
        if (!done || done->rows.empty()) {
            return std::nullopt;
        }
        return done->rows.front();
    }

    /// The command of a differential drive at a time between two waypoints: the velocity along the
    /// heading.
    std::pair<float, float> command(const rmf_traffic::Trajectory::Waypoint &from,
                                    const rmf_traffic::Trajectory::Waypoint &to, double time_s) const {
        const double span_s = to.time_s - from.time_s;
        const double share = span_s > 0.0 ? std::clamp((time_s - from.time_s) / span_s, 0.0, 1.0) : 1.0;
        const auto between = [share](double one, double other) { return one + share * (other - one); };
        const double yaw = between(from.position[2], to.position[2]);
        const double v_mps = between(from.velocity[0], to.velocity[0]) * std::cos(yaw) +
                             between(from.velocity[1], to.velocity[1]) * std::sin(yaw);
        const double omega_radps = between(from.velocity[2], to.velocity[2]);
        // What the platform cannot follow, its controller saturates.
        const double v_max_mps = platform_.v_max_mps, omega_max_radps = platform_.omega_max_radps;
        return {static_cast<float>(std::clamp(v_mps, -v_max_mps, v_max_mps)),
                static_cast<float>(std::clamp(omega_radps, -omega_max_radps, omega_max_radps))};
    }

    // Asking reads the newest frame.
    mutable joulebus::Questions questions_;
    std::uint32_t robot_;
    joulebus_platform platform_;
    float coverage_;
};

/// Open-RMF plans the tasks after a charge with the charge that it expects, and keeps them if the
/// charge is cancelled (rmf_ros2 #460). This says when they must be planned again.
class ChargePlan {
public:
    /// Tasks are planned for a robot that leaves the charger with this share.
    void expect(double share) { expected_ = share; }

    /// Whether the robot has left the charger with less, as of its share and whether it charges.
    /// Says so once.
    bool must_replan(double share, bool charges) {
        const bool has_left = charged_ && !charges;
        charged_ = charges;
        return has_left && falls_short(share);
    }

    /// As `must_replan`, when the task is cancelled: the robot may never have come to the charger.
    bool must_replan_cancelled(double share) {
        charged_ = false;
        return falls_short(share);
    }

private:
    bool falls_short(double share) {
        const auto expected = std::exchange(expected_, std::nullopt);
        // An unknown share is none to count on.
        return expected && !(share >= *expected);
    }

    std::optional<double> expected_;
    bool charged_ = false;
};

/// Along the x axis for a time, at rest before and after.
rmf_traffic::Trajectory straight(double speed_mps, double duration_s) {
    return {{{0.0, {0.0, 0.0, 0.0}, {speed_mps, 0.0, 0.0}},
             {duration_s, {speed_mps * duration_s, 0.0, 0.0}, {speed_mps, 0.0, 0.0}}}};
}

} // namespace

int main(int count, char **arguments) {
    if (count != 3) {
        std::cerr << "usage: " << arguments[0] << " CONFIG ROBOT\n";
        return 2;
    }
    const auto robot = static_cast<std::uint32_t>(std::strtoul(arguments[2], nullptr, 10));
    auto questions = joulebus::Questions::open(arguments[1], "rmf-adapter");
    if (!questions) {
        std::cerr << "cannot join the fleet: " << questions.error().message << '\n';
        return EXIT_FAILURE;
    }
    auto platform = questions->platform(robot);
    if (!platform) {
        std::cerr << platform.error().message << '\n';
        return EXIT_FAILURE;
    }
    auto age = questions->wait(std::chrono::seconds(10));
    if (!age) {
        std::cerr << age.error().message << '\n';
        return EXIT_FAILURE;
    }
    const JoulebusPowerSink sink(std::move(*questions), robot, *platform, 0.9f);
    const rmf_battery::MotionPowerSink &motion = sink;
    for (double duration_s : {5.0, 10.0, 20.0}) {
        std::cout << "10 cm/s for " << duration_s << " s: "
                  << 100.0 * motion.compute_change_in_charge(straight(0.1, duration_s)) << " % of the battery\n";
    }
    const rmf_battery::DevicePowerSink &devices = sink;
    std::cout << "at rest for 60 s: " << 100.0 * devices.compute_change_in_charge(60.0) << " % of the battery\n";
    const double share = sink.state_of_charge();
    std::cout << "left: " << 100.0 * share << " % of the battery\n";
    const double full = std::min(1.0, share + 0.2), unknown = std::numeric_limits<double>::quiet_NaN();
    ChargePlan plan;
    const auto say = [](const char *charge, bool must_replan) {
        std::cout << "a charge " << charge << ": " << (must_replan ? "plan again" : "go on") << '\n';
    };
    const auto ends_with = [&plan, full](double left) {
        plan.expect(full);
        return !plan.must_replan(left, true) && plan.must_replan(left, false);
    };
    say("as planned", ends_with(full));
    say("that is cancelled at once", ends_with(share));
    say("that ends with an unknown share", ends_with(unknown));
    plan.expect(full);
    say("that is cancelled on the way", plan.must_replan_cancelled(share));
    say("that is cancelled twice", plan.must_replan_cancelled(share) || plan.must_replan(share, false));
}
