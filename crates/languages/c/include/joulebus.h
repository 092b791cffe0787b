/**
 * @file
 * libjoulebus: publisher, subscriber, questions about plans and predictor of joulebus, a
 * shared-memory energy broker for robot fleets. docs/tutorial/cpp.md introduces it. joulebus.hpp is
 * a layer above for C++17.
 *
 * This file is made from the sources of joulebus-c and joulebus-wire: cargo test -p joulebus-c
 * --test all layouts.
 *
 * Errors. Calls return a joulebus_error. joulebus_last_error() has the message. After an error a
 * call has written no results, unless its comment says otherwise. No call aborts the program
 * because of its arguments or of what it reads.
 *
 * Threads. A publisher, subscriber, frame, questions or client belongs to the thread that opened
 * it. A call by another thread is refused (JOULEBUS_ERROR_THREAD), also one that closes it. Each
 * thread may open its own. A predictor may be used by any thread. A signal handler must make no
 * call. If it does, the call that it interrupted is not disturbed. The handler's calls on the same
 * handle are refused.
 *
 * Processes. In a child made by fork, handles of the parent are refused (JOULEBUS_ERROR_PROCESS).
 * The parent's memory is not disturbed. Open other handles in the child. Handles of a process may
 * be of several fleets.
 *
 * Handles are numbers in the shape of pointers. A handle that is closed, NULL or invalid is
 * refused. Closing twice is an error and nothing else. A handle that is open when its thread ends
 * stays open until the process ends. Other members of the fleet then remove what is left.
 *
 * The caller promises that every pointer that is not NULL points to as many elements as the call
 * says, aligned, in memory that no other thread changes meanwhile. NULL is allowed where a comment
 * says so, and for arrays without elements. Texts are UTF-8 and end with a zero. Do not write to
 * what a call returns in shared memory. You may read it until the time that the call states.
 *
 * Units: W, J, s, m, rad, V, A, ns. Times are of the host's monotonic clock
 * (joulebus_monotonic_ns()). Unknown values have their flag cleared, and are NaN.
 */

#ifndef JOULEBUS_H
#define JOULEBUS_H

#include <stddef.h>
#include <stdint.h>

/** The release of this header. */
#define JOULEBUS_VERSION "0.1.0"

/** Checked when a handle is opened: header and library must be of one release. */
#define JOULEBUS_HEADER "0.1.0, schema 4"

/** v_mps is known. */
#define JOULEBUS_SAMPLE_V 0x1u
/** omega_radps is known. */
#define JOULEBUS_SAMPLE_OMEGA 0x2u
/** power_w and measured_ns are known. */
#define JOULEBUS_SAMPLE_POWER 0x4u
/** voltage_v is known. */
#define JOULEBUS_SAMPLE_VOLTAGE 0x8u
/** current_a is known. */
#define JOULEBUS_SAMPLE_CURRENT 0x10u
/** The reading repeats the previous one: the monitor has not measured again. */
#define JOULEBUS_SAMPLE_HELD 0x20u
/** The robot is on its charger. */
#define JOULEBUS_SAMPLE_CHARGING 0x40u
/**
 * The sample does not continue the ones before it (a recorded trial starts again): the lag window
 * starts empty.
 */
#define JOULEBUS_SAMPLE_DISCONTINUITY 0x80u
/** soc is known. */
#define JOULEBUS_SAMPLE_SOC 0x100u
/**
 * The charger or the battery's own electronics says that the battery is full. Only with CHARGING.
 */
#define JOULEBUS_SAMPLE_FULL 0x200u
/** The battery has been exchanged since the last sample. */
#define JOULEBUS_SAMPLE_SWAPPED 0x400u
/** return_j is known. */
#define JOULEBUS_SAMPLE_RETURN 0x800u
/**
 * The robot is switched off: until its next sample it draws what it draws at rest. Without it a
 * silence costs the platform's greatest power.
 */
#define JOULEBUS_SAMPLE_OFF 0x1000u
/**
 * The source finds what the robot reports implausible: the alarm Implausible. From this bit on
 * flags are the source's judgement.
 */
#define JOULEBUS_SAMPLE_IMPLAUSIBLE 0x10000u
/** All defined bits. */
#define JOULEBUS_SAMPLE_ALL 0x11fffu

/** power_w is known. */
#define JOULEBUS_FORECAST_POWER 0x1u
/** lo_w and hi_w are known. */
#define JOULEBUS_FORECAST_INTERVAL 0x2u
/** reading_w and reading_age_ns are known. */
#define JOULEBUS_FORECAST_READING 0x4u
/** sample_seq, stamp_ns and target_ns are known: a sample has been accepted. */
#define JOULEBUS_FORECAST_SAMPLE 0x8u

/** residual_w and residual_z belong to the sample sample_seq. Otherwise they are NaN. */
#define JOULEBUS_DIAGNOSTIC_RESIDUAL 0x1u
/** At least one residual has been scored. */
#define JOULEBUS_DIAGNOSTIC_SCORES 0x2u
/**
 * The forecast learns online: the fields from network_w to level_w are known. Otherwise they are
 * NaN.
 */
#define JOULEBUS_DIAGNOSTIC_LEARNED 0x4u

/** The platform's config describes a battery. */
#define JOULEBUS_BUDGET_BATTERY 0x1u
/** Time to empty is known. */
#define JOULEBUS_BUDGET_TIME_TO_EMPTY 0x2u
/** The ledger holds at least one sample. */
#define JOULEBUS_BUDGET_LEDGER 0x4u
/** The robot has been on its charger since the ledger began. */
#define JOULEBUS_BUDGET_CHARGED 0x8u
/** The state of charge contains a measured one. */
#define JOULEBUS_BUDGET_MEASURED 0x10u
/**
 * A measured state of charge says that less is left than was counted, and is not believed yet: the
 * battery may be another one, and the bounds need not hold.
 */
#define JOULEBUS_BUDGET_CONTRADICTED 0x20u
/**
 * Energy left, usable and state of charge are known, with their bounds. Without it they are NaN:
 * the battery may be full or empty.
 */
#define JOULEBUS_BUDGET_CHARGE 0x40u
/** The robot has said that it is switched off: until its next sample it draws idle_w. */
#define JOULEBUS_BUDGET_OFF 0x80u

/** A sample has been accepted: stamp_ns is known. */
#define JOULEBUS_OUTLOOK_SAMPLE 0x1u
/** mean_w and energy_j are known. */
#define JOULEBUS_OUTLOOK_ENERGY 0x2u
/** Time to empty is known. */
#define JOULEBUS_OUTLOOK_TIME_TO_EMPTY 0x4u
/** The last row of the model lay outside the range that it was trained on. */
#define JOULEBUS_OUTLOOK_OUTSIDE_TRAINING 0x8u
/** Bounds of the longest horizons are extrapolated beyond those whose errors are known. */
#define JOULEBUS_OUTLOOK_EXTRAPOLATED 0x10u

/** A sample has been accepted: stamp_ns is known. */
#define JOULEBUS_PLAN_STATE_SAMPLE 0x1u
/** The lag window is full: all five lag_w are known. */
#define JOULEBUS_PLAN_STATE_LAGS 0x2u
/** v_mps and omega_radps are known. */
#define JOULEBUS_PLAN_STATE_COMMAND 0x4u
/** age_steps and interval_steps are known. */
#define JOULEBUS_PLAN_STATE_READING_AGE 0x8u
/** The robot's forecasts learn online: the fields from network_w to level_w are known. */
#define JOULEBUS_PLAN_STATE_LEARNED 0x10u
/** The last row of the model lay outside the range that it was trained on. */
#define JOULEBUS_PLAN_STATE_OUTSIDE_TRAINING 0x20u
/** The alarm NoData is raised: no sample for too long. */
#define JOULEBUS_PLAN_STATE_ALARM_NO_DATA 0x40u
/** The alarm OutOfRange is raised: samples are refused. */
#define JOULEBUS_PLAN_STATE_ALARM_OUT_OF_RANGE 0x80u
/** The alarm StuckSensor is raised: the reading does not change. */
#define JOULEBUS_PLAN_STATE_ALARM_STUCK_SENSOR 0x100u
/** The alarm HeldTooLong is raised: the same measurement is repeated. */
#define JOULEBUS_PLAN_STATE_ALARM_HELD_TOO_LONG 0x200u
/** The alarm SocImplausible is raised: the measured state of charge is not used. */
#define JOULEBUS_PLAN_STATE_ALARM_SOC_IMPLAUSIBLE 0x400u
/** The alarm Implausible is raised: the source doubts what it reports. */
#define JOULEBUS_PLAN_STATE_ALARM_IMPLAUSIBLE 0x800u

/** The model states what the robots of its training drew. */
#define JOULEBUS_PLATFORM_TRAINED 0x1u
/** It also states what commands cost. */
#define JOULEBUS_PLATFORM_COMMANDS 0x2u
/** The next robot starts from its last reading, not from the model's forecast. */
#define JOULEBUS_PLATFORM_FROM_LAST 0x4u

/** After the path, return to return_x_m, return_y_m. */
#define JOULEBUS_QUERY_RETURN 0x1u
/** heading_rad is the heading at the first point. Without it, towards the second. */
#define JOULEBUS_QUERY_HEADING 0x2u
/** One robot's: the power of every step is wanted. */
#define JOULEBUS_QUERY_POWER 0x4u
/** For an acknowledgement: the robot's present level is its own from now on. */
#define JOULEBUS_QUERY_NEW_NORMAL 0x8u
/** Of a path: the time that the robot waits at each point follows the points, s. */
#define JOULEBUS_QUERY_DWELL 0x10u
/** Of a path: the power that the robot draws in addition towards each point follows, W. */
#define JOULEBUS_QUERY_LOAD 0x20u
/** Of a path: the time of each point follows, s. */
#define JOULEBUS_QUERY_TIMES 0x40u
/** Of a path: tolerance_m is stated. */
#define JOULEBUS_QUERY_TOLERANCE 0x80u
/** The bits that only a path has. */
#define JOULEBUS_QUERY_OF_PATH 0xf3u
/** All bits of a question about a plan that this version knows. */
#define JOULEBUS_QUERY_ALL 0xf7u

