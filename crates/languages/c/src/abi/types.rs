//! Structs of calls. Those that lie in shared memory are `joulebus-wire`'s.
#![allow(non_camel_case_types, reason = "named as in C")]

use std::ffi::c_char;

use ::joulebus_publisher::{Charger, RobotState};
use joulebus_wire::{
    AnswerRow, Budget, BudgetHeader, Diagnostic, DiagnosticHeader, Forecast, ForecastHeader,
    Outlook, OutlookHeader, sample_flag,
};

/// Result of a call.
#[repr(i32)]
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum joulebus_error {
    /// Done.
    None = 0,
    /// A null pointer, a length, a text or a value that is not allowed.
    Argument = 1,
    /// A handle that is closed, in use by an interrupted call, or none.
    Handle = 2,
    /// A handle of another thread.
    Thread = 3,
    /// A handle of the process that forked this one.
    Process = 4,
    /// The program was compiled with the header of another release.
    Version = 5,
    /// The config, its models, joining the fleet, or a service of it. While publishing: files of this
    /// process were removed, and it must open again.
    Connect = 6,
    /// Frames could not be read, or are of another version. The next call may succeed.
    Read = 7,
    /// No frame has arrived yet.
    NoFrame = 8,
    /// A signal arrived while waiting.
    Interrupted = 9,
    /// A frame was not sent. The next may be.
    Publish = 10,
    /// A model file is refused, or does not fit the question.
    Model = 11,
    /// A question that cannot be answered: an unknown robot, a command that is not allowed.
    Question = 12,
    /// No worker answered: none runs, it has ended, or it took too long.
    Unanswered = 13,
    /// A defect of joulebus: the handle of the call is closed. Please report it.
    Defect = 14,
}

/// A source of samples.
#[derive(Debug)]
pub struct joulebus_publisher;
/// A reader of forecasts, diagnostics and budgets.
#[derive(Debug)]
pub struct joulebus_subscriber;
/// A frame of forecasts that is kept.
#[derive(Debug)]
pub struct joulebus_frame;
/// A planner that computes what plans cost.
#[derive(Debug)]
pub struct joulebus_questions;
/// A program that asks the worker what plans cost.
#[derive(Debug)]
pub struct joulebus_client;
/// A network.
#[derive(Debug)]
pub struct joulebus_predictor;

/// One robot in one control tick. Set to zero, nothing is known of it.
#[repr(C)]
#[derive(Debug, Clone, Copy, Default)]
pub struct joulebus_robot_state {
    /// Id of the robot, unique in the fleet.
    pub robot: u32,
    /// JOULEBUS_SAMPLE bits: which of the fields below are known, and HELD, CHARGING, FULL (which
    /// implies CHARGING), SWAPPED and OFF. Others are refused.
    pub flags: u32,
    /// When the power was measured, monotonic ns. 0: when the frame is published, or, for a held
    /// reading, when the repeated reading was measured.
    pub measured_ns: u64,
    /// Linear velocity just commanded, after saturation, m/s.
    pub v_mps: f32,
    /// Angular velocity just commanded, after saturation, rad/s.
    pub omega_radps: f32,
    /// Electrical power just read, W. Negative where the platform regenerates.
    pub power_w: f32,
    /// Battery voltage, V.
    pub voltage_v: f32,
    /// Battery current, A, positive while discharging.
    pub current_a: f32,
    /// Measured state of charge, 0 to 1.
    pub soc: f32,
    /// Energy that the robot needs from here to return to its charger, J.
    pub return_j: f32,
    /// 0.
    pub reserved: u32,
}

impl joulebus_robot_state {
    /// Flags that it may have.
    pub(crate) const FLAGS: u32 = sample_flag::ALL & !sample_flag::DISCONTINUITY;

    /// True if it states nothing that this release does not know.
    pub(crate) const fn is_known(&self) -> bool {
        self.flags & !Self::FLAGS == 0 && self.reserved == 0
    }
}

