//! The connection of a source to its fleet.

use std::fmt;
use std::path::Path;

use joulebus_bus::{Bus, SampleWriter, SendError, WaitError, clock, process_id};
use joulebus_config::Config;
use joulebus_config::settings::RefusedSample;
use joulebus_connect::refusals::{Refusals, Refused};
use joulebus_connect::{ConnectError, join};
use joulebus_wire::{SCHEMA_VERSION, Sample, SampleHeader, fnv1a, sample_flag};

use crate::RobotState;
use crate::not_taken::NotTaken;
use crate::state::Registry;
use crate::watch::Watch;

/// A source of samples: a fleet controller, a bridge, a simulation, a recording.
///
/// Stays connected while the worker ends and restarts. Belongs to one thread.
///
/// ```no_run
/// use joulebus_publisher::{Publisher, RobotState};
///
/// # fn main() -> Result<(), Box<dyn std::error::Error>> {
/// let mut publisher = Publisher::connect("configs/fleet.toml", "fleet-controller")?;
/// let sent = publisher.publish([RobotState::new(7).command(0.2, 0.0).reading(4.6)])?;
/// if sent.readers == 0 {
///     println!("no worker runs yet");
/// }
/// if let Some(refused) = &sent.first_refused {
///     println!("{} samples are refused: {refused}", sent.refused);
/// }
/// if let Some(not_taken) = &sent.not_taken {
///     println!("{not_taken}"); // for example another source has the robots
/// }
/// # Ok(())
/// # }
/// ```
pub struct Publisher {
    writer: SampleWriter,
    registry: Registry,
    config: Config,
    // Reused allocation.
    samples: Vec<Sample>,
    header: SampleHeader,
    // Frames begun, sent or not: distinguishes a robot given twice from one in a refused frame.
    attempts: u64,
    frames_sent: u64,
    samples_sent: u64,
    watch: Option<Watch>,
    // After the port, which must be dropped before the process leaves the domain.
    _bus: Bus,
}

/// A frame that was sent.
///
/// [`Publisher`] has an example.
#[derive(Debug)]
#[non_exhaustive]
pub struct Sent {
    /// Processes connected as readers: 0 means that no worker runs.
    pub readers: usize,
    /// Samples in it.
    pub samples: usize,
    /// Its number within this run of the source, from 0.
    pub frame_seq: u64,
    /// Error that left the worker asleep, if any. The worker takes the frame at its next tick all
    /// the same.
    pub not_woken: Option<WaitError>,
    /// Samples of it that the worker refuses for their values, by the config's limits. They are
    /// sent all the same, so that the worker counts them and raises `OutOfRange`.
    pub refused: usize,
    /// The first of them, with the reason.
    pub first_refused: Option<RefusedSample>,
    /// Samples of this run that the worker has refused, if it still does. Of a publisher that
    /// judges, some two seconds old. [`Publisher::refusals`] has all reasons.
    pub not_taken: Option<NotTaken>,
}

impl Publisher {
    /// Joins the fleet of the config file at `config_path` as `source_name`. The worker need not
    /// run.
    ///
    /// `source_name`, 1 to 128 bytes, distinguishes the sources of a fleet and must stay the same
    /// over restarts: the worker lets a source's next run publish for its robots. The monotonic
    /// clock at their beginning distinguishes the runs, so setting the wall clock changes nothing.
    ///
    /// # Errors
    /// [`ConnectError`] with the cause and the remedy.
    pub fn connect(config_path: impl AsRef<Path>, source_name: &str) -> Result<Self, ConnectError> {
        Self::with_config(&Config::load(config_path)?, source_name)
    }

    /// Same as [`Publisher::connect`], with a loaded config.
    ///
    /// # Errors
    /// [`ConnectError`].
    pub fn with_config(config: &Config, source_name: &str) -> Result<Self, ConnectError> {
        let mut publisher = Self::without_judgement(config, source_name)?;
        // Without a thread nothing is judged, and everything is published.
        let run = (publisher.source_id(), publisher.source_epoch());
        publisher.watch = Watch::start(config, source_name, run).ok();
        Ok(publisher)
    }

