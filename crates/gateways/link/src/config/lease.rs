//! Checks `[lease]`: the etcd cluster that elects the leader of a shard.

use std::path::{Path, PathBuf};

use crate::config::check::Check;
use crate::config::file::{LeaseSection, NetworkSection, Text};
use crate::config::network::is_loopback;
use crate::protocol::lease::MAX_TTL_S;

/// Range of the lease's time to live, s. etcd raises 1 s to 2 s.
const TTL_S: (u32, u32) = (2, MAX_TTL_S);
/// Maximum number of etcd members.
const MAX_ENDPOINTS: usize = 16;
const MAX_PREFIX: usize = 128;
const MAX_SECRET_BYTES: u64 = 4_096;

/// How to reach etcd.
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

impl Check<'_> {
    pub(super) fn lease(
        &mut self,
        section: &LeaseSection,
        network: &NetworkSection,
    ) -> LeaseSettings {
        let found = section.endpoints.len();
        if !(1..=MAX_ENDPOINTS).contains(&found) {
            let what = format!("are {found}");
            let remedy = format!("Allowed: 1 to {MAX_ENDPOINTS} members of etcd");
            self.problem(None, "lease.endpoints", what, &remedy);
        }
        for text in &section.endpoints {
            if let Err(remedy) = endpoint(text.get_ref(), network.unencrypted) {
                let what = format!("= {:?}", text.get_ref());
                self.problem(Some(text.span().start), "lease.endpoints", what, remedy);
            }
        }
        let (least, most) = TTL_S;
        if !(least..=most).contains(&section.ttl_s) {
            let what = format!("= {}", section.ttl_s);
            let remedy = format!("Allowed: {least} to {most}");
            self.problem(None, "lease.ttl_s", what, &remedy);
        }
        let prefix = section.prefix.get_ref();
        let plain = |c: char| c.is_ascii_alphanumeric() || "/-_.".contains(c);
        if prefix.len() > MAX_PREFIX || !prefix.chars().all(plain) {
            let what = format!("= {prefix:?}");
            let remedy = format!("Allowed: at most {MAX_PREFIX} letters, digits, / - _ and .");
            let at = Some(section.prefix.span().start);
            self.problem(at, "lease.prefix", what, &remedy);
        }
        let own =
            self.pair((&section.certificate, "lease.certificate"), (&section.key, "lease.key"));
        let own = own.map(|(certificate, key)| {
            let certificate = self.file(certificate, "lease.certificate", false);
            (certificate, self.file(key, "lease.key", true))
        });
        let user = self.pair((&section.user, "lease.user"), (&section.password, "lease.password"));
        let user = user.map(|(user, password)| {
            let path = self.file(password, "lease.password", true);
            (user.get_ref().clone(), path)
        });
        LeaseSettings {
            endpoints: section.endpoints.iter().map(|it| it.get_ref().clone()).collect(),
            ttl_s: section.ttl_s,
            prefix: prefix.clone(),
            ca: section.ca.as_ref().map(|ca| self.file(ca, "lease.ca", false)),
            own,
            user,
        }
    }

    /// Checks two keys that are useful only together.
    fn pair<'t>(
        &mut self,
        (one, name): (&'t Option<Text>, &str),
        (other, other_name): (&'t Option<Text>, &str),
    ) -> Option<(&'t Text, &'t Text)> {
        match (one, other) {
            (Some(one), Some(other)) => Some((one, other)),
            (None, None) => None,
            _ => {
                let missing = if one.is_some() { other_name } else { name };
                let remedy = format!("{name} and {other_name} belong together");
                self.problem(None, missing, "is missing".to_owned(), &remedy);
                None
            }
        }
    }

    /// A readable file, relative to the link's file.
    fn file(&mut self, text: &Text, key: &str, is_secret: bool) -> PathBuf {
        let path: PathBuf = self.folder.join(Path::new(text.get_ref()));
        let read = if is_secret {
            joulebus_files::read_secret(&path, MAX_SECRET_BYTES).map(drop)
        } else {
            joulebus_files::read_to_string(&path, 1 << 20).map(drop)
        };
        if let Err(error) = read {
            let what = format!("= {:?} cannot be read: {error}", text.get_ref());
            let remedy = "docs/how-to/standby.md has what each file contains";
            self.problem(Some(text.span().start), key, what, remedy);
        }
        path
    }
}

/// Checks an endpoint's address.
///
/// # Errors
/// What to write instead.
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
            "Use https://; `unencrypted = true` in [network] allows every host of the network to take the shard",
        ),
        _ => Err(form),
    }
}
