// Times calls of the C++ layer, for `tools/c_speed.py`: each line on stdin is a call and how often
// to make it, each line on stdout the time of all of them, ns. The same calls from Rust:
// `crates/languages/c/examples/calls.rs`.
//
//     ./calls fleet.toml
#include <chrono>
#include <cmath>
#include <cstdlib>
#include <functional>
#include <iostream>
#include <joulebus.hpp>
#include <map>
#include <string>
#include <vector>

using namespace std::chrono_literals;

namespace {

constexpr std::size_t width = 11, candidates = 16, steps = 50;
constexpr std::uint32_t robots = 100, first_robot = 100;

float wave(std::size_t at) { return static_cast<float>((at * 7) % 19) * 0.01f; }

std::vector<float> waves(std::size_t count, float scale, std::size_t from) {
    std::vector<float> values(count);
    for (std::size_t at = 0; at < count; at++) {
        values[at] = scale * wave(at + from);
    }
    return values;
}

/// Kept from the optimizer.
volatile float sink = 0.0f;

} // namespace

int main(int count, char **arguments) {
    if (count != 2) {
        std::cerr << "usage: " << arguments[0] << " CONFIG\n";
        return 2;
    }
    const auto predictor = joulebus::Predictor::open().value();
    auto subscriber = joulebus::Subscriber::open(arguments[1], "speed-c++").value();
    auto questions = joulebus::Questions::open(arguments[1], "speed-c++").value();
    auto publisher = joulebus::Publisher::open(arguments[1], "speed-c++").value();
    questions.wait(60s).value();
    const auto features = waves(1000 * width, 10.0f, 0);
    std::vector<float> power_w(1000);
    const auto v_mps = waves(candidates * steps, 1.0f, 0);
    const auto omega_radps = waves(candidates * steps, 5.0f, 3);
    const joulebus::Candidates plans{candidates, steps, 1.0f / 30.0f, v_mps, omega_radps};
    std::vector<joulebus::Answer> answers(candidates);
    std::vector<joulebus::RobotState> states;
    for (std::uint32_t robot = first_robot; robot < first_robot + robots; robot++) {
        states.push_back(joulebus::RobotState(robot).command(0.1f, 0.0f).reading(4.0f));
    }

    const auto predict = [&](std::size_t rows) {
        predictor.predict({features.data(), rows * width}, width, {power_w.data(), rows}).value();
        sink = power_w[0];
    };
    const std::map<std::string, std::function<void()>> calls{
        {"predict_1", [&] { predict(1); }},
        {"predict_100", [&] { predict(100); }},
        {"predict_1000", [&] { predict(1000); }},
        {"what_if",
         [&] {
             questions.what_if(0, plans, 0.9f, answers).value();
             sink = answers[0].mean_j;
         }},
        {"latest",
         [&] {
             float total_w = 0.0f;
             const auto frame = subscriber.latest().value();
             if (!frame) {
                 return;
             }
             for (const auto &row : *frame) {
                 total_w += joulebus::expected_w(row).value_or(0.0f);
             }
             sink = total_w;
         }},
        {"publish", [&] { publisher.publish(states).value(); }},
    };
    std::string name;
    for (std::size_t times = 0; std::cin >> name >> times;) {
        const auto found = calls.find(name);
        if (found == calls.end()) {
            std::cerr << "no call " << name << '\n';
            return EXIT_FAILURE;
        }
        const auto &call = found->second;
        const auto begun = std::chrono::steady_clock::now();
        for (std::size_t at = 0; at < times; at++) {
            call();
        }
        const auto took = std::chrono::steady_clock::now() - begun;
        std::cout << std::chrono::nanoseconds(took).count() << std::endl;
    }
}
