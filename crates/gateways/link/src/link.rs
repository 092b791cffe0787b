//! `joulebus link`: starts the threads, waits for the stop, and reports.

use std::fmt;
use std::thread;
use std::time::Duration;

use crate::arguments::{LinkArguments, LinkVerb};
use anyhow::Context as _;
use joulebus_bus::{check_threads, clock, yield_to_the_worker};
use joulebus_config::Config;
use joulebus_program::exit::{Outcome, UsageError};
use joulebus_program::output::{Output, log_line};
use joulebus_program::stop::Stop;
use serde::Serialize;

use crate::certificates::{self, CertificateReport};
use crate::config::{Mode, Settings, Side};
use crate::network::{Network, NetworkError, Peers};
use crate::protocol::carried::{max_message_bytes, max_state_message_bytes};
use crate::refusals::Refusals;
use crate::report::{Done, EgressRecord, IngressRecord};
use crate::threads::{HostClaim, Threads};
use crate::{init, rmw, tls_causes, tls_workaround};

/// Interval between checks for a stop. The main thread does nothing else.
const POLL_INTERVAL: Duration = Duration::from_millis(100);
/// Pause before the next attempt to reach a router.
const RETRY_ROUTER_NS: u64 = 500_000_000;
/// Nice value of all threads, so that the worker and its sources run first.
const NICE: u8 = 5;
/// A certificate that expires sooner is warned of.
const WARN_DAYS: i64 = 30;

/// The report of a link that has ended.
#[derive(Debug, Serialize)]
struct LinkReport {
    fleet: String,
    link: String,
    given: Vec<EgressRecord>,
    taken: Vec<IngressRecord>,
    /// Refused requests, by reason.
    refused: Refusals,
}

/// The report of `--check`.
#[derive(Debug, Serialize)]
struct CheckReport {
    fleet: String,
    link: String,
    mode: &'static str,
    connect: Vec<String>,
    listen: Vec<String>,
    encrypted: bool,
    certificate: Option<CertificateReport>,
    /// Links whose samples are taken, or whose outputs are followed.
    takes: Vec<String>,
    /// Links that get the samples published here.
    gives: Vec<String>,
    /// Links of the other candidates.
    stands_by_with: Vec<String>,
    /// The etcd members of the lease.
    lease: Vec<String>,
}

pub(crate) fn run(args: &LinkArguments, output: Output) -> anyhow::Result<Outcome> {
    match &args.verb {
        Some(LinkVerb::Init(init)) => return init::run(init, output),
        Some(LinkVerb::RmwZenoh) => return rmw::run(),
        None => {}
    }
    let file = args.file.as_deref().context("clap requires a file")?;
    check_threads()?;
    let config = args.config.load()?;
    let settings = Settings::load(file, &config)?;
    let certificate = match &settings.network.tls {
        Some(tls) => Some(certificates::check(tls, &settings.name)),
        None => None,
    };
    if args.check {
        let certificate = certificate.transpose();
        let certificate = certificate.map_err(|error| UsageError(format!("{error:#}")))?;
        output.report(&checked(&config, &settings, certificate))?;
        return Ok(Outcome::Done);
    }
    if settings.network.tls.is_some() {
        // Restart before signals are caught. A signal in between then still ends the program.
        tls_workaround::begin();
    }
    let stop = Stop::on_signals()?;
    match certificate {
        Some(Err(error)) => tracing::warn!("{error:#}"),
        Some(Ok(certificate)) if certificate.days_left < WARN_DAYS => {
            tracing::warn!("the certificate expires in {} days", certificate.days_left);
        }
        _ => {}
    }
    yield_to_the_worker(NICE);
    let claim = HostClaim::take(&config, &settings)?;
    let Some(network) = open(&config, &settings, &stop)? else {
        return Ok(Outcome::Done);
    };
    let threads = Threads::start(&config, &settings, claim, network)?;
    log_line(&format!("link {} of fleet {} is open", settings.name, config.fleet()));
    while !stop.is_asked() && !threads.have_ended() {
        thread::sleep(POLL_INTERVAL);
        threads.network().reopen_if_split();
        tls_causes::take().iter().for_each(|cause| tracing::warn!("{cause}"));
    }
    let Done { given, taken, refused } = threads.finish()?;
    let fleet = config.fleet().to_owned();
    let report = LinkReport { fleet, link: settings.name, given, taken, refused };
    let lost = report.is_lossy();
    output.report(&report)?;
    Ok(Outcome::unless_lost(lost))
}