impl From<&joulebus_robot_state> for RobotState {
    fn from(of: &joulebus_robot_state) -> Self {
        let has = |flag| of.flags & flag != 0;
        let known = |flag, value: f32| has(flag).then_some(value);
        let mut state = Self::new(of.robot);
        state.v_mps = known(sample_flag::V, of.v_mps);
        state.omega_radps = known(sample_flag::OMEGA, of.omega_radps);
        state.power_w = known(sample_flag::POWER, of.power_w);
        state.measured_ns = (of.measured_ns != 0).then_some(of.measured_ns);
        state.voltage_v = known(sample_flag::VOLTAGE, of.voltage_v);
        state.current_a = known(sample_flag::CURRENT, of.current_a);
        state.held = has(sample_flag::HELD);
        state.soc = known(sample_flag::SOC, of.soc);
        state.return_j = known(sample_flag::RETURN, of.return_j);
        // A charger that reports "full" is connected.
        state.charger = if has(sample_flag::FULL) {
            Charger::Full
        } else if has(sample_flag::CHARGING) {
            Charger::Charging
        } else {
            Charger::Disconnected
        };
        state.swapped = has(sample_flag::SWAPPED);
        state.off = has(sample_flag::OFF);
        state
    }
}

/// A frame that was sent.
#[repr(C)]
#[derive(Debug, Clone, Copy, Default)]
pub struct joulebus_sent {
    /// Processes connected as readers: 0 means that no worker runs.
    pub readers: usize,
    /// Samples in it.
    pub samples: usize,
    /// Its number within this run of the source, from 0.
    pub frame_seq: u64,
    /// 1 if the worker was woken. It takes the frame at its next tick all the same.
    pub woken: u32,
    /// Samples of it that the worker refuses for their values, by the limits of the config.
    pub refused: u32,
}

/// Samples of a source that the worker refuses, for the most frequent reason.
#[repr(C)]
#[derive(Debug, Clone, Copy)]
pub struct joulebus_not_taken {
    /// How many in this run. 0: none is refused at present.
    pub count: u64,
    /// Reason code, as in joulebus_refusal.
    pub reason: u32,
    /// The robot of the last one.
    pub robot: u32,
    /// Reason, field, value and remedy in words, cut at the end. Empty if none is refused.
    pub text: [c_char; 320],
}

/// Counts of a publisher.
#[repr(C)]
#[derive(Debug, Clone, Copy, Default)]
pub struct joulebus_publisher_counts {
    /// Frames sent in this run.
    pub frames_sent: u64,
    /// Samples sent in this run.
    pub samples_sent: u64,
    /// Most samples in a frame: the fleet's capacity.
    pub capacity: usize,
    /// Connections to workers that failed or broke: such workers miss frames.
    pub degraded: u64,
    /// Id of the source: FNV-1a of its name, 64 bits.
    pub source_id: u64,
    /// When this run of the source began, monotonic ns.
    pub source_epoch: u64,
}

/// A frame of forecasts, in the worker's shared memory.
#[repr(C)]
#[derive(Debug, Clone, Copy)]
pub struct joulebus_forecasts {
    /// Its header. NULL if there is no frame.
    pub header: *const ForecastHeader,
    /// All robots of the frame, in no particular order.
    pub robots: *const Forecast,
    /// How many.
    pub count: usize,
    /// Ticks of this worker whose frames were skipped or lost since the last frame that was
    /// returned.
    pub ticks_missed: u64,
    /// 1 if the frame is the first of another run of the worker than the one before, else 0.
    pub restarted: u64,
}

/// A frame of diagnostics, in the worker's shared memory.
#[repr(C)]
#[derive(Debug, Clone, Copy)]
pub struct joulebus_diagnostics {
    /// Its header. NULL if there is no frame.
    pub header: *const DiagnosticHeader,
    /// All robots of the frame, in no particular order.
    pub robots: *const Diagnostic,
    /// How many.
    pub count: usize,
}

/// A frame of budgets, in the worker's shared memory.
#[repr(C)]
#[derive(Debug, Clone, Copy)]
pub struct joulebus_budgets {
    /// Its header. NULL if there is no frame.
    pub header: *const BudgetHeader,
    /// All robots of the frame, in no particular order.
    pub robots: *const Budget,
    /// How many.
    pub count: usize,
}

