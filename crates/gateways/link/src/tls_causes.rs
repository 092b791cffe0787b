//! Causes of failed connections with TLS, in words. zenoh logs them only: on the side that connects
//! at the level `debug`, and on the side that listens with a hint at open files.

use std::sync::{Mutex, PoisonError};
use std::time::{Duration, Instant};

use joulebus_program::logging::LogTap;
use tracing::level_filters::LevelFilter;

/// Messages of zenoh about TLS and its attempts to connect.
pub(crate) const TAP: LogTap = LogTap {
    targets: &[
        ("zenoh_link_tls", LevelFilter::WARN),
        ("zenoh_link_commons::tls", LevelFilter::WARN),
        ("zenoh::net::runtime::orchestrator", LevelFilter::DEBUG),
    ],
    take: take_message,
};
/// Interval after which a cause that goes on is logged again.
const REPEAT_INTERVAL: Duration = Duration::from_secs(600);
/// Causes that are remembered. Strangers can cause any number of different ones.
const MAX_CAUSES: usize = 64;

struct Cause {
    text: String,
    logged: Instant,
    is_new: bool,
}

static CAUSES: Mutex<Vec<Cause>> = Mutex::new(Vec::new());

/// The causes that have come since the last call.
pub(crate) fn take() -> Vec<String> {
    let mut causes = CAUSES.lock().unwrap_or_else(PoisonError::into_inner);
    let new = causes.iter_mut().filter(|cause| cause.is_new);
    new.map(|cause| {
        cause.is_new = false;
        cause.text.clone()
    })
    .collect()
}

/// Returns whether the message is of a connection that failed: it needs no line of its own then.
fn take_message(message: &str) -> bool {
    let Some(text) = in_words(message) else {
        return false;
    };
    let mut causes = CAUSES.lock().unwrap_or_else(PoisonError::into_inner);
    let now = Instant::now();
    let is_over = |cause: &Cause| !cause.is_new && now - cause.logged >= REPEAT_INTERVAL;
    causes.retain(|cause| !is_over(cause));
    if causes.len() < MAX_CAUSES && causes.iter().all(|cause| cause.text != text) {
        causes.push(Cause { text, logged: now, is_new: true });
    }
    true
}

fn in_words(message: &str) -> Option<String> {
    if let Some((_, which)) = message.split_once("Closing TLS link ") {
        let (link, _) = which.split_once(" : remote certificate chain expired")?;
        return Some(format!(
            "the connection {link} ends: the other link's certificate has expired"
        ));
    }
    let error = match message.split_once(" Hint: increase the system open file limit.") {
        // It may be right.
        Some((error, _)) if error.contains("(os error ") => return None,
        Some((error, _)) => error.trim_end_matches('.'),
        None => message,
    };
    let who = match message.split_once("Unable to connect to configured peer ") {
        Some((_, rest)) => format!("no connection to {}", rest.split_once('!')?.0),
        None if error.len() < message.len() => "a connection was refused".to_owned(),
        None => return None,
    };
    let cause = cause(error);
    if cause.is_none() && error.len() == message.len() {
        // An address that does not answer. The link reports that, too.
        return None;
    }
    Some(format!("{who}: {}", cause.unwrap_or_else(|| error.to_owned())))
}

