//! Access control: the token, the server's names, and rate limits.

use std::collections::HashMap;
use std::io;
use std::net::IpAddr;
use std::path::{Path, PathBuf};
use std::time::Instant;

use axum::http::{HeaderMap, StatusCode, Uri, header};
use subtle::ConstantTimeEq as _;

use super::error::ApiError;
use super::listen::Peer;

/// Maximum size of the token file, bytes.
const MAX_FILE_BYTES: u64 = 4_096;
/// Shortest and longest token, characters.
const TOKEN_LENGTHS: std::ops::RangeInclusive<usize> = 16..=256;
/// Name of the cookie with the token of a fleet's server.
///
/// A browser sends a host's cookies to all its ports, so the servers of several fleets need
/// different names. The letters of a fleet's name are all allowed in a cookie's name.
pub(super) fn cookie_name(fleet: &str) -> String {
    format!("joulebus_token_{fleet}")
}

/// Why a token file is not used.
#[derive(Debug, thiserror::Error)]
pub(crate) enum TokenError {
    #[error("token file {}: {error}", path.display())]
    Read { path: PathBuf, error: io::Error },
    #[error(
        "token file {} holds {found} characters, expected one line of 16 to 256 letters, digits, -, ., _, ~: \
         `head -c 24 /dev/urandom | base64 | tr '+/' '-_' > {}`",
        path.display(), path.display()
    )]
    Text { path: PathBuf, found: usize },
}

/// A secret that clients send.
pub(super) struct Token(Vec<u8>);

impl Token {
    pub(super) fn read(path: &Path) -> Result<Self, TokenError> {
        let failed = |error| TokenError::Read {
            path: path.to_owned(),
            error,
        };
        let text = joulebus_files::read_secret(path, MAX_FILE_BYTES).map_err(failed)?;
        let text = text.trim_end_matches(['\n', '\r']);
        let plain = |byte: u8| byte.is_ascii_alphanumeric() || b"-._~".contains(&byte);
        if !TOKEN_LENGTHS.contains(&text.len()) || !text.bytes().all(plain) {
            return Err(TokenError::Text {
                path: path.to_owned(),
                found: text.len(),
            });
        }
        Ok(Self(text.as_bytes().to_vec()))
    }

    /// Compares in constant time. The length is not secret.
    fn is(&self, found: &[u8]) -> bool {
        self.0.ct_eq(found).into()
    }

    /// Whether a request carries it, as bearer or as the cookie `cookie`.
    fn is_in(&self, headers: &HeaderMap, cookie: &str) -> bool {
        let bearer = headers
            .get(header::AUTHORIZATION)
            .map(|value| value.as_bytes());
        let bearer = bearer.and_then(|value| value.strip_prefix(b"Bearer "));
        let cookies = headers.get_all(header::COOKIE).iter();
        let cookies = cookies.filter_map(|cookies| cookies.to_str().ok());
        let mut ours = cookies
            .flat_map(|cookies| cookies.split(';'))
            .filter_map(|found| found.trim().strip_prefix(cookie)?.strip_prefix('='));
        bearer.is_some_and(|found| self.is(found)) || ours.any(|found| self.is(found.as_bytes()))
    }
}

/// The checks that precede the handling of a request.
pub(super) struct Access {
    pub(super) token: Option<Token>,
    /// The name by [`cookie_name`].
    pub(super) cookie: String,
    /// Allowed names of the server, beside addresses and localhost.
    pub(super) hosts: Vec<String>,
}

impl Access {
    /// Whether a request may be answered.
    ///
    /// # Errors
    /// The refusal.
    pub(super) fn check(&self, uri: &Uri, headers: &HeaderMap) -> Result<(), ApiError> {
        self.check_site(headers)?;
        // Process supervisors have no token. They learn only whether a worker runs.
        let is_open = matches!(uri.path(), "/healthz" | "/readyz");
        match &self.token {
            Some(token) if !is_open && !token.is_in(headers, &self.cookie) => Err(ApiError::new(
                StatusCode::UNAUTHORIZED,
                "no token, or another one: send `Authorization: Bearer TOKEN`, or open /?token=TOKEN once",
            )),
            _ => Ok(()),
        }
    }

    /// Whether a request is for this server and not sent by a page of another site.
    ///
    /// # Errors
    /// The refusal.
    pub(super) fn check_site(&self, headers: &HeaderMap) -> Result<(), ApiError> {
        self.check_host(headers)?;
        check_site(headers)
    }

    /// The token of `/?token=T`, if it is the right one.
    pub(super) fn token_of(&self, uri: &Uri) -> Option<String> {
        let token = self.token.as_ref().filter(|_| uri.path() == "/")?;
        let query = uri.query()?.as_bytes();
        let (_, found) = form_urlencoded::parse(query).find(|(name, _)| name == "token")?;
        token.is(found.as_bytes()).then(|| found.into_owned())
    }

