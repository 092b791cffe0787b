//! The file of a link as it is written. Unknown keys are refused where they stand.

use serde::Deserialize;
use toml::{Spanned, Value};

use crate::protocol::carried::Carried;

/// A text with its place.
pub(super) type Text = Spanned<String>;

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct LinkFile {
    /// Of this host's link, unlike all others of the fleet.
    pub(super) name: Text,
    /// File of the fleet's shards, the same on all hosts; without it one worker has all robots.
    pub(super) shards: Option<Text>,
    pub(super) network: NetworkSection,
    pub(super) clock: Option<ClockSection>,
    pub(super) worker: Option<WorkerSection>,
    pub(super) samples: Option<SamplesSection>,
    pub(super) follow: Option<FollowSection>,
    pub(super) lease: Option<LeaseSection>,
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct NetworkSection {
    #[serde(default)]
    pub(super) mode: ModeWord,
    /// Addresses of others, as zenoh writes them.
    #[serde(default)]
    pub(super) connect: Vec<Text>,
    /// Addresses of this host.
    #[serde(default)]
    pub(super) listen: Vec<Text>,
    /// Allows addresses of other hosts without TLS.
    #[serde(default)]
    pub(super) unencrypted: bool,
    pub(super) tls: Option<TlsSection>,
}

/// What keeps the clocks of all hosts.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct ClockSection {
    /// The most by which the realtime clocks of two hosts differ.
    pub(super) realtime_within_s: Spanned<f64>,
}

#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "snake_case")]
pub(super) enum ModeWord {
    /// Connects to other links, and is connected to.
    #[default]
    Peer,
    /// Connects to a router.
    Client,
}

/// Files beside the link's own, or with absolute names.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct TlsSection {
    /// Certificate of the fleet's own authority.
    pub(super) ca: Text,
    /// Certificate of this host.
    pub(super) certificate: Text,
    /// Its private key, mode 0600.
    pub(super) key: Text,
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct WorkerSection {
    /// Hosts whose samples are taken.
    #[serde(default)]
    pub(super) take: Vec<TakeSection>,
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct TakeSection {
    /// Name of the link there.
    pub(super) from: Text,
    /// The robots of that host; without it all.
    pub(super) robots: Option<Vec<Value>>,
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct SamplesSection {
    /// Name of the worker's link; of a fleet with shards each robot has its own.
    pub(super) to: Option<Text>,
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct FollowSection {
    /// Name of the worker's link; of a fleet with shards all are followed.
    pub(super) worker: Option<Text>,
    #[serde(default = "services")]
    pub(super) services: Vec<Carries>,
    /// Every how many ticks.
    #[serde(default = "one")]
    pub(super) every: u32,
    /// Which robots; without it all.
    pub(super) robots: Option<Vec<Value>>,
}

fn services() -> Vec<Carries> {
    vec![Carries::Diagnostics, Carries::Budgets, Carries::PlanStates]
}

const fn one() -> u32 {
    1
}

/// What a planner's host may leave out; forecasts always come.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "snake_case")]
pub(super) enum Carries {
    Diagnostics,
    Budgets,
    PlanStates,
    Ticks,
}

impl Carries {
    pub(super) const fn carried(self) -> Carried {
        match self {
            Self::Diagnostics => Carried::DIAGNOSTICS,
            Self::Budgets => Carried::BUDGETS,
            Self::PlanStates => Carried::PLAN_STATES,
            Self::Ticks => Carried::TICKS,
        }
    }
}

/// etcd, by which one of the workers of a shard serves.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct LeaseSection {
    /// Addresses of its members.
    pub(super) endpoints: Vec<Text>,
    /// Time after which a host that says nothing has lost its shard.
    #[serde(default = "three")]
    pub(super) ttl_s: u32,
    /// What its keys begin with.
    #[serde(default = "prefix")]
    pub(super) prefix: Text,
    /// Certificate of its authority; without it those of the network.
    pub(super) ca: Option<Text>,
    /// Certificate of this host.
    pub(super) certificate: Option<Text>,
    /// Its private key, mode 0600.
    pub(super) key: Option<Text>,
    pub(super) user: Option<Text>,
    /// File with the user's password, mode 0600.
    pub(super) password: Option<Text>,
}

const fn three() -> u32 {
    3
}

fn prefix() -> Text {
    Spanned::new(0..0, "joulebus/".to_owned())
}

/// The file of the shards.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct ShardsFile {
    pub(super) shard: Vec<ShardSection>,
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct ShardSection {
    pub(super) name: Text,
    /// Names of the links of its worker, and of those that stand by.
    pub(super) workers: Vec<Text>,
    /// Which robots; in no shard, or in all.
    pub(super) robots: Option<Vec<Value>>,
}
