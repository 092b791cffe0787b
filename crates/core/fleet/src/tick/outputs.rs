//! The memory of a tick's outputs, and the table of those beside the forecasts.

use std::slice;

use joulebus_wire::{Budget, Diagnostic, Forecast, Outlook, PlanState};

/// The table of the outputs beside the forecasts, which `$declare` gets: the name of the rows, the
/// channel, the row, its function of the fleet, the fields of the header that samples and settings
/// determine, and the header beside that of the forecasts. The other fields are those of a process,
/// and of the times at which it sends.
#[macro_export]
macro_rules! secondary_outputs {
    ($declare:ident) => {
        $declare! {
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
    };
}
pub(crate) use secondary_outputs;

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

/// Declares the memory of the outputs.
macro_rules! memory {
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
    };
}

secondary_outputs!(memory);
