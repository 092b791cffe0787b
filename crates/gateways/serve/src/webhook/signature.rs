//! Signatures of requests, as [Standard Webhooks](https://www.standardwebhooks.com) defines them.

use std::fmt;
use std::path::Path;

use anyhow::{Context as _, anyhow};
use base64::Engine as _;
use base64::engine::general_purpose::STANDARD;
use hmac_sha256::HMAC;

/// Signs requests with a secret.
pub(super) struct Signer(Vec<u8>);

impl Signer {
    /// Reads a secret: base64 of 24 to 64 bytes, in a file of mode 0600.
    pub(super) fn read(path: &Path) -> anyhow::Result<Self> {
        let line = joulebus_files::read_secret_line(path)?;
        let text = line.trim().trim_start_matches("whsec_");
        let secret = STANDARD.decode(text).context("expected base64")?;
        if !(24..=64).contains(&secret.len()) {
            return Err(anyhow!("has {} bytes, allowed are 24 to 64", secret.len()));
        }
        Ok(Self(secret))
    }

    /// The header `webhook-signature` of a body with the other two headers.
    pub(super) fn sign(&self, id: &str, unix_s: u64, body: &[u8]) -> String {
        let mut signed = HMAC::new(&self.0);
        signed.update(format!("{id}.{unix_s}."));
        signed.update(body);
        format!("v1,{}", STANDARD.encode(signed.finalize()))
    }
}

impl fmt::Debug for Signer {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        out.write_str("Signer")
    }
}