    /// A web page elsewhere can make its own name mean this host, but not an address or localhost.
    pub(super) fn check_host(&self, headers: &HeaderMap) -> Result<(), ApiError> {
        let mut stated = headers.get_all(header::HOST).iter();
        let host = stated
            .next()
            .and_then(|host| host.to_str().ok())
            .unwrap_or_default();
        let name = name_of(host).to_ascii_lowercase();
        let is_known = name.parse::<IpAddr>().is_ok()
            || name == "localhost"
            || self
                .hosts
                .iter()
                .any(|known| known.eq_ignore_ascii_case(&name));
        if is_known && stated.next().is_none() {
            return Ok(());
        }
        let found: String = host.chars().take(60).collect();
        Err(ApiError::new(
            StatusCode::FORBIDDEN,
            format!(
                "the request is for host {found:?}: allowed are localhost, addresses, and names given by --allow-host"
            ),
        ))
    }
}

/// Pages of other sites can send requests, though not read the answers. Without this check they
/// would take up places.
fn check_site(headers: &HeaderMap) -> Result<(), ApiError> {
    let is = |name: &str, value: &str| headers.get(name).is_some_and(|found| found == value);
    if is("sec-fetch-site", "cross-site") && !is("sec-fetch-mode", "navigate") {
        let text = "a page of another site asks: only this server's own page may";
        return Err(ApiError::new(StatusCode::FORBIDDEN, text));
    }
    Ok(())
}

/// A host without its port and without the brackets of an address.
fn name_of(host: &str) -> &str {
    if let Some(rest) = host.strip_prefix('[') {
        return rest.split_once(']').map_or("", |(name, _)| name);
    }
    host.split_once(':').map_or(host, |(name, _)| name)
}

/// Requests per second of one address or user, and the size of a burst.
const RATE: f64 = 200.0;
const BURST: f64 = 1_000.0;
/// Maximum number of remembered addresses and users. Those with a full allowance are forgotten
/// first.
const MAX_ADDRESSES: usize = 4_096;

/// The remaining allowance of each address and user.
#[derive(Debug, Default)]
pub(super) struct Rates {
    left: HashMap<Peer, (f64, Instant)>,
}

impl Rates {
    /// Takes one request of `peer`.
    ///
    /// # Errors
    /// There were too many.
    pub(super) fn take(&mut self, peer: Peer, now: Instant) -> Result<(), ApiError> {
        let refilled = |left: f64, since: Instant| {
            let seconds = now.saturating_duration_since(since).as_secs_f64();
            (left + seconds * RATE).min(BURST)
        };
        if self.left.len() >= MAX_ADDRESSES && !self.left.contains_key(&peer) {
            self.left
                .retain(|_, (left, since)| refilled(*left, *since) < BURST);
        }
        if self.left.len() >= MAX_ADDRESSES && !self.left.contains_key(&peer) {
            return Err(too_many());
        }
        let (left, since) = self.left.entry(peer).or_insert((BURST, now));
        *left = refilled(*left, *since);
        *since = now;
        if *left < 1.0 {
            return Err(too_many());
        }
        *left -= 1.0;
        Ok(())
    }
}

fn too_many() -> ApiError {
    let text =
        format!("more than {RATE} requests a second from one address or user: ask less often");
    ApiError::new(StatusCode::TOO_MANY_REQUESTS, text)
}

#[cfg(test)]
mod tests {
    use std::time::Duration;

    use axum::http::HeaderValue;

    use super::*;

    fn headers(pairs: &[(&'static str, &'static str)]) -> HeaderMap {
        let pairs = pairs.iter();
        pairs
            .map(|(name, value)| {
                let name = header::HeaderName::from_static(name);
                (name, HeaderValue::from_static(value))
            })
            .collect()
    }

    fn access(token: Option<&str>) -> Access {
        Access {
            token: token.map(|token| Token(token.into())),
            cookie: cookie_name("1"),
            hosts: vec!["energy.example".to_owned()],
        }
    }

    fn status(access: &Access, path: &str, pairs: &[(&'static str, &'static str)]) -> Option<u16> {
        let uri: Uri = path.parse().expect("a path");
        let refused = access.check(&uri, &headers(pairs)).err();
        refused.map(|error| error.status.as_u16())
    }

