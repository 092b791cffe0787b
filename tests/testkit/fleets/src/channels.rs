//! A channel that joulebus does not have, declared as those of `wire`: tests send it everywhere.

use joulebus_wire::declare::ZeroCopySend;
use joulebus_wire::{Channel, Flow, FrameRows, Service, frame_header, rows};

rows! {
    /// How a robot's radio is received.
    pub struct Signal: "joulebus.Signal.v1", 24 {
        /// Id of the robot.
        pub robot: u32,
        /// Its access point.
        pub access_point: u32,
        /// When it was measured, monotonic ns.
        #[instant]
        pub stamp_ns: u64,
        /// Received power, dBm.
        pub level_dbm: f32,
        /// Noise, dBm.
        pub noise_dbm: f32,
    }

    /// Header of a frame of signals.
    #[derive(Eq)]
    pub struct SignalHeader: "joulebus.SignalHeader.v1", 40 {
        /// [`joulebus_wire::SCHEMA_VERSION`].
        pub schema: u32,
        /// Process id of the worker.
        pub pid: u32,
        /// Run of the worker.
        #[run]
        pub worker_epoch: u64,
        /// Number of the tick.
        pub tick: u64,
        /// When the frame was sent, monotonic ns.
        #[instant]
        pub sent_ns: u64,
        /// When the frame was sent, Unix ns.
        pub sent_unix_ns: u64,
    }
}

/// How the robots' radios are received, from the worker.
#[derive(Debug, Clone, Copy)]
pub struct Signals;

impl Channel for Signals {
    const SERVICE: Service = Service::named("signals");
    const MESSAGE: &'static str = "Signals";
    const FLOW: Flow = Flow::Planners { kept: 0, history: 1, on_demand: false };
    const ROWS: FrameRows = FrameRows::Robots;
    type Header = SignalHeader;
    type Row = Signal;
}

frame_header!(SignalHeader { order: worker_epoch, tick; sent: sent_ns, sent_unix_ns; });
