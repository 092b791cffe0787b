//! Recording through real shared memory: complete, ordered, split, in memory, on slow and full
//! disks, two fleets at once.
#![allow(clippy::unwrap_used, reason = "a test that cannot continue ends")]

use std::collections::BTreeMap;
use std::io::{self, Cursor, Write};
use std::os::unix::fs::PermissionsExt as _;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};

use joulebus_bus::{Bus, SampleWriter, WorkerLock, Writer as BusWriter, clock};
use joulebus_capture_format::{
    Attachments, CaptureSettings, Clock, Entry, Frame, Message, MessageKind, Reader, Times, Writer,
};
use joulebus_capture_recorder::replay::{Moment, PlayedChannel, Rebase, ReplayPorts, now};
use joulebus_capture_recorder::{
    Options, RecordedChannel, Recorder, Snapshot, StartError, Summary, Target, attach, host_clock,
};
use joulebus_config::Config;
use joulebus_testkit_fleets::channels::{Signal, SignalHeader, Signals};
use joulebus_wire::{
    Budgets, Channel, Diagnostics, Forecasts, FrameHeader as _, FrameOrder, Outlooks, PlanStates,
    SCHEMA_VERSION, Sample, SampleHeader, Samples, TakenFrame, TickHeader, Ticks, tick_flag,
};

const ROBOTS: usize = 10;
/// Timeout of waiting for a condition.
const PATIENCE: Duration = Duration::from_secs(180);

/// A fleet whose worker and source are this test. All tests here share its domain, one at a time.
struct Stage {
    config: Config,
    // Before the bus, because ports must be dropped first.
    samples: SampleWriter,
    forecasts: BusWriter<Forecasts>,
    diagnostics: BusWriter<Diagnostics>,
    budgets: BusWriter<Budgets>,
    plan_states: BusWriter<PlanStates>,
    outlooks: BusWriter<Outlooks>,
    ticks: BusWriter<Ticks>,
    bus: Bus,
    _lock: WorkerLock,
    source_epoch: u64,
    worker_epoch: u64,
    tick: u64,
    files: tempfile::TempDir,
    // After the bus, which leaves the directory empty.
    _root: Root,
    _turn: std::sync::MutexGuard<'static, ()>,
}

static TURN: Mutex<()> = Mutex::new(());

fn config(name: &str, root: &Path) -> Config {
    let text = format!(
        "[fleet]\nname = \"{name}\"\ncapacity = 16\n\
         [domain]\nroot = \"{}\"\nprefix = \"jcap_\"\n\
         [intake]\nbuffer_frames = 64\n[ledger]\ncheckpoint = \"\"\n\
         [[platform]]\nfile = \"builtin:gternal\"\nrobots = [\"0-15\"]\n",
        root.display()
    );
    Config::parse(&text, Path::new("/nowhere")).unwrap()
}

impl Stage {
    fn new() -> Self {
        let turn = TURN.lock().unwrap_or_else(|error| error.into_inner());
        let root = PathBuf::from(format!("/dev/shm/joulebus-capture-{}", std::process::id()));
        let config = config("rec", &root);
        let limits = config.limits();
        let lock = WorkerLock::acquire(&config.domain().unwrap()).unwrap();
        let bus = Bus::join(&config.domain().unwrap(), "stage").unwrap();
        Self {
            samples: bus.sample_writer(&limits, ROBOTS).unwrap(),
            forecasts: bus.writer(&limits).unwrap(),
            diagnostics: bus.writer(&limits).unwrap(),
            budgets: bus.writer(&limits).unwrap(),
            plan_states: bus.writer(&limits).unwrap(),
            outlooks: bus.writer(&limits).unwrap(),
            ticks: bus.writer(&limits).unwrap(),
            bus,
            _lock: lock,
            source_epoch: clock::monotonic_ns(),
            worker_epoch: clock::monotonic_ns(),
            tick: 0,
            files: tempfile::tempdir().unwrap(),
            _root: Root(root),
            config,
            _turn: turn,
        }
    }

    fn path(&self, name: &str) -> PathBuf {
        self.files.path().join(name)
    }

