//! What the robots of a platform have shown together, and whether its model fits them.

use crate::declare::ZeroCopySend;
use crate::layout::bits;
use crate::rows;

bits! {
    /// Bits of [`PlatformMemory::flags`].
    pub mod platform_flag {
        /// The model states what the robots of its training drew.
        pub const TRAINED: u32 = 1 << 0;
        /// It also states what commands cost.
        pub const COMMANDS: u32 = 1 << 1;
        /// The next robot starts from its last reading, not from the model's forecast.
        pub const FROM_LAST: u32 = 1 << 2;
    }
}

rows! {
    /// What the robots of a platform have shown together. 36 bytes, all 0 where there is none.
    pub struct PlatformMemory: "joulebus.PlatformMemory.v1", 36, 4 {
        /// [`platform_flag`] bits.
        pub flags: u32,
        /// Known robots, at most 32.
        pub robots: f32,
        /// Median of the mean powers of the robots, in that of the training. 0 without one.
        pub drawn: f32,
        /// The same as a prior of the next robot. No robot alone moves it by more than 5 %, so it
        /// stays near 1 in a small fleet.
        pub power: f32,
        /// How far commands explain the power: 1 as far as in the training, 0 not at all.
        pub command_trust: f32,
        /// Squared error of the first forecasts above that of the last reading, in the variance of
        /// the model's errors.
        pub start_excess: f32,
        /// NaN: no longer remembered.
        pub scatter: f32,
        /// Median power of the robots, in that of their commands. 0 while fewer than eight are known.
        pub level: f32,
        /// Relative standard deviation of that power between robots.
        pub spread: f32,
    }
}

impl PlatformMemory {
    /// A robot that draws this many times the power of its model, or that part of it, is of another
    /// kind ([`crate::Alarm::ModelMismatch`]).
    pub const UNLIKE: f32 = 4.0;
    /// Known robots from which the platform is judged.
    pub const ENOUGH: f32 = 6.0;

    /// Whether the model fits these robots, in a sentence for people. Says what is missing if that
    /// is not known.
    #[must_use]
    pub fn sentence(&self) -> String {
        let has = |flag: u32| self.flags & flag != 0;
        if !has(platform_flag::TRAINED) {
            return "The model states no power of a training, so whether it fits is not known."
                .to_owned();
        }
        let trained = "of what its model was trained on";
        let is_known = (self.robots >= Self::ENOUGH) & (self.drawn > 0.0);
        if !is_known {
            let so_far = if self.drawn > 0.0 {
                format!(" So far they draw {:.2} {trained}.", self.drawn)
            } else {
                String::new()
            };
            let (robots, enough) = (self.robots.max(0.0).round(), Self::ENOUGH);
            return format!(
                "Whether the model fits is known after half a minute of {enough} robots. {robots} \
                 have shown what they draw.{so_far}"
            );
        }
        let like = (self.drawn <= Self::UNLIKE) & (self.drawn * Self::UNLIKE >= 1.0);
        let unlike = if like { "" } else { " That is another kind of robot (ModelMismatch)." };
        let commands = if has(platform_flag::COMMANDS) {
            format!("Commands explain {:.2} of what they did there", self.command_trust)
        } else {
            "The model reads no commands".to_owned()
        };
        let start = if has(platform_flag::FROM_LAST) { "last reading" } else { "model's forecast" };
        format!(
            "This fleet draws {:.2} {trained}.{unlike} {commands}. New robots start from their {start}.",
            self.drawn
        )
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_sentence_says_whether_the_model_fits_or_what_is_missing() {
        let trained = platform_flag::TRAINED | platform_flag::COMMANDS;
        let of = |flags: u32, robots: f32, drawn: f32| {
            let known = PlatformMemory { flags, robots, drawn, ..PlatformMemory::default() };
            PlatformMemory { command_trust: 0.2, ..known }.sentence()
        };
        for (found, expected) in [
            (
                of(trained | platform_flag::FROM_LAST, 19.6, 0.83),
                "This fleet draws 0.83 of what its model was trained on. Commands explain 0.20 of \
                 what they did there. New robots start from their last reading.",
            ),
            (
                of(platform_flag::TRAINED, 20.0, 18.0),
                "This fleet draws 18.00 of what its model was trained on. That is another kind of \
                 robot (ModelMismatch). The model reads no commands. New robots start from their \
                 model's forecast.",
            ),
            (
                of(trained, 2.9, 1.5),
                "Whether the model fits is known after half a minute of 6 robots. 3 have shown what \
                 they draw. So far they draw 1.50 of what its model was trained on.",
            ),
            (
                of(trained, f32::NAN, f32::NAN),
                "Whether the model fits is known after half a minute of 6 robots. 0 have shown \
                 what they draw.",
            ),
            (
                of(0, 20.0, 1.0),
                "The model states no power of a training, so whether it fits is not known.",
            ),
        ] {
            assert_eq!(found, expected);
        }
        for unknown in [0.0, f32::NAN] {
            assert!(of(trained, 20.0, unknown).starts_with("Whether"), "{unknown} is not fine");
        }
    }
}
