//! Checks and reads the files of `[mqtt.tls]`.

use std::path::{Path, PathBuf};
use std::sync::Arc;

use joulebus_config::Section;
use rustls::pki_types::pem::{self, PemObject as _};
use rustls::pki_types::{CertificateDer, PrivateKeyDer};
use rustls::{ClientConfig, RootCertStore};

use crate::config::check::Check;

/// Maximum size of a file, bytes.
const MAX_BYTES: u64 = 1 << 20;

/// Files of TLS to a broker.
#[derive(Debug, Clone)]
pub(crate) struct TlsSettings {
    ca: PathBuf,
    /// The bridge's certificate and its key.
    identity: Option<(PathBuf, PathBuf)>,
}

impl TlsSettings {
    /// Reads the files. The error has the key of the file that is refused.
    pub(crate) fn load(&self) -> Result<Arc<ClientConfig>, (&'static str, String)> {
        let refused = |error: rustls::Error| format!("is refused: {error}");
        let mut roots = RootCertStore::empty();
        for certificate in certificates(&self.ca).map_err(|error| ("ca", error))? {
            roots.add(certificate).map_err(|error| ("ca", refused(error)))?;
        }
        let provider = Arc::new(rustls::crypto::ring::default_provider());
        let builder = ClientConfig::builder_with_provider(provider)
            .with_safe_default_protocol_versions()
            .map_err(|error| ("ca", refused(error)))?
            .with_root_certificates(roots);
        let Some((certificate, key)) = &self.identity else {
            return Ok(Arc::new(builder.with_no_client_auth()));
        };
        let certificates = certificates(certificate).map_err(|error| ("certificate", error))?;
        let key = private_key(key).map_err(|error| ("key", error))?;
        let config = builder.with_client_auth_cert(certificates, key);
        Ok(Arc::new(config.map_err(|error| ("key", refused(error)))?))
    }
}

fn certificates(path: &Path) -> Result<Vec<CertificateDer<'static>>, String> {
    let bytes = joulebus_files::read(path, MAX_BYTES)
        .map_err(|error| format!("cannot be read: {error}"))?;
    let found: Result<Vec<_>, _> = CertificateDer::pem_slice_iter(&bytes).collect();
    let found = found.map_err(|error| format!("is damaged: {error}"))?;
    if found.is_empty() {
        return Err("has no certificate, expected PEM, -----BEGIN CERTIFICATE-----".to_owned());
    }
    Ok(found)
}

fn private_key(path: &Path) -> Result<PrivateKeyDer<'static>, String> {
    let text = joulebus_files::read_secret(path, MAX_BYTES)
        .map_err(|error| format!("cannot be read: {error}"))?;
    PrivateKeyDer::from_pem_slice(text.as_bytes()).map_err(|error| match error {
        pem::Error::NoItemsFound => {
            "has no key, expected PEM without a password, -----BEGIN PRIVATE KEY-----".to_owned()
        }
        error => format!("is damaged: {error}"),
    })
}

impl Check<'_> {
    pub(super) fn tls(&mut self, section: &Section<'_>) -> Option<TlsSettings> {
        let path = |name: &str| Some(section.text(name)?.file());
        let named = ["certificate", "key"].map(|name| section.text(name));
        let identity = match named {
            [Some(_), Some(_)] => path("certificate").zip(path("key")),
            [None, None] => None,
            [one, other] => {
                let paired = Err::<(), _>("needs `certificate` and `key`, or neither");
                return self.checked(&one.or(other)?, paired).and(None);
            }
        };
        let settings = TlsSettings { ca: path("ca")?, identity };
        match settings.load() {
            Ok(_) => Some(settings),
            Err((name, error)) => self.checked(&section.text(name)?, Err(error)),
        }
    }
}