/** mean_j, lo_j and hi_j are known. */
#define JOULEBUS_ANSWER_ENERGY 0x1u
/** left_j and left_lo_j are known. */
#define JOULEBUS_ANSWER_LEFT 0x2u
/** probability is known. */
#define JOULEBUS_ANSWER_PROBABILITY 0x4u
/** margin_j is known. */
#define JOULEBUS_ANSWER_MARGIN 0x8u
/** limiting_leg is known. */
#define JOULEBUS_ANSWER_LIMITING_LEG 0x10u
/** turn_back_s is known. */
#define JOULEBUS_ANSWER_TURN_BACK 0x20u
/**
 * The plan is longer than the longest horizon whose errors are known: its interval and its
 * probability are extrapolated.
 */
#define JOULEBUS_ANSWER_BEYOND_HORIZON 0x40u
/** The robot's sample is overdue, or came without a reading. */
#define JOULEBUS_ANSWER_NO_READING 0x80u
/** The robot's newest row lay outside the range that its model was trained on. */
#define JOULEBUS_ANSWER_OUTSIDE_TRAINING 0x100u
/** The robot's alarm NoData is raised. */
#define JOULEBUS_ANSWER_ALARM_NO_DATA 0x200u
/** The robot's alarm OutOfRange is raised. */
#define JOULEBUS_ANSWER_ALARM_OUT_OF_RANGE 0x400u
/** The robot's alarm StuckSensor is raised. */
#define JOULEBUS_ANSWER_ALARM_STUCK_SENSOR 0x800u
/** The robot's alarm HeldTooLong is raised. */
#define JOULEBUS_ANSWER_ALARM_HELD_TOO_LONG 0x1000u
/** The robot's alarm SocImplausible is raised. */
#define JOULEBUS_ANSWER_ALARM_SOC_IMPLAUSIBLE 0x2000u
/** The robot's alarm Implausible is raised. */
#define JOULEBUS_ANSWER_ALARM_IMPLAUSIBLE 0x4000u
/** The recordings of the robot's model cannot show what the plan costs in full. */
#define JOULEBUS_ANSWER_MODEL_LIMIT 0x8000u

#define JOULEBUS_QUALITY_UNKNOWN 0u
#define JOULEBUS_QUALITY_FRESH 1u
#define JOULEBUS_QUALITY_HELD 2u
#define JOULEBUS_QUALITY_WARMUP 3u
#define JOULEBUS_QUALITY_OPEN_LOOP 4u
#define JOULEBUS_QUALITY_INVALID 5u

#define JOULEBUS_INVALID_STALE 1u
#define JOULEBUS_INVALID_NOT_FINITE 2u
#define JOULEBUS_INVALID_POWER_OUT_OF_RANGE 3u
#define JOULEBUS_INVALID_COMMAND_OUT_OF_RANGE 4u
#define JOULEBUS_INVALID_BAD_FLAGS 5u
#define JOULEBUS_INVALID_BAD_TIME 6u
#define JOULEBUS_INVALID_NO_COMMAND 7u
#define JOULEBUS_INVALID_NO_READING 8u
#define JOULEBUS_INVALID_MODEL_OUTPUT 9u
#define JOULEBUS_INVALID_NO_FRESHNESS 10u
#define JOULEBUS_INVALID_BATTERY_OUT_OF_RANGE 11u

#define JOULEBUS_LEVEL_OK 0u
#define JOULEBUS_LEVEL_WARN 1u
#define JOULEBUS_LEVEL_ERROR 2u
#define JOULEBUS_LEVEL_STALE 3u

#define JOULEBUS_ALARM_NO_DATA 1u
#define JOULEBUS_ALARM_OUT_OF_RANGE 2u
#define JOULEBUS_ALARM_STUCK_SENSOR 3u
#define JOULEBUS_ALARM_HELD_TOO_LONG 4u
#define JOULEBUS_ALARM_BIAS_HIGH 5u
#define JOULEBUS_ALARM_BIAS_LOW 6u
#define JOULEBUS_ALARM_NOISE_HIGH 7u
#define JOULEBUS_ALARM_MODEL_MISMATCH 8u
#define JOULEBUS_ALARM_OUT_OF_TRAINING 9u
#define JOULEBUS_ALARM_OFFLINE_CHARGING 10u
#define JOULEBUS_ALARM_DEADLINE_MISSED 11u
#define JOULEBUS_ALARM_WATCHDOG_STOP 12u
#define JOULEBUS_ALARM_CANNOT_RETURN 13u
#define JOULEBUS_ALARM_BATTERY_CRITICAL 14u
#define JOULEBUS_ALARM_BATTERY_LOW 15u
#define JOULEBUS_ALARM_SOC_IMPLAUSIBLE 16u
#define JOULEBUS_ALARM_LEVEL_HIGH 17u
#define JOULEBUS_ALARM_LEVEL_LOW 18u
#define JOULEBUS_ALARM_BATTERY_WORN 19u

#define JOULEBUS_CHARGE_UNKNOWN 0u
#define JOULEBUS_CHARGE_DISCHARGING 1u
#define JOULEBUS_CHARGE_CHARGING 2u

#define JOULEBUS_DROP_UNKNOWN_ROBOT 0u
#define JOULEBUS_DROP_OVER_CAPACITY 1u
#define JOULEBUS_DROP_FOREIGN_SOURCE 2u
#define JOULEBUS_DROP_OLD_EPOCH 3u
#define JOULEBUS_DROP_DUPLICATE 4u
#define JOULEBUS_DROP_OUT_OF_ORDER 5u
#define JOULEBUS_DROP_BAD_TIME 6u
#define JOULEBUS_DROP_NOT_FINITE 7u
#define JOULEBUS_DROP_POWER_OUT_OF_RANGE 8u
#define JOULEBUS_DROP_COMMAND_OUT_OF_RANGE 9u
#define JOULEBUS_DROP_BAD_FLAGS 10u
#define JOULEBUS_DROP_BACKLOG 11u
#define JOULEBUS_DROP_OVERFLOW 12u
#define JOULEBUS_DROP_SCHEMA 13u
#define JOULEBUS_DROP_BEFORE_JOIN 14u
#define JOULEBUS_DROP_TOO_MANY_SOURCES 15u
#define JOULEBUS_DROP_BATTERY_OUT_OF_RANGE 16u

#define JOULEBUS_QUERY_KIND_WHAT_IF 1u
#define JOULEBUS_QUERY_KIND_IDLE 2u
#define JOULEBUS_QUERY_KIND_FOLLOW 3u

#define JOULEBUS_REFUSAL_SCHEMA 1u
#define JOULEBUS_REFUSAL_FLEET 2u
#define JOULEBUS_REFUSAL_KIND 3u
#define JOULEBUS_REFUSAL_TOO_LARGE 4u
#define JOULEBUS_REFUSAL_LENGTH 5u
#define JOULEBUS_REFUSAL_UNKNOWN_ROBOT 6u
#define JOULEBUS_REFUSAL_QUESTION 7u
#define JOULEBUS_REFUSAL_DEADLINE 8u
#define JOULEBUS_REFUSAL_NO_FRAME 9u
#define JOULEBUS_REFUSAL_BUSY 10u
#define JOULEBUS_REFUSAL_ENDING 11u
#define JOULEBUS_REFUSAL_CLIENT_GONE 12u
#define JOULEBUS_REFUSAL_UNSENT 13u
#define JOULEBUS_REFUSAL_NOT_RAISED 14u

#define JOULEBUS_MAX_QUERY_VALUES 4096u
#define JOULEBUS_MAX_QUERY_ROBOTS 64u
#define JOULEBUS_MAX_QUERY_CANDIDATES 256u
#define JOULEBUS_MAX_QUERY_STEPS 108000u

#define JOULEBUS_SCHEMA_VERSION 4u

/** Refusals of one robot for one reason, as reported to operators. 16 bytes. */
typedef struct joulebus_refusal {
    /** Robot id stated in the samples. */
    uint32_t robot;
    /** Position of the reason in DropReason::ALL plus 1. 0 for an empty entry. */
    uint32_t reason;
    /** Process id of the sending source. */
    uint32_t pid;
    /** Samples refused since the entry was last assigned. */
    uint32_t count;
} joulebus_refusal;

/** Samples dropped, one counter per DropReason, with spare counters for later versions. */
typedef struct joulebus_drop_counts {
    /** Indexed by the reason's position in DropReason::ALL. */
    uint64_t counts[24];
} joulebus_drop_counts;

/** What the robots of a platform have shown together. 36 bytes, all 0 where there is none. */
typedef struct joulebus_platform_memory {
    /** platform_flag bits. */
    uint32_t flags;
    /** Known robots, at most 32. */
    float robots;
    /** Median of the mean powers of the robots, in that of the training. 0 without one. */
    float drawn;
    /**
     * The same as a prior of the next robot. No robot alone moves it by more than 5 %, so it stays
     * near 1 in a small fleet.
     */
    float power;
    /** How far commands explain the power: 1 as far as in the training, 0 not at all. */
    float command_trust;
    /**
     * Squared error of the first forecasts above that of the last reading, in the variance of the
     * model's errors.
     */
    float start_excess;
    /** NaN: no longer remembered. */
    float scatter;
    /**
     * Median power of the robots, in that of their commands. 0 while fewer than eight are known.
     */
    float level;
    /** Relative standard deviation of that power between robots. */
    float spread;
} joulebus_platform_memory;

