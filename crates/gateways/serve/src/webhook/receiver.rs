//! Receivers of alarms: those of `--webhook` and `--webhooks`, checked.

use std::path::Path;
use std::str::FromStr;

use anyhow::{Context as _, anyhow};
use joulebus_config::{CheckedFile, ConfigError, File, Problem, Section};
use ureq::Agent;
use ureq::http::Uri;
use ureq::tls::{PemItem, RootCerts, TlsConfig, parse_pem};

use super::signature::Signer;

/// Maximum size of a file with certificates, bytes. All of Mozilla's take a quarter of it.
const MAX_CERTIFICATE_BYTES: u64 = 1 << 20;

#[derive(Debug)]
pub(super) struct Receiver {
    pub(super) address: Uri,
    pub(super) agent: Agent,
    /// Address of the page to which the text links.
    pub(super) page: Option<String>,
    pub(super) signer: Option<Signer>,
}

impl Receiver {
    /// The value of `--webhook`: an address, or `@FILE` with one (mode 0600).
    /// Its certificate is checked against Mozilla's list.
    pub(super) fn named(to: &str) -> anyhow::Result<Self> {
        let text = match to.strip_prefix('@') {
            Some(path) => joulebus_files::read_secret_line(Path::new(path))
                .with_context(|| format!("--webhook {to}"))?,
            None => to.to_owned(),
        };
        Ok(Self {
            address: address(&text).context("--webhook")?,
            agent: agent(RootCerts::WebPki),
            page: None,
            signer: None,
        })
    }

    /// Reads the receivers of the file of `--webhooks`.
    pub(super) fn read(path: &Path) -> Result<Vec<Self>, ConfigError> {
        let file = CheckedFile::load(path, File::Webhooks)?;
        let root = file.root();
        let mut problems = file.problems.clone();
        if problems.is_empty() && root.list("webhook").next().is_none() {
            let what = "is missing: the file names no receiver".to_owned();
            problems.push(root.problem("webhook", what, "Add a [[webhook]] with an address"));
        }
        let mut receivers = Vec::new();
        if problems.is_empty() {
            for section in root.list("webhook") {
                match Self::new(&section) {
                    Ok(receiver) => receivers.push(receiver),
                    Err(problem) => problems.push(*problem),
                }
            }
        }
        if problems.is_empty() { Ok(receivers) } else { Err(ConfigError::Refused(problems)) }
    }

    fn new(section: &Section<'_>) -> Result<Self, Box<Problem>> {
        let refuse =
            |key: &str, what: String, remedy: &str| Box::new(section.problem(key, what, remedy));
        let broken = |key: &'static str, remedy: &'static str| {
            move |error: anyhow::Error| refuse(key, format!("{error:#}"), remedy)
        };
        let (key, named) = match (section.text("address"), section.text("address_file")) {
            (Some(text), None) => ("address", text.to_string()),
            (None, Some(file)) => {
                let line = joulebus_files::read_secret_line(&file.file());
                let remedy = "Name a file of mode 0600 whose first line is the address";
                ("address_file", line.map_err(Into::into).map_err(broken("address_file", remedy))?)
            }
            (found, _) => {
                let what = if found.is_some() { "stands beside address" } else { "is missing" };
                let remedy = "Set either address or address_file";
                return Err(refuse("address_file", what.to_owned(), remedy));
            }
        };
        let remedy = "Give an address such as https://host.example/path";
        let address = address(&named).map_err(broken(key, remedy))?;
        let roots = section.text("ca").map_or(Ok(RootCerts::WebPki), |file| {
            certificates(&file.file()).map_err(broken("ca", "Name a PEM file with certificates"))
        });
        let signer = section.text("secret_file").map(|file| {
            let remedy = "Make one: (umask 077; openssl rand -base64 32 >FILE)";
            Signer::read(&file.file()).map_err(broken("secret_file", remedy))
        });
        let page = section.text("page").map(|page| page.trim_end_matches('/').to_owned());
        Ok(Self { address, agent: agent(roots?), page, signer: signer.transpose()? })
    }

    /// Host of the address. The rest may be secret.
    pub(super) fn host(&self) -> &str {
        self.address.host().unwrap_or_default()
    }
}

/// An address of the web.
fn address(text: &str) -> anyhow::Result<Uri> {
    let refused = "expected an address such as https://host.example/path, or @FILE with one";
    let address = Uri::from_str(text.trim()).context(refused)?;
    let authority = address.authority();
    let named = authority.map_or("", |authority| authority.as_str());
    let (host, port) = (address.host().unwrap_or_default(), address.port_u16());
    if port.is_none_or(|port| port == 0)
        && named.rsplit_once(host).is_some_and(|(_, rest)| rest.starts_with(':'))
    {
        return Err(anyhow!("{named}: a port is 1 to 65535"));
    }
    let is_http = matches!(address.scheme_str(), Some("http" | "https"));
    if is_http && address.host().is_some_and(|host| !host.is_empty()) {
        return Ok(address);
    }
    Err(anyhow!(refused))
}

