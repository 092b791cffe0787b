// A fleet controller: publishes the commands and power readings of twenty robots, 30 times a
// second.
//
//     ./controller fleet.toml [FRAMES]          without FRAMES until Ctrl-C
#include <chrono>
#include <cmath>
#include <csignal>
#include <cstdlib>
#include <iostream>
#include <joulebus.hpp>
#include <thread>
#include <vector>

namespace {
volatile std::sig_atomic_t stop = 0;

// Up to 0.15 m/s: the built-in model was trained up to 0.2.
float speed_mps(std::uint32_t robot, unsigned long frame) {
    return 0.1f + 0.05f * std::sin(0.02f * static_cast<float>(frame) + static_cast<float>(robot));
}
} // namespace

int main(int count, char **arguments) {
    if (count < 2) {
        std::cerr << "usage: " << arguments[0] << " CONFIG [FRAMES]\n";
        return 2;
    }
    const unsigned long frames = count > 2 ? std::strtoul(arguments[2], nullptr, 10) : 0;
    std::signal(SIGINT, [](int) { stop = 1; });
    std::signal(SIGTERM, [](int) { stop = 1; });
    auto publisher = joulebus::Publisher::open(arguments[1], "example-cpp");
    if (!publisher) {
        std::cerr << "cannot join the fleet: " << publisher.error().message << '\n';
        return EXIT_FAILURE;
    }
    const std::chrono::nanoseconds period(33'333'333);
    // The clock that joulebus stamps with.
    auto due = std::chrono::steady_clock::now();
    for (unsigned long frame = 0; stop == 0 && (frames == 0 || frame < frames); frame++) {
        std::vector<joulebus::RobotState> robots;
        for (std::uint32_t robot = 0; robot < 20; robot++) {
            // What you commanded, and what your power monitor says. It measures at every third
            // frame, and repeats its reading in between.
            const float power_w = 2.8f + 9.0f * speed_mps(robot, frame - frame % 3);
            auto state = joulebus::RobotState(robot).command(speed_mps(robot, frame), 0.0f);
            // These come full from their chargers. State what yours know: `state_of_charge` if they
            // measure it, `charging`, `swapped` after an exchange, `off` in a robot's last frame.
            if (frame == 0) {
                state.full();
            }
            robots.push_back(frame % 3 == 0 ? state.reading(power_w) : state.held_reading(power_w));
        }
        const auto due_ns = std::chrono::nanoseconds(due.time_since_epoch()).count();
        auto sent = publisher->publish(robots, static_cast<std::uint64_t>(due_ns));
        if (!sent) {
            std::cerr << "not sent: " << sent.error().message << '\n';
            if (sent.error().code == JOULEBUS_ERROR_CONNECT) {
                return EXIT_FAILURE;    // files of this process were removed
            }
        }
        due += period;
        std::this_thread::sleep_until(due);
    }
    std::cout << publisher->counts().value().frames_sent << " frames\n";
}
