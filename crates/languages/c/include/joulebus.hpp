/**
 * @file
 * libjoulebus for C++17: handles that close themselves, results instead of error codes, frames as
 * ranges in shared memory. This header is complete, and uses joulebus.h. The rules of joulebus.h
 * for threads and processes hold. docs/tutorial/cpp.md shows how to use it.
 *
 * No function throws, except Result::value() of a failed call, and the standard library's
 * containers.
 */
#ifndef JOULEBUS_HPP
#define JOULEBUS_HPP

#include <chrono>
#include <cstddef>
#include <cstdint>
#include <cstdlib>
#include <initializer_list>
#include <limits>
#include <optional>
#include <stdexcept>
#include <string>
#include <type_traits>
#include <utility>
#include <variant>
#include <vector>

#include "joulebus.h"

namespace joulebus {

/** Why a call failed. */
struct Error {
    /** The code. */
    joulebus_error code;
    /** The found value, the allowed values, and the remedy. */
    std::string message;
};

/** Thrown by Result::value(). */
class Exception : public std::runtime_error {
public:
    explicit Exception(const Error &error) : std::runtime_error(error.message), code_(error.code) {}
    /** The code. */
    joulebus_error code() const noexcept { return code_; }

private:
    joulebus_error code_;
};

/** The error of the call of this thread that failed last. */
inline Error last_error(joulebus_error code) {
    const char *text = joulebus_last_error();
    return Error{code, text == nullptr ? "" : text};
}

namespace detail {
[[noreturn]] inline void raise(const Error &error) {
#if defined(__cpp_exceptions)
    throw Exception(error);
#else
    (void)error;
    std::abort();
#endif
}
} // namespace detail

/** A value, or why there is none: a part of std::expected of C++23. */
template <class T> class [[nodiscard]] Result {
public:
    Result(T value) : found_(std::in_place_index<0>, std::move(value)) {}
    Result(Error error) : found_(std::in_place_index<1>, std::move(error)) {}

    bool has_value() const noexcept { return found_.index() == 0; }
    explicit operator bool() const noexcept { return has_value(); }

    /** The value. Throws Exception if there is none. */
    T &value() & { return check(), std::get<0>(found_); }
    const T &value() const & { return check(), std::get<0>(found_); }
    /**
     * By value: so a range that is used in the same expression, or in a loop, outlives this Result.
     */
    T value() && { return check(), std::move(std::get<0>(found_)); }

    /** The value, which must be there. */
    T &operator*() & noexcept { return *std::get_if<0>(&found_); }
    const T &operator*() const & noexcept { return *std::get_if<0>(&found_); }
    T operator*() && { return std::move(*std::get_if<0>(&found_)); }
    T *operator->() noexcept { return std::get_if<0>(&found_); }
    const T *operator->() const noexcept { return std::get_if<0>(&found_); }

    template <class U> T value_or(U &&other) && {
        return has_value() ? std::move(**this) : static_cast<T>(std::forward<U>(other));
    }

    /** The error, which must be there. */
    const Error &error() const noexcept { return *std::get_if<1>(&found_); }

private:
    void check() const {
        if (!has_value()) {
            detail::raise(error());
        }
    }
    std::variant<T, Error> found_;
};

/** Done, or why not. */
template <> class [[nodiscard]] Result<void> {
public:
    Result() = default;
    Result(Error error) : error_(std::move(error)) {}

    bool has_value() const noexcept { return !error_.has_value(); }
    explicit operator bool() const noexcept { return has_value(); }
    /** Throws Exception if the call failed. */
    void value() const {
        if (error_) {
            detail::raise(*error_);
        }
    }
    /** The error, which must be there. */
    const Error &error() const noexcept { return *error_; }

private:
    std::optional<Error> error_;
};

/** Elements that lie elsewhere: a part of std::span of C++20. */
template <class T> class Span {
public:
    using value_type = std::remove_cv_t<T>;

    constexpr Span() noexcept = default;
    constexpr Span(T *data, std::size_t size) noexcept : data_(data), size_(size) {}
    /** Of a vector, an array, or another container whose elements lie side by side. */
    template <class Container,
              class = std::enable_if_t<std::is_convertible_v<decltype(std::declval<Container &>().data()), T *>>>
    constexpr Span(Container &of) noexcept : data_(of.data()), size_(of.size()) {}

    constexpr T *data() const noexcept { return data_; }
    constexpr std::size_t size() const noexcept { return size_; }
    constexpr bool empty() const noexcept { return size_ == 0; }
    constexpr T *begin() const noexcept { return data_; }
    constexpr T *end() const noexcept { return data_ + size_; }
    constexpr T &operator[](std::size_t at) const noexcept { return data_[at]; }

private:
    T *data_ = nullptr;
    std::size_t size_ = 0;
};

namespace detail {

/** A handle of the C library, closed by its owner. */
template <class Raw, joulebus_error (*Close)(Raw *)> class Handle {
public:
    Handle() noexcept = default;
    explicit Handle(Raw *raw) noexcept : raw_(raw) {}
    Handle(Handle &&other) noexcept : raw_(std::exchange(other.raw_, nullptr)) {}
    Handle &operator=(Handle &&other) noexcept {
        if (this != &other) {
            drop();
            raw_ = std::exchange(other.raw_, nullptr);
        }
        return *this;
    }
    Handle(const Handle &) = delete;
    Handle &operator=(const Handle &) = delete;
    ~Handle() { drop(); }

    Raw *get() const noexcept { return raw_; }

    Result<void> close() {
        joulebus_error code = Close(raw_);
        if (code != JOULEBUS_ERROR_NONE) {
            return last_error(code);
        }
        raw_ = nullptr;
        return {};
    }

private:
    // In another thread or process, the library refuses this, and the handle stays open. A
    // destructor cannot report it.
    void drop() noexcept {
        if (raw_ != nullptr) {
            (void)Close(raw_);
            raw_ = nullptr;
        }
    }
    Raw *raw_ = nullptr;
};

inline std::uint64_t ns(std::chrono::nanoseconds time) noexcept {
    return time.count() < 0 ? 0 : static_cast<std::uint64_t>(time.count());
}

inline Result<void> done(joulebus_error code) {
    if (code != JOULEBUS_ERROR_NONE) {
        return last_error(code);
    }
    return {};
}

} // namespace detail

/** Time-out that never ends. */
inline constexpr std::chrono::nanoseconds forever = std::chrono::nanoseconds::max();

/** One robot in one control tick. Values that are not set are unknown. */
struct RobotState : joulebus_robot_state {
    explicit RobotState(std::uint32_t id) noexcept : joulebus_robot_state{} { robot = id; }

