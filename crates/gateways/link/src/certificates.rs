//! Certificates of a fleet's own authority: made by `joulebus link init`, and compared by
//! `--check`.

use std::net::IpAddr;
use std::path::Path;
use std::sync::Arc;
use std::time::{Duration, SystemTime};

use anyhow::{Context as _, bail};
use rcgen::{
    BasicConstraints, CertificateParams, DistinguishedName, DnType, ExtendedKeyUsagePurpose, IsCa,
    Issuer, KeyPair, KeyUsagePurpose,
};
use rustls::RootCertStore;
use rustls::pki_types::pem::PemObject as _;
use rustls::pki_types::{CertificateDer, PrivateKeyDer, UnixTime};
use rustls::server::WebPkiClientVerifier;
use rustls::server::danger::ClientCertVerifier;
use rustls::sign::CertifiedKey;
use serde::Serialize;
use x509_parser::certificate::X509Certificate;
use x509_parser::prelude::{FromDer as _, GeneralName};

use crate::config::TlsSettings;

/// Maximum size of a file, bytes.
pub(crate) const MAX_BYTES: u64 = 1 << 20;
const DAY: Duration = Duration::from_secs(86_400);
const AUTHORITY_DAYS: u32 = 3_650;
/// A certificate is valid from this long before it is made, for hosts whose clocks are late.
const CLOCKS_APART: Duration = Duration::from_secs(3_600);

/// A fleet's authority, which signs the certificates of its hosts.
pub(crate) struct Authority {
    pub(crate) pem: String,
    issuer: Issuer<'static, KeyPair>,
}

/// A certificate and its private key.
pub(crate) struct Identity {
    pub(crate) certificate: String,
    pub(crate) key: String,
}

impl Authority {
    /// Makes an authority. Returns it with its private key.
    pub(crate) fn make() -> Result<(Self, String), rcgen::Error> {
        let (key, params) = (KeyPair::generate()?, Self::params());
        let (pem, key_pem) = (params.self_signed(&key)?.pem(), key.serialize_pem());
        Ok((Self { pem, issuer: Issuer::new(params, key) }, key_pem))
    }

    /// Takes an authority that was made before, from its certificate and key.
    pub(crate) fn open(pem: String, key: &str) -> Result<Self, rcgen::Error> {
        let key = KeyPair::from_pem(key)?;
        Ok(Self { pem, issuer: Issuer::new(Self::params(), key) })
    }

    fn params() -> CertificateParams {
        let mut params = valid_for(AUTHORITY_DAYS, "joulebus fleet");
        params.is_ca = IsCa::Ca(BasicConstraints::Unconstrained);
        params.key_usages = vec![KeyUsagePurpose::KeyCertSign];
        params
    }

    /// Signs a certificate of the link `name` at `address`.
    ///
    /// # Errors
    /// The address cannot be in a certificate, or the certificate of this authority belongs to
    /// another key.
    pub(crate) fn sign(&self, name: &str, address: &str, days: u32) -> anyhow::Result<Identity> {
        let mut params = valid_for(days, name);
        params.subject_alt_names = CertificateParams::new([address.to_owned()])?.subject_alt_names;
        params.extended_key_usages =
            vec![ExtendedKeyUsagePurpose::ServerAuth, ExtendedKeyUsagePurpose::ClientAuth];
        let key = KeyPair::generate()?;
        let certificate = params.signed_by(&key, &self.issuer)?;
        verify(&self.pem, certificate.der()).context("the authority's key signs another")?;
        Ok(Identity { certificate: certificate.pem(), key: key.serialize_pem() })
    }
}

fn valid_for(days: u32, name: &str) -> CertificateParams {
    let now = SystemTime::now();
    let mut params = CertificateParams::default();
    params.not_before = (now - CLOCKS_APART).into();
    params.not_after = (now + days * DAY).into();
    params.distinguished_name = DistinguishedName::new();
    params.distinguished_name.push(DnType::CommonName, name);
    params
}