/// The certificates in a file.
fn certificates(path: &Path) -> anyhow::Result<RootCerts> {
    let bytes = joulebus_files::read(path, MAX_CERTIFICATE_BYTES)?;
    let mut found = Vec::new();
    for item in parse_pem(&bytes) {
        if let PemItem::Certificate(certificate) = item? {
            found.push(certificate);
        }
    }
    if found.is_empty() {
        return Err(anyhow!("no certificate is in it, expected PEM, -----BEGIN CERTIFICATE-----"));
    }
    Ok(RootCerts::new_with_certs(&found))
}

fn agent(roots: RootCerts) -> Agent {
    let config = Agent::config_builder()
        // A redirect would reveal the address to another host.
        .max_redirects(0)
        .max_redirects_will_error(false)
        .http_status_as_error(false)
        .tls_config(TlsConfig::builder().root_certs(roots).build())
        .user_agent(concat!("joulebus/", env!("CARGO_PKG_VERSION")))
        .build();
    config.into()
}

#[cfg(test)]
mod tests {
    use std::os::unix::fs::PermissionsExt as _;

    use super::*;

    #[test]
    fn only_addresses_of_the_web_are_taken() {
        let address = |to: &str| Receiver::named(to).map(|receiver| receiver.address);
        for good in ["http://127.0.0.1:9/x", "https://hooks.example/T0/secret?a=b"] {
            assert_eq!(address(good).unwrap().to_string(), good);
        }
        for bad in [
            "",
            "hooks.example/x",
            "ftp://host/x",
            "file:///etc/passwd",
            "http://",
            "@/nowhere",
            "https://host.example:70000/x",
            "https://host.example:0/x",
            "http://[::1]:99999/",
        ] {
            assert!(address(bad).is_err(), "{bad}");
        }
    }

    #[test]
    fn a_files_problems_name_line_and_remedy() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("hooks.toml");
        let read = |text: &str| {
            std::fs::write(&path, text).unwrap();
            Receiver::read(&path)
        };
        for (name, mode, text) in [
            ("secret", 0o600, "whsec_MDEyMzQ1Njc4OTAxMjM0NTY3ODkwMTIz\n"),
            ("short", 0o600, "MDEyMzQ1\n"),
            ("open", 0o644, "MDEyMzQ1Njc4OTAxMjM0NTY3ODkwMTIz\n"),
        ] {
            std::fs::write(folder.path().join(name), text).unwrap();
            let mode = std::fs::Permissions::from_mode(mode);
            std::fs::set_permissions(folder.path().join(name), mode).unwrap();
        }
        let at = "[[webhook]]\naddress = \"http://host/\"\n";
        for (text, expected) in [
            ("", vec!["webhook", "is missing", "Add a [[webhook]]"]),
            (
                "[[webhook]]\n",
                vec!["hooks.toml:1", "webhook.address_file` is missing", "either address"],
            ),
            ("[[webhook]]\naddress = \"ftp://host\"\n", vec!["hooks.toml:2", "http://host/path"]),
            (&*format!("{at}address_file = \"secret\"\n"), vec!["stands beside address"]),
            (&format!("{at}pages = \"http://x\"\n"), vec!["hooks.toml:3", "webhook.page"]),
            (&format!("{at}format = \"slack\"\n"), vec!["hooks.toml:3", "text", "--on-alarm"]),
            (&format!("{at}template = '{{}}'\n"), vec!["hooks.toml:3", "text", "--on-alarm"]),
            (&format!("{at}repeat_s = 5\n"), vec!["hooks.toml:3", "configs/prometheus"]),
            (&format!("{at}ca = \"secret\"\n"), vec!["webhook.ca", "BEGIN CERTIFICATE"]),
            (
                &format!("{at}secret_file = \"short\"\n"),
                vec!["6 bytes", "24 to 64", "openssl rand"],
            ),
            (&format!("{at}secret_file = \"open\"\n"), vec!["hooks.toml:3", "0644", "umask 077"]),
        ] {
            let refused = read(text).unwrap_err().to_string();
            for words in expected {
                assert!(refused.contains(words), "{text}: {refused} lacks {words}");
            }
        }
        let both = format!("{at}secret_file = \"secret\"\n{at}page = \"http://page/\"\n");
        assert_eq!(read(&both).unwrap().len(), 2);
    }
}