/** One robot's command and latest reading in one control tick. 64 bytes. */
typedef struct joulebus_sample {
    /** Id of the robot, unique in the fleet. */
    uint32_t robot;
    /** sample_flag bits. */
    uint32_t flags;
    /** Number of this robot's sample within the source epoch. Strictly increasing. */
    uint64_t seq;
    /** When the command was issued, monotonic ns. Strictly increasing per robot. */
    uint64_t stamp_ns;
    /**
     * When the power was *measured*, monotonic ns. Equal to the previous one for a held reading.
     */
    uint64_t measured_ns;
    /** Linear velocity just commanded, after saturation, m/s. */
    float v_mps;
    /** Angular velocity just commanded, after saturation, rad/s. */
    float omega_radps;
    /** Electrical power just read, W. Negative where the platform regenerates. */
    float power_w;
    /** Battery voltage, V. */
    float voltage_v;
    /** Battery current, A, positive while discharging. */
    float current_a;
    /** Measured state of charge, 0 to 1. */
    float soc;
    /**
     * Energy that the robot needs from here to return, J: what its planner says. It applies to this
     * sample only. Without it the platform's config applies.
     */
    float return_j;
    /** Zero. */
    uint32_t reserved;
} joulebus_sample;

/** Header of a frame of samples: what one source sends at once. */
typedef struct joulebus_sample_header {
    /** SCHEMA_VERSION. */
    uint32_t schema;
    /** Process id of the source. That of a link has the bit 2³¹ beside it. */
    uint32_t pid;
    /** Id of the source, stable over restarts (a hash of its name). */
    uint64_t source_id;
    /**
     * When this run of the source began, monotonic ns: a restart has a greater one, however the
     * wall clock was set.
     */
    uint64_t source_epoch;
    /** Number of this frame within the epoch, from 0. */
    uint64_t frame_seq;
    /** Samples sent in this epoch before this frame, from which a reader computes its loss. */
    uint64_t samples_before;
    /**
     * Intended send time, monotonic ns. Latency is measured from here, so that a stalled source
     * does not hide its own delay (coordinated omission).
     */
    uint64_t intended_ns;
    /** When the frame was sent, monotonic ns. */
    uint64_t sent_ns;
    /** When the frame was sent, Unix ns: informative only, never used for an interval. */
    uint64_t sent_unix_ns;
} joulebus_sample_header;

/** One robot's forecast. 72 bytes. */
typedef struct joulebus_forecast {
    /** Id of the robot. */
    uint32_t robot;
    /** forecast_flag bits. */
    uint32_t flags;
    /** Quality code. */
    uint16_t quality;
    /** Detail of the quality: readings held so far, open-loop steps, or the reason. */
    uint16_t quality_detail;
    /** The last accepted reading, W. */
    float reading_w;
    /** Power expected at target_ns, W. */
    float power_w;
    /** Lower end of the interval, W. */
    float lo_w;
    /** Upper end of the interval, W. */
    float hi_w;
    /** Number of times the robot's slot has been reassigned. */
    uint32_t generation;
    /** Sample::seq of the sample that this forecast is based on. */
    uint64_t sample_seq;
    /** Sample::stamp_ns of that sample. */
    uint64_t stamp_ns;
    /** Stamp for which the reading is forecast, monotonic ns. */
    uint64_t target_ns;
    /** From the measurement of reading_w to stamp_ns, ns. */
    uint64_t reading_age_ns;
    /** SampleHeader::source_epoch of that sample. */
    uint64_t source_epoch;
} joulebus_forecast;

/** Header of a frame of forecasts: timing of the tick and counters of sample ingest. */
typedef struct joulebus_forecast_header {
    /** SCHEMA_VERSION. */
    uint32_t schema;
    /** Process id of the worker. */
    uint32_t pid;
    /**
     * When this run of the worker began, monotonic ns: a restart has a greater one, however the
     * wall clock was set.
     */
    uint64_t worker_epoch;
    /** Number of this tick within the epoch, from 1. */
    uint64_t tick;
    /** Period of the tick, ns: a frame older than two of these is stale. */
    uint64_t period_ns;
    /**
     * Hash of the model in use. Where platforms use different models: a combination of their
     * hashes, in the order of the platforms.
     */
    uint64_t model_hash;
    /** Robots that the worker has capacity for. */
    uint32_t capacity;
    /** Frames of samples taken in this tick. */
    uint32_t frames_taken;
    /** SampleHeader::intended_ns of the first frame taken in this tick. 0 if none was. */
    uint64_t first_intended_ns;
    /** SampleHeader::sent_ns of that frame. 0 if none was taken. */
    uint64_t first_sent_ns;
    /** When the worker took that frame, monotonic ns. 0 if none was taken. */
    uint64_t first_taken_ns;
    /** When the tick began to compute, monotonic ns. */
    uint64_t compute_start_ns;
    /** When the last forecast was written, monotonic ns. */
    uint64_t compute_end_ns;
    /** When the frame was sent, monotonic ns. */
    uint64_t sent_ns;
    /** When the frame was sent, Unix ns: informative only. */
    uint64_t sent_unix_ns;
    /** Ticks skipped in this epoch because the one before took too long. */
    uint64_t ticks_skipped;
    /** Ticks in this epoch that started more than a tenth of a period after they were due. */
    uint64_t ticks_late;
    /** Samples of this epoch: accepted. */
    uint64_t samples_accepted;
    /** Samples of this epoch: dropped, by reason. */
    joulebus_drop_counts samples_dropped;
} joulebus_forecast_header;

/** One robot's diagnostics. 176 bytes. */
typedef struct joulebus_diagnostic {
    /** Id of the robot. */
    uint32_t robot;
    /** diagnostic_flag bits. */
    uint32_t flags;
    /** Level code. */
    uint16_t level;
    /** Alarm code of the most important alarm. */
    uint16_t alarm;
    /** All alarms that are raised: AlarmSet bits. */
    uint32_t alarms;
    /** Reading minus what the network forecast for it, W, whatever was published. */
    float residual_w;
    /** The residual over the model's own residual standard deviation. */
    float residual_z;
    /** Exponentially weighted mean of the residuals, W. */
    float bias_w;
    /** NaN: retired with BiasHigh. */
    float cusum_up;
    /** NaN: retired with BiasLow. */
    float cusum_down;
    /** Exponentially weighted mean of the squared whitened residual: 1 for a healthy robot. */
    float noise_ratio;
    /** Share of readings that fell inside their interval, over the whole epoch. */
    float coverage;
    /** The same, exponentially weighted: recent coverage. */
    float coverage_recent;
    /** Residuals scored so far. */
    uint64_t scored;
    /** Mean absolute residual, W. */
    double mae_w;
    /** Coefficient of determination of the forecasts. */
    double r2;
    /** Mean absolute error of persistence (the last reading again) on the same readings, W. */
    double persistence_mae_w;
    /** Coefficient of determination of persistence. */
    double persistence_r2;
    /** 1 − (squared error of the forecasts / squared error of persistence). */
    double skill;
    /** Sample::seq of the newest sample accepted. */
    uint64_t sample_seq;
    /** Sample::stamp_ns of that sample. */
    uint64_t stamp_ns;
    /** SampleHeader::source_epoch of that sample. */
    uint64_t source_epoch;
    /** Samples of this robot that were refused in this epoch. */
    uint64_t refused;
    /** The network's own forecast of the next reading, W, whatever is published. */
    float network_w;
    /** Mean of the readings, W. The newest counts 1/256 at least. */
    float mean_w;
    /** Mean size of the changes between new measurements, W. */
    float change_w;
    /** Weight of the last reading where a new measurement is due, 0 to 1. */
    float weight_last;
    /** Weight of the network there. */
    float weight_network;
    /** Weight of the stack there. */
    float weight_stack;
    /** Weight of the last reading where the measurement will be held. */
    float held_weight_last;
    /** Weight of the stack there. */
    float held_weight_stack;
    /**
     * Gain of the last reading within the stack: signed, on its deviation from the model's
     * autoregression.
     */
    float gain_last;
    /** Gain of the network. */
    float gain_network;
    /** Gain of the mean of the readings. */
    float gain_mean;
    /** Level that the stack adds, W. */
    float level_w;
} joulebus_diagnostic;

/** Header of a frame of diagnostics. */
typedef struct joulebus_diagnostic_header {
    /** SCHEMA_VERSION. */
    uint32_t schema;
    /** Process id of the worker. */
    uint32_t pid;
    /** As in ForecastHeader::worker_epoch. */
    uint64_t worker_epoch;
    /** As in ForecastHeader::tick. */
    uint64_t tick;
    /** Recent refusals. See DiagnosticHeader::refusals. */
    joulebus_refusal refused[16];
    /**
     * What the robots of each platform have shown, in the order of the config. Of the first 16
     * platforms.
     */
    joulebus_platform_memory platforms[16];
} joulebus_diagnostic_header;

/**
 * One robot's budget. 176 bytes.
 * The ledger part (drawn_uj, drawn_remainder, metered_ns, unmetered_ns, stamp_ns) is exact:
 * metered_ns + unmetered_ns is the time from the first sample to stamp_ns. The energy left is
 * counted from it and fused with measured states of charge. The truth lies between the bounds (_lo,
 * _hi) with 95 % where the errors are as the platform's config says. They widen with unmetered time
 * by all that the robot could have drawn.
 */