    fn record(&self, target: Target, options: &Options) -> Recorder {
        self.record_with(Vec::new(), target, options)
    }

    fn record_with(
        &self,
        streams: Vec<Box<dyn io::Read + Send>>,
        target: Target,
        options: &Options,
    ) -> Recorder {
        let clock = host_clock();
        let attachments = attach(std::slice::from_ref(&self.config), clock).unwrap();
        Recorder::start(&self.config, streams, clock, attachments, target, options).unwrap()
    }

    /// Sends the frames of a source and a worker for one tick. Robot 3 raises `alarms`.
    fn tick(&mut self, alarms: u32) {
        let now_ns = clock::monotonic_ns();
        let tick = self.tick;
        let header = SampleHeader {
            schema: SCHEMA_VERSION,
            source_id: 1,
            source_epoch: self.source_epoch,
            frame_seq: tick,
            samples_before: tick * ROBOTS as u64,
            sent_ns: now_ns,
            ..SampleHeader::default()
        };
        let sample = |robot: usize| Sample::new(robot as u32, tick, now_ns).command(0.1, -0.0);
        self.samples.send(header, ROBOTS, sample).unwrap();
        self.tick += 1;
        let (worker_epoch, tick) = (self.worker_epoch, self.tick);
        let order = FrameOrder { run: worker_epoch, number: tick };
        send(&mut self.forecasts, order, |robot, row| row.robot = robot);
        send(&mut self.diagnostics, order, |robot, row| {
            (row.robot, row.alarms) = (robot, if robot == 3 { alarms } else { 0 });
        });
        send(&mut self.budgets, order, |robot, row| row.robot = robot);
        send(&mut self.plan_states, order, |robot, row| row.robot = robot);
        send(&mut self.outlooks, order, |robot, row| row.robot = robot);
        let header = TickHeader {
            worker_epoch,
            tick,
            start_ns: now_ns,
            sent_ns: clock::monotonic_ns(),
            flags: tick_flag::PLAN_STATES | tick_flag::OUTLOOKS,
            ..TickHeader::default()
        };
        let taken = TakenFrame {
            source_id: 1,
            source_epoch: self.source_epoch,
            frame_seq: tick - 1,
            taken_ns: now_ns,
            samples: ROBOTS as u32,
            truncated: 0,
        };
        self.ticks.send(header, 1, |_| taken).unwrap();
    }

    /// Plays ticks, not faster than recorders can read.
    fn play(&mut self, ticks: u64) {
        for _ in 0..ticks {
            self.tick(0);
            std::thread::sleep(Duration::from_millis(25));
        }
    }
}

/// Sends a frame with a row of each robot.
fn send<C: Channel>(writer: &mut BusWriter<C>, order: FrameOrder, fill: impl Fn(u32, &mut C::Row)) {
    let mut header = C::Header::default();
    header.set_order(std::process::id(), order);
    header.set_sent(clock::monotonic_ns(), clock::unix_ns());
    let row = |robot: usize| {
        let mut row = C::Row::default();
        fill(robot as u32, &mut row);
        row
    };
    writer.send(header, ROBOTS, row).unwrap();
}

/// The directory of the fleet's shared memory, removed at the end if it is empty.
struct Root(PathBuf);

impl Drop for Root {
    fn drop(&mut self) {
        let _ = std::fs::remove_dir(&self.0);
    }
}

fn entries(path: &Path) -> Vec<Entry> {
    let reader = Reader::open(path).unwrap();
    reader.collect::<Result<_, _>>().unwrap()
}

fn counts(entries: &[Entry]) -> BTreeMap<String, u64> {
    let mut counts = BTreeMap::new();
    for entry in entries {
        *counts.entry(entry.topic.to_string()).or_default() += 1;
    }
    counts
}

fn lost(summary: &Summary, topic: &str) -> u64 {
    let lost = summary.lost.get(topic);
    lost.map_or(0, |lost| lost.overwritten + lost.unwritten)
}

const SERVICES: [&str; 7] =
    ["samples", "forecasts", "diagnostics", "budgets", "plan_states", "outlooks", "ticks"];

