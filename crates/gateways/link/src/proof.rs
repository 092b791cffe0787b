//! Proof that a request comes from the link whose name it has.
//!
//! Zenoh's access rules bind a key to the certificates that a file names. But every certificate of
//! the fleet may request, so no file names the links that do. Each request therefore carries a
//! random *token* and, several times a second, a signature of the key and this token by the key of
//! the link's certificate. Who accepts requests remembers the token that was proven for each name.
//! Only the two ends of a connection know it.

use std::collections::BTreeMap;
use std::path::Path;
use std::sync::Arc;

use anyhow::{Context as _, bail};
use joulebus_files::disk;
use rustls::SignatureScheme;
use rustls::crypto::{CryptoProvider, ring};
use rustls::pki_types::pem::PemObject as _;
use rustls::pki_types::{CertificateDer, PrivateKeyDer, UnixTime};
use rustls::server::danger::ClientCertVerifier;
use rustls::sign::CertifiedKey;
use x509_parser::certificate::X509Certificate;
use x509_parser::prelude::FromDer as _;

use crate::certificates::{self, MAX_BYTES};
use crate::config::TlsSettings;

const TOKEN_BYTES: usize = 32;
/// Interval between two requests with the signature. One that restarts learns the token from it.
const SIGNATURE_INTERVAL_NS: u64 = 250_000_000;
/// Time for which a token counts, and after which its signature is verified again: the certificate
/// may have expired.
const TOKEN_TIMEOUT_NS: u64 = 10_000_000_000;
const VERIFY_INTERVAL_NS: u64 = 5_000_000_000;
/// Maximum number of names with a proven token. Each is of a certificate that the fleet's authority
/// has signed.
const MAX_NAMES: usize = 4_096;
/// Begin of what is signed, so that a signature is none of anything else.
const PURPOSE: &[u8] = b"joulebus link request 1\0";

fn signed(key: &str, token: &[u8]) -> Vec<u8> {
    [PURPOSE, key.as_bytes(), b"\0", token].concat()
}

/// Makes the proofs for requests on one key.
#[derive(Debug)]
pub(crate) struct Prover {
    tls: TlsSettings,
    key: String,
    /// Token, certificates and signature. Empty while the files cannot be used.
    proof: Vec<u8>,
    /// The certificate's file that the proof is of.
    version: Option<disk::Version>,
    signature_due_ns: u64,
}

impl Prover {
    pub(crate) fn new(tls: &TlsSettings, key: &str) -> Self {
        Self {
            tls: tls.clone(),
            key: key.to_owned(),
            proof: Vec::new(),
            version: None,
            signature_due_ns: 0,
        }
    }

    /// The proof to send with a request at `now_ns`.
    pub(crate) fn proof(&mut self, now_ns: u64) -> &[u8] {
        if now_ns < self.signature_due_ns {
            return &self.proof[..TOKEN_BYTES.min(self.proof.len())];
        }
        self.signature_due_ns = now_ns.saturating_add(SIGNATURE_INTERVAL_NS);
        // A certificate may be renewed while the link runs.
        let version = disk::version(&self.tls.certificate).ok();
        if self.proof.is_empty() || version != self.version {
            match prove(&self.tls, &self.key) {
                Ok(proof) => (self.proof, self.version) = (proof, version),
                Err(error) => tracing::debug!("requests are not signed: {error:#}"),
            }
        }
        &self.proof
    }
}

/// Signs a new token.
fn prove(tls: &TlsSettings, key: &str) -> anyhow::Result<Vec<u8>> {
    let read = |path: &Path| joulebus_files::read_to_string(path, MAX_BYTES);
    let pem = read(&tls.certificate)?;
    let chain: Vec<_> = CertificateDer::pem_slice_iter(pem.as_bytes()).collect::<Result<_, _>>()?;
    let private = PrivateKeyDer::from_pem_slice(read(&tls.key)?.as_bytes())?;
    let provider = ring::default_provider();
    let certified = CertifiedKey::from_der(chain, private, &provider)?;
    let schemes = provider.signature_verification_algorithms.supported_schemes();
    let signer = certified.key.choose_scheme(&schemes).context("no scheme for this key")?;
    let mut proof = vec![0; TOKEN_BYTES];
    if provider.secure_random.fill(&mut proof).is_err() {
        bail!("no random numbers");
    }
    let signature = signer.sign(&signed(key, &proof))?;
    proof.extend_from_slice(&u16::from(signer.scheme()).to_le_bytes());
    for part in [&*signature].into_iter().chain(certified.cert.iter().map(AsRef::as_ref)) {
        proof.extend_from_slice(&u16::try_from(part.len())?.to_le_bytes());
        proof.extend_from_slice(part);
    }
    Ok(proof)
}

