//! Access control: the token and the server's names.

use std::io;
use std::net::IpAddr;
use std::path::{Path, PathBuf};

use axum::http::{HeaderMap, StatusCode, Uri, header};
use subtle::ConstantTimeEq as _;

use super::error::ApiError;

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

/// Reason that a token file is not used.
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
        let failed = |error| TokenError::Read { path: path.to_owned(), error };
        let text = joulebus_files::read_secret(path, MAX_FILE_BYTES).map_err(failed)?;
        let text = text.trim_end_matches(['\n', '\r']);
        let plain = |byte: u8| byte.is_ascii_alphanumeric() || b"-._~".contains(&byte);
        if !TOKEN_LENGTHS.contains(&text.len()) || !text.bytes().all(plain) {
            return Err(TokenError::Text { path: path.to_owned(), found: text.len() });
        }
        Ok(Self(text.as_bytes().to_vec()))
    }

    /// Compares in constant time. The length is not secret.
    fn is(&self, found: &[u8]) -> bool {
        self.0.ct_eq(found).into()
    }

    /// True if a request carries it, as bearer or as the cookie `cookie`.
    fn is_in(&self, headers: &HeaderMap, cookie: &str) -> bool {
        let bearer = headers.get(header::AUTHORIZATION).map(|value| value.as_bytes());
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

/// True if a path states for supervisors whether server and worker run. Supervisors have no token,
/// learn nothing else, and are answered whatever other clients do.
pub(super) fn is_of_health(uri: &Uri) -> bool {
    matches!(uri.path(), "/healthz" | "/readyz")
}

impl Access {
    /// Checks that a request may be answered.
    pub(super) fn check(&self, uri: &Uri, headers: &HeaderMap) -> Result<(), ApiError> {
        self.check_site(uri, headers)?;
        match &self.token {
            Some(token) if !is_of_health(uri) && !token.is_in(headers, &self.cookie) => {
                Err(ApiError::new(
                    StatusCode::UNAUTHORIZED,
                    "no token, or another one: send `Authorization: Bearer TOKEN`, or open /?token=TOKEN once",
                ))
            }
            _ => Ok(()),
        }
    }

    /// Checks that a request is for this server and not sent by a page of another site.
    pub(super) fn check_site(&self, uri: &Uri, headers: &HeaderMap) -> Result<(), ApiError> {
        self.check_host(uri, headers)?;
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
    /// A request may name the host in its first line, too.
    pub(super) fn check_host(&self, uri: &Uri, headers: &HeaderMap) -> Result<(), ApiError> {
        let mut stated = headers.get_all(header::HOST).iter();
        let host = stated.next().and_then(|host| host.to_str().ok()).unwrap_or_default();
        let is_known = |host: &str| {
            let name = name_of(host).to_ascii_lowercase();
            let mut names = self.hosts.iter();
            name.parse::<IpAddr>().is_ok()
                || name == "localhost"
                || names.any(|known| known.eq_ignore_ascii_case(&name))
        };
        let asked = uri.authority().map(axum::http::uri::Authority::as_str);
        let host = asked.filter(|asked| !is_known(asked)).unwrap_or(host);
        if is_known(host) && stated.next().is_none() {
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

#[cfg(test)]
mod tests {
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
    fn a_request_that_names_another_host_in_its_first_line_is_refused() {
        let (open, host) = (access(None), [("host", "localhost")]);
        for (line, refused) in [
            ("http://evil.example/", Some(403)),
            ("http://localhost/", None),
            ("http://energy.example:80/", None),
            ("http://evil.example@localhost/", Some(403)),
        ] {
            assert_eq!(status(&open, line, &host), refused, "{line}");
        }
    }

    #[test]
    fn with_a_token_only_its_holders_are_answered() {
        let closed = access(Some("0123456789abcdef"));
        let host = ("host", "localhost");
        for allowed in [
            ("authorization", "Bearer 0123456789abcdef"),
            ("cookie", "joulebus_token_1=0123456789abcdef"),
            ("cookie", "joulebus_token_2=fedcba9876543210; joulebus_token_1=0123456789abcdef"),
            ("cookie", "a=b; joulebus_token_1=0123456789abcdef; c=d"),
        ] {
            assert_eq!(status(&closed, "/metrics", &[host, allowed]), None, "{allowed:?}");
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
            assert_eq!(status(&closed, "/", &[host, refused]), Some(401), "{refused:?}");
        }
        assert_eq!(status(&closed, "/", &[host]), Some(401));
        assert_eq!(status(&closed, "/healthz", &[host]), None);
        let uri = |path: &str| path.parse::<Uri>().expect("a path");
        let found = closed.token_of(&uri("/?token=0123456789abcdef"));
        assert_eq!(found.as_deref(), Some("0123456789abcdef"));
        for path in ["/?token=", "/?token=0123456789abcdeX", "/", "/metrics?token=0123456789abcdef"]
        {
            assert_eq!(closed.token_of(&uri(path)), None, "{path}");
        }
        assert_eq!(access(None).token_of(&uri("/?token=0123456789abcdef")), None);
    }
}