    /** With the command just issued: m/s and rad/s. */
    RobotState &command(float v, float omega) noexcept {
        v_mps = v, omega_radps = omega;
        return with(JOULEBUS_SAMPLE_V | JOULEBUS_SAMPLE_OMEGA);
    }
    /** With the power just measured, W. `measured` in ns on the monotonic clock, 0 for now. */
    RobotState &reading(float power, std::uint64_t measured = 0) noexcept {
        power_w = power, measured_ns = measured, flags &= ~static_cast<std::uint32_t>(JOULEBUS_SAMPLE_HELD);
        return with(JOULEBUS_SAMPLE_POWER);
    }
    /** With the previous power repeated, W: the monitor has not measured again. */
    RobotState &held_reading(float power) noexcept {
        power_w = power, measured_ns = 0;
        return with(JOULEBUS_SAMPLE_POWER | JOULEBUS_SAMPLE_HELD);
    }
    /** With the battery's voltage, V, and current, A, positive while discharging. */
    RobotState &battery(float voltage, float current) noexcept {
        voltage_v = voltage, current_a = current;
        return with(JOULEBUS_SAMPLE_VOLTAGE | JOULEBUS_SAMPLE_CURRENT);
    }
    /** With the measured state of charge, 0 to 1. */
    RobotState &state_of_charge(float share) noexcept {
        soc = share;
        return with(JOULEBUS_SAMPLE_SOC);
    }
    /** With the energy that the robot needs to return, J. */
    RobotState &return_energy(float energy) noexcept {
        return_j = energy;
        return with(JOULEBUS_SAMPLE_RETURN);
    }
    /** On its charger. */
    RobotState &charging() noexcept { return with(JOULEBUS_SAMPLE_CHARGING); }
    /** On its charger, which says that the battery is full. */
    RobotState &full() noexcept { return with(JOULEBUS_SAMPLE_CHARGING | JOULEBUS_SAMPLE_FULL); }
    /** With a battery that has been exchanged since the last frame. */
    RobotState &swapped() noexcept { return with(JOULEBUS_SAMPLE_SWAPPED); }
    /** Of a robot that is switched off: its last frame until it is switched on again. */
    RobotState &off() noexcept { return with(JOULEBUS_SAMPLE_OFF); }

private:
    RobotState &with(std::uint32_t bits) noexcept {
        flags |= bits;
        return *this;
    }
};
static_assert(sizeof(RobotState) == sizeof(joulebus_robot_state), "an array of one is an array of the other");

/** A source of samples. Belongs to one thread. */
class Publisher {
public:
    /** Joins the fleet of a config file. The worker need not run. */
    static Result<Publisher> open(const std::string &config_path, const std::string &source_name) {
        joulebus_publisher *raw = nullptr;
        auto code = joulebus_publisher_open(JOULEBUS_HEADER, config_path.c_str(), source_name.c_str(), &raw);
        if (code != JOULEBUS_ERROR_NONE) {
            return last_error(code);
        }
        return Publisher(raw);
    }