typedef struct joulebus_budget {
    /** Id of the robot. */
    uint32_t robot;
    /** budget_flag bits. */
    uint32_t flags;
    /** ChargeState code. */
    uint32_t charge_state;
    /**
     * Times that another battery was noticed: a measured state of charge that contradicted the
     * counted one and lasted, or a sample that says so.
     */
    uint32_t battery_changes;
    /** Energy drawn over the metered time, µJ. */
    int64_t drawn_uj;
    /**
     * Remainder of the integral below one µJ, in µW·ns · 2: carried, so that no energy is rounded
     * away.
     */
    int64_t drawn_remainder;
    /** Forecast energy over the same metered time, µJ. */
    int64_t forecast_uj;
    /** Time covered by readings, ns. */
    uint64_t metered_ns;
    /** Time not covered by readings, ns. */
    uint64_t unmetered_ns;
    /** Stamp of the newest sample in the ledger, monotonic ns. */
    uint64_t stamp_ns;
    /** Valid until, monotonic ns: stamp_ns plus the platform's stale_after. */
    uint64_t valid_until_ns;
    /** Mean power over the last minutes off the charger (exponentially weighted), W. */
    float mean_power_w;
    /** Energy left in the battery, best estimate, J. */
    float left_j;
    /** Usable energy above the reserve, best estimate, J. */
    float usable_j;
    /** Lower bound of usable_j: unmetered time is charged at the platform's maximum power, J. */
    float usable_lo_j;
    /** State of charge, 0 to 1. */
    float soc;
    /** State of charge, lower bound. */
    float soc_lo;
    /** Time until the reserve is reached at the power that is expected until then, s. */
    float time_to_empty_s;
    /** The same, lower bound of the 90 % interval, s. */
    float time_to_empty_lo_s;
    /** The same, its upper bound, s. */
    float time_to_empty_hi_s;
    /** State of charge, upper bound. */
    float soc_hi;
    /**
     * Standard deviation of soc, by which probabilities are computed: errors of the monitor, and
     * what is likely within the range of unmetered time.
     */
    float soc_sd;
    /** Estimated error of the measured state of charge: measured minus true. */
    float sensor_bias;
    /** Standard deviation of sensor_bias. */
    float sensor_bias_sd;
    /** Covariance of soc and sensor_bias. */
    float sensor_covariance;
    /**
     * Mean power at rest over the last minutes at rest (exponentially weighted), W. NaN if unknown.
     */
    float idle_w;
    /** Unmetered time since the charge was last measured, full or stated, s. */
    float pause_s;
    /** By how much that time has lowered soc_lo at most, as a share. */
    float pause;
    /**
     * Learned capacity, J: energy left is the charge times it. NaN before anything is learned, when
     * the stated one counts.
     */
    float capacity_j;
    /** Its standard deviation, J. NaN before anything is learned. */
    float capacity_sd_j;
    /**
     * Weight of the pairs of known charges that it is learned from: 1 for one from full to empty,
     * at most 2.5. 0 before anything is learned.
     */
    float capacity_weight;
    /**
     * Charging rate in each tenth of the charge, in thousandths of the capacity an hour. 0 if
     * unknown.
     */
    uint16_t charge_rate[10];
    /** 0. */
    uint32_t reserved;
} joulebus_budget;

/** Header of a frame of budgets. */
typedef struct joulebus_budget_header {
    /** SCHEMA_VERSION. */
    uint32_t schema;
    /** Process id of the worker. */
    uint32_t pid;
    /** As in ForecastHeader::worker_epoch. */
    uint64_t worker_epoch;
    /** As in ForecastHeader::tick. */
    uint64_t tick;
    /** When the frame was sent, monotonic ns. */
    uint64_t sent_ns;
    /** When the frame was sent, Unix ns: relates stamps to the wall clock over a reboot. */
    uint64_t sent_unix_ns;
} joulebus_budget_header;

/**
 * State from which plans of one robot start. 208 bytes.
 * While the robot's next sample is overdue, lag window and reading age include open_steps periods
 * that the model bridged with its own forecasts, as the forecast published in the same tick does.
 */
typedef struct joulebus_plan_state {
    /** Id of the robot. */
    uint32_t robot;
    /** plan_state_flag bits. */
    uint32_t flags;
    /** Quality code, as of the forecast of the same tick. */
    uint16_t quality;
    /** Detail of the quality. */
    uint16_t quality_detail;
    /** Place of the robot's platform, and so of its model, in the config. */
    uint16_t platform;
    /** Sample periods since the last reading. Those by the worker's clock are included. */
    uint16_t open_steps;
    /** Samples since the last measurement, 0 to 254. 255 before the first. */
    uint16_t age_steps;
    /** Samples from one measurement to the next, 1 to 255. 0 until two have been seen. */
    uint16_t interval_steps;
    /** Number of times the robot's slot has been reassigned. */
    uint32_t generation;
    /** Sample::stamp_ns of the last accepted sample. */
    uint64_t stamp_ns;
    /** The command in force, m/s. */
    float v_mps;
    /** The command in force, rad/s. */
    float omega_radps;
    /** The last reading, W. */
    float lag1_w;
    /** The one before it, W. */
    float lag2_w;
    /** The third, W. */
    float lag3_w;
    /** The fourth, W. */
    float lag4_w;
    /** The fifth, W. */
    float lag5_w;
    /** The network's own forecast of the next reading, W. */
    float network_w;
    /** Mean of the readings, W. */
    float mean_w;
    /** Mean size of the changes between new measurements, W. */
    float change_w;
    /** Weight of the last reading where a new measurement is due. */
    float weight_last;
    /** Weight of the network there. */
    float weight_network;
    /** Weight of the stack there. */
    float weight_stack;
    /** Weight of the stack where it will be held. The rest is that of the last reading. */
    float held_weight_stack;
    /** Gain of the last reading within the stack. */
    float gain_last;
    /** Gain of the network within the stack. */
    float gain_network;
    /** Gain of the mean of the readings within the stack. */
    float gain_mean;
    /** Level that the stack adds, W. */
    float level_w;
    /** Recent mean size of the residuals where a new measurement is due, W. */
    float size_due_w;
    /** Distance of the interval's lower end from the forecast there, in sizes. */
    float below_due;
    /** Distance of its upper end, in sizes. */
    float above_due;
    /** Recent mean size of the residuals where a reading is held, W. */
    float size_held_w;
    /** Distance of the interval's lower end there, in sizes. */
    float below_held;
    /** Distance of its upper end, in sizes. */
    float above_held;
    /** Discounted energy over the time constants of joulebus_energy::LEVELS_S, J. */
    float energy_j[4];
    /** What the platform's command model says of the same time, J. */
    float command_j[4];
    /** Discounted time, s. 0 before the first metered reading. */
    float time_s[4];
    /**
     * Lower bounds of the energy's 90 % interval at the horizons of joulebus_energy::SHADOWS_S, in
     * half widths from the middle of the trained one.
     */
    float error_lower[3];
    /** Its upper bounds. −1 and 1 are the trained interval. */
    float error_upper[3];
    /** How far the commands explain this robot's power, 0 to 1: 1 as far as the platform's. */
    float command_trust;
    /** 0. */
    uint32_t reserved;
} joulebus_plan_state;

/**
 * Header of a frame of PlanStates. A planner computes with models and settings of its own: the
 * hashes tell whether they are the worker's.
 */
typedef struct joulebus_plan_state_header {
    /** SCHEMA_VERSION. */
    uint32_t schema;
    /** Process id of the worker. */
    uint32_t pid;
    /** As in ForecastHeader::worker_epoch. */
    uint64_t worker_epoch;
    /** As in ForecastHeader::tick. */
    uint64_t tick;
    /** Period of the tick, ns: a frame older than two of these is stale. */
    uint64_t period_ns;
    /** Hash of the fleet's settings. */
    uint64_t settings_hash;
    /** Hash of all models, as in ForecastHeader::model_hash. */
    uint64_t model_hash;
    /** Hash of each platform's model. 0 beyond the last platform, and beyond LISTED_MODELS. */
    uint64_t models[16];
    /** When the tick began to compute, monotonic ns. */
    uint64_t compute_start_ns;
    /** When the frame was sent, monotonic ns. */
    uint64_t sent_ns;
    /** When the frame was sent, Unix ns: informative only. */
    uint64_t sent_unix_ns;
} joulebus_plan_state_header;

/**
 * One robot's outlook. 96 bytes.
 * The assumption: the robot goes on as it does. Its future commands are unknown. The forecast
 * follows from its own recent power, with the platform's mean as the prior.
 * The horizons are 1, 10, 60 and 300 s from stamp_ns on, in this order in each array. The energy
 * lies between the bounds (_lo, _hi) with 90 %. The first bounded horizons have bounds: all, or
 * none of a model without known errors.
 */
typedef struct joulebus_outlook {
    /** Id of the robot. */
    uint32_t robot;
    /** outlook_flag bits. */
    uint32_t flags;
    /** Quality code, as of the forecast of the same tick. */
    uint16_t quality;
    /** Detail of the quality. */
    uint16_t quality_detail;
    /** Place of the robot's platform, and so of its model, in the config. */
    uint16_t platform;
    /** Number of horizons, from the shortest, with bounds. */
    uint16_t bounded;
    /** Number of times the robot's slot has been reassigned. */
    uint32_t generation;
    /** Mean power expected over the longest horizon, W. */
    float mean_w;
    /** Sample::stamp_ns of the last accepted sample. */
    uint64_t stamp_ns;
    /** Energy expected over each horizon, J. */
    float energy_j[4];
    /** Its lower bounds, J. */
    float energy_lo_j[4];
    /** Its upper bounds, J. */
    float energy_hi_j[4];
    /** Budget::usable_j of the same tick, J. */
    float usable_j;
    /** Budget::time_to_empty_s of the same tick, s. */
    float time_to_empty_s;
    /** Its lower bound, s. */
    float time_to_empty_lo_s;
    /** Its upper bound, s. */
    float time_to_empty_hi_s;
} joulebus_outlook;

/** Header of a frame of Outlooks. */
typedef struct joulebus_outlook_header {
    /** SCHEMA_VERSION. */
    uint32_t schema;
    /** Process id of the worker. */
    uint32_t pid;
    /** As in ForecastHeader::worker_epoch. */
    uint64_t worker_epoch;
    /** As in ForecastHeader::tick. */
    uint64_t tick;
    /** Period of the tick, ns: a frame older than two of these is stale. */
    uint64_t period_ns;
    /** Hash of all models, as in ForecastHeader::model_hash. */
    uint64_t model_hash;
    /** When the tick began to compute, monotonic ns. */
    uint64_t compute_start_ns;
    /** When the frame was sent, monotonic ns. */
    uint64_t sent_ns;
    /** When the frame was sent, Unix ns: informative only. */
    uint64_t sent_unix_ns;
} joulebus_outlook_header;

