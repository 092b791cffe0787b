//! Paths and what they answer.

use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::mpsc::{SyncSender, TrySendError};
use std::time::Duration;

use axum::Router;
use axum::body::{Body, Bytes, HttpBody as _};
use axum::extract::{Extension, FromRequestParts, Path, Request, State};
use axum::http::request::Parts;
use axum::http::{HeaderMap, StatusCode, Uri, header};
use axum::response::{IntoResponse as _, Response};
use axum::routing::{get, post};
use futures_util::stream;
use joulebus_board::{CardRecord, OutlookRecord};
use joulebus_bus::clock;
use joulebus_config::settings::Platform;
use joulebus_config::{Config, KEYS};
use joulebus_wire::{AlarmCard, Outlook};
use serde::Serialize;
use serde::de::DeserializeOwned;
use tokio::sync::watch;
use tokio::time::{Instant, MissedTickBehavior, interval_at, timeout};

use super::acknowledge::Acknowledge;
use super::battery::StateBattery;
use super::capacity::CapacityRecord;
use super::connections::{Connection, Connections, Receiving};
use super::entry::Object;
use super::error::{ApiError, json, typed};
use super::listen::Peer;
use super::metrics;
use super::page;
use super::plan_rows::RowsError;
use super::questions::{Questions, report};
use super::reader::Ask;
use super::shares::{AllShares, Reply, Turn};
use super::snapshot::Snapshot;
use super::stream::Client;
use super::view::View;
use super::what_if::Asked;

/// Largest body of a request, bytes.
const MAX_BODY_BYTES: usize = 1 << 20;
/// A request's body must have arrived within this time.
const BODY_TIMEOUT: Duration = Duration::from_secs(5);
/// The reading thread must have answered within this time.
const ANSWER_TIMEOUT: Duration = Duration::from_secs(5);
/// Interval after which an idle stream sends a keep-alive.
const KEEP_ALIVE: Duration = Duration::from_secs(5);
/// Allowed message rate of a stream, Hz, and the default at its end.
const HZ: std::ops::RangeInclusive<f64> = 0.2..=10.0;
const USUAL_HZ: f64 = 5.0;

/// State shared by the handlers.
pub(super) struct App {
    pub(super) config: Config,
    pub(super) snapshots: watch::Receiver<Arc<Snapshot>>,
    pub(super) asks: SyncSender<Ask>,
    pub(super) metrics_robots: usize,
    /// Messages sent on streams.
    pub(super) messages: AtomicU64,
    pub(super) connections: Arc<Connections>,
    pub(super) shares: AllShares,
    questions: Questions,
}

impl App {
    pub(super) fn new(
        config: Config,
        snapshots: watch::Receiver<Arc<Snapshot>>,
        asks: SyncSender<Ask>,
        metrics_robots: usize,
    ) -> Self {
        Self {
            config,
            snapshots,
            asks,
            metrics_robots,
            messages: AtomicU64::new(0),
            connections: Arc::default(),
            shares: AllShares::default(),
            questions: Questions::default(),
        }
    }

    fn newest(&self) -> Arc<Snapshot> {
        Arc::clone(&self.snapshots.borrow())
    }

    /// Asks the reading thread for a client, and waits for its answer.
    async fn ask<T>(&self, peer: Peer, ask: impl FnOnce(Reply<T>) -> Ask) -> Result<T, ApiError> {
        let (reply, answer) = Reply::new(self.shares.readings.take(peer, 1)?);
        self.asks.try_send(ask(reply)).map_err(|error| match error {
            TrySendError::Full(_) => ApiError::busy("too many requests wait: ask again"),
            TrySendError::Disconnected(_) => ApiError::busy("the server is ending"),
        })?;
        let answered = timeout(ANSWER_TIMEOUT, answer).await.ok().and_then(Result::ok);
        let late = "the reading thread has not answered within 5 s: ask again";
        answered.ok_or_else(|| ApiError::busy(late))
    }
}

/// The router of all paths.
pub(super) fn router(app: Arc<App>) -> Router {
    Router::new()
        .route("/healthz", get(|| async { "ok\n" }))
        .route("/readyz", get(ready))
        .route("/metrics", get(metrics_text))
        .route("/api/v1/openapi.json", get(|| async { typed("application/json", OPENAPI) }))
        .route("/api/v1/fleet", get(fleet))
        .route("/api/v1/robots", get(robots))
        .route("/api/v1/robots/{id}", get(robot))
        .route("/api/v1/robots/{id}/capacity", get(capacity))
        .route("/api/v1/robots/{id}/history", get(history))
        .route("/api/v1/robots/{id}/outlook", get(outlook))
        .route("/api/v1/alarms", get(alarms))
        .route("/api/v1/alarms/acknowledge", post(acknowledge))
        .route("/api/v1/alarms/cards", get(cards))
        .route("/api/v1/battery", post(battery))
        .route("/api/v1/stream", get(stream))
        .route("/api/v1/what_if", post(what_if))
        .fallback(get(file).fallback(wrong_method))
        .method_not_allowed_fallback(wrong_method)
        .with_state(app)
}

