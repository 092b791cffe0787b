//! Reasons that a sample was not accepted, and that a robot has no forecast.

use crate::declare::ZeroCopySend;
use crate::layout::names;
use crate::rows;

/// Reason that a sample was dropped. Sent = accepted + dropped, summed over all reasons.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[non_exhaustive]
pub enum DropReason {
    /// The robot belongs to no platform of the config.
    UnknownRobot,
    /// The fleet is at its capacity.
    OverCapacity,
    /// Another source owns the robot.
    ForeignSource,
    /// From a run of the source that a newer run has replaced.
    OldEpoch,
    /// Already accepted: the same robot, epoch and sequence number.
    Duplicate,
    /// The sequence number is lower than one already accepted.
    OutOfOrder,
    /// The stamp does not advance, or jumps further than allowed.
    BadTime,
    /// NaN or infinite although its flag marks it as known.
    NotFinite,
    /// The power lies outside the platform's limits.
    PowerOutOfRange,
    /// The command lies outside the platform's limits.
    CommandOutOfRange,
    /// Unknown flag bits, flags that contradict each other, or a non-zero reserved field.
    BadFlags,
    /// More samples of one robot in one tick than allowed.
    Backlog,
    /// Overwritten in the buffer before the worker took it, as known from the frame header.
    Overflow,
    /// The frame has another schema version.
    Schema,
    /// Sent before the worker was connected, as known from the frame header.
    BeforeJoin,
    /// More sources than the worker tracks.
    TooManySources,
    /// The state of charge or the energy to return lies outside its limits.
    BatteryOutOfRange,
}

names! {
    /// All reasons. The position is the index into [`DropCounts`].
    pub DropReason:
        UnknownRobot OverCapacity ForeignSource OldEpoch Duplicate OutOfOrder BadTime NotFinite
        PowerOutOfRange CommandOutOfRange BadFlags Backlog Overflow Schema BeforeJoin
        TooManySources BatteryOutOfRange
}

impl DropReason {
    /// What the source can do about it.
    #[must_use]
    pub const fn remedy(self) -> &'static str {
        match self {
            Self::UnknownRobot => "no platform of the config has it: see platform.robots",
            Self::OverCapacity => "the fleet is full: raise fleet.capacity for all its processes",
            Self::ForeignSource => {
                "another source publishes for this robot: end one of the two. Robots of a source \
                 that has ended are free at once"
            }
            Self::OldEpoch => {
                "a newer process with this source's name has taken over: end one of the two, or \
                 give each a name of its own"
            }
            Self::Duplicate | Self::OutOfOrder => {
                "the numbers of a robot's samples must rise: let one publisher number them"
            }
            Self::BadTime => "stamps must rise, by at most intake.max_jump_s",
            Self::NotFinite => "leave out what is unknown",
            Self::PowerOutOfRange => {
                "see unit and sign, then platform.power_min_w and platform.power_max_w"
            }
            Self::CommandOutOfRange => {
                "see the units, then platform.v_max_mps and platform.omega_max_radps"
            }
            Self::BadFlags => "set only known flags that agree with each other",
            Self::Backlog => "publish less often, or raise intake.max_samples_per_tick",
            Self::Overflow => {
                "the worker was late: raise intake.buffer_frames, see joulebus doctor"
            }
            Self::Schema => "use one release of joulebus for all processes of the fleet",
            Self::BeforeJoin => "they were sent before the worker knew this source",
            Self::TooManySources => "end a source, or raise intake.max_sources",
            Self::BatteryOutOfRange => "a state of charge is 0 to 1, not percent",
        }
    }
}

rows! {
    /// Refusals of one robot for one reason, as reported to operators. 16 bytes.
    #[derive(Eq)]
    pub struct Refusal: "joulebus.Refusal", 16, 4 {
        /// Robot id stated in the samples.
        pub robot: u32,
        /// Position of the reason in [`DropReason::ALL`] plus 1. 0 for an empty entry.
        pub reason: u32,
        /// Process id of the sending source.
        pub pid: u32,
        /// Samples refused since the entry was last assigned.
        pub count: u32,
    }
}

impl Refusal {
    /// The reason, unless the entry is empty or this version does not know it.
    pub fn reason(&self) -> Option<DropReason> {
        let position = usize::try_from(self.reason).ok()?.checked_sub(1)?;
        DropReason::ALL.get(position).copied()
    }
}

rows! {
    /// Samples dropped, one counter per [`DropReason`], with spare counters for later versions.
    #[derive(Eq)]
    pub struct DropCounts: "joulebus.DropCounts", 192 {
        /// Indexed by the reason's position in [`DropReason::ALL`].
        pub counts: [u64; 24],
    }
}

impl DropCounts {
    /// Counts `samples` more.
    pub const fn add(&mut self, reason: DropReason, samples: u64) {
        let count = &mut self.counts[reason as usize];
        *count = count.saturating_add(samples);
    }

    /// Samples dropped for `reason`.
    #[must_use]
    pub const fn get(&self, reason: DropReason) -> u64 {
        self.counts[reason as usize]
    }

    /// Samples dropped for any reason.
    pub fn total(&self) -> u64 {
        self.counts.iter().fold(0, |sum, count| sum.saturating_add(*count))
    }

    /// Counts since `earlier`, or all counts when `earlier` is of another run.
    #[must_use]
    pub fn since(&self, earlier: &Self) -> Self {
        let mut newer = Self::default();
        for (newer, (now, before)) in
            newer.counts.iter_mut().zip(self.counts.iter().zip(&earlier.counts))
        {
            *newer = now.checked_sub(*before).unwrap_or(*now);
        }
        newer
    }

    /// The reasons that occurred, with their counts.
    pub fn iter(&self) -> impl Iterator<Item = (DropReason, u64)> + '_ {
        DropReason::ALL
            .into_iter()
            .map(|reason| (reason, self.get(reason)))
            .filter(|(_, count)| *count > 0)
    }
}

/// Reason that a robot has no forecast.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[non_exhaustive]
pub enum InvalidReason {
    /// No sample for longer than `stale_after`.
    Stale,
    /// Its last sample was refused: NaN or infinite.
    NotFinite,
    /// Its last sample was refused: power outside the platform's limits.
    PowerOutOfRange,
    /// Its last sample was refused: command outside the platform's limits.
    CommandOutOfRange,
    /// Its last sample was refused: unknown flags.
    BadFlags,
    /// Its last sample was refused: a stamp that does not advance, or jumps.
    BadTime,
    /// The model needs velocities, and the samples carry none.
    NoCommand,
    /// Samples arrive without readings.
    NoReading,
    /// The model's output is not finite.
    ModelOutput,
    /// The model needs the age of readings, and two new measurements have not arrived yet.
    NoFreshness,
    /// Its last sample was refused: state of charge or energy to return outside their limits.
    BatteryOutOfRange,
    /// Written by a newer version than this reader.
    Unknown,
}

names! {
    /// All reasons, in the order of their codes.
    pub InvalidReason:
        Stale NotFinite PowerOutOfRange CommandOutOfRange BadFlags BadTime NoCommand NoReading
        ModelOutput NoFreshness BatteryOutOfRange
        ;
        Unknown
}

impl InvalidReason {
    /// The code in shared memory.
    pub const fn code(self) -> u16 {
        match self {
            Self::Unknown => u16::MAX,
            known => known as u16 + 1,
        }
    }

    /// From shared memory.
    #[must_use]
    pub const fn decode(code: u16) -> Self {
        if code >= 1 && code as usize <= Self::ALL.len() {
            Self::ALL[code as usize - 1]
        } else {
            Self::Unknown
        }
    }
}