    /// Same as [`Publisher::with_config`], but its samples raise no alarm `Implausible`. For
    /// programs that judge by themselves, or replay known data.
    ///
    /// # Errors
    /// [`ConnectError`].
    pub fn without_judgement(config: &Config, source_name: &str) -> Result<Self, ConnectError> {
        let limits = config.limits();
        let bus = join(config, source_name)?;
        let writer = bus.sample_writer(&limits, limits.capacity)?;
        let header = SampleHeader {
            schema: SCHEMA_VERSION,
            pid: process_id(),
            source_id: fnv1a(source_name.bytes()),
            source_epoch: clock::monotonic_ns(),
            ..SampleHeader::default()
        };
        Ok(Self {
            writer,
            registry: Registry::new(limits.capacity),
            config: config.clone(),
            samples: Vec::new(),
            header,
            attempts: 0,
            frames_sent: 0,
            samples_sent: 0,
            watch: None,
            _bus: bus,
        })
    }

    /// Sends one frame: each robot at most once, numbered and stamped with the current time.
    ///
    /// # Errors
    /// [`PublishError`]. Nothing was sent.
    pub fn publish(
        &mut self,
        robots: impl IntoIterator<Item = RobotState>,
    ) -> Result<Sent, PublishError> {
        self.publish_intended(clock::monotonic_ns(), robots)
    }

    /// Same as [`Publisher::publish`], for a frame that was due at `intended_ns` (monotonic):
    /// [`crate::Slot::intended_ns`]. Latencies are measured from there, so that a stalled source
    /// does not hide its own delay.
    ///
    /// # Errors
    /// [`PublishError`]. Nothing was sent.
    pub fn publish_intended(
        &mut self,
        intended_ns: u64,
        robots: impl IntoIterator<Item = RobotState>,
    ) -> Result<Sent, PublishError> {
        self.publish_stamped(intended_ns, clock::monotonic_ns(), robots)
    }

    /// Same as [`Publisher::publish_intended`], stamped with `now_ns`: for a simulation, whose time
    /// passes at another rate. `measured_ns` of states is on the same clock. Stamps of a robot rise
    /// all the same, by 1 ns where `now_ns` does not.
    ///
    /// # Errors
    /// [`PublishError`]. Nothing was sent.
    pub fn publish_stamped(
        &mut self,
        intended_ns: u64,
        now_ns: u64,
        robots: impl IntoIterator<Item = RobotState>,
    ) -> Result<Sent, PublishError> {
        let allowed = self.writer.max_len();
        self.attempts += 1;
        self.samples.clear();
        let mut robots = robots.into_iter();
        while let Some(state) = robots.next() {
            if self.samples.len() == allowed {
                let found = allowed + 1 + robots.count();
                return Err(PublishError::TooMany { found, allowed });
            }
            let Some(mut sample) = self.registry.sample(&state, self.attempts, now_ns) else {
                return Err(PublishError::DuplicateRobot { robot: state.robot });
            };
            if self.watch.as_ref().is_some_and(|watch| watch.doubts(state.robot)) {
                sample = sample.with(sample_flag::IMPLAUSIBLE);
            }
            self.samples.push(sample);
            if let Some(watch) = &mut self.watch {
                watch.add(&state, now_ns);
            }
        }
        if let Some(watch) = &mut self.watch {
            watch.hand_over();
        }
        let samples = std::mem::take(&mut self.samples);
        let sent = self.publish_samples(intended_ns, &samples);
        self.samples = samples;
        sent
    }