    /**
     * Sends one frame: each robot at most once. `intended_ns`: when it was due, monotonic. 0 for
     * now.
     */
    Result<joulebus_sent> publish(Span<const RobotState> robots, std::uint64_t intended_ns = 0) {
        joulebus_sent sent{};
        auto code = joulebus_publisher_publish(handle_.get(), robots.data(), robots.size(), intended_ns, &sent);
        if (code != JOULEBUS_ERROR_NONE) {
            return last_error(code);
        }
        return sent;
    }
    Result<joulebus_sent> publish(std::initializer_list<RobotState> robots, std::uint64_t intended_ns = 0) {
        return publish(Span<const RobotState>(robots.begin(), robots.size()), intended_ns);
    }

    /** Samples with numbers and stamps of their own, for recordings and simulations. */
    Result<joulebus_sent> publish_samples(Span<const joulebus_sample> samples, std::uint64_t intended_ns = 0) {
        joulebus_sent sent{};
        auto code =
            joulebus_publisher_publish_samples(handle_.get(), samples.data(), samples.size(), intended_ns, &sent);
        if (code != JOULEBUS_ERROR_NONE) {
            return last_error(code);
        }
        return sent;
    }

    Result<joulebus_publisher_counts> counts() const {
        joulebus_publisher_counts counts{};
        auto code = joulebus_publisher_get_counts(handle_.get(), &counts);
        if (code != JOULEBUS_ERROR_NONE) {
            return last_error(code);
        }
        return counts;
    }

    /** Samples of this run that the worker refuses, with reason and remedy. Its `count` is 0 if none is. */
    Result<joulebus_not_taken> not_taken() const {
        joulebus_not_taken not_taken{};
        auto code = joulebus_publisher_get_not_taken(handle_.get(), &not_taken);
        if (code != JOULEBUS_ERROR_NONE) {
            return last_error(code);
        }
        return not_taken;
    }

    /**
     * Leaves the fleet, and returns an error if that is refused. The destructor does the same, and
     * cannot return one.
     */
    Result<void> close() { return handle_.close(); }
    /** For calls of joulebus.h. */
    joulebus_publisher *get() const noexcept { return handle_.get(); }

private:
    explicit Publisher(joulebus_publisher *raw) noexcept : handle_(raw) {}
    detail::Handle<joulebus_publisher, joulebus_publisher_close> handle_;
};

/** Power expected, W, if there is a forecast. */
inline std::optional<float> expected_w(const joulebus_forecast &row) noexcept {
    if ((row.flags & JOULEBUS_FORECAST_POWER) == 0) {
        return std::nullopt;
    }
    return row.power_w;
}
/** Lower and upper end of the interval, W, if there is one. */
inline std::optional<std::pair<float, float>> interval_w(const joulebus_forecast &row) noexcept {
    if ((row.flags & JOULEBUS_FORECAST_INTERVAL) == 0) {
        return std::nullopt;
    }
    return std::make_pair(row.lo_w, row.hi_w);
}

/**
 * A frame in shared memory: a range of rows, valid until the next read, or as long as it is kept.
 */
template <class Raw, class Header, class Row> class Frame {
public:
    explicit Frame(const Raw &raw) noexcept : raw_(raw) {}

    const Header &header() const noexcept { return *raw_.header; }
    std::size_t size() const noexcept { return raw_.count; }
    const Row *begin() const noexcept { return raw_.robots; }
    const Row *end() const noexcept { return raw_.robots + raw_.count; }
    const Row &operator[](std::size_t at) const noexcept { return raw_.robots[at]; }
    Span<const Row> rows() const noexcept { return {raw_.robots, raw_.count}; }

    /** One robot, by a search of the rows. nullptr if it is not there. */
    const Row *find(std::uint32_t robot) const noexcept {
        for (const Row &row : *this) {
            if (row.robot == robot) {
                return &row;
            }
        }
        return nullptr;
    }
    const Raw &raw() const noexcept { return raw_; }

private:
    Raw raw_;
};

using Forecasts = Frame<joulebus_forecasts, joulebus_forecast_header, joulebus_forecast>;
using Diagnostics = Frame<joulebus_diagnostics, joulebus_diagnostic_header, joulebus_diagnostic>;
using Budgets = Frame<joulebus_budgets, joulebus_budget_header, joulebus_budget>;
using Outlooks = Frame<joulebus_outlooks, joulebus_outlook_header, joulebus_outlook>;

/** The worker has ended. The event comes once. */
struct Gone {
    joulebus_end end;
};
/** The newest frame is older than two tick periods. The event comes once. */
struct Stale {
    std::chrono::nanoseconds age;
};
/** A signal arrived. */
struct Interrupted {};
/** Nothing happened in the time. */
struct TimedOut {};
/** An event of a subscriber. */
using Event = std::variant<TimedOut, Forecasts, Gone, Stale, Interrupted>;

/** A frame of forecasts that stays valid as long as this, which is a range of rows as Forecasts is.
 *  Its rows stay as they are, also after the subscriber is closed, which then keeps its place
 *  (readers.max_planners) until this is closed. Belongs to its planner's thread. Its rows cannot be
 *  taken from a temporary one, which gives the frame back at once. */
class KeptForecasts {
public:
    KeptForecasts(joulebus_frame *raw, const joulebus_forecasts &frame) noexcept : handle_(raw), frame_(frame) {}

