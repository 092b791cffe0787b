//! Checks `[network]`.
//!
//! A link listens only where its file says so. Traffic that leaves this host is encrypted unless
//! the file allows otherwise.

use std::net::IpAddr;
use std::path::PathBuf;

use crate::config::check::Check;
use crate::config::file::{ClockSection, ModeWord, NetworkSection, Text, TlsSection};

/// Range of `clock.realtime_within_s`: from the best of PTP to what round trips reach without a
/// statement.
const REALTIME_WITHIN_S: (f64, f64) = (1e-6, 0.01);

/// How to reach other hosts.
#[derive(Debug, Clone)]
pub(crate) struct NetworkSettings {
    pub(crate) mode: Mode,
    pub(crate) connect: Vec<String>,
    pub(crate) listen: Vec<String>,
    pub(crate) tls: Option<TlsSettings>,
    /// Upper bound of the difference between the realtime clocks of two hosts. Without it realtime
    /// clocks are not used.
    pub(crate) realtime_within_ns: Option<u64>,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Mode {
    Peer,
    Client,
}

impl Mode {
    /// Zenoh's name of the mode.
    pub(crate) const fn name(self) -> &'static str {
        match self {
            Self::Peer => "peer",
            Self::Client => "client",
        }
    }
}

/// Files of mutual TLS.
#[derive(Debug, Clone)]
pub(crate) struct TlsSettings {
    pub(crate) ca: PathBuf,
    pub(crate) certificate: PathBuf,
    pub(crate) key: PathBuf,
}

impl Check<'_> {
    pub(super) fn network(
        &mut self,
        section: &NetworkSection,
        clock: Option<&ClockSection>,
    ) -> NetworkSettings {
        let mode = match section.mode {
            ModeWord::Peer => Mode::Peer,
            ModeWord::Client => Mode::Client,
        };
        if section.connect.is_empty() && (section.listen.is_empty() || mode == Mode::Client) {
            let what = "reaches nobody".to_owned();
            let remedy = "Add `connect` with the addresses of other links or of a router, or, of a peer, `listen`";
            self.problem(None, "network", what, remedy);
        }
        let mut addresses = |list: &[Text], key: &str| -> Vec<String> {
            for text in list {
                if let Err((what, remedy)) = address(text.get_ref(), section) {
                    self.problem(Some(text.span().start), key, what, remedy);
                }
            }
            list.iter().map(|text| text.get_ref().clone()).collect()
        };
        let connect = addresses(&section.connect, "network.connect");
        let listen = addresses(&section.listen, "network.listen");
        let tls = section.tls.as_ref().map(|tls| self.tls(tls));
        NetworkSettings {
            mode,
            connect,
            listen,
            tls,
            realtime_within_ns: clock.map(|clock| self.realtime(clock)),
        }
    }

    fn realtime(&mut self, section: &ClockSection) -> u64 {
        let within_s = section.realtime_within_s.get_ref();
        let (least_s, most_s) = REALTIME_WITHIN_S;
        if !(least_s <= *within_s && *within_s <= most_s) {
            let what = format!("= {within_s}");
            let remedy = format!(
                "Allowed: {least_s} to {most_s}; leave the section out where nothing keeps the clocks"
            );
            let at = Some(section.realtime_within_s.span().start);
            self.problem(at, "clock.realtime_within_s", what, &remedy);
        }
        // Within the range this is a positive whole number. Other values were refused.
        (within_s * 1e9).round() as u64
    }

    fn tls(&mut self, section: &TlsSection) -> TlsSettings {
        let mut file = |text: &Text, key: &str, is_secret: bool| {
            let path = self.folder.join(text.get_ref());
            let read = if is_secret {
                joulebus_files::read_secret(&path, 1 << 20).map(drop)
            } else {
                joulebus_files::read_to_string(&path, 1 << 20).map(drop)
            };
            if let Err(error) = read {
                let what = format!("= {:?} cannot be read: {error}", text.get_ref());
                let remedy =
                    "docs/how-to/hosts.md has the commands that make the fleet's certificates";
                self.problem(Some(text.span().start), key, what, remedy);
            }
            path
        };
        TlsSettings {
            ca: file(&section.ca, "network.tls.ca", false),
            certificate: file(&section.certificate, "network.tls.certificate", false),
            key: file(&section.key, "network.tls.key", true),
        }
    }
}

/// Checks an address `tcp/host:port` or `tls/host:port`.
///
/// # Errors
/// The problem and its remedy.
fn address(text: &str, section: &NetworkSection) -> Result<(), (String, &'static str)> {
    let wrong = |remedy| (format!("= {text:?}"), remedy);
    let form = "Write \"tls/host:port\", or \"tcp/host:port\" with a port";
    let (protocol, place) = text.split_once('/').ok_or_else(|| wrong(form))?;
    let (host, port) = place.rsplit_once(':').ok_or_else(|| wrong(form))?;
    if host.is_empty() || host.contains(['#', '?', '/']) || port.parse::<u16>().is_err() {
        return Err(wrong(form));
    }
    match protocol {
        "tls" if section.tls.is_none() => Err(wrong(
            "Add [network.tls] with the fleet's authority, and this host's certificate and key",
        )),
        "tls" => Ok(()),
        "tcp" if is_loopback(host) || section.unencrypted => Ok(()),
        "tcp" => Err(wrong(
            "Use \"tls/…\"; `unencrypted = true` in [network] allows every host of the network to read and to forge",
        )),
        _ => Err(wrong(form)),
    }
}

pub(super) fn is_loopback(host: &str) -> bool {
    let host = host.trim_start_matches('[').trim_end_matches(']');
    host == "localhost" || host.parse::<IpAddr>().is_ok_and(|it| it.is_loopback())
}