/// Everything sent is written or counted as lost, service by service.
fn assert_adds_up(found: &[Entry], summary: &Summary, ticks: u64) {
    let counts = counts(found);
    for service in SERVICES {
        let topic = format!("joulebus/rec/{service}");
        let written = counts.get(&topic).copied().unwrap_or(0);
        let lost = lost(summary, &topic);
        assert_eq!(written + lost, ticks, "{topic}: {written} + {lost}");
    }
}

#[test]
fn messages_are_written_in_order_causes_before_effects() {
    let mut stage = Stage::new();
    let path = stage.path("run.mcap");
    let recorder = stage.record(Target::File(path.clone()), &Options::default());
    stage.play(40);
    let summary = recorder.finish();
    assert_eq!(summary.failure, None);
    let found = entries(&path);
    assert_adds_up(&found, &summary, 40);
    assert_eq!(summary.messages(), found.len() as u64);
    assert_eq!(summary.bytes(), std::fs::metadata(&path).unwrap().len());
    assert!(found.is_sorted_by_key(|entry| entry.log_time_ns));
    let clock = Reader::open(&path).unwrap().attachments().clock().unwrap();
    let mut frames = Vec::new();
    for entry in &found {
        if let Some(Frame { header, rows }) = entry.message.frame::<Samples>() {
            frames.push((header.source_id, header.source_epoch, header.frame_seq));
            assert_eq!(clock.monotonic_ns(entry.publish_time_ns), header.sent_ns);
            assert_eq!(rows[0].omega_radps.to_bits(), (-0.0_f32).to_bits());
        }
        let journal = entry.message.frame::<Ticks>();
        for frame in journal.map_or(&[][..], |journal| &journal.rows) {
            let frame = (frame.source_id, frame.source_epoch, frame.frame_seq);
            assert!(frames.contains(&frame), "{frame:?} is taken before it is sent");
        }
    }
}

#[test]
fn what_is_overwritten_before_the_first_look_of_a_recording_is_counted() {
    let mut stage = Stage::new();
    stage.play(3);
    let path = stage.path("late.mcap");
    let recorder = stage.record(Target::File(path.clone()), &Options::default());
    // As many as the journal queues, and more than the other channels do.
    (0..30).for_each(|_| stage.tick(0));
    let summary = recorder.finish();
    let found = entries(&path);
    let is_since = |entry: &&Entry| entry.message.order().is_some_and(|order| order.number > 3);
    let of_ticks = found.iter().filter(is_since).cloned().collect::<Vec<_>>();
    let written = counts(&of_ticks);
    for service in SERVICES.into_iter().filter(|service| *service != "samples") {
        let topic = format!("joulebus/rec/{service}");
        let (written, lost) = (written[&topic], lost(&summary, &topic));
        assert_eq!(written + lost, 30, "{topic}: {written} + {lost}");
        assert!(lost == 0 || service != "ticks", "{lost} lost");
    }
}

#[test]
fn a_capture_brings_its_own_config_and_models() {
    let mut stage = Stage::new();
    let path = stage.path("run.mcap");
    let recorder = stage.record(Target::File(path.clone()), &Options::default());
    stage.play(2);
    drop(recorder);
    let mode = std::fs::metadata(&path).unwrap().permissions().mode();
    assert_eq!(mode & 0o777, 0o600, "it tells where robots were");
    let reader = Reader::open(&path).unwrap();
    let attachments = reader.attachments();
    assert_eq!(attachments.altered(), Vec::<&str>::new());
    assert_eq!(attachments.fleets().collect::<Vec<_>>(), ["rec"]);
    let text = attachments.config("rec").unwrap();
    let config = Config::parse_attached(text, &attachments.files("rec")).unwrap();
    assert_eq!(config.settings(), stage.config.settings());
    assert_eq!(config.policy(), stage.config.policy());
    assert_eq!(config.checkpoint(), &joulebus_config::Checkpoint::Off);
    let joulebus_config::ModelSource::Attached(_, model) = &config.models()[0] else {
        panic!("{:?}", config.models());
    };
    let joulebus_config::ModelSource::Builtin(_, bytes) = &stage.config.models()[0] else {
        panic!("{:?}", stage.config.models());
    };
    assert_eq!(&**model, *bytes);
    // An untrusted capture reads nothing else.
    for file in ["/etc/hostname", "../../x"] {
        let evil = text.replace("model = \"models/", &format!("model = \"{file}"));
        let refused = Config::parse_attached(&evil, &attachments.files("rec")).unwrap_err();
        assert!(refused.to_string().contains("is not attached"), "{refused}");
    }
}