    const joulebus_forecast_header &header() const & noexcept { return frame_.header(); }
    const joulebus_forecast_header &header() const && = delete;
    std::size_t size() const noexcept { return frame_.size(); }
    const joulebus_forecast *begin() const & noexcept { return frame_.begin(); }
    const joulebus_forecast *begin() const && = delete;
    const joulebus_forecast *end() const & noexcept { return frame_.end(); }
    const joulebus_forecast *end() const && = delete;
    const joulebus_forecast &operator[](std::size_t at) const & noexcept { return frame_[at]; }
    const joulebus_forecast &operator[](std::size_t at) const && = delete;
    Span<const joulebus_forecast> rows() const & noexcept { return frame_.rows(); }
    Span<const joulebus_forecast> rows() const && = delete;
    /** One robot, by a search of the rows. nullptr if it is not there. */
    const joulebus_forecast *find(std::uint32_t robot) const & noexcept { return frame_.find(robot); }
    const joulebus_forecast *find(std::uint32_t robot) const && = delete;

    /** Returns the frame to the worker. Afterwards this has no rows, and a header of zeros. */
    Result<void> close() {
        static const joulebus_forecast_header none{};
        auto closed = handle_.close();
        if (closed) {
            joulebus_forecasts empty{};
            empty.header = &none;
            frame_ = Forecasts(empty);
        }
        return closed;
    }

private:
    detail::Handle<joulebus_frame, joulebus_frame_close> handle_;
    Forecasts frame_;
};

/** A descriptor that is readable when Subscriber::wait is likely to have something to return, and
 *  how long to wait for it before wait is called anyway. The descriptor is the subscriber's. */
struct Readiness {
    int descriptor;
    std::chrono::nanoseconds look_within;
};

/** A reader of forecasts, diagnostics, budgets and outlooks. Belongs to one thread. */
class Subscriber {
public:
    /** Joins the fleet of a config file. The worker need not run. */
    static Result<Subscriber> open(const std::string &config_path, const std::string &name = "planner") {
        joulebus_subscriber *raw = nullptr;
        auto code = joulebus_subscriber_open(JOULEBUS_HEADER, config_path.c_str(), name.c_str(), &raw);
        if (code != JOULEBUS_ERROR_NONE) {
            return last_error(code);
        }
        return Subscriber(raw);
    }

    /** The next event. A frame is valid until the next wait, latest or close. */
    Result<Event> wait(std::chrono::nanoseconds timeout) {
        joulebus_event event{};
        auto ns = timeout == forever ? std::numeric_limits<std::uint64_t>::max() : detail::ns(timeout);
        auto code = joulebus_subscriber_wait(handle_.get(), ns, &event);
        if (code != JOULEBUS_ERROR_NONE) {
            return last_error(code);
        }
        switch (event.kind) {
        case JOULEBUS_EVENT_KIND_FRAME:
            return Event(Forecasts(event.frame));
        case JOULEBUS_EVENT_KIND_GONE:
            return Event(Gone{event.end});
        case JOULEBUS_EVENT_KIND_STALE:
            return Event(Stale{std::chrono::nanoseconds(event.age_ns)});
        case JOULEBUS_EVENT_KIND_INTERRUPTED:
            return Event(Interrupted{});
        default:
            return Event(TimedOut{});
        }
    }

    /** What an event loop waits for: joulebus_subscriber_readiness says how. */
    Result<Readiness> readiness() {
        std::int32_t descriptor = -1;
        std::uint64_t look_within_ns = 0;
        auto code = joulebus_subscriber_readiness(handle_.get(), &descriptor, &look_within_ns);
        if (code != JOULEBUS_ERROR_NONE) {
            return last_error(code);
        }
        return Readiness{descriptor, std::chrono::nanoseconds(look_within_ns)};
    }

    /** The newest frame, if one has arrived, without waiting. */
    Result<std::optional<Forecasts>> latest() {
        joulebus_forecasts frame{};
        auto code = joulebus_subscriber_latest(handle_.get(), &frame);
        return read<Forecasts>(code, frame);
    }

    /**
     * One robot of the frame that was returned last, in constant time. nullptr if it is not there.
     */
    Result<const joulebus_forecast *> robot(std::uint32_t id) {
        const joulebus_forecast *row = nullptr;
        auto code = joulebus_subscriber_robot(handle_.get(), id, &row);
        if (code != JOULEBUS_ERROR_NONE) {
            return last_error(code);
        }
        return row;
    }