fn checked(
    config: &Config,
    settings: &Settings,
    certificate: Option<CertificateReport>,
) -> CheckReport {
    let network = &settings.network;
    let (takes, gives) = match &settings.side {
        Side::Worker(takes) => (takes.iter().map(|take| take.from.clone()).collect(), Vec::new()),
        Side::Other { samples, follow } => (
            follow.iter().flat_map(|follow| follow.workers.clone()).collect(),
            samples.clone().unwrap_or_default(),
        ),
    };
    CheckReport {
        fleet: config.fleet().to_owned(),
        link: settings.name.clone(),
        mode: network.mode.name(),
        connect: network.connect.clone(),
        listen: network.listen.clone(),
        encrypted: network.tls.is_some(),
        certificate,
        takes,
        gives,
        stands_by_with: settings
            .standby
            .iter()
            .flat_map(|standby| standby.others.clone())
            .collect(),
        lease: settings
            .standby
            .iter()
            .flat_map(|standby| standby.lease.endpoints.clone())
            .collect(),
    }
}

/// Opens the network. A client retries until a router answers or a stop is requested.
fn open(config: &Config, settings: &Settings, stop: &Stop) -> anyhow::Result<Option<Network>> {
    let of = (config.fleet(), settings.name.as_str());
    let capacity = config.limits().capacity;
    let max_message_bytes = match settings.standby {
        Some(_) => max_state_message_bytes(capacity),
        None => max_message_bytes(capacity),
    };
    let candidates = settings.standby.iter().flat_map(|standby| &standby.others);
    let peers = match &settings.side {
        Side::Worker(takes) => Peers {
            is_worker: true,
            samples_from: takes.iter().map(|take| take.from.as_str()).collect(),
            outputs_from: candidates.map(String::as_str).collect(),
            ..Peers::default()
        },
        Side::Other { samples, follow } => Peers {
            samples_to: samples.iter().flatten().map(String::as_str).collect(),
            outputs_from: follow
                .iter()
                .flat_map(|follow| follow.workers.iter().map(String::as_str))
                .collect(),
            ..Peers::default()
        },
    };
    let mut is_logged = false;
    while !stop.is_asked() {
        match Network::open(&settings.network, of, &peers, max_message_bytes) {
            Err(NetworkError::Open { .. }) if settings.network.mode == Mode::Client => {
                if !is_logged {
                    let router = settings.network.connect.join(", ");
                    tracing::warn!("no router answers at {router}: waiting for one");
                }
                is_logged = true;
                stop.sleep_until(clock::monotonic_ns() + RETRY_ROUTER_NS);
            }
            opened => return Ok(Some(opened?)),
        }
    }
    Ok(None)
}

impl LinkReport {
    /// True if frames were lost or refused. Frames dropped on a slow link count, because planners
    /// did not get them.
    fn is_lossy(&self) -> bool {
        let given = self.given.iter();
        self.refused.total() > 0
            || given.clone().any(|egress| egress.sent.dropped > 0 || egress.sent.unheard > 0)
            || self.taken.iter().any(|IngressRecord { received, refused, .. }| {
                received.lost > 0
                    || received.dropped > 0
                    || received.future > 0
                    || refused.total() > 0
            })
    }
}

impl fmt::Display for LinkReport {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        writeln!(out, "link {} of fleet {}", self.link, self.fleet)?;
        for EgressRecord { to, sent } in &self.given {
            writeln!(
                out,
                "sent {to} {} frames, {} bytes; {} left out for newer ones, {} not acknowledged",
                sent.frames, sent.bytes, sent.dropped, sent.unheard
            )?;
        }
        for taken in &self.taken {
            let received = &taken.received;
            writeln!(
                out,
                "received {} frames, {} bytes from {}; {} lost, {} left out there, {} repeated, {} \
                 runs, {} silences",
                received.frames,
                received.bytes,
                taken.from,
                received.lost,
                received.dropped,
                received.repeated,
                received.runs,
                received.silences
            )?;
            if let Some(uncertainty_s) = taken.clock_uncertainty_s {
                writeln!(
                    out,
                    "clock of {}: within {:.3} ms, {} refits, {} steps",
                    taken.from,
                    uncertainty_s * 1e3,
                    taken.clock_refits,
                    taken.clock_steps
                )?;
            }
            for (reason, count) in taken.refused.iter() {
                writeln!(out, "refused of {}: {count} ({reason})", taken.from)?;
            }
        }
        self.refused
            .iter()
            .try_for_each(|(reason, count)| writeln!(out, "refused requests: {count} ({reason})"))
    }
}

impl fmt::Display for CheckReport {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        let way = if self.encrypted { "encrypted" } else { "not encrypted" };
        writeln!(out, "link {} of fleet {}: {}, {way}", self.link, self.fleet, self.mode)?;
        if let Some(CertificateReport { name, addresses, days_left }) = &self.certificate {
            let at = addresses.join(", ");
            writeln!(out, "certificate of {name}, to be reached as {at}: {days_left} days left")?;
        }
        for (what, list) in [
            ("connects to", &self.connect),
            ("listens on", &self.listen),
            ("takes from", &self.takes),
            ("gives samples to", &self.gives),
            ("stands by with", &self.stands_by_with),
            ("asks for a lease", &self.lease),
        ] {
            if !list.is_empty() {
                writeln!(out, "{what} {}", list.join(", "))?;
            }
        }
        Ok(())
    }
}