/** Header of a question. 112 bytes. */
typedef struct joulebus_query_header {
    /** SCHEMA_VERSION. */
    uint32_t schema;
    /** Code of the QueryKind. */
    uint32_t kind;
    /** fnv1a of the fleet's name. */
    uint64_t fleet;
    /** Number that the answer repeats. */
    uint64_t number;
    /** When it was asked, monotonic ns. */
    uint64_t asked_ns;
    /** When the client stops waiting, monotonic ns: later the question is refused. */
    uint64_t deadline_ns;
    /** Lower half of the id of the client's listener, which the answer wakes. */
    uint64_t listener_lo;
    /** Upper half. */
    uint64_t listener_hi;
    /** query_flag bits. */
    uint32_t flags;
    /** Number of robots, at most MAX_QUERY_ROBOTS. */
    uint32_t robots;
    /**
     * Number of candidates, at most MAX_QUERY_CANDIDATES. Of one robot's path or rest: number of
     * evenly spaced moments up to which a part of the plan is answered too, each with a row.
     */
    uint32_t candidates;
    /** Steps of each candidate, points of the path, or characters of a name. */
    uint32_t steps;
    /** Coverage of the intervals, 0.5 to 0.999. */
    float coverage;
    /** Time that each command is in force, s. */
    float period_s;
    /** Time at rest, s. */
    float duration_s;
    /**
     * Distance from the path within which corners are cut, m. Without the flag: stairs of a grid
     * within half a cell.
     */
    float tolerance_m;
    /** Where to return to, m. */
    double return_x_m;
    /** Where to return to, m. */
    double return_y_m;
    /** Heading at the first point, rad, counter-clockwise from east. */
    double heading_rad;
} joulebus_query_header;

/** Header of an answer. 112 bytes. */
typedef struct joulebus_answer_header {
    /** SCHEMA_VERSION. */
    uint32_t schema;
    /** Process id of the worker. */
    uint32_t pid;
    /** The question's number. */
    uint64_t number;
    /** Run of the worker that the state is of. */
    uint64_t worker_epoch;
    /** Tick of the plan states that the answer is computed from. 0 if it is refused. */
    uint64_t tick;
    /** Period of the tick, ns. */
    uint64_t period_ns;
    /** When that frame was sent, monotonic ns. */
    uint64_t sent_state_ns;
    /** Run of the worker that the budgets are of. */
    uint64_t budget_epoch;
    /** Tick of the budgets. 0 without any. */
    uint64_t budget_tick;
    /** When that frame was sent, monotonic ns. */
    uint64_t sent_budget_ns;
    /** The time that the answer is as of, monotonic ns. */
    uint64_t now_ns;
    /** When the worker took the question, monotonic ns. */
    uint64_t taken_ns;
    /** When the answer was sent, monotonic ns. */
    uint64_t sent_ns;
    /** Code of the QueryRefusal. 0 if the question is answered. */
    uint32_t refusal;
    /** Number of AnswerRows. */
    uint32_t rows;
    /** Number of powers after the rows. */
    uint32_t powers;
    /** Bytes of the text of a refusal. */
    uint32_t text_bytes;
} joulebus_answer_header;

/** The answer to one candidate, or of one robot. 64 bytes. */
typedef struct joulebus_answer_row {
    /** Id of the robot. */
    uint32_t robot;
    /** answer_flag bits. */
    uint16_t flags;
    /** 1 yes, 2 tight, 3 no, 4 unknown. Others are of a newer version. */
    uint16_t verdict;
    /**
     * Why it is unknown: 1 stale, 2 invalid, 3 warm-up, 4 unreadable, 5 no level, 6 no battery, 7
     * battery unknown, 8 no budget. 0 if it is not.
     */
    uint16_t unknown;
    /**
     * Code of the InvalidReason, or readings so far in the warm-up. With other verdicts the longest
     * delay at a point of a path with times, s, rounded up.
     */
    uint16_t unknown_detail;
    /** The first leg at whose end a yes does not hold, from 0. */
    uint32_t limiting_leg;
    /** Age of the frame where it is stale, ns. */
    uint64_t age_ns;
    /** From the first command to the end of the last, s. */
    float duration_s;
    /** Energy of the plan, expected, J. */
    float mean_j;
    /** Lower end at the asked coverage, J. */
    float lo_j;
    /** Upper end, J. */
    float hi_j;
    /** Energy left in the battery at the end, best estimate, J. */
    float left_j;
    /** Conservative, J. */
    float left_lo_j;
    /**
     * Probability of finishing above the reserve. NaN where the model's errors do not cover the
     * plan.
     */
    float probability;
    /** A bound: what the battery can spare at least, less the upper end of the energy, J. */
    float margin_j;
    /** Until when the robot must turn back, s. NaN with a yes: it can drive the whole path. */
    float turn_back_s;
    /** Steps whose commands lie outside the training data. */
    uint32_t outside_training;
} joulebus_answer_row;


/**
 * Result of a call.
 */
enum joulebus_error
#if defined(__cplusplus) || __STDC_VERSION__ >= 202311L
  : int32_t
#endif // defined(__cplusplus) || __STDC_VERSION__ >= 202311L
 {
    /**
     * Done.
     */
    JOULEBUS_ERROR_NONE = 0,
    /**
     * A null pointer, a length, a text or a value that is not allowed.
     */
    JOULEBUS_ERROR_ARGUMENT = 1,
    /**
     * A handle that is closed, in use by an interrupted call, or none.
     */
    JOULEBUS_ERROR_HANDLE = 2,
    /**
     * A handle of another thread.
     */
    JOULEBUS_ERROR_THREAD = 3,
    /**
     * A handle of the process that forked this one.
     */
    JOULEBUS_ERROR_PROCESS = 4,
    /**
     * The program was compiled with the header of another release.
     */
    JOULEBUS_ERROR_VERSION = 5,
    /**
     * The config, its models, joining the fleet, or a service of it. While publishing: files of this
     * process were removed, and it must open again.
     */
    JOULEBUS_ERROR_CONNECT = 6,
    /**
     * Frames could not be read, or are of another version. The next call may succeed.
     */
    JOULEBUS_ERROR_READ = 7,
    /**
     * No frame has arrived yet.
     */
    JOULEBUS_ERROR_NO_FRAME = 8,
    /**
     * A signal arrived while waiting.
     */
    JOULEBUS_ERROR_INTERRUPTED = 9,
    /**
     * A frame was not sent. The next may be.
     */
    JOULEBUS_ERROR_PUBLISH = 10,
    /**
     * A model file is refused, or does not fit the question.
     */
    JOULEBUS_ERROR_MODEL = 11,
    /**
     * A question that cannot be answered: an unknown robot, a command that is not allowed.
     */
    JOULEBUS_ERROR_QUESTION = 12,
    /**
     * No worker answered: none runs, it has ended, or it took too long.
     */
    JOULEBUS_ERROR_UNANSWERED = 13,
    /**
     * A defect of joulebus: the handle of the call is closed. Please report it.
     */
    JOULEBUS_ERROR_DEFECT = 14,
};
#ifndef __cplusplus
#if __STDC_VERSION__ >= 202311L
typedef enum joulebus_error joulebus_error;
#else
typedef int32_t joulebus_error;
#endif // __STDC_VERSION__ >= 202311L
#endif // __cplusplus

/**
 * Kinds of events.
 */
enum joulebus_event_kind
#if defined(__cplusplus) || __STDC_VERSION__ >= 202311L
  : uint32_t
#endif // defined(__cplusplus) || __STDC_VERSION__ >= 202311L
 {
    /**
     * No event before the time-out.
     */
    JOULEBUS_EVENT_KIND_TIMED_OUT = 0,
    /**
     * A frame that was not returned before.
     */
    JOULEBUS_EVENT_KIND_FRAME = 1,
    /**
     * The worker has ended. Told once.
     */
    JOULEBUS_EVENT_KIND_GONE = 2,
    /**
     * The newest frame is older than two tick periods. Told once.
     */
    JOULEBUS_EVENT_KIND_STALE = 3,
    /**
     * A signal arrived, and the program's own handler has run.
     */
    JOULEBUS_EVENT_KIND_INTERRUPTED = 4,
};
#ifndef __cplusplus
#if __STDC_VERSION__ >= 202311L
typedef enum joulebus_event_kind joulebus_event_kind;
#else
typedef uint32_t joulebus_event_kind;
#endif // __STDC_VERSION__ >= 202311L
#endif // __cplusplus

/**
 * How the end of a worker was detected.
 */
enum joulebus_end
#if defined(__cplusplus) || __STDC_VERSION__ >= 202311L
  : uint32_t
#endif // defined(__cplusplus) || __STDC_VERSION__ >= 202311L
 {
    /**
     * No end.
     */
    JOULEBUS_END_NONE = 0,
    /**
     * It said so.
     */
    JOULEBUS_END_ENDED = 1,
    /**
     * Its process exited without saying so: told by the kernel, at once.
     */
    JOULEBUS_END_EXITED = 2,
    /**
     * Another process found it dead: where processes cannot be watched.
     */
    JOULEBUS_END_FOUND_DEAD = 3,
    /**
     * It is on another host, from which nothing comes. The worker may run.
     */
    JOULEBUS_END_UNREACHABLE = 4,
};
#ifndef __cplusplus
#if __STDC_VERSION__ >= 202311L
typedef enum joulebus_end joulebus_end;
#else
typedef uint32_t joulebus_end;
#endif // __STDC_VERSION__ >= 202311L
#endif // __cplusplus