    /** Takes the frame that was returned last out of the subscriber. Then there is no current frame
     *  until a newer one arrives. Two frames may be kept. */
    Result<KeptForecasts> take_current() {
        joulebus_frame *raw = nullptr;
        joulebus_forecasts frame{};
        auto code = joulebus_subscriber_take_current(handle_.get(), &raw, &frame);
        if (code != JOULEBUS_ERROR_NONE) {
            return last_error(code);
        }
        return KeptForecasts(raw, frame);
    }

    /** The newest diagnostics, if any has arrived. Valid until the next call. */
    Result<std::optional<Diagnostics>> diagnostics() {
        joulebus_diagnostics frame{};
        auto code = joulebus_subscriber_diagnostics(handle_.get(), &frame);
        return read<Diagnostics>(code, frame);
    }

    /** The newest budgets, if any have arrived. Valid until the next call. */
    Result<std::optional<Budgets>> budgets() {
        joulebus_budgets frame{};
        auto code = joulebus_subscriber_budgets(handle_.get(), &frame);
        return read<Budgets>(code, frame);
    }

    /** The newest outlooks, if any have arrived. Valid until the next call. The worker computes
     *  them from the first call on. */
    Result<std::optional<Outlooks>> outlooks() {
        joulebus_outlooks frame{};
        auto code = joulebus_subscriber_outlooks(handle_.get(), &frame);
        return read<Outlooks>(code, frame);
    }

    Result<joulebus_subscriber_status> status() const {
        joulebus_subscriber_status status{};
        auto code = joulebus_subscriber_get_status(handle_.get(), &status);
        if (code != JOULEBUS_ERROR_NONE) {
            return last_error(code);
        }
        return status;
    }

    Result<void> close() { return handle_.close(); }
    joulebus_subscriber *get() const noexcept { return handle_.get(); }

private:
    explicit Subscriber(joulebus_subscriber *raw) noexcept : handle_(raw) {}

    template <class Of, class Raw> static Result<std::optional<Of>> read(joulebus_error code, const Raw &raw) {
        if (code != JOULEBUS_ERROR_NONE) {
            return last_error(code);
        }
        return raw.header == nullptr ? std::optional<Of>() : std::optional<Of>(Of(raw));
    }

    detail::Handle<joulebus_subscriber, joulebus_subscriber_close> handle_;
};

/** Whether a robot's battery suffices for a plan, without its reserve. */
enum class Verdict : std::uint16_t { yes = 1, tight = 2, no = 3, unknown = 4 };

/** The answer to one candidate, or of one robot. */
struct Answer : joulebus_answer_row {
    Answer() noexcept : joulebus_answer_row{} {}

    Verdict kind() const noexcept { return static_cast<Verdict>(verdict); }
    /** True if an alarm casts doubt on the robot's readings: `flags` has its JOULEBUS_ANSWER_ALARM bit. */
    bool is_doubted() const noexcept {
        return (flags & (JOULEBUS_ANSWER_ALARM_NO_DATA | JOULEBUS_ANSWER_ALARM_OUT_OF_RANGE | JOULEBUS_ANSWER_ALARM_STUCK_SENSOR
                         | JOULEBUS_ANSWER_ALARM_HELD_TOO_LONG | JOULEBUS_ANSWER_ALARM_SOC_IMPLAUSIBLE
                         | JOULEBUS_ANSWER_ALARM_IMPLAUSIBLE)) != 0;
    }
    /** Energy expected, J. */
    std::optional<float> energy_j() const noexcept { return known(JOULEBUS_ANSWER_ENERGY, mean_j); }
    /** Upper end of the energy at the asked coverage, J. */
    std::optional<float> energy_hi_j() const noexcept { return known(JOULEBUS_ANSWER_ENERGY, hi_j); }
    /** A bound: that of the energy above the reserve from below, less the upper end of the energy, J. */
    std::optional<float> spare_j() const noexcept { return known(JOULEBUS_ANSWER_MARGIN, margin_j); }
    /** Latest time to turn back, s. A yes has none: the robot can drive the whole path. */
    std::optional<float> turn_back() const noexcept { return known(JOULEBUS_ANSWER_TURN_BACK, turn_back_s); }

private:
    std::optional<float> known(unsigned flag, float value) const noexcept {
        return (flags & flag) == 0 ? std::nullopt : std::optional<float>(value);
    }
};
static_assert(sizeof(Answer) == sizeof(joulebus_answer_row), "an array of one is an array of the other");

/**
 * Sequences of commands of one robot, which lie elsewhere: candidate by candidate, step by step.
 */
struct Candidates {
    std::size_t count;
    std::size_t steps;
    /** Time that each command is in force, s. */
    float period_s;
    /** count * steps linear velocities, m/s. */
    Span<const float> v_mps;
    /** As many angular velocities, rad/s. */
    Span<const float> omega_radps;
};

/** A question about plans, with the robots, path or commands that it asks about. */
class Question {
public:
    /** Robots that stand still, s. */
    static Question idle(std::vector<std::uint32_t> robots, float duration_s) {
        Question made(JOULEBUS_QUERY_KIND_IDLE, std::move(robots));
        made.asked_.duration_s = duration_s;
        return made;
    }
    /** Robots that follow a path from where they are. The answers list the best robot first. */
    static Question follow(std::vector<std::uint32_t> robots, std::vector<joulebus_waypoint> path) {
        Question made(JOULEBUS_QUERY_KIND_FOLLOW, std::move(robots));
        made.path_ = std::move(path);
        return made;
    }
    /** One robot, each of several sequences of commands, which are copied. */
    static Question what_if(std::uint32_t robot, const Candidates &candidates) {
        Question made(JOULEBUS_QUERY_KIND_WHAT_IF, {robot});
        made.asked_.candidates = candidates.count;
        made.asked_.steps = candidates.steps;
        made.asked_.period_s = candidates.period_s;
        made.v_mps_.assign(candidates.v_mps.begin(), candidates.v_mps.end());
        made.omega_radps_.assign(candidates.omega_radps.begin(), candidates.omega_radps.end());
        return made;
    }