/// A frame of outlooks, in the worker's shared memory.
#[repr(C)]
#[derive(Debug, Clone, Copy)]
pub struct joulebus_outlooks {
    /// Its header. NULL if there is no frame.
    pub header: *const OutlookHeader,
    /// All robots of the frame, in no particular order.
    pub robots: *const Outlook,
    /// How many.
    pub count: usize,
}

/// Kinds of events.
#[repr(u32)]
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum joulebus_event_kind {
    /// No event before the time-out.
    TimedOut = 0,
    /// A frame that was not returned before.
    Frame = 1,
    /// The worker has ended. Told once.
    Gone = 2,
    /// The newest frame is older than two tick periods. Told once.
    Stale = 3,
    /// A signal arrived, and the program's own handler has run.
    Interrupted = 4,
}

/// How the end of a worker was detected.
#[repr(u32)]
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum joulebus_end {
    /// No end.
    None = 0,
    /// It said so.
    Ended = 1,
    /// Its process exited without saying so: told by the kernel, at once.
    Exited = 2,
    /// Another process found it dead: where processes cannot be watched.
    FoundDead = 3,
    /// It is on another host, from which nothing comes. The worker may run.
    Unreachable = 4,
}

/// An event of a subscriber.
#[repr(C)]
#[derive(Debug, Clone, Copy)]
pub struct joulebus_event {
    /// Kind of the event.
    pub kind: joulebus_event_kind,
    /// How the worker ended, of JOULEBUS_EVENT_KIND_GONE.
    pub end: joulebus_end,
    /// Time since the newest frame was sent, ns, of JOULEBUS_EVENT_KIND_STALE.
    pub age_ns: u64,
    /// For JOULEBUS_EVENT_KIND_FRAME.
    pub frame: joulebus_forecasts,
}

/// The worker, as seen by a subscriber.
#[repr(u32)]
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum joulebus_worker {
    /// No frame has arrived yet.
    Waiting = 0,
    /// The newest frame is at most two tick periods old.
    Alive = 1,
    /// It is older: do not rely on it.
    Stale = 2,
    /// The worker has ended.
    Gone = 3,
}

/// Status of a subscriber.
#[repr(C)]
#[derive(Debug, Clone, Copy)]
pub struct joulebus_subscriber_status {
    /// The worker, as of the last call that read.
    pub worker: joulebus_worker,
    /// How it ended.
    pub end: joulebus_end,
    /// Frames returned.
    pub frames: u64,
    /// Gaps between them.
    pub gaps: u64,
    /// Ticks missing in all gaps.
    pub ticks_missed: u64,
    /// Runs of the worker.
    pub workers: u64,
    /// Connections to workers that failed or broke: frames are missing.
    pub degraded: u64,
    /// Frames passed over because another process than the worker has sent them.
    pub foreign: u64,
}

/// A point of a path, and the speed towards it.
#[repr(C)]
#[derive(Debug, Clone, Copy, Default)]
pub struct joulebus_waypoint {
    /// East, m.
    pub x_m: f64,
    /// North, m.
    pub y_m: f64,
    /// Speed towards it, m/s. One above the platform's is refused, and infinity is the highest that
    /// the model was trained on. That of the first point is not used.
    pub speed_mps: f64,
}

