//! Checks `[network]`.
//!
//! A link listens only where its file states it. Traffic that leaves this host is encrypted unless
//! the file allows otherwise.

use std::net::IpAddr;
use std::path::PathBuf;

use joulebus_config::{Section, Text};
use serde::Deserialize;

use crate::config::check::Check;

/// Settings of the network to other hosts.
#[derive(Debug, Clone)]
pub(crate) struct NetworkSettings {
    pub(crate) mode: Mode,
    pub(crate) connect: Vec<String>,
    pub(crate) listen: Vec<String>,
    pub(crate) tls: Option<TlsSettings>,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "snake_case")]
pub(crate) enum Mode {
    /// Connects to other links and accepts connections.
    Peer,
    /// Connects to a router.
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

impl Check {
    pub(super) fn network(&mut self, file: &Section<'_>) -> Option<NetworkSettings> {
        let Some(section) = file.section("network") else {
            let what = "is missing".to_owned();
            self.add(file.problem("network", what, "Add [network] with `connect` or `listen`"));
            return None;
        };
        let mode = section.word("mode")?;
        let (connect, listen) = (section.texts("connect"), section.texts("listen"));
        if connect.is_empty() && (listen.is_empty() || mode == Mode::Client) {
            let what = "reaches nobody".to_owned();
            let remedy = "Add `connect` with the addresses of other links or of a router, or, of a peer, `listen`";
            self.add(section.problem("", what, remedy));
        }
        let tls = section.section("tls");
        let unencrypted = section.flag("unencrypted")?;
        let mut addresses = |list: Vec<Text>| -> Vec<String> {
            let each = list.into_iter().map(|text| {
                if let Err(remedy) = address(&text, tls.is_some(), unencrypted) {
                    self.add(text.problem("", remedy));
                }
                text.to_string()
            });
            each.collect()
        };
        let (connect, listen) = (addresses(connect), addresses(listen));
        let tls = match tls {
            Some(tls) => Some(TlsSettings {
                ca: self.file(&tls.text("ca")?, false),
                certificate: self.file(&tls.text("certificate")?, false),
                key: self.file(&tls.text("key")?, true),
            }),
            None => None,
        };
        Some(NetworkSettings { mode, connect, listen, tls })
    }
}

/// Checks an address `tcp/host:port` or `tls/host:port`.
fn address(text: &str, has_tls: bool, unencrypted: bool) -> Result<(), &'static str> {
    let form = "Write \"tls/host:port\", or \"tcp/host:port\" with a port";
    let (protocol, place) = text.split_once('/').ok_or(form)?;
    let (host, port) = place.rsplit_once(':').ok_or(form)?;
    if host.is_empty() || host.contains(['#', '?', '/']) || port.parse::<u16>().is_err() {
        return Err(form);
    }
    match protocol {
        "tls" if !has_tls => {
            Err("Add [network.tls] with the fleet's authority, and this host's certificate and key")
        }
        "tls" => Ok(()),
        "tcp" if is_loopback(host) || unencrypted => Ok(()),
        "tcp" => Err(
            "Use \"tls/…\". `unencrypted = true` in [network] allows every host of the network to \
             read and to forge",
        ),
        _ => Err(form),
    }
}

pub(super) fn is_loopback(host: &str) -> bool {
    let host = host.trim_start_matches('[').trim_end_matches(']');
    host == "localhost" || host.parse::<IpAddr>().is_ok_and(|address| address.is_loopback())
}
