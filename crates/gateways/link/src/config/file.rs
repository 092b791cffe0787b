//! The link's file as TOML structures. Unknown keys are refused, with their line.

use serde::Deserialize;
use toml::{Spanned, Value};

use crate::protocol::carried::Carried;

/// A text with its position in the file.
pub(super) type Text = Spanned<String>;

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct LinkFile {
    /// Name of this host's link, unique in the fleet.
    pub(super) name: Text,
    /// File of the fleet's shards, the same on all hosts. Without it one worker has all robots.
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
    /// Addresses of peers, in zenoh's notation.
    #[serde(default)]
    pub(super) connect: Vec<Text>,
    /// Addresses that this host listens on, in zenoh's notation.
    #[serde(default)]
    pub(super) listen: Vec<Text>,
    /// Allow addresses of other hosts without TLS.
    #[serde(default)]
    pub(super) unencrypted: bool,
    pub(super) tls: Option<TlsSection>,
}

/// What the operator states about the realtime clocks of all hosts.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct ClockSection {
    /// Upper bound of the difference between the realtime clocks of two hosts, s.
    pub(super) realtime_within_s: Spanned<f64>,
}

#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "snake_case")]
pub(super) enum ModeWord {
    /// Connects to other links and accepts connections.
    #[default]
    Peer,
    /// Connects to a router.
    Client,
}

/// Files of mutual TLS: relative to the link's file, or with absolute names.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct TlsSection {
    /// Certificate of the fleet's own certificate authority.
    pub(super) ca: Text,
    /// Certificate of this host.
    pub(super) certificate: Text,
    /// Private key of this host, mode 0600.
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
    /// Name of the link on that host.
    pub(super) from: Text,
    /// Robots of that host. Without it all robots.
    pub(super) robots: Option<Vec<Value>>,
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct SamplesSection {
    /// Name of the worker's link. With shards each robot has its own.
    pub(super) to: Option<Text>,
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct FollowSection {
    /// Name of the worker's link. With shards all of them are followed.
    pub(super) worker: Option<Text>,
    #[serde(default = "services")]
    pub(super) services: Vec<Carries>,
    /// Take the frames of every n-th tick.
    #[serde(default = "one")]
    pub(super) every: u32,
    /// Robots to follow. Without it all robots.
    pub(super) robots: Option<Vec<Value>>,
}

fn services() -> Vec<Carries> {
    vec![Carries::Diagnostics, Carries::Budgets, Carries::PlanStates, Carries::Outlooks]
}

const fn one() -> u32 {
    1
}

/// Services that a planner's host may leave out. Forecasts are always carried.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "snake_case")]
pub(super) enum Carries {
    Diagnostics,
    Budgets,
    PlanStates,
    Outlooks,
    Ticks,
}

impl Carries {
    pub(super) const fn carried(self) -> Carried {
        match self {
            Self::Diagnostics => Carried::DIAGNOSTICS,
            Self::Budgets => Carried::BUDGETS,
            Self::PlanStates => Carried::PLAN_STATES,
            Self::Outlooks => Carried::OUTLOOKS,
            Self::Ticks => Carried::TICKS,
        }
    }
}

/// The etcd cluster that elects the leader of a shard.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct LeaseSection {
    /// Addresses of the etcd members.
    pub(super) endpoints: Vec<Text>,
    /// Time to live of the lease, s. A host that does not renew within it loses its shard.
    #[serde(default = "three")]
    pub(super) ttl_s: u32,
    /// Prefix of the keys in etcd.
    #[serde(default = "prefix")]
    pub(super) prefix: Text,
    /// Certificate of etcd's authority. Without it the authority of `[network]`.
    pub(super) ca: Option<Text>,
    /// Certificate of this host.
    pub(super) certificate: Option<Text>,
    /// Private key of this host, mode 0600.
    pub(super) key: Option<Text>,
    pub(super) user: Option<Text>,
    /// File with the password of etcd's user, mode 0600.
    pub(super) password: Option<Text>,
}

const fn three() -> u32 {
    3
}

fn prefix() -> Text {
    Spanned::new(0..0, "joulebus/".to_owned())
}

/// The file of the fleet's shards.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct ShardsFile {
    pub(super) shard: Vec<ShardSection>,
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct ShardSection {
    pub(super) name: Text,
    /// Names of the links of the shard's worker and its standbys.
    pub(super) workers: Vec<Text>,
    /// Robots of the shard. Either every shard lists its robots, or none does.
    pub(super) robots: Option<Vec<Value>>,
}