#[test]
fn split_files_are_each_complete_and_continue_each_other() {
    let mut stage = Stage::new();
    let path = stage.path("run.mcap");
    let options = Options {
        max_file_ns: 300_000_000,
        settings: CaptureSettings { chunk_ns: 1, ..CaptureSettings::default() },
        ..Options::default()
    };
    let recorder = stage.record(Target::File(path), &options);
    stage.play(40);
    let summary = recorder.finish();
    assert!(summary.files.len() >= 3, "{summary:?}");
    let mut all = Vec::new();
    for (part, (path, written)) in summary.files.iter().enumerate() {
        let name = match part {
            0 => "run.mcap".to_owned(),
            part => format!("run_{part}.mcap"),
        };
        assert_eq!(path.file_name().unwrap().to_str(), Some(name.as_str()));
        let reader = Reader::open(path).unwrap();
        assert!(reader.attachments().config("rec").is_some());
        assert_eq!(reader.attachments().about("part"), Some(part.to_string().as_str()));
        let found = entries(path);
        assert_eq!(found.len() as u64, written.messages);
        all.extend(found);
    }
    assert_adds_up(&all, &summary, 40);
    let mut next = BTreeMap::new();
    for entry in &all {
        let number = next.entry(&entry.topic).or_insert(0);
        assert_eq!(entry.sequence, *number, "{}", entry.topic);
        *number += 1;
    }
}

#[test]
fn times_that_a_false_frame_states_neither_end_a_file_nor_leave_the_time_of_the_recording() {
    let mut stage = Stage::new();
    let path = stage.path("times.mcap");
    let began_ns = clock::unix_ns();
    let recorder = stage.record(Target::File(path.clone()), &Options::default());
    let false_times = [0, 1, u64::MAX, u64::MAX / 2];
    for (number, sent_ns) in false_times.into_iter().enumerate() {
        let header = SampleHeader {
            schema: SCHEMA_VERSION,
            source_id: 9,
            source_epoch: stage.source_epoch,
            frame_seq: number as u64,
            sent_ns,
            ..SampleHeader::default()
        };
        let sample = |robot: usize| Sample::new(robot as u32, 0, 0);
        stage.samples.send(header, 1, sample).unwrap();
        stage.play(3);
    }
    let summary = recorder.finish();
    assert_eq!(summary.files.len(), 1, "{summary:?}");
    let ended_ns = clock::unix_ns();
    let found = entries(&path);
    assert!(found.len() > false_times.len());
    // The clocks' offset is read once, some moments after the wall clock here.
    let slack_ns = 1_000_000_000;
    for entry in &found {
        let log_ns = entry.log_time_ns;
        assert!(log_ns + slack_ns >= began_ns && log_ns <= ended_ns + slack_ns, "{log_ns}");
    }
    assert!(found.is_sorted_by_key(|entry| entry.log_time_ns));
}

#[test]
fn existing_files_are_not_changed() {
    let stage = Stage::new();
    let path = stage.path("run.mcap");
    std::fs::write(&path, "precious").unwrap();
    let (config, clock) = (&stage.config, host_clock());
    let start = |resume| {
        let options = Options { resume, ..Options::default() };
        let target = Target::File(path.clone());
        Recorder::start(config, Vec::new(), clock, Attachments::default(), target, &options)
    };
    let refused = start(false).err().unwrap().to_string();
    assert!(refused.contains("run.mcap"), "{refused}");
    let summary = start(true).unwrap().finish();
    assert_eq!(summary.files[0].0, stage.path("run_1.mcap"));
    assert_eq!(std::fs::read_to_string(&path).unwrap(), "precious");
}

