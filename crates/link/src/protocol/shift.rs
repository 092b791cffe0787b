//! Times of another host's frames as times of this one.
//!
//! Only instants of the monotonic clock are moved. Durations, Unix times, and the runs of sources and workers, which
//! identify them wherever they are read, stay.

use joulebus_wire::{
    Budget, BudgetHeader, Diagnostic, DiagnosticHeader, Forecast, ForecastHeader, PlanState,
    PlanStateHeader, Sample, SampleHeader, StateHeader, TakenFrame, TickHeader,
};

use crate::protocol::offset::shifted;

/// A part of a frame that has times of its host's monotonic clock.
pub(crate) trait Instants {
    /// All of them; 0 where one is not known.
    fn instants(&mut self, each: impl FnMut(&mut u64));

    /// Moves them all.
    fn shift(&mut self, offset_ns: i128) {
        self.instants(|stamp_ns| *stamp_ns = shifted(*stamp_ns, offset_ns));
    }
}

macro_rules! instants {
    ($($part:ty: $($field:ident),*;)*) => {
        $(impl Instants for $part {
            fn instants(&mut self, mut each: impl FnMut(&mut u64)) {
                $(each(&mut self.$field);)*
                // A part without instants does not use it.
                let _ = &mut each;
            }
        })*

        /// The fields that are moved, by the name of their struct.
        #[cfg(test)]
        const MOVED: &[(&str, &[&str])] = &[$((stringify!($part), &[$(stringify!($field)),*])),*];
    };
}

instants! {
    Forecast: stamp_ns, target_ns;
    ForecastHeader: first_intended_ns, first_sent_ns, first_taken_ns, compute_start_ns, compute_end_ns, sent_ns;
    Diagnostic: stamp_ns;
    DiagnosticHeader: ;
    Budget: stamp_ns, valid_until_ns;
    BudgetHeader: sent_ns;
    PlanState: stamp_ns;
    PlanStateHeader: compute_start_ns, sent_ns;
    TakenFrame: taken_ns;
    TickHeader: start_ns, sent_ns;
    Sample: stamp_ns, measured_ns;
    SampleHeader: intended_ns, sent_ns;
    StateHeader: taken_ns, sent_ns;
}

#[cfg(test)]
mod tests {
    use joulebus_wire::layouts;

    use super::*;

    /// Times that are not instants of the monotonic clock.
    const STAY: [&str; 5] = [
        "period_ns",
        "sent_unix_ns",
        "reading_age_ns",
        "metered_ns",
        "unmetered_ns",
    ];

    #[test]
    fn every_time_of_a_frame_that_crosses_is_moved_or_known_to_stay() {
        let mut seen = Vec::new();
        for layout in layouts() {
            let Some((_, moved)) = MOVED.iter().find(|(name, _)| *name == layout.name) else {
                continue;
            };
            seen.push(layout.name);
            for field in layout
                .fields
                .iter()
                .filter(|field| field.name.ends_with("_ns"))
            {
                let known = [moved.contains(&field.name), STAY.contains(&field.name)];
                assert_eq!(
                    known.iter().filter(|it| **it).count(),
                    1,
                    "{}.{}",
                    layout.name,
                    field.name
                );
            }
        }
        let unseen = MOVED.iter().map(|(name, _)| *name);
        let unseen: Vec<&str> = unseen.filter(|name| !seen.contains(name)).collect();
        // What other languages do not read is not described: their times are all in their definitions' first lines.
        assert_eq!(unseen, ["TakenFrame", "TickHeader", "StateHeader"]);
    }

    #[test]
    fn distances_between_times_stay_and_what_is_not_known_stays_so() {
        let mut row = Budget {
            stamp_ns: 1_000,
            valid_until_ns: 1_500,
            metered_ns: 70,
            ..Budget::default()
        };
        row.shift(-400);
        assert_eq!(
            (row.stamp_ns, row.valid_until_ns, row.metered_ns),
            (600, 1_100, 70)
        );
        let mut nothing = Forecast::default();
        nothing.shift(5_000);
        assert_eq!(nothing, Forecast::default());
    }
}