/**
 * The worker, as seen by a subscriber.
 */
enum joulebus_worker
#if defined(__cplusplus) || __STDC_VERSION__ >= 202311L
  : uint32_t
#endif // defined(__cplusplus) || __STDC_VERSION__ >= 202311L
 {
    /**
     * No frame has arrived yet.
     */
    JOULEBUS_WORKER_WAITING = 0,
    /**
     * The newest frame is at most two tick periods old.
     */
    JOULEBUS_WORKER_ALIVE = 1,
    /**
     * It is older: do not rely on it.
     */
    JOULEBUS_WORKER_STALE = 2,
    /**
     * The worker has ended.
     */
    JOULEBUS_WORKER_GONE = 3,
};
#ifndef __cplusplus
#if __STDC_VERSION__ >= 202311L
typedef enum joulebus_worker joulebus_worker;
#else
typedef uint32_t joulebus_worker;
#endif // __STDC_VERSION__ >= 202311L
#endif // __cplusplus

/**
 * A program that asks the worker what plans cost.
 */
typedef struct joulebus_client joulebus_client;

/**
 * A frame of forecasts that is kept.
 */
typedef struct joulebus_frame joulebus_frame;

/**
 * A network.
 */
typedef struct joulebus_predictor joulebus_predictor;

/**
 * A source of samples.
 */
typedef struct joulebus_publisher joulebus_publisher;

/**
 * A planner that computes what plans cost.
 */
typedef struct joulebus_questions joulebus_questions;

/**
 * A reader of forecasts, diagnostics and budgets.
 */
typedef struct joulebus_subscriber joulebus_subscriber;

/**
 * One robot in one control tick. Set to zero, nothing is known of it.
 */
typedef struct joulebus_robot_state {
    /**
     * Id of the robot, unique in the fleet.
     */
    uint32_t robot;
    /**
     * JOULEBUS_SAMPLE bits: which of the fields below are known, and HELD, CHARGING, FULL (which
     * implies CHARGING), SWAPPED and OFF. Others are refused.
     */
    uint32_t flags;
    /**
     * When the power was measured, monotonic ns. 0: when the frame is published, or, for a held
     * reading, when the repeated reading was measured.
     */
    uint64_t measured_ns;
    /**
     * Linear velocity just commanded, after saturation, m/s.
     */
    float v_mps;
    /**
     * Angular velocity just commanded, after saturation, rad/s.
     */
    float omega_radps;
    /**
     * Electrical power just read, W. Negative where the platform regenerates.
     */
    float power_w;
    /**
     * Battery voltage, V.
     */
    float voltage_v;
    /**
     * Battery current, A, positive while discharging.
     */
    float current_a;
    /**
     * Measured state of charge, 0 to 1.
     */
    float soc;
    /**
     * Energy that the robot needs from here to return to its charger, J.
     */
    float return_j;
    /**
     * 0.
     */
    uint32_t reserved;
} joulebus_robot_state;

/**
 * A frame that was sent.
 */
typedef struct joulebus_sent {
    /**
     * Processes connected as readers: 0 means that no worker runs.
     */
    size_t readers;
    /**
     * Samples in it.
     */
    size_t samples;
    /**
     * Its number within this run of the source, from 0.
     */
    uint64_t frame_seq;
    /**
     * 1 if the worker was woken. It takes the frame at its next tick all the same.
     */
    uint32_t woken;
    /**
     * Samples of it that the worker refuses for their values, by the limits of the config.
     */
    uint32_t refused;
} joulebus_sent;

/**
 * Counts of a publisher.
 */
typedef struct joulebus_publisher_counts {
    /**
     * Frames sent in this run.
     */
    uint64_t frames_sent;
    /**
     * Samples sent in this run.
     */
    uint64_t samples_sent;
    /**
     * Most samples in a frame: the fleet's capacity.
     */
    size_t capacity;
    /**
     * Connections to workers that failed or broke: such workers miss frames.
     */
    uint64_t degraded;
    /**
     * Id of the source: FNV-1a of its name, 64 bits.
     */
    uint64_t source_id;
    /**
     * When this run of the source began, monotonic ns.
     */
    uint64_t source_epoch;
} joulebus_publisher_counts;

/**
 * Samples of a source that the worker refuses, for the most frequent reason.
 */
typedef struct joulebus_not_taken {
    /**
     * How many in this run. 0: none is refused at present.
     */
    uint64_t count;
    /**
     * Reason code, as in joulebus_refusal.
     */
    uint32_t reason;
    /**
     * The robot of the last one.
     */
    uint32_t robot;
    /**
     * Reason, field, value and remedy in words, cut at the end. Empty if none is refused.
     */
    char text[320];
} joulebus_not_taken;

/**
 * A frame of forecasts, in the worker's shared memory.
 */
typedef struct joulebus_forecasts {
    /**
     * Its header. NULL if there is no frame.
     */
    const joulebus_forecast_header *header;
    /**
     * All robots of the frame, in no particular order.
     */
    const joulebus_forecast *robots;
    /**
     * How many.
     */
    size_t count;
    /**
     * Ticks of this worker whose frames were skipped or lost since the last frame that was
     * returned.
     */
    uint64_t ticks_missed;
    /**
     * 1 if the frame is the first of another run of the worker than the one before, else 0.
     */
    uint64_t restarted;
} joulebus_forecasts;

/**
 * An event of a subscriber.
 */
typedef struct joulebus_event {
    /**
     * Kind of the event.
     */
    joulebus_event_kind kind;
    /**
     * How the worker ended, of JOULEBUS_EVENT_KIND_GONE.
     */
    joulebus_end end;
    /**
     * Time since the newest frame was sent, ns, of JOULEBUS_EVENT_KIND_STALE.
     */
    uint64_t age_ns;
    /**
     * For JOULEBUS_EVENT_KIND_FRAME.
     */
    struct joulebus_forecasts frame;
} joulebus_event;

/**
 * A frame of diagnostics, in the worker's shared memory.
 */
typedef struct joulebus_diagnostics {
    /**
     * Its header. NULL if there is no frame.
     */
    const joulebus_diagnostic_header *header;
    /**
     * All robots of the frame, in no particular order.
     */
    const joulebus_diagnostic *robots;
    /**
     * How many.
     */
    size_t count;
} joulebus_diagnostics;

/**
 * A frame of budgets, in the worker's shared memory.
 */
typedef struct joulebus_budgets {
    /**
     * Its header. NULL if there is no frame.
     */
    const joulebus_budget_header *header;
    /**
     * All robots of the frame, in no particular order.
     */
    const joulebus_budget *robots;
    /**
     * How many.
     */
    size_t count;
} joulebus_budgets;

/**
 * A frame of outlooks, in the worker's shared memory.
 */
typedef struct joulebus_outlooks {
    /**
     * Its header. NULL if there is no frame.
     */
    const joulebus_outlook_header *header;
    /**
     * All robots of the frame, in no particular order.
     */
    const joulebus_outlook *robots;
    /**
     * How many.
     */
    size_t count;
} joulebus_outlooks;

/**
 * Status of a subscriber.
 */
typedef struct joulebus_subscriber_status {
    /**
     * The worker, as of the last call that read.
     */
    joulebus_worker worker;
    /**
     * How it ended.
     */
    joulebus_end end;
    /**
     * Frames returned.
     */
    uint64_t frames;
    /**
     * Gaps between them.
     */
    uint64_t gaps;
    /**
     * Ticks missing in all gaps.
     */
    uint64_t ticks_missed;
    /**
     * Runs of the worker.
     */
    uint64_t workers;
    /**
     * Connections to workers that failed or broke: frames are missing.
     */
    uint64_t degraded;
    /**
     * Frames passed over because another process than the worker has sent them.
     */
    uint64_t foreign;
} joulebus_subscriber_status;

/**
 * A platform, as the fleet's config describes it.
 */
typedef struct joulebus_platform {
    /**
     * Period of a robot's samples, s: of commands, if not said otherwise.
     */
    float period_s;
    /**
     * Greatest linear velocity, m/s.
     */
    float v_max_mps;
    /**
     * Greatest angular velocity, rad/s.
     */
    float omega_max_radps;
    /**
     * Least electrical power, W.
     */
    float power_min_w;
    /**
     * Greatest electrical power, W.
     */
    float power_max_w;
    /**
     * 0.
     */
    uint32_t reserved;
    /**
     * Capacity of the battery, J. NaN without one.
     */
    double capacity_j;
} joulebus_platform;

/**
 * A point of a path, and the speed towards it.
 */
typedef struct joulebus_waypoint {
    /**
     * East, m.
     */
    double x_m;
    /**
     * North, m.
     */
    double y_m;
    /**
     * Speed towards it, m/s. One above the platform's is refused, and infinity is the highest that
     * the model was trained on. That of the first point is not used.
     */
    double speed_mps;
} joulebus_waypoint;

/**
 * A question about plans. Fields that its kind does not name are not read.
 */