#[test]
fn a_recorder_that_cannot_join_its_fleet_leaves_no_file() {
    let folder = tempfile::tempdir().unwrap();
    let (root, path) = (folder.path().join("no-folder"), folder.path().join("run.mcap"));
    std::fs::write(&root, "somebody's").unwrap();
    let (config, target) = (config("rec", &root), Target::File(path.clone()));
    let (clock, options) = (host_clock(), Options::default());
    let refused =
        Recorder::start(&config, Vec::new(), clock, Attachments::default(), target, &options);
    assert!(matches!(refused, Err(StartError::Drain(_))), "{refused:?}");
    assert!(!path.exists());
}

#[test]
fn robots_have_separate_channels_on_request() {
    let mut stage = Stage::new();
    let options = Options {
        per_robot: true,
        choose: Arc::new(|topic| topic.contains("/robot/7/") || topic.ends_with("/ticks")),
        ..Options::default()
    };
    let record = |attempt: u32| {
        let path = stage.path(&format!("plots-{attempt}.mcap"));
        let recorder = stage.record(Target::File(path.clone()), &options);
        stage.play(5);
        let summary = recorder.finish();
        (summary.messages_lost() == 0).then_some(path)
    };
    // A recorder that gets no processor in time loses messages and counts them.
    let path = (0..5).find_map(record);
    let path = path.expect("the recorder lost messages each time");
    let counts = counts(&entries(&path));
    let expected = ["budget", "diagnostic", "forecast", "sample"];
    let expected = expected.map(|name| (format!("joulebus/rec/robot/7/{name}"), 5));
    let mut expected = BTreeMap::from(expected);
    expected.insert("joulebus/rec/ticks".to_owned(), 5);
    assert_eq!(counts, expected);
}

#[test]
fn more_robots_than_a_file_has_channels_are_refused_with_the_numbers() {
    let root = Path::new("/dev/shm/joulebus-capture-many");
    let text = format!(
        "[fleet]\nname = \"many\"\ncapacity = 20000\n[domain]\nroot = \"{}\"\n\
         [[platform]]\nfile = \"builtin:gternal\"\nrobots = [\"0-15\"]\n",
        root.display()
    );
    let config = Config::parse(&text, Path::new("/nowhere")).unwrap();
    let options = Options { per_robot: true, ..Options::default() };
    let target = Target::Stream(Box::new(io::sink()));
    let (clock, none) = (host_clock(), Attachments::default());
    let refused = Recorder::start(&config, Vec::new(), clock, none, target, &options);
    let refused = refused.err().unwrap().to_string();
    assert!(refused.contains("80010") && refused.contains("65535"), "{refused}");
    assert!(!root.exists());
}

/// A disk that blocks on request.
struct Disk {
    bytes: Arc<Mutex<Vec<u8>>>,
    held_up: Arc<AtomicBool>,
}

impl Write for Disk {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        while self.held_up.load(Ordering::Relaxed) {
            std::thread::sleep(Duration::from_millis(1));
        }
        self.bytes.lock().unwrap().extend_from_slice(bytes);
        Ok(bytes.len())
    }

    fn flush(&mut self) -> io::Result<()> {
        Ok(())
    }
}

#[test]
fn a_slow_disk_causes_counted_message_loss_only() {
    let mut stage = Stage::new();
    let (bytes, held_up) = (Arc::default(), Arc::new(AtomicBool::new(false)));
    let disk = Disk { bytes: Arc::clone(&bytes), held_up: Arc::clone(&held_up) };
    let options = Options {
        queue_bytes: 20_000,
        settings: CaptureSettings { chunk_ns: 1, ..CaptureSettings::default() },
        ..Options::default()
    };
    let recorder = stage.record(Target::Stream(Box::new(disk)), &options);
    held_up.store(true, Ordering::Relaxed);
    let unwritten = |summary: &Summary| -> u64 {
        let lost = summary.lost.values();
        lost.map(|lost| lost.unwritten).sum()
    };
    let give_up = Instant::now() + PATIENCE;
    while unwritten(&recorder.summary()) == 0 {
        assert!(Instant::now() < give_up, "{:?}", recorder.summary());
        stage.play(1);
    }
    held_up.store(false, Ordering::Relaxed);
    stage.play(5);
    let ticks = stage.tick;
    let summary = recorder.finish();
    assert_eq!(summary.failure, None);
    let file = bytes.lock().unwrap().clone();
    let found: Vec<Entry> =
        Reader::new(Cursor::new(file)).unwrap().collect::<Result<_, _>>().unwrap();
    assert_adds_up(&found, &summary, ticks);
    assert!(unwritten(&summary) > 0, "{summary:?}");
}