    /** Returns to a point after the path, m. */
    Question &back_to(double x_m, double y_m) & {
        asked_.flags |= JOULEBUS_QUERY_RETURN;
        asked_.return_x_m = x_m, asked_.return_y_m = y_m;
        return *this;
    }
    Question &&back_to(double x_m, double y_m) && { return std::move(back_to(x_m, y_m)); }
    /** Heading at the first point, rad, counter-clockwise from east. */
    Question &heading(double rad) & {
        asked_.flags |= JOULEBUS_QUERY_HEADING;
        asked_.heading_rad = rad;
        return *this;
    }
    Question &&heading(double rad) && { return std::move(heading(rad)); }
    /** Time that the robot waits at each point of the path, s. */
    Question &dwell(std::vector<double> s) & {
        dwell_s_ = std::move(s);
        return *this;
    }
    Question &&dwell(std::vector<double> s) && { return std::move(dwell(std::move(s))); }
    /** Power that the robot draws in addition on the way to each point and while it waits there, W. */
    Question &load(std::vector<double> w) & {
        load_w_ = std::move(w);
        return *this;
    }
    Question &&load(std::vector<double> w) && { return std::move(load(std::move(w))); }
    /** When the robot is at each point, s, from the first. Speeds are then upper limits. */
    Question &times(std::vector<double> s) & {
        time_s_ = std::move(s);
        return *this;
    }
    Question &&times(std::vector<double> s) && { return std::move(times(std::move(s))); }
    /** Cuts corners within a distance of the path, m. Without it, the stairs of a grid within half a cell. */
    Question &tolerance(float m) & {
        asked_.flags |= JOULEBUS_QUERY_TOLERANCE;
        asked_.tolerance_m = m;
        return *this;
    }
    Question &&tolerance(float m) && { return std::move(tolerance(m)); }
    /** For one robot: also answers the parts of the plan up to evenly spaced moments, after the whole. */
    Question &moments(std::size_t count) & {
        moments_ = count;
        return *this;
    }
    Question &&moments(std::size_t count) && { return std::move(moments(count)); }
    /** Coverage of the intervals, 0.5 to 0.999. The default is 0.9. */
    Question &coverage(float share) & {
        asked_.coverage = share;
        return *this;
    }
    Question &&coverage(float share) && { return std::move(coverage(share)); }
    /** The power of every step is wanted: of candidates, or of one robot that follows a path. */
    Question &power() & {
        power_ = true;
        return *this;
    }
    Question &&power() && { return std::move(power()); }

    bool wants_power() const noexcept { return power_; }

    /**
     * The struct of C. It is valid until this question changes. It is empty if there are too few
     * commands, or a column has not one value for each point.
     */
    std::optional<joulebus_question> raw() const noexcept {
        joulebus_question raw = asked_;
        const std::size_t steps = raw.steps;
        if (v_mps_.size() != omega_radps_.size() || (steps == 0 ? 0 : v_mps_.size() / steps) != raw.candidates ||
            (steps != 0 && v_mps_.size() % steps != 0)) {
            return std::nullopt;
        }
        for (const auto *column : {&dwell_s_, &load_w_, &time_s_}) {
            if (!column->empty() && column->size() != path_.size()) {
                return std::nullopt;
            }
        }
        const auto given = [](const std::vector<double> &column) { return column.empty() ? nullptr : column.data(); };
        raw.dwell_s = given(dwell_s_), raw.load_w = given(load_w_), raw.time_s = given(time_s_);
        if (raw.kind != JOULEBUS_QUERY_KIND_WHAT_IF) {
            raw.candidates = moments_;
        }
        raw.robots = robots_.data(), raw.robot_count = robots_.size();
        raw.v_mps = v_mps_.data(), raw.omega_radps = omega_radps_.data();
        raw.path = path_.data(), raw.points = path_.size();
        return raw;
    }

private:
    Question(std::uint32_t kind, std::vector<std::uint32_t> robots) : robots_(std::move(robots)) {
        asked_.kind = kind;
        asked_.coverage = 0.9f;
    }

