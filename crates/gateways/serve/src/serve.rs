//! `joulebus serve`: runs the server until a signal.

use std::fmt;
use std::time::Duration;

use crate::arguments::ServeArguments;
use joulebus_bus::{NoWorker, check_threads};
use joulebus_program::exit::Outcome;
use joulebus_program::output::{Output, log_line};
use joulebus_program::stop::Stop;
use serde::Serialize;

use crate::http::{HttpReport, HttpServer, Options};

/// Interval of checking whether to stop.
const POLL_INTERVAL: Duration = Duration::from_millis(20);

#[derive(Debug, Serialize)]
struct ServeReport {
    fleet: String,
    http: HttpReport,
}

pub(crate) fn run(args: &ServeArguments, output: Output) -> anyhow::Result<Outcome> {
    let stop = Stop::on_signals()?;
    check_threads()?;
    let config = args.config.load()?;
    let options = Options {
        address: args.http,
        socket: args.socket.clone(),
        token_file: args.token_file.clone(),
        allow_host: args.allow_host.clone(),
        metrics_robots: args.metrics_robots,
    };
    let http = HttpServer::start(&config, &options)?;
    let fleet = config.fleet().to_owned();
    for place in http.places() {
        log_line(&format!("serving fleet {fleet} at {place}"));
    }
    if let Some(no_worker) = NoWorker::look(&config.domain()?) {
        log_line(&format!("{no_worker}. Waiting for one"));
    }
    while !stop.is_asked() && !http.is_over() {
        std::thread::sleep(POLL_INTERVAL);
    }
    output.report(&ServeReport { fleet, http: http.finish()? })?;
    Ok(Outcome::Done)
}

impl fmt::Display for ServeReport {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { fleet, http } = self;
        let HttpReport { address, socket, requests, refused, messages } = http;
        let socket = socket.as_ref().map(|socket| socket.display().to_string());
        let places: Vec<&str> = address.iter().chain(&socket).map(String::as_str).collect();
        let places = places.join(" and ");
        writeln!(
            out,
            "served fleet {fleet} at {places}: {requests} requests, {refused} refused, {messages} messages"
        )
    }
}
