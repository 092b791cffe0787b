//! Reasons that a tick or a frame could not be recomputed or compared.

use std::fmt;

use serde::Serialize;

/// Reason that a tick could not be recomputed or compared.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
pub enum Loss {
    /// Its journal was not recorded.
    Journal,
    /// A frame of samples that it took was not recorded.
    Samples {
        /// Its source.
        source_id: u64,
        /// Its number.
        frame_seq: u64,
    },
    /// The tick took a frame of which the capture has several that differ, or one of another
    /// length. A process sends in the source's name, and nothing shows which frame the worker took.
    Ambiguous {
        /// Its source.
        source_id: u64,
        /// Its number.
        frame_seq: u64,
    },
    /// The tick took more frames than a journal lists.
    Unlisted,
    /// One of its outputs was not recorded.
    Output,
    /// The capture has several frames of this channel that differ. Nothing shows which of them was
    /// sent.
    Differing(&'static str),
    /// A frame of this channel belongs to no tick that could have sent it.
    Stray(&'static str),
    /// No keyframe was recorded between the last loss and it.
    NoKeyframe,
    /// It lies before the first keyframe of a recording that began in the middle.
    Before,
    /// The tick took a frame that was sent before the recording began.
    Beginning,
    /// The recording, or the worker, ended with it.
    End,
    /// It lacks parts like the last tick of a run, and others followed.
    NotTheEnd,
    /// It was computed by older rules, by which the channel has other bits.
    OlderRules(u32),
    /// A refusal for reasons of time: a deadline, a client or a worker that ended.
    ByTime,
    /// A refusal for a reason that the capture does not prove.
    Unproven,
    /// People make it, and it follows from no sample.
    ByPeople,
    /// An answer by the rules of another version.
    OtherAnswers,
    /// The capture states that ticks were computed by these rules, and keyframes or the rules of
    /// answers deny it.
    Rules(u32),
    /// A kind or a refusal that is not defined, or that what is recorded denies.
    Undefined,
    /// A keyframe that begins a range of ticks: it is taken as given.
    Given,
    /// A keyframe of a tick that was not recomputed.
    NotRecomputed,
    /// A keyframe of a tick that the capture does not have, or that came long after its tick.
    NoTick,
    /// A keyframe with a missing piece.
    Broken,
    /// A keyframe of another config, model or version.
    Refused,
}

impl Loss {
    /// True if no recording could have avoided it.
    pub(super) const fn is_excused(self) -> bool {
        matches!(
            self,
            Self::Before
                | Self::Beginning
                | Self::End
                | Self::OlderRules(_)
                | Self::Given
                | Self::ByTime
                | Self::ByPeople
                | Self::OtherAnswers
        )
    }

    /// The reason in a few words, the same for all frames.
    pub(super) fn reason(self) -> String {
        match self {
            Self::Journal => "the journal was not recorded".to_owned(),
            Self::Samples { .. } => "samples were not recorded".to_owned(),
            Self::Ambiguous { .. } => "several frames of samples have one number".to_owned(),
            Self::Unlisted => "the journal was full".to_owned(),
            Self::Output => "not recorded".to_owned(),
            Self::Differing(_) => "several frames differ".to_owned(),
            Self::Stray(_) => "sent in no tick".to_owned(),
            Self::NoKeyframe => "no keyframe before".to_owned(),
            Self::Before | Self::Beginning => "before the first keyframe".to_owned(),
            Self::End => "cut off at the end".to_owned(),
            Self::NotTheEnd => "it lacks parts as if the run ended, and others follow".to_owned(),
            Self::OlderRules(rules) => format!("computed by older rules ({rules})"),
            Self::ByTime => "refused for reasons of time".to_owned(),
            Self::Unproven => "refused for a reason that the capture does not prove".to_owned(),
            Self::ByPeople => "made by people, follows from no sample".to_owned(),
            Self::OtherAnswers => "computed by the rules of another version".to_owned(),
            Self::Rules(rules) => format!(
                "the capture states rules {rules}, and its keyframes or the rules of its answers deny it"
            ),
            Self::Undefined => "a kind or refusal that cannot be".to_owned(),
            Self::Given => "taken as given".to_owned(),
            Self::NotRecomputed => "its tick was not recomputed".to_owned(),
            Self::NoTick => "of no recorded tick".to_owned(),
            Self::Broken => "a piece is missing".to_owned(),
            Self::Refused => "refused".to_owned(),
        }
    }
}

impl fmt::Display for Loss {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Journal => write!(out, "its journal was not recorded"),
            Self::Samples { source_id, frame_seq } => {
                write!(out, "frame {frame_seq} of source {source_id:016x} was not recorded")
            }
            Self::Ambiguous { source_id, frame_seq } => write!(
                out,
                "other frames claim to be frame {frame_seq} of source {source_id:016x}: another process sends in its name"
            ),
            Self::Unlisted => write!(out, "it took more frames than a journal lists"),
            Self::Output => write!(out, "its output was not recorded"),
            Self::Differing(channel) => write!(
                out,
                "the capture has several frames of {channel} that differ: which one was sent is not known"
            ),
            Self::Stray(channel) => {
                write!(
                    out,
                    "a frame of {channel} came long after it, or its journal denies the frame"
                )
            }
            Self::NoKeyframe => write!(out, "no keyframe before it"),
            Self::Beginning => write!(out, "it took frames sent before the recording began"),
            Self::End => write!(out, "the recording ends there"),
            Self::NoTick => write!(out, "a keyframe names it, and it is not in the capture"),
            other => write!(out, "{}", other.reason()),
        }
    }
}