/// The API as OpenAPI 3.1.
static OPENAPI: &[u8] = include_bytes!("openapi.json");

type Answer = Result<Response, ApiError>;

async fn wrong_method(uri: Uri) -> ApiError {
    let text = format!("{} does not take this method: see /api/v1/openapi.json", uri.path());
    ApiError::new(StatusCode::METHOD_NOT_ALLOWED, text)
}

async fn file(uri: Uri, headers: HeaderMap) -> Answer {
    page::file(uri.path(), &headers).ok_or_else(|| {
        let path: String = uri.path().chars().take(80).collect();
        let text = format!(
            "there is nothing at {path:?}: the page is at /, the API in /api/v1/openapi.json"
        );
        ApiError::new(StatusCode::NOT_FOUND, text)
    })
}

async fn ready(State(app): State<Arc<App>>) -> Answer {
    match app.newest().why_not_up(clock::monotonic_ns()) {
        None => Ok("ready\n".into_response()),
        Some(why) => Err(ApiError::busy(why)),
    }
}

async fn metrics_text(State(app): State<Arc<App>>, Extension(peer): Extension<Peer>) -> Answer {
    let now_ns = clock::monotonic_ns();
    // Without series of robots nothing needs to be computed for them.
    let outlooks = match app.metrics_robots {
        0 => Vec::new(),
        _ => outlooks(&app, peer, None).await.unwrap_or_default(),
    };
    let limits = (app.config.fleet(), app.metrics_robots);
    let text = metrics::text(&app.newest(), &outlooks, now_ns, limits);
    Ok(typed(metrics::KIND, text))
}

async fn fleet(State(app): State<Arc<App>>) -> Response {
    json(&app.newest().fleet)
}

async fn alarms(State(app): State<Arc<App>>) -> Response {
    json(&*app.newest().alarms)
}

async fn acknowledge(
    State(app): State<Arc<App>>,
    Extension(peer): Extension<Peer>,
    request: Request,
) -> Answer {
    let asked: Acknowledge = body(&app, peer, request).await?;
    let turn = app.shares.statements.enter(peer).await?;
    beside(&app, turn, move |config| asked.ask(config)).await
}

async fn battery(
    State(app): State<Arc<App>>,
    Extension(peer): Extension<Peer>,
    request: Request,
) -> Answer {
    let asked: StateBattery = body(&app, peer, request).await?;
    let turn = app.shares.statements.enter(peer).await?;
    beside(&app, turn, move |config| asked.ask(config)).await
}

async fn capacity(
    State(app): State<Arc<App>>,
    Extension(peer): Extension<Peer>,
    RobotId(robot): RobotId,
) -> Answer {
    let is_named = app.config.settings().platforms.iter().any(|platform| platform.has(robot));
    if !is_named {
        return Err(no_robot(robot));
    }
    let turn = app.shares.capacities.enter(peer).await?;
    beside(&app, turn, move |config| Ok(CapacityRecord::read(config, robot))).await
}

/// Has the worker take a statement of a person, or reads what it saves, in a thread of its own.
async fn beside<T: Serialize + Send + 'static>(
    app: &App,
    turn: Turn,
    ask: impl FnOnce(&Config) -> Result<T, ApiError> + Send + 'static,
) -> Answer {
    let config = app.config.clone();
    // Ports of the fleet belong to one thread.
    let asked = tokio::task::spawn_blocking(move || {
        let _turn = turn;
        ask(&config)
    });
    let defect = |_| ApiError::new(StatusCode::INTERNAL_SERVER_ERROR, "a defect");
    Ok(json(&asked.await.map_err(defect)??))
}

/// A card with the values of its keys, if those of a robot are asked for.
#[derive(Serialize)]
struct CardOfRobot {
    #[serde(flatten)]
    card: CardRecord,
    #[serde(skip_serializing_if = "Option::is_none")]
    values: Option<Vec<Option<String>>>,
}