#[test]
fn a_snapshot_keeps_the_last_seconds_and_saves_them_on_request_and_on_alarm() {
    let mut stage = Stage::new();
    let path = stage.path("alarm.mcap");
    let options = Options {
        snapshot: Some(Snapshot { keep_ns: 500_000_000, max_bytes: 1 << 20, on_alarm: true }),
        ..Options::default()
    };
    let recorder = stage.record(Target::File(path.clone()), &options);
    stage.play(40);
    assert!(!path.exists(), "no event so far");
    stage.tick(4);
    wait_for(&recorder, 1);
    let found = entries(&path);
    let span_ns = found.last().unwrap().log_time_ns - found[0].log_time_ns;
    assert!(span_ns <= 500_000_000, "{span_ns}");
    let alarms = |entry: &Entry| {
        let diagnostics = entry.message.frame::<Diagnostics>();
        diagnostics.map_or(0, |diagnostics| diagnostics.rows[3].alarms)
    };
    assert!(found.iter().any(|entry| alarms(entry) == 4));
    // An alarm that persists is not new.
    for _ in 0..10 {
        stage.tick(4);
        std::thread::sleep(Duration::from_millis(25));
    }
    assert_eq!(recorder.summary().files.len(), 1);
    // Nothing is saved while there is nothing in memory: the recorder may have got no processor
    // since.
    let give_up = Instant::now() + PATIENCE;
    while recorder.summary().kept.is_none_or(|kept| kept.messages == 0) {
        assert!(Instant::now() < give_up, "{:?}", recorder.summary());
        stage.tick(4);
        std::thread::sleep(Duration::from_millis(25));
    }
    recorder.write_down();
    wait_for(&recorder, 2);
    let summary = recorder.finish();
    assert_eq!(summary.files.len(), 2, "{summary:?}");
    assert_eq!(summary.files[1].0, stage.path("alarm_1.mcap"));
    assert!(!entries(&stage.path("alarm_1.mcap")).is_empty());
}

/// Waits until the recording reports so many files.
fn wait_for(recorder: &Recorder, files: usize) {
    let give_up = Instant::now() + PATIENCE;
    while recorder.summary().files.len() < files {
        assert!(Instant::now() < give_up, "{:?}", recorder.summary());
        std::thread::sleep(Duration::from_millis(5));
    }
}

