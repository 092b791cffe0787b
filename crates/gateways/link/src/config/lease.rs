//! Checks `[lease]`: the etcd cluster that elects the leader.

use std::path::PathBuf;

use joulebus_config::{Section, Text};

use crate::config::check::Check;
use crate::config::network::is_loopback;

/// Settings of the connection to etcd.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) struct LeaseSettings {
    /// `http://host:port` or `https://host:port`.
    pub(crate) endpoints: Vec<String>,
    pub(crate) ttl_s: u32,
    pub(crate) prefix: String,
    pub(crate) ca: Option<PathBuf>,
    /// Certificate and key of this host.
    pub(crate) own: Option<(PathBuf, PathBuf)>,
    /// User name and password file.
    pub(crate) user: Option<(String, PathBuf)>,
}

impl Check {
    pub(super) fn lease(
        &mut self,
        section: &Section<'_>,
        file: &Section<'_>,
    ) -> Option<LeaseSettings> {
        let network = file.section("network");
        let unencrypted = network.and_then(|network| network.flag("unencrypted")) == Some(true);
        let endpoints = section.texts("endpoints");
        for text in &endpoints {
            if let Err(remedy) = endpoint(text, unencrypted) {
                self.add(text.problem("", remedy));
            }
        }
        let own = self.pair(section, "certificate", "key");
        let own =
            own.map(|(certificate, key)| (self.file(&certificate, false), self.file(&key, true)));
        let user = self.pair(section, "user", "password");
        let user = user.map(|(user, password)| (user.to_string(), self.file(&password, true)));
        let ca = section.text("ca").map(|ca| self.file(&ca, false));
        Some(LeaseSettings {
            endpoints: endpoints.iter().map(|text| text.to_string()).collect(),
            ttl_s: section.integer("ttl_s")?,
            prefix: section.text("prefix")?.to_string(),
            ca,
            own,
            user,
        })
    }

    /// Checks two keys that are useful only together.
    fn pair(&mut self, section: &Section<'_>, one: &str, other: &str) -> Option<(Text, Text)> {
        let missing = match (section.has(one), section.has(other)) {
            (true, false) => other,
            (false, true) => one,
            _ => return section.text(one).zip(section.text(other)),
        };
        let remedy = format!("{one} and {other} belong together");
        self.add(section.problem(missing, "is missing".to_owned(), &remedy));
        None
    }
}

/// Checks an endpoint's address.
fn endpoint(text: &str, unencrypted: bool) -> Result<(), &'static str> {
    let form = "Write \"https://host:port\", or \"http://host:port\", without a path";
    let (scheme, place) = text.split_once("://").ok_or(form)?;
    let (host, port) = place.rsplit_once(':').ok_or(form)?;
    let is_plain = |c: char| c.is_ascii_alphanumeric() || "-_.:[]".contains(c);
    if host.is_empty() || !host.chars().all(is_plain) || port.parse::<u16>().is_err() {
        return Err(form);
    }
    match scheme {
        "https" => Ok(()),
        "http" if is_loopback(host) || unencrypted => Ok(()),
        "http" => Err(
            "Use https://. `unencrypted = true` in [network] allows every host of the network to \
             take the lease",
        ),
        _ => Err(form),
    }
}