async fn cards(State(app): State<Arc<App>>, uri: Uri) -> Answer {
    let mut platform = None;
    for (name, value) in parameters(&uri) {
        if name != "robot" {
            return Err(unknown_parameter(&name));
        }
        let robot: u32 =
            value.parse().map_err(|_| ApiError::value(&name, &value, "a robot's id"))?;
        let has_it = |platform: &Platform| platform.robots.iter().any(|ids| ids.contains(&robot));
        platform = app.config.settings().platforms.iter().position(has_it);
    }
    let value = |platform: usize, key: &&'static str| {
        // A platform's own limit replaces the fleet's.
        let own = app.config.value(&format!("platform.{key}"), platform);
        let found = own.or_else(|| app.config.value(key, platform))?;
        let unit = KEYS.iter().find(|known| known.path == *key).map_or("", |known| known.unit);
        Some(format!("{found} {unit}").trim_end().to_owned())
    };
    let cards = AlarmCard::all().map(|card| CardOfRobot {
        card: CardRecord::from(card),
        values: platform.map(|platform| card.keys.iter().map(|key| value(platform, key)).collect()),
    });
    Ok(json(&cards.collect::<Vec<_>>()))
}

#[derive(Serialize)]
struct RobotsRecord<'a> {
    total: usize,
    matched: usize,
    from: usize,
    robots: Vec<&'a Object>,
}

async fn robots(State(app): State<Arc<App>>, uri: Uri) -> Answer {
    let mut view = View::default();
    for (name, value) in parameters(&uri) {
        if !view.take(&name, &value)? {
            return Err(unknown_parameter(&name));
        }
    }
    let snapshot = app.newest();
    let window = view.window(&snapshot);
    let robots = window.robots.iter();
    let robots: Vec<Arc<Object>> = robots.filter_map(|robot| snapshot.robot(*robot)).collect();
    Ok(json(&RobotsRecord {
        total: window.total,
        matched: window.matched,
        from: view.from,
        robots: robots.iter().map(|robot| &**robot).collect(),
    }))
}

async fn robot(State(app): State<Arc<App>>, RobotId(robot): RobotId) -> Answer {
    let found = app.newest().robot(robot);
    Ok(json(&*found.ok_or_else(|| no_robot(robot))?))
}

async fn history(
    State(app): State<Arc<App>>,
    Extension(peer): Extension<Peer>,
    RobotId(robot): RobotId,
) -> Answer {
    let record = app.ask(peer, |reply| Ask::History(robot, reply)).await?;
    Ok(json(&record.ok_or_else(|| no_robot(robot))?))
}

async fn outlook(
    State(app): State<Arc<App>>,
    Extension(peer): Extension<Peer>,
    RobotId(robot): RobotId,
) -> Answer {
    let found = outlooks(&app, peer, Some(robot)).await?;
    let missing = || match app.newest().robot(robot) {
        Some(_) => ApiError::busy("no outlook of the worker within 1 s: ask again"),
        None => no_robot(robot),
    };
    Ok(json(&OutlookRecord::new(found.first().ok_or_else(missing)?)))
}

/// The outlooks of one robot, or of all. The worker computes them for some time from now on.
async fn outlooks(app: &App, peer: Peer, robot: Option<u32>) -> Result<Vec<Outlook>, ApiError> {
    app.ask(peer, |reply| Ask::Outlooks(robot, reply)).await
}

/// The id of the robot in a path.
struct RobotId(u32);

impl<S: Send + Sync> FromRequestParts<S> for RobotId {
    type Rejection = ApiError;

    async fn from_request_parts(parts: &mut Parts, state: &S) -> Result<Self, ApiError> {
        let found = Path::<String>::from_request_parts(parts, state).await;
        // What is no UTF-8 is shown as it came.
        let id = found.map_or_else(|_| parts.uri.path().to_owned(), |Path(id)| id);
        id_of(&id).map(Self)
    }
}

fn id_of(id: &str) -> Result<u32, ApiError> {
    id.parse().map_err(|_| ApiError::value("the robot's id", id, "0 to 4294967295"))
}

fn no_robot(robot: u32) -> ApiError {
    let text = format!("robot {robot} is not in the fleet: /api/v1/robots lists the robots");
    ApiError::new(StatusCode::NOT_FOUND, text)
}

fn unknown_parameter(name: &str) -> ApiError {
    let allowed = "the parameters in /api/v1/openapi.json";
    ApiError::value("a parameter", name, allowed)
}

fn parameters(uri: &Uri) -> impl Iterator<Item = (String, String)> {
    let query = form_urlencoded::parse(uri.query().unwrap_or_default().as_bytes());
    query.map(|(name, value)| (name.into_owned(), value.into_owned()))
}

/// A stream that a client reads.
struct Flow {
    app: Arc<App>,
    client: Client,
    ticks: tokio::time::Interval,
    shown: Option<Arc<Snapshot>>,
    sent: Instant,
}

