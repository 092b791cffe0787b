//! Signatures of requests, as [Standard Webhooks](https://www.standardwebhooks.com) defines them.

use std::fmt;
use std::path::Path;

use anyhow::{Context as _, anyhow};
use base64::Engine as _;
use base64::engine::general_purpose::STANDARD;
use ring::hmac;

/// Signs requests with a secret.
pub(super) struct Signer(hmac::Key);

impl Signer {
    /// Reads a secret: base64 of 24 to 64 bytes, in a file of mode 0600.
    pub(super) fn read(path: &Path) -> anyhow::Result<Self> {
        let line = joulebus_files::read_secret_line(path)?;
        let text = line.trim().trim_start_matches("whsec_");
        let secret = STANDARD.decode(text).context("expected base64")?;
        if !(24..=64).contains(&secret.len()) {
            return Err(anyhow!("has {} bytes, allowed are 24 to 64", secret.len()));
        }
        Ok(Self(hmac::Key::new(hmac::HMAC_SHA256, &secret)))
    }

    /// The header `webhook-signature` of a body with the other two headers.
    pub(super) fn sign(&self, id: &str, unix_s: u64, body: &[u8]) -> String {
        let mut signed = hmac::Context::with_key(&self.0);
        signed.update(format!("{id}.{unix_s}.").as_bytes());
        signed.update(body);
        format!("v1,{}", STANDARD.encode(signed.sign()))
    }
}

impl fmt::Debug for Signer {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        out.write_str("Signer")
    }
}