/// A question about plans. Fields that its kind does not name are not read.
#[repr(C)]
#[derive(Debug, Clone, Copy)]
pub struct joulebus_question {
    /// JOULEBUS_QUERY_KIND_WHAT_IF: candidates of one robot. IDLE: robots that stand still. FOLLOW:
    /// robots that follow a path, which are answered the best first.
    pub kind: u32,
    /// JOULEBUS_QUERY_RETURN, HEADING and TOLERANCE, of FOLLOW.
    pub flags: u32,
    /// Coverage of the intervals, 0.5 to 0.999.
    pub coverage: f32,
    /// For WHAT_IF: time that each command is in force, s.
    pub period_s: f32,
    /// For IDLE: the time, s.
    pub duration_s: f32,
    /// Distance from the path within which corners are cut, m, with JOULEBUS_QUERY_TOLERANCE. Else
    /// the stairs of a grid within half a cell.
    pub tolerance_m: f32,
    /// Ids of the robots.
    pub robots: *const u32,
    /// How many. One of WHAT_IF.
    pub robot_count: usize,
    /// For WHAT_IF: number of candidates. For IDLE and FOLLOW of one robot: number of evenly spaced
    /// moments, at most 256, up to each of which its part of the plan is answered in a row of its own,
    /// after that of the whole.
    pub candidates: usize,
    /// For WHAT_IF: steps of each.
    pub steps: usize,
    /// For WHAT_IF: linear velocities, m/s, candidate by candidate.
    pub v_mps: *const f32,
    /// For WHAT_IF: angular velocities, rad/s, candidate by candidate.
    pub omega_radps: *const f32,
    /// For FOLLOW: the path. The robots are at its first point.
    pub path: *const joulebus_waypoint,
    /// For FOLLOW: its points.
    pub points: usize,
    /// Where to return to, m, with JOULEBUS_QUERY_RETURN.
    pub return_x_m: f64,
    /// Where to return to, m.
    pub return_y_m: f64,
    /// Heading at the first point, rad, counter-clockwise from east, with JOULEBUS_QUERY_HEADING.
    /// Else towards the first point that is elsewhere.
    pub heading_rad: f64,
    /// For FOLLOW: time that the robot waits at each point, s. NULL: none.
    pub dwell_s: *const f64,
    /// For FOLLOW: power that the robot draws in addition on the way to each point and while it waits
    /// there, W. NULL: none.
    pub load_w: *const f64,
    /// For FOLLOW: when the robot is at each point, s, from the first. Speeds are then upper limits.
    /// NULL: no times.
    pub time_s: *const f64,
}

/// Memory for answers, and which frames they are computed from.
#[repr(C)]
#[derive(Debug, Clone, Copy)]
pub struct joulebus_answers {
    /// Memory for an answer for each candidate or robot.
    pub rows: *mut AnswerRow,
    /// How many fit: at least as many as there are answers.
    pub row_capacity: usize,
    /// Answers written.
    pub row_count: usize,
    /// Memory for the power of every step, W, candidate by candidate, of WHAT_IF and of FOLLOW with
    /// one robot. NULL if it is not wanted.
    pub power_w: *mut f32,
    /// How many fit.
    pub power_capacity: usize,
    /// Powers there are. If more than fit, none is written.
    pub power_count: usize,
    /// Tick of the frame that the answers are computed from.
    pub tick: u64,
    /// Its age when they were computed, ns.
    pub age_ns: u64,
    /// From asking the worker to its answer, ns. 0 where this process computes.
    pub took_ns: u64,
}

/// A platform, as the fleet's config describes it.
#[repr(C)]
#[derive(Debug, Clone, Copy)]
pub struct joulebus_platform {
    /// Period of a robot's samples, s: of commands, if not said otherwise.
    pub period_s: f32,
    /// Greatest linear velocity, m/s.
    pub v_max_mps: f32,
    /// Greatest angular velocity, rad/s.
    pub omega_max_radps: f32,
    /// Least electrical power, W.
    pub power_min_w: f32,
    /// Greatest electrical power, W.
    pub power_max_w: f32,
    /// 0.
    pub reserved: u32,
    /// Capacity of the battery, J. NaN without one.
    pub capacity_j: f64,
}

/// Command sequences, for as many robots as there are starts.
#[repr(C)]
#[derive(Debug, Clone, Copy)]
pub struct joulebus_rollout {
    /// Robots.
    pub robots: usize,
    /// Candidates of each.
    pub candidates: usize,
    /// Steps of each candidate.
    pub steps: usize,
    /// Time between two steps, s.
    pub step_s: f32,
    /// 0.
    pub reserved: u32,
    /// Linear velocities, m/s: those of the first candidate of the first robot, step by step, then
    /// the next candidate.
    pub v_mps: *const f32,
    /// Angular velocities, rad/s, in the same order.
    pub omega_radps: *const f32,
    /// The last five readings of each robot, W, newest first.
    pub readings_w: *const f32,
    /// The command of each robot before the first step: v in m/s, omega in rad/s. NULL: the first
    /// step has no derivatives.
    pub before: *const f32,
}