    joulebus_question asked_{};
    std::vector<std::uint32_t> robots_;
    std::vector<float> v_mps_;
    std::vector<float> omega_radps_;
    std::vector<joulebus_waypoint> path_;
    std::vector<double> dwell_s_;
    std::vector<double> load_w_;
    std::vector<double> time_s_;
    std::size_t moments_ = 0;
    bool power_ = false;
};

/** The answers to a question. */
struct Answers {
    /** Of each candidate, or of each robot. */
    std::vector<Answer> rows;
    /** Power of every step, W, candidate by candidate, if asked for. */
    std::vector<float> power_w;
    /** Tick of the frame that they are computed from. */
    std::uint64_t tick = 0;
    /** Its age then. */
    std::chrono::nanoseconds age{};
    /** From asking the worker to its answer. 0 where this process computes. */
    std::chrono::nanoseconds took{};
};

namespace detail {

/**
 * Asks with memory for the answers. If the number of powers is not known before, it asks once more
 * with enough memory.
 */
template <class Ask> Result<Answers> answered(const Question &question, Ask ask) {
    auto raw = question.raw();
    if (!raw) {
        return Error{JOULEBUS_ERROR_ARGUMENT, "v_mps and omega_radps must have candidates * steps values each, "
                                              "and dwell, load and times none or one for each point"};
    }
    const bool what_if = raw->kind == JOULEBUS_QUERY_KIND_WHAT_IF;
    std::size_t powers = !question.wants_power() ? 0 : what_if ? raw->candidates * raw->steps : JOULEBUS_MAX_QUERY_STEPS;
    for (;;) {
        Answers answers;
        const std::size_t moments = raw->candidates < JOULEBUS_MAX_QUERY_CANDIDATES ? raw->candidates : JOULEBUS_MAX_QUERY_CANDIDATES;
        answers.rows.resize(what_if ? raw->candidates : raw->robot_count == 1 ? 1 + moments : raw->robot_count);
        answers.power_w.resize(powers);
        joulebus_answers to{};
        to.rows = answers.rows.data();
        to.row_capacity = answers.rows.size();
        to.power_w = powers == 0 ? nullptr : answers.power_w.data();
        to.power_capacity = powers;
        joulebus_error code = ask(&*raw, &to);
        if (code != JOULEBUS_ERROR_NONE) {
            return last_error(code);
        }
        if (to.power_count > powers) {
            powers = to.power_count;
            continue;
        }
        answers.rows.resize(to.row_count);
        answers.power_w.resize(to.power_count);
        answers.tick = to.tick;
        answers.age = std::chrono::nanoseconds(to.age_ns);
        answers.took = std::chrono::nanoseconds(to.took_ns);
        return answers;
    }
}

} // namespace detail

/** Answers about the cost of plans, computed in this process. Belongs to one thread. */
class Questions {
public:
    /** Joins the fleet of a config file, and loads its models. */
    static Result<Questions> open(const std::string &config_path, const std::string &name = "planner") {
        joulebus_questions *raw = nullptr;
        auto code = joulebus_questions_open(JOULEBUS_HEADER, config_path.c_str(), name.c_str(), &raw);
        if (code != JOULEBUS_ERROR_NONE) {
            return last_error(code);
        }
        return Questions(raw);
    }

    /** Waits for a frame that is at most two ticks old. Returns the age of the newest. */
    Result<std::chrono::nanoseconds> wait(std::chrono::nanoseconds timeout) {
        std::uint64_t tick = 0, age_ns = 0;
        auto code = joulebus_questions_wait(handle_.get(), detail::ns(timeout), &tick, &age_ns);
        if (code != JOULEBUS_ERROR_NONE) {
            return last_error(code);
        }
        return std::chrono::nanoseconds(age_ns);
    }

    /** The platform of a robot. */
    Result<joulebus_platform> platform(std::uint32_t robot) {
        joulebus_platform platform{};
        auto code = joulebus_questions_platform(handle_.get(), robot, &platform);
        if (code != JOULEBUS_ERROR_NONE) {
            return last_error(code);
        }
        return platform;
    }

    /**
     * The answer to each candidate, into memory of the caller. `power_w`: the power of every step,
     * or nothing.
     */
    Result<void> what_if(std::uint32_t robot, const Candidates &candidates, float coverage, Span<Answer> answers,
                         Span<float> power_w = {}) {
        const std::size_t steps = candidates.steps;
        const bool fits = candidates.v_mps.size() == candidates.omega_radps.size() && steps != 0 &&
                          candidates.v_mps.size() / steps == candidates.count && candidates.v_mps.size() % steps == 0 &&
                          answers.size() == candidates.count &&
                          (power_w.empty() || power_w.size() == candidates.v_mps.size());
        if (!fits) {
            return Error{JOULEBUS_ERROR_ARGUMENT, "v_mps, omega_radps and power_w must have count * steps values, "
                                                  "and answers count places"};
        }
        return detail::done(joulebus_questions_what_if(
            handle_.get(), robot, candidates.count, steps, candidates.period_s, candidates.v_mps.data(),
            candidates.omega_radps.data(), coverage, answers.data(), power_w.empty() ? nullptr : power_w.data()));
    }