    /// Sends samples unchanged, with the caller's own numbers and stamps: for recordings and
    /// simulations. `intended_ns` as in [`Publisher::publish_intended`]. Do not mix with
    /// [`Publisher::publish`] for the same robot: `seq` and `stamp_ns` of each must increase
    /// strictly.
    ///
    /// # Errors
    /// [`PublishError`]. Nothing was sent.
    pub fn publish_samples(
        &mut self,
        intended_ns: u64,
        samples: &[Sample],
    ) -> Result<Sent, PublishError> {
        let allowed = self.writer.max_len();
        if samples.len() > allowed {
            let found = samples.len();
            return Err(PublishError::TooMany { found, allowed });
        }
        let header = SampleHeader {
            frame_seq: self.frames_sent,
            samples_before: self.samples_sent,
            intended_ns,
            sent_ns: clock::monotonic_ns(),
            sent_unix_ns: clock::unix_ns(),
            ..self.header
        };
        let sent = self.writer.send(header, samples.len(), |i| samples[i])?;
        self.frames_sent += 1;
        self.samples_sent += samples.len() as u64;
        let mut refusals =
            samples.iter().filter_map(|sample| self.config.settings().refusal(sample));
        let first_refused = refusals.next();
        let refused = refusals.count() + usize::from(first_refused.is_some());
        Ok(Sent {
            readers: sent.readers,
            samples: samples.len(),
            frame_seq: header.frame_seq,
            not_woken: sent.not_woken,
            refused,
            first_refused,
            not_taken: self.watch.as_ref().and_then(Watch::not_taken),
        })
    }

    /// The samples of this run that the worker has refused, by reason, the most frequent first. Reads
    /// a file of the fleet's directory, which the worker's process writes twice a second. Empty
    /// without a worker on this host.
    #[must_use]
    pub fn refusals(&self) -> Vec<Refused> {
        Refusals::of_source(&self.config, (self.source_id(), self.source_epoch()))
    }

    /// Frames sent in this run.
    pub const fn frames_sent(&self) -> u64 {
        self.frames_sent
    }

    /// Samples sent in this run: the sum of those that the worker accepts and drops.
    pub const fn samples_sent(&self) -> u64 {
        self.samples_sent
    }

    /// Maximum number of samples per frame: the fleet's capacity.
    pub const fn capacity(&self) -> usize {
        self.writer.max_len()
    }

    /// Id of the source, as in [`SampleHeader::source_id`]: the 64-bit FNV-1a hash of its name.
    pub const fn source_id(&self) -> u64 {
        self.header.source_id
    }

    /// When this run of the source began, monotonic ns.
    pub const fn source_epoch(&self) -> u64 {
        self.header.source_epoch
    }

    /// Connections to workers that failed or broke: such workers miss frames.
    pub fn degraded(&self) -> u64 {
        self.writer.degraded()
    }
}

impl fmt::Debug for Publisher {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        out.debug_struct("Publisher")
            .field("source_id", &self.source_id())
            .field("source_epoch", &self.source_epoch())
            .field("frames_sent", &self.frames_sent)
            .field("samples_sent", &self.samples_sent)
            .field("capacity", &self.capacity())
            .finish_non_exhaustive()
    }
}

/// Errors of publishing a frame.
///
/// ```no_run
/// # use joulebus_publisher::{PublishError, Publisher, RobotState};
/// # fn example(publisher: &mut Publisher, fleet: &[RobotState]) {
/// match publisher.publish(fleet.iter().copied()) {
///     Ok(_) => {}
///     Err(PublishError::DuplicateRobot { robot }) => panic!("{robot} is in the fleet twice"),
///     // Every further frame would fail: join again.
///     Err(PublishError::Send(error)) if error.is_final() => panic!("{error}"),
///     // It names the remedy. The publisher remains usable.
///     Err(error) => eprintln!("{error}"),
/// }
/// # }
/// ```
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
#[allow(missing_docs)] // The messages name the fields.
pub enum PublishError {
    /// More samples than the capacity of the fleet.
    #[error(
        "a frame of {found} samples, allowed are {allowed}. Raise `fleet.capacity` in the config \
         of all processes of the fleet"
    )]
    TooMany { found: usize, allowed: usize },
    /// A robot occurs twice in a frame.
    #[error("robot {robot} is in the frame twice. Give each robot its own id, once per frame")]
    DuplicateRobot { robot: u32 },
    /// The bus refused the frame.
    #[error(transparent)]
    Send(#[from] SendError),
}
