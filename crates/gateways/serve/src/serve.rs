//! `joulebus serve`: runs the page and the webhooks in one process.

use std::fmt;
use std::time::Duration;

use crate::arguments::ServeArguments;
use joulebus_bus::{NoWorker, check_threads};
use joulebus_program::exit::Outcome;
use joulebus_program::output::{Output, log_line};
use joulebus_program::stop::Stop;
use serde::Serialize;

use crate::http::{HttpReport, HttpServer, Options};
use crate::webhook::{WebhookReport, Webhooks};

/// Interval of checking whether to stop.
const POLL_INTERVAL: Duration = Duration::from_millis(20);

#[derive(Debug, Serialize)]
struct ServeReport {
    fleet: String,
    #[serde(skip_serializing_if = "Option::is_none")]
    http: Option<HttpReport>,
    #[serde(skip_serializing_if = "Vec::is_empty")]
    webhooks: Vec<WebhookReport>,
}

pub(crate) fn run(args: &ServeArguments, output: Output) -> anyhow::Result<Outcome> {
    let stop = Stop::on_signals()?;
    check_threads()?;
    let config = args.config.load()?;
    let is_http = args.http.is_some() || args.socket.is_some();
    let http = is_http.then(|| {
        let options = Options {
            address: args.http,
            socket: args.socket.clone(),
            token_file: args.token_file.clone(),
            allow_host: args.allow_host.clone(),
            metrics_robots: args.metrics_robots,
        };
        HttpServer::start(&config, &options)
    });
    let http = http.transpose()?;
    let (to, listed) = (args.webhook.as_deref(), args.webhooks.as_deref());
    let webhooks = (to.is_some() || listed.is_some()).then(|| Webhooks::start(&config, to, listed));
    let webhooks = webhooks.transpose()?;
    let fleet = config.fleet();
    for place in http.iter().flat_map(HttpServer::places) {
        log_line(&format!("serving fleet {fleet} at {place}"));
    }
    if let Some(webhooks) = &webhooks {
        log_line(&format!("telling {} of alarms of fleet {fleet}", webhooks.hosts()));
    }
    if let Some(no_worker) = NoWorker::look(&config.domain()?) {
        log_line(&format!("{no_worker}. Waiting for one"));
    }
    let is_over = || {
        webhooks.as_ref().is_some_and(Webhooks::is_over)
            || http.as_ref().is_some_and(HttpServer::is_over)
    };
    while !stop.is_asked() && !is_over() {
        std::thread::sleep(POLL_INTERVAL);
    }
    let http = http.map(HttpServer::finish).transpose()?;
    let webhooks = webhooks.map(Webhooks::finish).transpose()?.unwrap_or_default();
    let lost = webhooks.iter().any(|webhook| webhook.lost > 0);
    output.report(&ServeReport { fleet: fleet.to_owned(), http, webhooks })?;
    Ok(Outcome::unless_lost(lost))
}

impl fmt::Display for ServeReport {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        let fleet = &self.fleet;
        if let Some(http) = &self.http {
            let HttpReport { address, socket, requests, refused, messages } = http;
            let socket = socket.as_ref().map(|socket| socket.display().to_string());
            let places: Vec<&str> = address.iter().chain(&socket).map(String::as_str).collect();
            let places = places.join(" and ");
            writeln!(
                out,
                "served fleet {fleet} at {places}: {requests} requests, {refused} refused, {messages} messages"
            )?;
        }
        for webhook in &self.webhooks {
            let WebhookReport { host, told, failed, lost, ticks_missed } = webhook;
            writeln!(
                out,
                "told {host} of alarms of fleet {fleet}: {told} changes, {lost} lost ({ticks_missed} of them ticks without diagnostics), \
                 {failed} requests failed"
            )?;
        }
        Ok(())
    }
}
