#![doc = include_str!("../README.md")]
#![forbid(unsafe_code)]

mod acknowledgement;
mod alarm_card;
mod budget;
mod channel;
mod description;
mod diagnostic;
mod forecast;
mod hash;
mod journal;
mod layout;
mod outlook;
mod plan_state;
mod platform_memory;
mod query;
mod reason;
mod sample;
mod service;
mod state;
mod statement;

pub use acknowledgement::{
    Acknowledgement, AcknowledgementHeader, MAX_ACKNOWLEDGED, MAX_ACKNOWLEDGED_BY, MAX_NAME_BYTES,
    text,
};
pub use alarm_card::AlarmCard;
pub use budget::{Budget, BudgetHeader, CHARGE_TENTHS, ChargeState, budget_flag};
pub use channel::{
    Acknowledgements, Budgets, Channel, Diagnostics, Flow, ForEachChannel, Forecasts, FrameHeader,
    FrameOrder, FrameRows, Outlooks, PlanStates, Queries, Samples, SentIn, State, Ticks,
    each_channel,
};
pub use description::{Constant, Constants, constants, layouts};
pub use diagnostic::{Alarm, AlarmSet, Diagnostic, DiagnosticHeader, Level, diagnostic_flag};
pub use forecast::{Forecast, ForecastHeader, Quality, forecast_flag};
pub use hash::{combine_hashes, fnv1a};
pub use journal::{TakenFrame, TickHeader, tick_flag};
pub use layout::{FieldLayout, FieldRole, FieldType, Payload, Row, StructLayout, declare};
pub use outlook::{OUTLOOK_HORIZONS, OUTLOOK_S, Outlook, OutlookHeader, outlook_flag};
pub use plan_state::{LISTED_MODELS, PlanState, PlanStateHeader, plan_state_flag};
pub use platform_memory::{PlatformMemory, platform_flag};
pub use query::{
    ANSWER_RULES, AnswerHeader, AnswerRow, MAX_ANSWER_WORDS, MAX_QUERY_CANDIDATES,
    MAX_QUERY_ROBOTS, MAX_QUERY_STEPS, MAX_QUERY_VALUES, MAX_RECORD_WORDS, QueriesHeader,
    QueryCounts, QueryHeader, QueryKind, QueryRecord, QueryRefusal, ROW_WORDS, Record, TICK_RULES,
    answer_flag, answer_parts, push_record, query_flag, records,
};
pub use reason::{DropCounts, DropReason, InvalidReason, Refusal};
pub use sample::{Freshness, Sample, SampleHeader, sample_flag};
pub use service::{Service, WakeEvent, service_name};
pub use state::StateHeader;
pub use statement::Statement;

/// Version of every payload in this crate. A frame with another version is refused and counted.
pub const SCHEMA_VERSION: u32 = 4;