    #[test]
    fn names_that_a_page_elsewhere_can_choose_are_refused() {
        let open = access(None);
        for host in [
            "127.0.0.1:8630",
            "localhost",
            "LOCALHOST:9",
            "[::1]:8630",
            "10.0.0.7",
            "energy.example:443",
            "Energy.Example",
        ] {
            assert_eq!(status(&open, "/", &[("host", host)]), None, "{host}");
        }
        for host in [
            "",
            "evil.example",
            "localhost.evil.example",
            "127.0.0.1.evil.example",
            "[evil.example]",
            "energy.example.evil",
            "evil.example:8630",
            "127.0.0.1@evil.example",
        ] {
            assert_eq!(status(&open, "/", &[("host", host)]), Some(403), "{host}");
        }
        assert_eq!(status(&open, "/", &[]), Some(403));
        let two = [("host", "localhost"), ("host", "evil.example")];
        assert_eq!(status(&open, "/", &two), Some(403));
        let page = [("host", "localhost"), ("sec-fetch-site", "cross-site")];
        assert_eq!(status(&open, "/api/v1/stream", &page), Some(403));
        let link = [page[0], page[1], ("sec-fetch-mode", "navigate")];
        assert_eq!(status(&open, "/", &link), None);
    }

    #[test]
    fn with_a_token_only_its_holders_are_answered() {
        let closed = access(Some("0123456789abcdef"));
        let host = ("host", "localhost");
        for allowed in [
            ("authorization", "Bearer 0123456789abcdef"),
            ("cookie", "joulebus_token_1=0123456789abcdef"),
            (
                "cookie",
                "joulebus_token_2=fedcba9876543210; joulebus_token_1=0123456789abcdef",
            ),
            ("cookie", "a=b; joulebus_token_1=0123456789abcdef; c=d"),
        ] {
            assert_eq!(
                status(&closed, "/metrics", &[host, allowed]),
                None,
                "{allowed:?}"
            );
        }
        for refused in [
            ("authorization", "Bearer 0123456789abcdeg"),
            ("authorization", "Bearer 0123456789abcde"),
            ("authorization", "Bearer 0123456789abcdef0"),
            ("authorization", "Bearer "),
            ("authorization", "0123456789abcdef"),
            ("authorization", "Basic 0123456789abcdef"),
            ("cookie", "joulebus_token_1="),
            // Another fleet's.
            ("cookie", "joulebus_token_2=0123456789abcdef"),
            ("cookie", "xjoulebus_token_1=0123456789abcdef"),
            ("cookie", "joulebus_token_1=0123456789abcdef0"),
        ] {
            assert_eq!(
                status(&closed, "/", &[host, refused]),
                Some(401),
                "{refused:?}"
            );
        }
        assert_eq!(status(&closed, "/", &[host]), Some(401));
        assert_eq!(status(&closed, "/healthz", &[host]), None);
        let uri = |path: &str| path.parse::<Uri>().expect("a path");
        let found = closed.token_of(&uri("/?token=0123456789abcdef"));
        assert_eq!(found.as_deref(), Some("0123456789abcdef"));
        for path in [
            "/?token=",
            "/?token=0123456789abcdeX",
            "/",
            "/metrics?token=0123456789abcdef",
        ] {
            assert_eq!(closed.token_of(&uri(path)), None, "{path}");
        }
        assert_eq!(
            access(None).token_of(&uri("/?token=0123456789abcdef")),
            None
        );
    }

    #[test]
    fn an_address_that_asks_too_often_waits_and_others_do_not() {
        let (mut rates, begin) = (Rates::default(), Instant::now());
        let one = Peer::Address([127, 0, 0, 1].into());
        let other = Peer::Address([10, 0, 0, 1].into());
        let taken = (0..5_000)
            .filter(|_| rates.take(one, begin).is_ok())
            .count();
        assert_eq!(taken, 1_000);
        assert!(rates.take(other, begin).is_ok());
        let later = begin + Duration::from_secs(1);
        let taken = (0..5_000)
            .filter(|_| rates.take(one, later).is_ok())
            .count();
        assert_eq!(taken, 200);
        // A user of this host has an allowance apart from all addresses.
        let taken = (0..5_000)
            .filter(|_| rates.take(Peer::User(0), later).is_ok())
            .count();
        assert_eq!(taken, 1_000);
    }

    #[test]
    fn many_addresses_take_bounded_memory() {
        let (mut rates, begin) = (Rates::default(), Instant::now());
        for number in 0..20_000_u32 {
            let now = begin + Duration::from_millis(number.into());
            let peer = match number % 2 {
                0 => Peer::Address(number.to_be_bytes().into()),
                _ => Peer::User(number),
            };
            let _ = rates.take(peer, now);
            assert!(rates.left.len() <= MAX_ADDRESSES);
        }
        assert!(
            rates
                .take(Peer::User(7), begin + Duration::from_secs(60))
                .is_ok()
        );
    }
}
