// A planner: reads forecasts where the worker has written them, and asks what a plan costs before
// it moves.
//
//     ./planner fleet.toml [FRAMES]             without FRAMES until Ctrl-C
#include <chrono>
#include <csignal>
#include <cstdlib>
#include <iostream>
#include <joulebus.hpp>
#include <vector>

using namespace std::chrono_literals;

namespace {

volatile std::sig_atomic_t stop = 0;

/// What it costs robot 7 to drive for three seconds, at three speeds.
void ask(joulebus::Questions &questions) {
    auto platform = questions.platform(7);
    if (!platform) {
        std::cerr << platform.error().message << '\n';
        return;
    }
    const std::size_t steps = 90;
    std::vector<float> v_mps, omega_radps(3 * steps, 0.0f), power_w(3 * steps);
    for (float speed : {0.0f, 0.05f, 0.15f}) {
        v_mps.insert(v_mps.end(), steps, speed);
    }
    const joulebus::Candidates candidates{3, steps, platform->period_s, v_mps, omega_radps};
    std::vector<joulebus::Answer> answers(3);
    auto done = questions.what_if(7, candidates, 0.9f, answers, power_w);
    if (!done) {
        std::cerr << done.error().message << '\n';
        return;
    }
    for (const auto &answer : answers) {
        std::cout << "robot 7, verdict " << answer.verdict;
        if (auto energy_j = answer.energy_j()) {
            std::cout << ": " << *energy_j << " J in " << answer.duration_s << " s, at most " << answer.hi_j << " J";
        }
        std::cout << '\n';
    }
    auto trip = questions.ask(
        joulebus::Question::follow({7}, {{0.0, 0.0, 0.15}, {0.5, 0.0, 0.15}, {0.5, 0.4, 0.15}}).back_to(0.0, 0.0));
    if (trip) {
        const auto &answer = trip->rows.front();
        std::cout << "a trip of " << answer.duration_s << " s, verdict " << answer.verdict << std::endl;
    }
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
    auto planner = joulebus::Subscriber::open(arguments[1]);
    auto questions = joulebus::Questions::open(arguments[1]);
    if (!planner || !questions) {
        std::cerr << "cannot join the fleet: " << (!planner ? planner.error() : questions.error()).message << '\n';
        return EXIT_FAILURE;
    }
    unsigned long seen = 0;
    while (stop == 0 && (frames == 0 || seen < frames)) {
        auto event = planner->wait(1s);
        if (!event) {
            std::cerr << event.error().message << '\n';
            continue;
        }
        if (auto *frame = std::get_if<joulebus::Forecasts>(&*event)) {
            double total_w = 0.0;
            for (const joulebus_forecast &robot : *frame) {
                total_w += joulebus::expected_w(robot).value_or(0.0f);
            }
            std::cout << "tick " << frame->header().tick << ": " << frame->size() << " robots, " << total_w << " W"
                      << std::endl;
            if (++seen == 20) {
                ask(*questions);
            }
        } else if (std::holds_alternative<joulebus::Gone>(*event)) {
            std::cout << "the worker has ended: do not rely on forecasts" << std::endl;
        } else if (auto *stale = std::get_if<joulebus::Stale>(&*event)) {
            std::cout << "no frame for " << stale->age.count() / 1000000 << " ms: do not rely on forecasts" << std::endl;
        } else if (std::holds_alternative<joulebus::TimedOut>(*event)) {
            std::cout << "no forecasts: does a worker run, and does a controller publish?" << std::endl;
        }
    }
    const auto status = planner->status().value();
    std::cout << status.frames << " frames, " << status.workers << " workers\n";
}