/// A token that was proven for a name.
#[derive(Debug)]
struct Proven {
    token: [u8; TOKEN_BYTES],
    at_ns: u64,
}

/// Verifies the proofs of requests, whose keys end in the name of the requesting link.
#[derive(Debug)]
pub(crate) struct Verifier {
    /// The keys without the name.
    prefix: String,
    verifier: Arc<dyn ClientCertVerifier>,
    provider: CryptoProvider,
    proven: BTreeMap<Arc<str>, Proven>,
}

impl Verifier {
    pub(crate) fn new(ca: &Path, prefix: String) -> anyhow::Result<Self> {
        let ca = joulebus_files::read_to_string(ca, MAX_BYTES)?;
        let verifier = certificates::verifier(&ca)?;
        Ok(Self { prefix, verifier, provider: ring::default_provider(), proven: BTreeMap::new() })
    }

    /// True if a request under `name` with this proof comes from the link of that name. False if it
    /// has a token whose signature has not arrived yet.
    pub(crate) fn verify(
        &mut self,
        name: &Arc<str>,
        proof: &[u8],
        now_ns: u64,
    ) -> anyhow::Result<bool> {
        let Some((token, rest)) = proof.split_first_chunk::<TOKEN_BYTES>() else {
            bail!("its sender shows no certificate");
        };
        let age_ns = match self.proven.get(name) {
            Some(proven) if proven.token == *token => now_ns.saturating_sub(proven.at_ns),
            _ => u64::MAX,
        };
        if rest.is_empty() || age_ns < VERIFY_INTERVAL_NS {
            return Ok(age_ns < TOKEN_TIMEOUT_NS);
        }
        self.check(name, token, rest)?;
        if self.proven.len() >= MAX_NAMES {
            self.proven.retain(|_, proven| now_ns.saturating_sub(proven.at_ns) < TOKEN_TIMEOUT_NS);
        }
        self.proven.insert(Arc::clone(name), Proven { token: *token, at_ns: now_ns });
        Ok(true)
    }

    fn check(&self, name: &str, token: &[u8], rest: &[u8]) -> anyhow::Result<()> {
        let (scheme, rest) = rest.split_first_chunk().context("its signature is damaged")?;
        let scheme = SignatureScheme::from(u16::from_le_bytes(*scheme));
        let mut parts = parts(rest).context("its signature is damaged")?.into_iter();
        let signature = parts.next().context("it has no signature")?;
        let certificate = CertificateDer::from(parts.next().context("it has no certificate")?);
        let others: Vec<_> = parts.map(CertificateDer::from).collect();
        self.verifier.verify_client_cert(&certificate, &others, UnixTime::now())?;
        let (_, parsed) = X509Certificate::from_der(&certificate)?;
        let own = certificates::common_name(&parsed);
        if own != name {
            bail!("its sender's certificate is for the link {own:?}");
        }
        let public = &parsed.public_key().subject_public_key.data;
        let algorithms = self.provider.signature_verification_algorithms.mapping.iter();
        let algorithms = algorithms.filter(|(of, _)| *of == scheme).flat_map(|(_, all)| *all);
        let message = signed(&format!("{}{name}", self.prefix), token);
        let is_signed = |algorithm: &&dyn rustls::pki_types::SignatureVerificationAlgorithm| {
            algorithm.verify_signature(public, &message, signature).is_ok()
        };
        if !algorithms.into_iter().any(is_signed) {
            bail!("its signature is not of its certificate's key");
        }
        Ok(())
    }
}