async fn stream(
    State(app): State<Arc<App>>,
    Extension(connection): Extension<Arc<Connection>>,
    uri: Uri,
) -> Answer {
    let (mut view, mut robot, mut hz) = (View::default(), None, USUAL_HZ);
    for (name, value) in parameters(&uri) {
        match name.as_str() {
            "robot" => robot = Some(id_of(&value)?),
            "hz" => {
                let found = value.parse().ok().filter(|hz| HZ.contains(hz));
                hz = found.ok_or_else(|| ApiError::value("hz", &value, "0.2 to 10"))?;
            }
            _ if view.take(&name, &value)? => {}
            _ => return Err(unknown_parameter(&name)),
        }
    }
    app.connections.begin_stream(&connection)?;
    let now = Instant::now();
    let mut ticks = interval_at(now, Duration::from_secs_f64(1.0 / hz));
    ticks.set_missed_tick_behavior(MissedTickBehavior::Delay);
    let flow = Flow { client: Client::new(view, robot), app, ticks, shown: None, sent: now };
    let messages = stream::unfold(flow, |mut flow| async move {
        let message = flow.message().await?;
        Some((Ok::<Bytes, std::convert::Infallible>(message), flow))
    });
    Ok(typed("text/event-stream", Body::from_stream(messages)))
}

impl Flow {
    /// The next message. `None` when the server ends.
    async fn message(&mut self) -> Option<Bytes> {
        loop {
            self.ticks.tick().await;
            let newest = self.app.newest();
            if self.shown.as_ref().is_none_or(|shown| !Arc::ptr_eq(shown, &newest)) {
                let message = self.client.message(&newest);
                self.shown = Some(newest);
                self.sent = Instant::now();
                self.app.messages.fetch_add(1, Ordering::Relaxed);
                return Some(message.into());
            }
            // The reading thread has ended.
            self.app.snapshots.has_changed().ok()?;
            if self.sent.elapsed() >= KEEP_ALIVE {
                self.sent = Instant::now();
                return Some(Bytes::from_static(b": keep-alive\n\n"));
            }
        }
    }
}

async fn what_if(
    State(app): State<Arc<App>>,
    Extension(peer): Extension<Peer>,
    request: Request,
) -> Answer {
    let wrong = |text: String| ApiError::new(StatusCode::BAD_REQUEST, text);
    let asked = body::<Asked>(&app, peer, request).await?;
    let charge_to = asked.charge_to;
    let question = asked.question().map_err(wrong)?;
    let turn = app.shares.questions.enter(peer).await?;
    let turn = app.questions.load(turn, &app.config).await?;
    let robots = question.plan.robots().to_vec();
    let rows =
        app.ask(peer, |reply| Ask::Rows(robots, reply)).await?.map_err(|error| match error {
            RowsError::UnknownRobot(_) => ApiError::new(StatusCode::NOT_FOUND, error.to_string()),
            error => ApiError::busy(error.to_string()),
        })?;
    let simplified = match &question.plan {
        joulebus_plan::Plan::Follow { path, .. } => path.simplified(),
        _ => None,
    };
    let stated = (question.coverage, simplified);
    let reply = app.questions.answer(turn, question, rows.clone()).await?;
    Ok(json(&report(&app.config, stated, (&rows, charge_to), &reply)))
}

/// The body of a request, which is JSON.
async fn body<T: DeserializeOwned>(app: &App, peer: Peer, request: Request) -> Result<T, ApiError> {
    let kind = request.headers().get(header::CONTENT_TYPE);
    let kind = kind.and_then(|kind| kind.to_str().ok()?.split(';').next());
    let is_json = kind.is_some_and(|kind| kind.trim().eq_ignore_ascii_case("application/json"));
    if !is_json {
        let text = "the body is JSON: send Content-Type: application/json";
        return Err(ApiError::new(StatusCode::UNSUPPORTED_MEDIA_TYPE, text));
    }
    let length = request.body().size_hint().upper().unwrap_or(u64::MAX).min(MAX_BODY_BYTES as u64);
    let _share = app.shares.received.take(peer, length as usize)?;
    let connection = request.extensions().get::<Arc<Connection>>();
    let receiving = connection.map(Receiving::new);
    let body = axum::body::to_bytes(request.into_body(), MAX_BODY_BYTES);
    let body = timeout(BODY_TIMEOUT, body).await;
    drop(receiving);
    let late = || ApiError::new(StatusCode::REQUEST_TIMEOUT, "the body has not arrived within 5 s");
    let body = body.map_err(|_| late())?.map_err(|_| {
        let text =
            format!("the body is longer than {MAX_BODY_BYTES} bytes, or its transfer failed");
        ApiError::new(StatusCode::PAYLOAD_TOO_LARGE, text)
    })?;
    serde_json::from_slice(&body).map_err(|error| {
        let text = format!("the body is not as in /api/v1/openapi.json: {error}");
        ApiError::new(StatusCode::BAD_REQUEST, text)
    })
}
