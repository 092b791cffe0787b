//! Certificates of a fleet's own authority.

use std::path::Path;
use std::process::Command;

/// Makes certificates for 127.0.0.1 as the documentation describes, valid for `days`, in `folder`:
/// `fleet-ca.pem`, and `NAME.pem` and `NAME.key` of each host. Returns false without `openssl`,
/// which is logged.
///
/// # Panics
/// There is no `openssl`, and `CI` is `true`.
pub fn certificates(folder: &Path, days: u32, hosts: &[&str]) -> bool {
    let script = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../tools/fleet_certificates.sh");
    let hosts = hosts.iter().map(|name| format!("{name}=127.0.0.1"));
    let made = Command::new(script)
        .arg(folder)
        .args(hosts)
        .env("JOULEBUS_CERTIFICATE_DAYS", days.to_string())
        .output();
    let is_made = made.is_ok_and(|made| made.status.success());
    assert!(is_made || std::env::var_os("CI").is_none_or(|ci| ci != "true"), "openssl is needed");
    if !is_made {
        eprintln!("skipped: openssl is needed");
    }
    is_made
}