/// Meaning of an error of rustls for the files of links.
fn cause(error: &str) -> Option<String> {
    if let Some((_, found)) = error.split_once("invalid peer certificate: ") {
        let found = found.split(" at /").next().unwrap_or(found);
        let is = |words: &[&str]| words.iter().any(|word| found.contains(word));
        return Some(if is(&["expired", "Expired"]) {
            "the other link's certificate has expired".to_owned()
        } else if is(&["not valid yet", "NotValidYet"]) {
            "the other link's certificate is not valid yet: compare the clocks of the hosts"
                .to_owned()
        } else if is(&["not valid for name", "NotValidForName"]) {
            format!("the other link's certificate is for another address: {found}")
        } else if is(&["UnknownIssuer", "BadSignature"]) {
            "the other link's certificate is of another authority than `ca` in this link's file"
                .to_owned()
        } else {
            format!("the other link's certificate is invalid: {found}")
        });
    }
    if error.contains("peer sent no certificates") {
        return Some("the other side shows no certificate".to_owned());
    }
    let (_, alert) = error.split_once("received fatal alert: ")?;
    let alert = alert.split([' ', '.']).next().unwrap_or(alert);
    let why = match alert {
        "CertificateExpired" => "it has expired, by the other host's clock",
        "UnknownCA" | "DecryptError" => {
            "it is of another authority than `ca` in the other link's file"
        }
        "CertificateRequired" => "none was shown",
        "BadCertificate" => "it may be for another address than the other link's file names",
        other => other,
    };
    Some(format!("the other side refuses this link's certificate: {why}"))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_zenoh_logs_of_tls_is_reported_in_words_and_all_else_is_left_to_it() {
        const HINT: &str = " Hint: increase the system open file limit.";
        let refused = |error: &str| in_words(&format!("{error}.{HINT}"));
        let failed = |error: &str| {
            let peer = "Unable to connect to configured peer tls/10.0.0.1:7447!";
            in_words(&format!("{peer} {error} at /src/unicast.rs:378.. Retry in 200ms."))
        };
        let invalid = |found: &str| format!("invalid peer certificate: {found}");
        for (found, expected) in [
            (invalid("certificate expired: verification time 7 (UNIX)"), "has expired"),
            (invalid("certificate not valid yet: verification time 7"), "clocks of the hosts"),
            (invalid("certificate not valid for name \"a\""), "another address"),
            (invalid("UnknownIssuer"), "another authority"),
            (invalid("BadSignature"), "another authority"),
            (invalid("BadEncoding"), "BadEncoding"),
            ("peer sent no certificates".to_owned(), "no certificate"),
            (
                "received fatal alert: CertificateExpired".to_owned(),
                "this link's certificate: it has",
            ),
            ("received fatal alert: DecryptError".to_owned(), "the other link's file"),
            ("received fatal alert: BadCertificate".to_owned(), "another address"),
            ("received fatal alert: CertificateRequired".to_owned(), "none was shown"),
        ] {
            let (here, there) = (failed(&found).unwrap(), refused(&found).unwrap());
            assert!(here.starts_with("no connection to tls/10.0.0.1:7447: "), "{here}");
            assert!(here.contains(expected) && there.contains(expected), "{here}; {there}");
            assert!(!there.contains("open file"), "{there}");
        }
        let stranger = refused("received corrupt message of type InvalidContentType").unwrap();
        assert!(stranger.ends_with("InvalidContentType"), "{stranger}");
        let closed = "Closing TLS link 10.0.0.1:1 => 10.0.0.2:2 : remote certificate chain expired";
        assert!(in_words(closed).unwrap().contains("10.0.0.1:1 => 10.0.0.2:2"));
        for other in [
            &format!("Too many open files (os error 24).{HINT}"),
            "Unable to connect to configured peer tls/10.0.0.1:7447! Connection refused. Retry in 1s.",
            "Scouting delay elapsed before start conditions are met.",
        ] {
            assert_eq!(in_words(other), None);
        }
    }

    #[test]
    fn a_cause_is_logged_once_and_any_number_of_others_takes_no_memory() {
        let wrong = |number: usize| {
            assert!(take_message(&format!(
                "odd {number}. Hint: increase the system open file limit."
            )));
        };
        wrong(0);
        wrong(0);
        assert_eq!(take(), ["a connection was refused: odd 0"]);
        wrong(0);
        assert!(take().is_empty());
        (0..10 * MAX_CAUSES).for_each(wrong);
        assert_eq!(take().len(), MAX_CAUSES - 1);
    }
}