#[test]
fn two_fleets_are_recorded_into_one_file() {
    let mut stage = Stage::new();
    let other = config("yard", Path::new("/dev/shm/joulebus-capture-yard"));
    let theirs = Clock { offset_ns: 5 };
    let here = host_clock();
    let attachments = attach(std::slice::from_ref(&other), theirs).unwrap();
    let mut writer = Writer::new(Vec::new(), CaptureSettings::default(), &attachments).unwrap();
    // One frame in five is missing.
    for frame_seq in (0..50_u64).filter(|seq| seq % 5 != 3) {
        let header =
            SampleHeader { source_id: 1, source_epoch: 1, frame_seq, ..SampleHeader::default() };
        let log_ns = theirs.unix_ns(clock::monotonic_ns());
        let times = Times { log_ns, publish_ns: log_ns };
        let message = Message::of::<Samples>(header, vec![Sample::new(9, frame_seq, 1)]);
        writer.write("yard", times, &message).unwrap();
    }
    let (_, _, stream) = writer.finish().unwrap();
    let path = stage.path("both.mcap");
    let target = Target::File(path.clone());
    let streams: Vec<Box<dyn io::Read + Send>> = vec![Box::new(Cursor::new(stream))];
    let both = [stage.config.clone(), other];
    let attachments = attach(&both, here).unwrap();
    let recorder =
        Recorder::start(&stage.config, streams, here, attachments, target, &Options::default())
            .unwrap();
    stage.play(10);
    let summary = recorder.finish();
    let found = entries(&path);
    assert_adds_up(&found, &summary, 10);
    let of_yard: Vec<&Entry> = found.iter().filter(|entry| &*entry.fleet == "yard").collect();
    assert_eq!(of_yard.len(), 40);
    assert_eq!(lost(&summary, "joulebus/yard/samples"), 10);
    // Times are converted to this recording's clock.
    let now_ns = here.unix_ns(clock::monotonic_ns());
    for entry in of_yard {
        assert!(now_ns - entry.log_time_ns < 600_000_000_000, "{entry:?}");
    }
    let fleets = Reader::open(&path).unwrap();
    let fleets: Vec<String> = fleets.attachments().fleets().map(str::to_owned).collect();
    assert_eq!(fleets, ["rec", "yard"]);
    let twice = [stage.config.clone(), stage.config.clone()];
    let refused = attach(&twice, here).unwrap_err();
    assert!(refused.to_string().contains("\"rec\""), "{refused}");
}

#[test]
fn a_channel_that_is_declared_elsewhere_is_recorded_and_played() {
    let stage = Stage::new();
    let (path, limits) = (stage.path("signals.mcap"), stage.config.limits());
    let mut writer = stage.bus.writer::<Signals>(&limits).unwrap();
    let mut options = Options::default();
    options.channels.push(RecordedChannel::of::<Signals>());
    let recorder = stage.record(Target::File(path.clone()), &options);
    let begun_ns = clock::monotonic_ns();
    for tick in [1, 2, 4] {
        let header = SignalHeader {
            schema: SCHEMA_VERSION,
            worker_epoch: stage.worker_epoch,
            tick,
            sent_ns: clock::monotonic_ns(),
            ..SignalHeader::default()
        };
        let signal = |robot| Signal {
            robot: robot as u32,
            stamp_ns: begun_ns + tick,
            level_dbm: tick as f32,
            ..Signal::default()
        };
        writer.send(header, ROBOTS, signal).unwrap();
    }
    let summary = recorder.finish();
    assert_eq!(lost(&summary, "joulebus/rec/signals"), 1, "{summary:?}");
    let kind = MessageKind::of::<Signals>();
    let reader = Reader::open(&path).unwrap().with_kinds([kind]);
    let found: Vec<Entry> = reader.collect::<Result<_, _>>().unwrap();
    assert_eq!(found.len(), 3);

    let again = config("again", stage.config.root());
    let domain = again.domain().unwrap();
    let bus = Bus::join(&domain, "watch").unwrap();
    let mut played = bus.reader::<Signals>(&limits).unwrap();
    let channels = [PlayedChannel::of::<Signals>()];
    let mut ports = ReplayPorts::open(&domain, &limits, &channels, &[kind]).unwrap();
    let recorded = Moment { monotonic_ns: begun_ns, unix_ns: 0 };
    let mut rebase = Rebase::new(recorded, now());
    for entry in found {
        let recorded = entry.message.clone();
        let mut message = entry.message;
        ports.send(&mut message, &mut rebase, 1.0).unwrap();
        let sent = message.frame::<Signals>().unwrap();
        let received = played.take_next().unwrap().unwrap();
        assert_eq!((received.header(), received.payload()), (&sent.header, &sent.rows[..]));
        let Frame { header, rows } = recorded.frame::<Signals>().unwrap();
        assert_eq!(header.tick, sent.header.tick);
        let moved_ns = sent.rows[3].stamp_ns - rows[3].stamp_ns;
        let restored =
            sent.rows.iter().map(|row| Signal { stamp_ns: row.stamp_ns - moved_ns, ..*row });
        assert_eq!(&restored.collect::<Vec<Signal>>(), rows);
    }
    ports.end();
}