/// The certificate of a link, as `--check` reports it.
#[derive(Debug, Serialize)]
pub(crate) struct CertificateReport {
    pub(crate) name: String,
    /// Host names and addresses by which others may connect to it.
    pub(crate) addresses: Vec<String>,
    /// Days until it expires. Negative afterwards.
    pub(crate) days_left: i64,
}

/// Compares the files of a link that is called `name`, as its peers will.
///
/// # Errors
/// The first that does not fit, and its remedy.
pub(crate) fn check(tls: &TlsSettings, name: &str) -> anyhow::Result<CertificateReport> {
    let read = |path: &Path| {
        joulebus_files::read_to_string(path, MAX_BYTES).with_context(|| path.display().to_string())
    };
    let (ca, certificate, key) = (read(&tls.ca)?, read(&tls.certificate)?, read(&tls.key)?);
    let of = |path: &Path| format!("{} of link {name}", path.display());
    let der = CertificateDer::from_pem_slice(certificate.as_bytes())
        .with_context(|| format!("{} has no certificate", of(&tls.certificate)))?;
    let (_, parsed) = X509Certificate::from_der(&der)
        .with_context(|| format!("{} is damaged", of(&tls.certificate)))?;
    let report = CertificateReport::new(&parsed);
    if report.name != name {
        bail!(
            "{} is for the link {:?}: use that of {name:?}, or set `name = {:?}`",
            of(&tls.certificate),
            report.name,
            report.name
        );
    }
    let key = PrivateKeyDer::from_pem_slice(key.as_bytes())
        .with_context(|| format!("{} has no private key", of(&tls.key)))?;
    let provider = rustls::crypto::ring::default_provider();
    CertifiedKey::from_der(vec![der.clone()], key, &provider).with_context(|| {
        let certificate = tls.certificate.display();
        format!("{} is not the key of {certificate}: copy both from one place", of(&tls.key))
    })?;
    verify(&ca, &der).with_context(|| {
        format!(
            "peers refuse {} ({} days left): `joulebus link init … --replace` writes a new one",
            of(&tls.certificate),
            report.days_left
        )
    })?;
    Ok(report)
}

/// Verifies a certificate as a peer does.
fn verify(ca: &str, certificate: &CertificateDer<'_>) -> anyhow::Result<()> {
    verifier(ca)?.verify_client_cert(certificate, &[], UnixTime::now())?;
    Ok(())
}

/// Verifies certificates of links by the authority's certificate.
pub(crate) fn verifier(ca: &str) -> anyhow::Result<Arc<dyn ClientCertVerifier>> {
    let mut roots = RootCertStore::empty();
    for authority in CertificateDer::pem_slice_iter(ca.as_bytes()) {
        roots.add(authority.context("the authority's certificate is damaged")?)?;
    }
    let provider = Arc::new(rustls::crypto::ring::default_provider());
    Ok(WebPkiClientVerifier::builder_with_provider(Arc::new(roots), provider).build()?)
}

/// The name of a certificate's link.
pub(crate) fn common_name(parsed: &X509Certificate<'_>) -> String {
    let mut names = parsed.subject().iter_common_name();
    names.next().and_then(|name| name.as_str().ok()).unwrap_or_default().to_owned()
}

impl CertificateReport {
    fn new(parsed: &X509Certificate<'_>) -> Self {
        let name = common_name(parsed);
        let alternatives = parsed.subject_alternative_name().ok().flatten();
        let alternatives = alternatives.iter().flat_map(|extension| &extension.value.general_names);
        let addresses = alternatives.filter_map(|name| match name {
            GeneralName::DNSName(host) => Some((*host).to_owned()),
            GeneralName::IPAddress(bytes) => {
                let v4 = <[u8; 4]>::try_from(*bytes).map(IpAddr::from);
                let v6 = <[u8; 16]>::try_from(*bytes).map(IpAddr::from);
                v4.or(v6).ok().map(|address| address.to_string())
            }
            _ => None,
        });
        let left_s = parsed.validity().not_after.timestamp() - UnixTime::now().as_secs() as i64;
        let days_left = left_s.div_euclid(DAY.as_secs() as i64);
        Self { name, addresses: addresses.collect(), days_left }
    }
}
