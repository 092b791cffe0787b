//! The outputs of a tick as one table. Shards write the rows, the worker sends them, and the
//! verification of captures computes them again.

use std::slice;

use joulebus_wire::{
    Budget, BudgetHeader, Budgets, Channel, Diagnostic, DiagnosticHeader, Diagnostics, Forecast,
    ForecastHeader, Forecasts, Outlook, OutlookHeader, Outlooks, PlanState, PlanStateHeader,
    PlanStates,
};

use crate::fleet::Fleet;

/// A channel to which a tick sends a frame with a row for each robot.
pub trait Output: Channel {
    /// The fields of a header that samples and settings determine. The others are those of a
    /// process, and of the times at which it sends.
    const COMPUTED: &'static [&'static str];

    /// The header of its frame beside this one of the forecasts, without the times of sending.
    fn header(fleet: &Fleet, forecasts: &ForecastHeader) -> Self::Header;

    /// Its row of the robot at `place` (0 to [`Fleet::len`] − 1), as of the last tick. A
    /// [`crate::Shard`] writes those of all robots faster.
    fn row(fleet: &Fleet, place: usize) -> Self::Row;
}

/// Is called with each output by [`each_output`].
pub trait ForEachOutput {
    /// Takes an output.
    fn output<O: Output>(&mut self);
}

impl Output for Forecasts {
    const COMPUTED: &'static [&'static str] = &[
        "model_hash",
        "capacity",
        "frames_taken",
        "first_intended_ns",
        "first_sent_ns",
        "first_taken_ns",
        "compute_start_ns",
        "samples_accepted",
        "samples_dropped",
    ];

    fn header(_: &Fleet, forecasts: &ForecastHeader) -> ForecastHeader {
        *forecasts
    }

    fn row(fleet: &Fleet, place: usize) -> Forecast {
        fleet.forecast(place)
    }
}

/// Output of [`crate::Shard::run`]: slices of the shard's length, or empty ones for outputs that
/// are left out.
#[derive(Debug, Default)]
pub struct Outputs<'a> {
    /// Forecasts.
    pub forecasts: &'a mut [Forecast],
    /// The others.
    pub secondary: SecondaryOutputs<'a>,
}

impl Outputs<'_> {
    /// The first `robots` of each, and the rest. A shorter slice, which is not to be written,
    /// belongs to the first.
    pub fn split_at(self, robots: usize) -> (Self, Self) {
        let (forecasts, more_forecasts) = split(self.forecasts, robots);
        let (secondary, more_secondary) = self.secondary.split_at(robots);
        (
            Outputs { forecasts, secondary },
            Outputs { forecasts: more_forecasts, secondary: more_secondary },
        )
    }
}

fn split<T>(rows: &mut [T], robots: usize) -> (&mut [T], &mut [T]) {
    let robots = robots.min(rows.len());
    rows.split_at_mut(robots)
}

/// Declares the outputs beside the forecasts: the name of the rows, the channel, the row, its
/// function of [`Fleet`], and of the header the fields that are computed, and how.
macro_rules! secondary {
    ($($(#[doc = $doc:literal])* $rows:ident: $channel:ident, $row:ident, $get:ident,
        $computed:expr, |$fleet:ident, $forecasts:ident| $header:ident { $($fields:tt)* };)*
    ) => {
        /// Output of [`crate::Shard::account`]: slices of the shard's length, or empty ones for
        /// outputs that are left out.
        #[derive(Debug, Default)]
        pub struct SecondaryOutputs<'a> {
            $($(#[doc = $doc])* pub $rows: &'a mut [$row],)*
        }

        impl<'a> SecondaryOutputs<'a> {
            pub(crate) fn places(self) -> SecondaryRows<'a> {
                SecondaryRows { $($rows: self.$rows.iter_mut(),)* }
            }

            fn split_at(self, robots: usize) -> (Self, Self) {
                $(let $rows = split(self.$rows, robots);)*
                (Self { $($rows: $rows.0,)* }, Self { $($rows: $rows.1,)* })
            }
        }

        /// Places of the outputs of the second pass that are still to be written. None of an
        /// omitted one.
        pub(crate) struct SecondaryRows<'a> {
            $(pub $rows: slice::IterMut<'a, $row>,)*
        }

        /// Memory for the outputs of a tick, for who does not send them.
        #[derive(Debug, Clone)]
        pub struct OutputRows {
            /// Forecasts.
            pub forecasts: Vec<Forecast>,
            $($(#[doc = $doc])* pub $rows: Vec<$row>,)*
        }

        impl OutputRows {
            /// For so many robots.
            #[must_use]
            pub fn new(robots: usize) -> Self {
                Self {
                    forecasts: vec![Forecast::default(); robots],
                    $($rows: vec![$row::default(); robots],)*
                }
            }

            /// All of them, for the first `robots`.
            pub fn outputs(&mut self, robots: usize) -> Outputs<'_> {
                Outputs {
                    forecasts: &mut self.forecasts[..robots],
                    secondary: SecondaryOutputs { $($rows: &mut self.$rows[..robots],)* },
                }
            }
        }

        $(impl Output for $channel {
            const COMPUTED: &'static [&'static str] = &$computed;

            fn header($fleet: &Fleet, $forecasts: &ForecastHeader) -> $header {
                let ForecastHeader { schema, pid, worker_epoch, tick, .. } = *$forecasts;
                $header { schema, pid, worker_epoch, tick, $($fields)* }
            }

            fn row(fleet: &Fleet, place: usize) -> $row {
                fleet.$get(place)
            }
        })*

        /// Calls `each` with all outputs, the forecasts first.
        pub fn each_output(each: &mut impl ForEachOutput) {
            each.output::<Forecasts>();
            $(each.output::<$channel>();)*
        }
    };
}

secondary! {
    /// Diagnostics.
    diagnostics: Diagnostics, Diagnostic, diagnostic, ["refused", "platforms"],
        |fleet, _forecasts| DiagnosticHeader {
            refused: fleet.refusals(),
            platforms: fleet.platform_memories(),
        };
    /// Budgets.
    budgets: Budgets, Budget, budget, [],
        |_fleet, _forecasts| BudgetHeader { ..BudgetHeader::default() };
    /// Starts of plans.
    plan_states: PlanStates, PlanState, plan_state,
        ["settings_hash", "model_hash", "models", "compute_start_ns"],
        |fleet, forecasts| PlanStateHeader {
            period_ns: forecasts.period_ns,
            settings_hash: fleet.settings_hash(),
            model_hash: forecasts.model_hash,
            models: fleet.model_hashes(),
            compute_start_ns: forecasts.compute_start_ns,
            ..PlanStateHeader::default()
        };
    /// Outlooks.
    outlooks: Outlooks, Outlook, outlook, ["model_hash", "compute_start_ns"],
        |_fleet, forecasts| OutlookHeader {
            period_ns: forecasts.period_ns,
            model_hash: forecasts.model_hash,
            compute_start_ns: forecasts.compute_start_ns,
            ..OutlookHeader::default()
        };
}