/// Splits parts with their lengths. `None` if they do not fill the bytes.
fn parts(mut bytes: &[u8]) -> Option<Vec<&[u8]>> {
    let mut parts = Vec::new();
    while let Some((length, rest)) = bytes.split_first_chunk() {
        let (part, rest) = rest.split_at_checked(u16::from_le_bytes(*length).into())?;
        parts.push(part);
        bytes = rest;
    }
    bytes.is_empty().then_some(parts)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::certificates::Authority;

    const PREFIX: &str = "joulebus/lab/ask/outputs/base/";
    const SECOND_NS: u64 = 1_000_000_000;

    struct Folder {
        directory: tempfile::TempDir,
        authority: Authority,
    }

    impl Folder {
        fn new() -> Self {
            let (authority, _) = Authority::make().unwrap();
            let directory = tempfile::tempdir().unwrap();
            std::fs::write(directory.path().join("ca.pem"), &authority.pem).unwrap();
            Self { directory, authority }
        }

        fn tls(&self, name: &str) -> TlsSettings {
            let path = |file: &str| self.directory.path().join(file);
            let (certificate, key) = (path(&format!("{name}.pem")), path(&format!("{name}.key")));
            let made = self.authority.sign(name, "127.0.0.1", 30).unwrap();
            std::fs::write(&certificate, made.certificate).unwrap();
            std::fs::write(&key, made.key).unwrap();
            TlsSettings { ca: path("ca.pem"), certificate, key }
        }

        fn verifier(&self) -> Verifier {
            let ca = self.directory.path().join("ca.pem");
            Verifier::new(&ca, PREFIX.to_owned()).unwrap()
        }
    }

    #[test]
    fn a_request_counts_under_the_name_in_its_certificate_and_under_no_other() {
        let folder = Folder::new();
        let (desk, spy) = (Arc::<str>::from("desk"), Arc::<str>::from("spy"));
        let tls = [&desk, &spy].map(|name| folder.tls(name));
        let mut verifier = folder.verifier();
        // The spy signs keys of both names with its own certificate.
        let mut own = Prover::new(&tls[1], &format!("{PREFIX}spy"));
        let mut forged = Prover::new(&tls[1], &format!("{PREFIX}desk"));
        assert!(verifier.verify(&spy, own.proof(0), 0).unwrap());
        for proof in [own.proof(SECOND_NS), forged.proof(SECOND_NS), &[][..], &[7; 40]] {
            verifier.verify(&desk, proof, SECOND_NS).unwrap_err();
        }
        // A token alone, before and after it was proven.
        let mut real = Prover::new(&tls[0], &format!("{PREFIX}desk"));
        let signed = real.proof(0).to_vec();
        let token = real.proof(1).to_vec();
        assert_eq!(token, signed[..TOKEN_BYTES]);
        assert!(!verifier.verify(&desk, &token, 0).unwrap());
        assert!(verifier.verify(&desk, &signed, 0).unwrap());
        assert!(verifier.verify(&desk, &token, 1).unwrap());
        assert!(!verifier.verify(&spy, &token, 1).unwrap());
        assert!(!verifier.verify(&desk, &[7; TOKEN_BYTES], 1).unwrap());
        assert!(!verifier.verify(&desk, &token, TOKEN_TIMEOUT_NS).unwrap());
        // The signature is of this receiver's key, and each of its bytes counts.
        let elsewhere = PREFIX.replace("base", "base-2");
        let ca = folder.directory.path().join("ca.pem");
        let mut other = Verifier::new(&ca, elsewhere).unwrap();
        other.verify(&desk, &signed, 0).unwrap_err();
        for at in (0..signed.len()).step_by(3) {
            let mut changed = signed.clone();
            changed[at] ^= 1;
            let mut verifier = folder.verifier();
            verifier.verify(&desk, &changed, 0).expect_err(&format!("byte {at}"));
            assert!(!verifier.verify(&desk, &signed[..at], 0).unwrap_or(false), "{at} bytes");
        }
        // Another authority's certificate, and one whose files are gone.
        let gone = Folder::new().tls("desk");
        assert_eq!(Prover::new(&gone, &format!("{PREFIX}desk")).proof(0), [0; 0]);
        let elsewhere = Folder::new();
        let tls = elsewhere.tls("desk");
        let mut stranger = Prover::new(&tls, &format!("{PREFIX}desk"));
        verifier.verify(&desk, stranger.proof(0), 0).unwrap_err();
    }

    #[test]
    fn requests_are_signed_with_a_renewed_certificate_without_a_restart() {
        let folder = Folder::new();
        let desk: Arc<str> = "desk".into();
        let tls = folder.tls("desk");
        let mut prover = Prover::new(&tls, &format!("{PREFIX}desk"));
        let before = prover.proof(0).to_vec();
        assert_eq!(prover.proof(SECOND_NS), before);
        folder.tls("desk");
        let after = prover.proof(2 * SECOND_NS).to_vec();
        assert_ne!(after[..TOKEN_BYTES], before[..TOKEN_BYTES]);
        assert!(folder.verifier().verify(&desk, &after, 0).unwrap());
    }
}