typedef struct joulebus_question {
    /**
     * JOULEBUS_QUERY_KIND_WHAT_IF: candidates of one robot. IDLE: robots that stand still. FOLLOW:
     * robots that follow a path, which are answered the best first.
     */
    uint32_t kind;
    /**
     * JOULEBUS_QUERY_RETURN, HEADING and TOLERANCE, of FOLLOW.
     */
    uint32_t flags;
    /**
     * Coverage of the intervals, 0.5 to 0.999.
     */
    float coverage;
    /**
     * For WHAT_IF: time that each command is in force, s.
     */
    float period_s;
    /**
     * For IDLE: the time, s.
     */
    float duration_s;
    /**
     * Distance from the path within which corners are cut, m, with JOULEBUS_QUERY_TOLERANCE. Else
     * the stairs of a grid within half a cell.
     */
    float tolerance_m;
    /**
     * Ids of the robots.
     */
    const uint32_t *robots;
    /**
     * How many. One of WHAT_IF.
     */
    size_t robot_count;
    /**
     * For WHAT_IF: number of candidates. For IDLE and FOLLOW of one robot: number of evenly spaced
     * moments, at most 256, up to each of which its part of the plan is answered in a row of its own,
     * after that of the whole.
     */
    size_t candidates;
    /**
     * For WHAT_IF: steps of each.
     */
    size_t steps;
    /**
     * For WHAT_IF: linear velocities, m/s, candidate by candidate.
     */
    const float *v_mps;
    /**
     * For WHAT_IF: angular velocities, rad/s, candidate by candidate.
     */
    const float *omega_radps;
    /**
     * For FOLLOW: the path. The robots are at its first point.
     */
    const struct joulebus_waypoint *path;
    /**
     * For FOLLOW: its points.
     */
    size_t points;
    /**
     * Where to return to, m, with JOULEBUS_QUERY_RETURN.
     */
    double return_x_m;
    /**
     * Where to return to, m.
     */
    double return_y_m;
    /**
     * Heading at the first point, rad, counter-clockwise from east, with JOULEBUS_QUERY_HEADING.
     * Else towards the first point that is elsewhere.
     */
    double heading_rad;
    /**
     * For FOLLOW: time that the robot waits at each point, s. NULL: none.
     */
    const double *dwell_s;
    /**
     * For FOLLOW: power that the robot draws in addition on the way to each point and while it waits
     * there, W. NULL: none.
     */
    const double *load_w;
    /**
     * For FOLLOW: when the robot is at each point, s, from the first. Speeds are then upper limits.
     * NULL: no times.
     */
    const double *time_s;
} joulebus_question;

/**
 * Memory for answers, and which frames they are computed from.
 */
typedef struct joulebus_answers {
    /**
     * Memory for an answer for each candidate or robot.
     */
    joulebus_answer_row *rows;
    /**
     * How many fit: at least as many as there are answers.
     */
    size_t row_capacity;
    /**
     * Answers written.
     */
    size_t row_count;
    /**
     * Memory for the power of every step, W, candidate by candidate, of WHAT_IF and of FOLLOW with
     * one robot. NULL if it is not wanted.
     */
    float *power_w;
    /**
     * How many fit.
     */
    size_t power_capacity;
    /**
     * Powers there are. If more than fit, none is written.
     */
    size_t power_count;
    /**
     * Tick of the frame that the answers are computed from.
     */
    uint64_t tick;
    /**
     * Its age when they were computed, ns.
     */
    uint64_t age_ns;
    /**
     * From asking the worker to its answer, ns. 0 where this process computes.
     */
    uint64_t took_ns;
} joulebus_answers;

/**
 * Command sequences, for as many robots as there are starts.
 */
typedef struct joulebus_rollout {
    /**
     * Robots.
     */
    size_t robots;
    /**
     * Candidates of each.
     */
    size_t candidates;
    /**
     * Steps of each candidate.
     */
    size_t steps;
    /**
     * Time between two steps, s.
     */
    float step_s;
    /**
     * 0.
     */
    uint32_t reserved;
    /**
     * Linear velocities, m/s: those of the first candidate of the first robot, step by step, then
     * the next candidate.
     */
    const float *v_mps;
    /**
     * Angular velocities, rad/s, in the same order.
     */
    const float *omega_radps;
    /**
     * The last five readings of each robot, W, newest first.
     */
    const float *readings_w;
    /**
     * The command of each robot before the first step: v in m/s, omega in rad/s. NULL: the first
     * step has no derivatives.
     */
    const float *before;
} joulebus_rollout;

