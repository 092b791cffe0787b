//! The page's files, from memory only.

use axum::body::Body;
use axum::http::{HeaderMap, HeaderValue, StatusCode, header};
use axum::response::{IntoResponse as _, Response};
use hmac_sha256::Hash as Sha256;

use super::error::typed;

const HTML: &str = "text/html; charset=utf-8";
const CSS: &str = "text/css; charset=utf-8";
const JS: &str = "text/javascript; charset=utf-8";
const SVG: &str = "image/svg+xml";
const TEXT: &str = "text/plain; charset=utf-8";

/// A file's path, type and content.
type File = (&'static str, &'static str, &'static [u8]);

macro_rules! file {
    ($path:literal, $kind:expr) => {
        (concat!("/", $path), $kind, include_bytes!(concat!("../../page/", $path)))
    };
}

/// Every file of `page/`.
static PAGE: &[File] = &[
    file!("index.html", HTML),
    file!("address.js", JS),
    file!("alarms.js", JS),
    file!("board.js", JS),
    file!("capacity.js", JS),
    file!("card.js", JS),
    file!("charts.js", JS),
    file!("fan.js", JS),
    file!("favicon.svg", SVG),
    file!("format.js", JS),
    file!("list.js", JS),
    file!("outlook.js", JS),
    file!("meaning.js", JS),
    file!("page.css", CSS),
    file!("page.js", JS),
    file!("person.js", JS),
    file!("robot.js", JS),
    file!("stream.js", JS),
    file!("vendor/uPlot.LICENSE", TEXT),
    file!("vendor/uPlot.iife.min.js", JS),
    file!("vendor/uPlot.min.css", CSS),
    file!("what_if.js", JS),
    file!("worker.js", JS),
];

/// The page for a client without the token.
const CLOSED: &str = "<!doctype html><html lang=\"en\"><meta charset=\"utf-8\"><title>joulebus</title>\
    <h1>joulebus</h1><p>This page needs the token of the server's <code>--token-file</code>. Open \
    <code>/?token=TOKEN</code> once. Programs send <code>Authorization: Bearer \
    TOKEN</code>.</p></html>\n";

/// The file at `path`, or only that the client has it.
pub(super) fn file(path: &str, request: &HeaderMap) -> Option<Response> {
    let wanted = if path == "/" { "/index.html" } else { path };
    let (_, kind, bytes) = PAGE.iter().find(|(path, ..)| *path == wanted)?;
    let tag = tag(bytes);
    let known = request.get(header::IF_NONE_MATCH);
    let mut response = if known.is_some_and(|known| known.as_bytes() == tag.as_bytes()) {
        StatusCode::NOT_MODIFIED.into_response()
    } else {
        typed(kind, *bytes)
    };
    let headers = response.headers_mut();
    // Hexadecimal digits in quotes.
    if let Ok(tag) = HeaderValue::try_from(tag) {
        headers.insert(header::ETAG, tag);
    }
    headers.insert(header::CACHE_CONTROL, HeaderValue::from_static("no-cache"));
    Some(response)
}

fn tag(bytes: &[u8]) -> String {
    let digest = Sha256::hash(bytes);
    let digits: String = digest.iter().take(8).map(|byte| format!("{byte:02x}")).collect();
    format!("\"{digits}\"")
}

/// The page that states how to get in.
pub(super) fn closed() -> Response {
    let mut response = typed(HTML, Body::from(CLOSED));
    *response.status_mut() = StatusCode::UNAUTHORIZED;
    response
}
