// The C++ layer beside a running worker and a source of robots 0 to 7:
//
//     ./layer fleet.toml
//
// Prints the bits of forecasts that the test compares with Rust's.
#include <chrono>
#include <cmath>
#include <cstdlib>
#include <cstring>
#include <iostream>
#include <joulebus.hpp>
#include <poll.h>
#include <thread>
#include <vector>

using namespace std::chrono_literals;

#define HOLDS(condition)                                                                                                \
    do {                                                                                                                \
        if (!(condition)) {                                                                                             \
            std::cerr << "line " << __LINE__ << ": " << #condition << '\n';                                             \
            std::exit(EXIT_FAILURE);                                                                                    \
        }                                                                                                               \
    } while (false)

namespace {

constexpr auto patience = 120s;

joulebus::Forecasts next_frame(joulebus::Subscriber &subscriber) {
    for (;;) {
        auto event = subscriber.wait(patience).value();
        HOLDS(!std::holds_alternative<joulebus::TimedOut>(event));
        if (auto *frame = std::get_if<joulebus::Forecasts>(&event); frame && frame->size() >= 8) {
            return *frame;
        }
    }
}

void results() {
    auto failed = joulebus::Publisher::open("/no/such.toml", "one");
    HOLDS(!failed && failed.error().code == JOULEBUS_ERROR_CONNECT);
    HOLDS(failed.error().message.find("/no/such.toml") != std::string::npos);
    bool thrown = false;
    try {
        failed.value();
    } catch (const joulebus::Exception &exception) {
        thrown = exception.code() == JOULEBUS_ERROR_CONNECT && exception.what() == failed.error().message;
    }
    HOLDS(thrown);
    HOLDS(joulebus::Result<int>(3).value_or(4) == 3);
    HOLDS(joulebus::Result<int>(joulebus::Error{JOULEBUS_ERROR_READ, ""}).value_or(4) == 4);
}

void publishing(const std::string &config) {
    auto one = joulebus::Publisher::open(config, "layer").value();
    auto sent = one.publish({joulebus::RobotState(80).command(0.1f, 0.0f).reading(4.0f),
                             joulebus::RobotState(81).held_reading(4.0f).state_of_charge(0.5f)});
    HOLDS(sent->samples == 2);
    std::vector<joulebus::RobotState> robots{joulebus::RobotState(80), joulebus::RobotState(80)};
    HOLDS(one.publish(robots).error().code == JOULEBUS_ERROR_PUBLISH);
    joulebus::Publisher two = std::move(one);
    HOLDS(one.get() == nullptr && one.publish(robots).error().code == JOULEBUS_ERROR_ARGUMENT);
    HOLDS(two.counts()->frames_sent == 1);
    std::thread([&two] { HOLDS(two.close().error().code == JOULEBUS_ERROR_THREAD); }).join();
    HOLDS(two.close() && two.close());
    HOLDS(two.publish(robots).error().code == JOULEBUS_ERROR_ARGUMENT);
}

void frames(const std::string &config) {
    std::optional<joulebus::Subscriber> subscriber = joulebus::Subscriber::open(config).value();
    next_frame(*subscriber);
    const auto readiness = subscriber->readiness().value();
    HOLDS(readiness.look_within <= 100ms);
    pollfd polled{readiness.descriptor, POLLIN, 0};
    HOLDS(poll(&polled, 1, 60000) == 1 && polled.revents == POLLIN);
    auto kept = subscriber->take_current().value();
    auto frame = next_frame(*subscriber);
    HOLDS(kept.header().tick < frame.header().tick);
    std::size_t count = 0;
    for (const auto &robot : frame) {
        const auto interval = joulebus::interval_w(robot);
        HOLDS(!interval || interval->first <= interval->second);
        count++;
    }
    HOLDS(count == frame.size() && frame.rows().size() == count);
    HOLDS(frame.find(7) == subscriber->robot(7).value() && frame.find(7)->robot == 7);
    HOLDS(frame.find(4000000000u) == nullptr);
    HOLDS(subscriber->latest()->has_value());
    while (!subscriber->budgets()->has_value() || !subscriber->diagnostics()->has_value() ||
           !subscriber->outlooks()->has_value()) {
        std::this_thread::sleep_for(2ms);
    }
    HOLDS(subscriber->budgets().value()->find(7)->robot == 7);
    HOLDS(subscriber->outlooks().value()->find(7)->robot == 7);
    HOLDS(subscriber->status()->worker == JOULEBUS_WORKER_ALIVE || subscriber->status()->worker == JOULEBUS_WORKER_STALE);
    // The frame stays as it is, byte by byte: 33 ticks after the subscriber was closed, memory that
    // was given back has been written to.
    const auto bytes = [&kept] {
        const auto robots = reinterpret_cast<const char *>(&*kept.begin());
        return std::string(robots, kept.size() * sizeof(*kept.begin())) +
               std::string(reinterpret_cast<const char *>(&kept.header()), sizeof(kept.header()));
    };
    const auto before = bytes();
    auto later = joulebus::Subscriber::open(config).value();
    subscriber.reset();
    for (const auto until = next_frame(later).header().tick + 40; next_frame(later).header().tick < until;) {
    }
    HOLDS(kept.find(7) != nullptr && kept.size() >= 8 && bytes() == before);
    auto moved = std::move(kept);
    HOLDS(moved.close());
    HOLDS(moved.size() == 0 && moved.begin() == moved.end() && moved.header().tick == 0);
}

// A kept frame does not become one that is not kept, and a loop over a temporary one keeps it until
// the loop ends.
static_assert(!std::is_convertible_v<joulebus::KeptForecasts &, joulebus::Forecasts>);
static_assert(std::is_same_v<decltype(std::declval<joulebus::Result<joulebus::KeptForecasts>>().value()),
                             joulebus::KeptForecasts>);
void kept_by_a_loop(const std::string &config) {
    auto subscriber = joulebus::Subscriber::open(config).value();
    next_frame(subscriber);
    std::size_t count = 0;
    for (const auto &row : subscriber.take_current().value()) {
        // As many frames as would take its place if it had been given back.
        next_frame(subscriber);
        HOLDS(row.robot < 4000000000u);
        count++;
    }
    HOLDS(count >= 8);
}

void plans(const std::string &config) {
    auto questions = joulebus::Questions::open(config).value();
    questions.wait(patience).value();
    const auto platform = questions.platform(7).value();
    std::vector<float> v(60, 0.1f), omega(60, 0.0f), power_w(60);
    std::vector<joulebus::Answer> answers(2);
    const joulebus::Candidates candidates{2, 30, platform.period_s, v, omega};
    while (!questions.what_if(7, candidates, 0.9f, answers, power_w) || !answers[0].energy_j()) {
        std::this_thread::sleep_for(10ms);
    }
    HOLDS(*answers[0].energy_j() > 0.0f && answers[0].energy_j() == answers[1].energy_j());
    HOLDS(*answers[0].energy_hi_j() >= *answers[0].energy_j() && answers[0].kind() != joulebus::Verdict::unknown);
    const auto asked = questions.ask(joulebus::Question::what_if(7, candidates).power()).value();
    HOLDS(asked.rows.size() == 2 && asked.power_w.size() == 60 && asked.took == 0ns);
    std::vector<float> short_column(59, 0.0f);
    const joulebus::Candidates uneven{2, 30, platform.period_s, v, short_column};
    HOLDS(questions.what_if(7, uneven, 0.9f, answers).error().code == JOULEBUS_ERROR_ARGUMENT);
    HOLDS(questions.ask(joulebus::Question::what_if(7, uneven)).error().code == JOULEBUS_ERROR_ARGUMENT);
    const auto path = std::vector<joulebus_waypoint>{{0.0, 0.0, 0.1}, {0.4, 0.0, 0.1}, {0.4, 0.3, 0.1}};
    const auto trip = questions.ask(joulebus::Question::follow({7}, path).back_to(0.0, 0.0).power()).value();
    HOLDS(trip.rows.size() == 1 && trip.power_w.size() > 30);
    const auto ranked = questions.ask(joulebus::Question::follow({3, 7, 5}, path)).value();
    HOLDS(ranked.rows.size() == 3 && ranked.power_w.empty());

    auto client = joulebus::Client::open(config).value();
    const auto through = client.ask(joulebus::Question::idle({7, 3}, 5.0f), patience).value();
    HOLDS(through.rows.size() == 2 && through.rows[0].robot == 7 && through.took > 0ns);
    const auto computed = client.ask(joulebus::Question::what_if(7, candidates).power(), patience).value();
    HOLDS(computed.power_w.size() == 60);
    client.state_battery(7, JOULEBUS_SAMPLE_SOC, "ann", patience, 0.4f).value();
    const auto left_j = [&] {
        const auto now = client.ask(joulebus::Question::idle({7}, 1.0f), patience).value();
        return now.rows[0].left_j;
    };
    // Of 5 Wh, and with what it draws.
    while (!(left_j() < 0.45f * 18000.0f)) {
        std::this_thread::sleep_for(10ms);
    }
    HOLDS(client.state_battery(7, 0, "ann", patience).error().code == JOULEBUS_ERROR_ARGUMENT);
}

/// Rows that the test makes as well.
void print_bits() {
    const auto model = joulebus::Predictor::open().value();
    for (std::size_t width : {11, 13}) {
        std::vector<float> features;
        for (std::size_t row = 0; row < 150; row++) {
            for (std::size_t feature = 0; feature < width; feature++) {
                features.push_back(feature < 6 ? 0.01f * static_cast<float>((row + feature) % 13)
                                               : 3.0f + 0.1f * static_cast<float>((row * feature) % 17));
            }
        }
        std::vector<float> power_w(150);
        model.predict(features, width, power_w).value();
        for (float power : power_w) {
            std::uint32_t bits = 0;
            std::memcpy(&bits, &power, sizeof bits);
            std::cout << bits << '\n';
        }
        HOLDS(model.predict(features, width + 1, power_w).error().code == JOULEBUS_ERROR_ARGUMENT);
    }
}

} // namespace

int main(int count, char **arguments) {
    if (count != 2) {
        return 2;
    }
    results();
    publishing(arguments[1]);
    frames(arguments[1]);
    kept_by_a_loop(arguments[1]);
    plans(arguments[1]);
    print_bits();
}