#ifdef __cplusplus
extern "C" {
#endif // __cplusplus

/**
 * The library's release, like "0.1.0".
 */
const char *joulebus_version(void);

/**
 * The schema version of the payloads that the library writes and reads.
 */
uint32_t joulebus_schema_version(void);

/**
 * Refuses a program whose header is not of this library's release, with both versions. What opens
 * a handle checks it.
 *
 * @param header JOULEBUS_HEADER.
 */
joulebus_error joulebus_check_version(const char *header);

/**
 * The message of the last call that failed in this thread: what was found, what is allowed, what
 * to do, with the words of the Rust library. NULL if none has failed. Valid until the next call
 * that fails in this thread.
 */
const char *joulebus_last_error(void);

/**
 * The name of an error, like "thread", or "unknown" of another number.
 */
const char *joulebus_error_name(int32_t error);

/**
 * The name of a diagnostic's alarm, like "BatteryLow".
 */
const char *joulebus_alarm_name(uint16_t code);

/**
 * The name of the reason why a robot has no forecast, like "NotFinite": the detail of
 * JOULEBUS_QUALITY_INVALID.
 */
const char *joulebus_invalid_name(uint16_t code);

/**
 * The name of a diagnostic's level, like "warn".
 */
const char *joulebus_level_name(uint16_t code);

/**
 * The time of all stamps: the host's monotonic clock (CLOCK_MONOTONIC), ns.
 */
uint64_t joulebus_monotonic_ns(void);

/**
 * Joins the fleet of a config file as a source of samples. The worker need not run.
 *
 * @param header      JOULEBUS_HEADER.
 * @param config_path The fleet's config file.
 * @param source_name 1 to 128 bytes that tell the sources of a fleet apart and stay the same over
 *                    restarts.
 * @param publisher   The new handle.
 */
joulebus_error joulebus_publisher_open(const char *header,
                                       const char *config_path,
                                       const char *source_name,
                                       struct joulebus_publisher **publisher);

/**
 * Sends one frame: each robot at most once, numbered and stamped with the current time. Never
 * blocks. When the worker is too slow, the oldest frame is overwritten, and the worker counts it.
 * Values are sent unchecked: what is not finite or beyond the platform's limits is refused by the
 * worker, counted by reason.
 *
 * @param robots      The robots' states. NULL if count is 0.
 * @param count       How many.
 * @param intended_ns When the frame was due, monotonic ns: latencies are measured from there. 0:
 *                    now.
 * @param sent        The frame that was sent. NULL if it is not wanted.
 */
joulebus_error joulebus_publisher_publish(struct joulebus_publisher *publisher,
                                          const struct joulebus_robot_state *robots,
                                          size_t count,
                                          uint64_t intended_ns,
                                          struct joulebus_sent *sent);

/**
 * Same as joulebus_publisher_publish, for samples with the caller's own numbers and stamps: for
 * recordings and simulations. Do not mix both for the same robot: seq and stamp_ns of each must
 * increase strictly.
 */
joulebus_error joulebus_publisher_publish_samples(struct joulebus_publisher *publisher,
                                                  const joulebus_sample *samples,
                                                  size_t count,
                                                  uint64_t intended_ns,
                                                  struct joulebus_sent *sent);

/**
 * Reads the publisher's counts.
 */
joulebus_error joulebus_publisher_get_counts(struct joulebus_publisher *publisher,
                                             struct joulebus_publisher_counts *counts);

/**
 * Reads which samples of this run the worker refuses, and why: another source has the robots, a
 * newer process of the same name has taken over, a value is out of range. The worker tells it
 * twice a second in a file, which this reads: call it now and then. Without a worker on this host
 * nothing is known.
 */
joulebus_error joulebus_publisher_get_not_taken(struct joulebus_publisher *publisher,
                                                struct joulebus_not_taken *not_taken);

/**
 * Leaves the fleet. A worker that has not noticed this source yet takes none of its frames. NULL
 * is closed already.
 */
joulebus_error joulebus_publisher_close(struct joulebus_publisher *publisher);

/**
 * Joins the fleet of a config file as a subscriber. The worker need not run.
 *
 * @param header      JOULEBUS_HEADER.
 * @param config_path The fleet's config file.
 * @param name        1 to 128 bytes, shown to operators. Need not be unique.
 * @param subscriber  The new handle.
 */
joulebus_error joulebus_subscriber_open(const char *header,
                                        const char *config_path,
                                        const char *name,
                                        struct joulebus_subscriber **subscriber);

/**
 * Waits for a frame that was not returned before, the worker's end, a frame that is too old, or a
 * signal. Of several frames it returns the newest. Skipped ones are counted. Frames stay where
 * they are in shared memory: the event's pointers are valid until the next call of
 * joulebus_subscriber_wait, joulebus_subscriber_latest or joulebus_subscriber_close with this
 * subscriber.
 *
 * @param timeout_ns Time to wait, ns. UINT64_MAX for ever, 0 not at all.
 * @param event      What happened.
 */
joulebus_error joulebus_subscriber_wait(struct joulebus_subscriber *subscriber,
                                        uint64_t timeout_ns,
                                        struct joulebus_event *event);

/**
 * A descriptor that is readable when joulebus_subscriber_wait is likely to have something to
 * return, for event loops: a frame has arrived, or the worker's process has exited. When it is
 * readable, call joulebus_subscriber_wait with a time of 0 until it returns
 * JOULEBUS_EVENT_KIND_TIMED_OUT. Call it as well where it has not been readable for
 * look_within_ns, since it tells nothing of a worker that is silent, and may miss a frame that
 * arrives while an earlier one is read. It belongs to the subscriber, and must not be closed.
 *
 * @param descriptor     To be polled for reading only.
 * @param look_within_ns Longest time to wait for it from now on, ns. At most 100 ms.
 */
joulebus_error joulebus_subscriber_readiness(struct joulebus_subscriber *subscriber,
                                             int32_t *descriptor,
                                             uint64_t *look_within_ns);

/**
 * The newest frame, without waiting, whether or not it was returned before. Its header is NULL
 * until the first has arrived. Pointers are valid as of joulebus_subscriber_wait.
 */
joulebus_error joulebus_subscriber_latest(struct joulebus_subscriber *subscriber,
                                          struct joulebus_forecasts *frame);

/**
 * One robot of the frame that was returned last, in constant time while no robots join or leave.
 * NULL if it is not in the frame, or the frame was taken. Valid as of joulebus_subscriber_wait.
 */
joulebus_error joulebus_subscriber_robot(struct joulebus_subscriber *subscriber,
                                         uint32_t robot,
                                         const joulebus_forecast **row);

/**
 * Takes the frame that was returned last out of the subscriber, to keep it: there is no current
 * frame then until a newer one arrives. Its pointers stay valid, and its rows as they are, until
 * joulebus_frame_close, also after the subscriber is closed and the worker has ended. Two may be
 * kept. With more, reading is an error until one is closed. A closed subscriber keeps its place
 * (readers.max_planners) until its frames are closed. Without a frame, JOULEBUS_ERROR_NO_FRAME.
 *
 * @param frame The new handle.
 * @param view  The frame that is kept. NULL if it is not wanted.
 */
joulebus_error joulebus_subscriber_take_current(struct joulebus_subscriber *subscriber,
                                                struct joulebus_frame **frame,
                                                struct joulebus_forecasts *view);

/**
 * Gives a kept frame back. NULL is closed already.
 */
joulebus_error joulebus_frame_close(struct joulebus_frame *frame);

/**
 * The fleet's newest diagnostics, without waiting. The first call opens them: frames sent from
 * then on are read. The header is NULL until the first has arrived. Valid until the next call of
 * this function, or joulebus_subscriber_close.
 */
joulebus_error joulebus_subscriber_diagnostics(struct joulebus_subscriber *subscriber,
                                               struct joulebus_diagnostics *frame);

/**
 * The fleet's newest budgets, without waiting. The first call opens them: frames sent before are
 * read as soon as the worker sends again. The header is NULL until the first has arrived. Valid
 * until the next call of this function, or joulebus_subscriber_close.
 */
joulebus_error joulebus_subscriber_budgets(struct joulebus_subscriber *subscriber,
                                           struct joulebus_budgets *frame);

/**
 * The fleet's newest outlooks, without waiting: the energy that each robot will draw if it goes on
 * as it does. The first call opens them, and the worker computes them from the next tick on, until
 * joulebus_subscriber_close. The header is NULL until the first has arrived. Valid until the next
 * call of this function, or joulebus_subscriber_close.
 */
joulebus_error joulebus_subscriber_outlooks(struct joulebus_subscriber *subscriber,
                                            struct joulebus_outlooks *frame);

/**
 * The worker as seen by the last call that read, and what was counted.
 */
joulebus_error joulebus_subscriber_get_status(struct joulebus_subscriber *subscriber,
                                              struct joulebus_subscriber_status *status);

/**
 * Leaves the fleet, unless frames are kept: these stay as they are, and the process a member in
 * the subscriber's place, until they are closed. NULL is closed already.
 */
joulebus_error joulebus_subscriber_close(struct joulebus_subscriber *subscriber);

/**
 * Joins the fleet of a config file as a planner that asks, and loads the models that the config
 * names. The worker writes what plans start from while there is one: keep it for as long as there
 * are questions.
 *
 * @param header      JOULEBUS_HEADER.
 * @param config_path The fleet's config file, the worker's.
 * @param name        1 to 128 bytes, shown to operators.
 * @param questions   The new handle.
 */
joulebus_error joulebus_questions_open(const char *header,
                                       const char *config_path,
                                       const char *name,
                                       struct joulebus_questions **questions);

/**
 * Waits until the newest frame is at most two ticks old, and returns its tick and its age. After
 * the time, those of the frame that there is.
 *
 * @param timeout_ns Time to wait, ns.
 * @param tick       Tick of the newest frame.
 * @param age_ns     Its age, ns.
 * @return JOULEBUS_ERROR_NO_FRAME if nothing has arrived.
 */
joulebus_error joulebus_questions_wait(struct joulebus_questions *questions,
                                       uint64_t timeout_ns,
                                       uint64_t *tick,
                                       uint64_t *age_ns);

/**
 * The platform of a robot, as the config describes it. Of one that belongs to none,
 * JOULEBUS_ERROR_QUESTION.
 */
joulebus_error joulebus_questions_platform(struct joulebus_questions *questions,
                                           uint32_t robot,
                                           struct joulebus_platform *platform);

/**
 * The energy of each of several sequences of commands of one robot, and whether it makes them, as
 * of the newest frame. Allocates nothing after the first call with so many candidates.
 *
 * @param candidates  Number of sequences.
 * @param steps       Steps of each, at most 1,000,000.
 * @param period_s    Time that each command is in force, s.
 * @param v_mps       candidates * steps linear velocities, m/s, candidate by candidate.
 * @param omega_radps As many angular velocities, rad/s.
 * @param coverage    Coverage of the intervals, 0.5 to 0.999.
 * @param answers     Memory for candidates answers.
 * @param power_w     Memory for candidates * steps powers, W, candidate by candidate. NULL if they
 *                    are not wanted.
 */
joulebus_error joulebus_questions_what_if(struct joulebus_questions *questions,
                                          uint32_t robot,
                                          size_t candidates,
                                          size_t steps,
                                          float period_s,
                                          const float *v_mps,
                                          const float *omega_radps,
                                          float coverage,
                                          joulebus_answer_row *answers,
                                          float *power_w);

/**
 * Answers a question as of the newest frame.
 *
 * @param question What is asked.
 * @param answers  Memory for the answers. Filled with what they are of.
 */
joulebus_error joulebus_questions_ask(struct joulebus_questions *questions,
                                      const struct joulebus_question *question,
                                      struct joulebus_answers *answers);

/**
 * Leaves the fleet. NULL is closed already.
 */
joulebus_error joulebus_questions_close(struct joulebus_questions *questions);

/**
 * Joins the fleet of a config file as a program that asks. Loads no models. The worker need not
 * run yet.
 *
 * @param header      JOULEBUS_HEADER.
 * @param config_path The fleet's config file.
 * @param name        1 to 128 bytes, shown to operators.
 * @param client      The new handle.
 */
joulebus_error joulebus_client_open(const char *header,
                                    const char *config_path,
                                    const char *name,
                                    struct joulebus_client **client);

/**
 * Asks the worker, and waits for its answer. If the worker ends meanwhile, this returns at once. A
 * question has at most JOULEBUS_MAX_QUERY_ROBOTS robots, JOULEBUS_MAX_QUERY_CANDIDATES candidates
 * and JOULEBUS_MAX_QUERY_VALUES values.
 *
 * @param question   What is asked.
 * @param timeout_ns Time to wait, ns. Later the worker does not answer any more.
 * @param answers    Memory for the answers. Filled with what they are of. Powers that do not fit
 *                   into a frame are left out: power_count is 0 then.
 */
joulebus_error joulebus_client_ask(struct joulebus_client *client,
                                   const struct joulebus_question *question,
                                   uint64_t timeout_ns,
                                   struct joulebus_answers *answers);

/**
 * States a robot's battery in the name of a person, as `joulebus battery` does. Returns when the
 * worker has taken it: its next tick counts from there.
 *
 * @param statement  JOULEBUS_SAMPLE_SOC, JOULEBUS_SAMPLE_FULL or JOULEBUS_SAMPLE_SWAPPED: it was
 *                   measured, it is full, or it was exchanged.
 * @param soc        The state of charge that was measured, 0 to 1.
 * @param by         Who states it, shown to operators and in captures.
 * @param timeout_ns Time to wait, ns.
 */
joulebus_error joulebus_client_state_battery(struct joulebus_client *client,
                                             uint32_t robot,
                                             uint32_t statement,
                                             float soc,
                                             const char *by,
                                             uint64_t timeout_ns);

/**
 * Leaves the fleet. NULL is closed already.
 */
joulebus_error joulebus_client_close(struct joulebus_client *client);

/**
 * Opens a model file of joulebus (.safetensors), or a built-in model (builtin:NAME).
 *
 * @param header    JOULEBUS_HEADER.
 * @param model     Its path or name. NULL: builtin:gternal-sim.
 * @param predictor The new handle. Any thread may use it, also several at once.
 */
joulebus_error joulebus_predictor_open(const char *header,
                                       const char *model,
                                       struct joulebus_predictor **predictor);

/**
 * Forecasts of rows of features, W. Bits are those of every other way to compute them. A NaN in a
 * row makes that row's forecast NaN and changes no other.
 *
 * @param features rows * width values: v, omega, their derivatives, their magnitudes, the last
 *                 five readings, newest first (m, rad, s, W). Of width 13 also the age of the
 *                 newest reading in steps, and 1 where the next is due, else 0.
 * @param rows     Robots.
 * @param width    11 or 13. 13 is not copied.
 * @param power_w  Memory for rows forecasts.
 */
joulebus_error joulebus_predictor_predict(struct joulebus_predictor *predictor,
                                          const float *features,
                                          size_t rows,
                                          size_t width,
                                          float *power_w);

/**
 * Energy and power of command sequences, in open loop: the network is fed with its own forecasts.
 *
 * @param rollout  The commands, and what each robot starts from.
 * @param energy_j Memory for robots * candidates energies, J.
 * @param power_w  Memory for robots * candidates * steps powers, W, in the order of the commands.
 *                 NULL if they are not wanted.
 */
joulebus_error joulebus_predictor_rollout(struct joulebus_predictor *predictor,
                                          const struct joulebus_rollout *rollout,
                                          float *energy_j,
                                          float *power_w);

/**
 * A number that is equal for equal models, on every machine.
 */
joulebus_error joulebus_predictor_hash(struct joulebus_predictor *predictor, uint64_t *hash);

/**
 * Closes a predictor, by any thread. Calls that use it meanwhile are finished. NULL is closed
 * already.
 */
joulebus_error joulebus_predictor_close(struct joulebus_predictor *predictor);

#ifdef __cplusplus
}  // extern "C"
#endif  // __cplusplus

#endif  /* JOULEBUS_H */