    /** The answers to a question. */
    Result<Answers> ask(const Question &question) {
        return detail::answered(question, [this](const joulebus_question *asked, joulebus_answers *to) {
            return joulebus_questions_ask(handle_.get(), asked, to);
        });
    }

    Result<void> close() { return handle_.close(); }
    joulebus_questions *get() const noexcept { return handle_.get(); }

private:
    explicit Questions(joulebus_questions *raw) noexcept : handle_(raw) {}
    detail::Handle<joulebus_questions, joulebus_questions_close> handle_;
};

/** Asks the worker what plans cost, for programs that do not compute. Belongs to one thread. */
class Client {
public:
    static Result<Client> open(const std::string &config_path, const std::string &name = "client") {
        joulebus_client *raw = nullptr;
        auto code = joulebus_client_open(JOULEBUS_HEADER, config_path.c_str(), name.c_str(), &raw);
        if (code != JOULEBUS_ERROR_NONE) {
            return last_error(code);
        }
        return Client(raw);
    }

    /** The worker's answers. */
    Result<Answers> ask(const Question &question, std::chrono::nanoseconds timeout) {
        return detail::answered(question, [&](const joulebus_question *asked, joulebus_answers *to) {
            return joulebus_client_ask(handle_.get(), asked, detail::ns(timeout), to);
        });
    }

    /**
     * States a robot's battery in the name of a person. `statement`: JOULEBUS_SAMPLE_SOC (with the
     * state of charge that was measured), _FULL or _SWAPPED.
     */
    Result<void> state_battery(std::uint32_t robot, std::uint32_t statement, const std::string &by,
                               std::chrono::nanoseconds timeout, float soc = 0.0f) {
        auto code = joulebus_client_state_battery(handle_.get(), robot, statement, soc, by.c_str(), detail::ns(timeout));
        return detail::done(code);
    }

    Result<void> close() { return handle_.close(); }
    joulebus_client *get() const noexcept { return handle_.get(); }

private:
    explicit Client(joulebus_client *raw) noexcept : handle_(raw) {}
    detail::Handle<joulebus_client, joulebus_client_close> handle_;
};

/** A network. Any thread may use it, also several at once. */
class Predictor {
public:
    /** A model file, or "builtin:NAME". */
    static Result<Predictor> open(const std::string &model = "builtin:gternal-sim") {
        joulebus_predictor *raw = nullptr;
        auto code = joulebus_predictor_open(JOULEBUS_HEADER, model.c_str(), &raw);
        if (code != JOULEBUS_ERROR_NONE) {
            return last_error(code);
        }
        return Predictor(raw);
    }

    /**
     * Forecasts of rows of `width` features, 11 or 13, in W. `power_w` has one element for each
     * row.
     */
    Result<void> predict(Span<const float> features, std::size_t width, Span<float> power_w) const {
        const bool fits = width != 0 && features.size() % width == 0 && features.size() / width == power_w.size();
        if (!fits) {
            return Error{JOULEBUS_ERROR_ARGUMENT, "features must have width values for each place of power_w"};
        }
        return detail::done(
            joulebus_predictor_predict(handle_.get(), features.data(), power_w.size(), width, power_w.data()));
    }

    /** Energies, J, and powers of every step, W, of command sequences. */
    Result<void> rollout(const joulebus_rollout &rollout, Span<float> energy_j, Span<float> power_w = {}) const {
        const std::size_t lanes = rollout.robots * rollout.candidates;
        if (energy_j.size() != lanes || (!power_w.empty() && power_w.size() != lanes * rollout.steps)) {
            return Error{JOULEBUS_ERROR_ARGUMENT, "energy_j must have robots * candidates places, power_w steps times "
                                                  "as many or none"};
        }
        return detail::done(joulebus_predictor_rollout(handle_.get(), &rollout, energy_j.data(),
                                                       power_w.empty() ? nullptr : power_w.data()));
    }

    /** Equal for equal models. */
    Result<std::uint64_t> hash() const {
        std::uint64_t hash = 0;
        auto code = joulebus_predictor_hash(handle_.get(), &hash);
        if (code != JOULEBUS_ERROR_NONE) {
            return last_error(code);
        }
        return hash;
    }

    Result<void> close() { return handle_.close(); }
    joulebus_predictor *get() const noexcept { return handle_.get(); }

private:
    explicit Predictor(joulebus_predictor *raw) noexcept : handle_(raw) {}
    detail::Handle<joulebus_predictor, joulebus_predictor_close> handle_;
};

} // namespace joulebus

#endif
