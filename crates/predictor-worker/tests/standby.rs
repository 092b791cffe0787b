//! A standby worker serves only with a permit, continues where the previous leader ended, and is
//! silent once the permit has run out.
#![allow(clippy::unwrap_used, reason = "a test that cannot continue ends")]

use std::fs;
use std::path::PathBuf;
use std::sync::Mutex;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::time::{Duration, Instant};

use joulebus_bus::{Bus, clock};
use joulebus_config::Config;
use joulebus_connect::standby::{Permit, SavedState, StandbyFiles};
use joulebus_predictor_worker::{RunError, Worker};
use joulebus_testkit::OnDrop;
use joulebus_wire::{
    Budget, Budgets, Forecast, Forecasts, Quality, SCHEMA_VERSION, Sample, SampleHeader,
};

const ROBOTS: u32 = 20;
const PERIOD_NS: u64 = 33_333_333;
const PATIENCE: Duration = Duration::from_secs(120);
/// The tests share one domain, in which they follow each other.
static ONE_AT_A_TIME: Mutex<()> = Mutex::new(());

fn eventually(what: &str, mut condition: impl FnMut() -> bool) {
    let begun = Instant::now();
    while !condition() {
        assert!(begun.elapsed() < PATIENCE, "{what}: not after {PATIENCE:?}");
        std::thread::sleep(Duration::from_millis(1));
    }
}

/// A domain with a source, that is removed at the end.
struct Scene {
    root: PathBuf,
    config: Config,
    files: StandbyFiles,
    stop: AtomicBool,
    /// Frames that the source has sent.
    sent: AtomicU64,
    /// The source sends no samples in this time.
    is_silent: AtomicBool,
    /// The newest forecasts and budgets, and when the newest forecasts were sent.
    read: Mutex<(Vec<Forecast>, Vec<Budget>)>,
    sent_ns: AtomicU64,
    frames: AtomicU64,
    /// Number of times that the planner has read everything available.
    looks: AtomicU64,
}

impl Scene {
    fn new() -> Self {
        let root = PathBuf::from(format!("/dev/shm/jb-standby-{}", std::process::id()));
        let text = format!(
            "[fleet]\nname = \"lab\"\ncapacity = {ROBOTS}\n\
             [domain]\nroot = \"{}\"\nprefix = \"t_\"\n\
             [tick]\nrate_hz = 30.0\n\
             [intake]\nbuffer_frames = 64\n\
             [ledger]\ncheckpoint = \"\"\n\
             [[platform]]\nfile = \"builtin:gternal\"\nrobots = [\"0-{}\"]\n",
            root.display(),
            ROBOTS - 1
        );
        let config = Config::parse(&text, &root.join("nowhere")).unwrap();
        Self {
            files: StandbyFiles::new(&config),
            root,
            config,
            stop: AtomicBool::new(false),
            sent: AtomicU64::new(0),
            is_silent: AtomicBool::new(false),
            read: Mutex::default(),
            sent_ns: AtomicU64::new(0),
            frames: AtomicU64::new(0),
            looks: AtomicU64::new(0),
        }
    }

    fn source(&self) {
        let bus = Bus::join(&self.config.domain().unwrap(), "source").unwrap();
        let mut writer = bus.sample_writer(&self.config.limits(), ROBOTS as usize).unwrap();
        let mut header = SampleHeader {
            schema: SCHEMA_VERSION,
            source_id: 1,
            source_epoch: clock::monotonic_ns(),
            ..SampleHeader::default()
        };
        // On the platform's grid, like a controller, however this thread is scheduled.
        let begun_ns = clock::monotonic_ns();
        while !self.stop.load(Ordering::Relaxed) {
            let seq = header.frame_seq + 1;
            let stamp_ns = begun_ns + seq * PERIOD_NS;
            while clock::monotonic_ns() < stamp_ns {
                std::thread::sleep(Duration::from_millis(1));
            }
            header.frame_seq = seq;
            if self.is_silent.load(Ordering::Relaxed) {
                continue;
            }
            (header.sent_ns, header.intended_ns) = (stamp_ns, stamp_ns);
            let sample = |place: usize| {
                let power_w = 3.5 + (seq % 9) as f32 * 0.01 + place as f32 * 1e-3;
                Sample::new(place as u32, seq, stamp_ns)
                    .command(0.1, 0.5)
                    .reading(power_w, stamp_ns)
            };
            writer.send(header, ROBOTS as usize, sample).unwrap();
            header.samples_before += u64::from(ROBOTS);
            self.sent.fetch_add(1, Ordering::Relaxed);
        }
    }

    fn planner(&self) {
        let bus = Bus::join(&self.config.domain().unwrap(), "planner").unwrap();
        let limits = self.config.limits();
        let mut forecasts = bus.reader::<Forecasts>(&limits).unwrap();
        let mut budgets = bus.reader::<Budgets>(&limits).unwrap();
        while !self.stop.load(Ordering::Relaxed) {
            while let Some(frame) = forecasts.take_next().unwrap() {
                self.sent_ns.fetch_max(frame.header().sent_ns, Ordering::Relaxed);
                self.read.lock().unwrap().0 = frame.payload().to_vec();
                self.frames.fetch_add(1, Ordering::Relaxed);
            }
            while let Some(frame) = budgets.take_next().unwrap() {
                self.read.lock().unwrap().1 = frame.payload().to_vec();
            }
            self.looks.fetch_add(1, Ordering::Relaxed);
            std::thread::sleep(Duration::from_millis(1));
        }
    }

    /// Runs `play` beside the source and the planner.
    fn play(&self, play: impl FnOnce()) {
        std::thread::scope(|scope| {
            let _end = OnDrop(&self.stop);
            scope.spawn(|| self.source());
            scope.spawn(|| self.planner());
            play();
        });
    }

    fn permit(&self, term: u64, until_ns: u64) {
        let permit = Permit { term, until_ns, lease: 0 };
        permit.write(&self.files.permit).unwrap();
    }

    /// Ticks the worker until the condition holds.
    fn until(&self, worker: &mut Worker, what: &str, mut condition: impl FnMut(&Worker) -> bool) {
        let begun = Instant::now();
        while !condition(worker) {
            worker.poll().unwrap();
            assert!(
                begun.elapsed() < PATIENCE,
                "{what}: not after {PATIENCE:?}. {:?} sent, {:?} frames, {:?} looks, accounts {:?}",
                self.sent,
                self.frames,
                self.looks,
                self.accounts()
            );
        }
    }

    /// Waits until the planner has read all that was sent before: it may get no processor for a
    /// while.
    fn read_all(&self) {
        let before = self.looks.load(Ordering::Relaxed);
        // The first one may have begun before.
        eventually("the planner looks twice", || self.looks.load(Ordering::Relaxed) > before + 1);
    }

    /// Energy and time of all robots' accounts, of the newest budgets.
    fn accounts(&self) -> (i64, u64, u64) {
        let read = self.read.lock().unwrap();
        let budgets = read.1.iter();
        budgets.fold((0, 0, 0), |(drawn, metered, unmetered), budget| {
            (drawn + budget.drawn_uj, metered + budget.metered_ns, unmetered + budget.unmetered_ns)
        })
    }

    fn is_warm(&self) -> bool {
        let read = self.read.lock().unwrap();
        let forecasts = &read.0;
        forecasts.len() == ROBOTS as usize
            && forecasts
                .iter()
                .all(|forecast| matches!(forecast.quality(), Quality::Fresh | Quality::Held))
    }
}

impl Drop for Scene {
    fn drop(&mut self) {
        for file in [&self.files.permit, &self.files.keyframe, &self.files.replica] {
            let _ = fs::remove_file(file);
        }
        // All members have left, and taken their files with them.
        let _ = fs::remove_dir_all(&self.root);
    }
}

/// Forecasts of a first frame: none of them may be warming up.
fn first_frame(scene: &Scene, worker: &mut Worker) -> Vec<Quality> {
    let before = scene.frames.load(Ordering::Relaxed);
    worker.poll().unwrap();
    scene.until(worker, "a frame", |_| scene.frames.load(Ordering::Relaxed) > before);
    let read = scene.read.lock().unwrap();
    read.0.iter().map(Forecast::quality).collect()
}

#[test]
fn without_a_permit_nothing_is_sent_and_with_one_it_goes_on_where_the_one_before_was_killed() {
    // Longer than windows can be bridged: they stay warm by the samples that came meanwhile.
    goes_on_after(45);
}

#[test]
fn a_worker_that_waits_longer_than_it_keeps_samples_goes_on_without_a_loss() {
    // A lease may last for a minute, and the store may be away.
    goes_on_after(500);
}

/// A worker is killed, and another one leads after that many frames.
fn goes_on_after(frames: u64) {
    let _one = ONE_AT_A_TIME.lock().unwrap_or_else(std::sync::PoisonError::into_inner);
    let scene = Scene::new();
    let never = AtomicBool::new(false);
    scene.play(|| {
        let mut worker = Worker::open_standby(&scene.config).unwrap();
        eventually("samples", || scene.sent.load(Ordering::Relaxed) > 20);
        let stopped = AtomicBool::new(true);
        assert!(!worker.stand_by(&stopped).unwrap(), "it was stopped");
        scene.read_all();
        assert_eq!(scene.frames.load(Ordering::Relaxed), 0, "it has no permit");
        scene.permit(1, u64::MAX);
        assert!(worker.stand_by(&never).unwrap());
        scene.until(&mut worker, "a warm fleet", |_| scene.is_warm());
        let mut turns = Vec::new();
        eventually("a keyframe", || {
            turns.push((clock::monotonic_ns(), scene.sent.load(Ordering::Relaxed)));
            worker.poll().unwrap();
            let saved = SavedState::read(&scene.files.keyframe).unwrap();
            saved.is_some_and(|saved| saved.taken_ns > turns[0].0)
        });
        // The keyframe crosses to another host, whose clock is the same here, and the worker is
        // killed.
        let saved = SavedState::read(&scene.files.keyframe).unwrap().unwrap();
        assert_eq!(saved.term, 1);
        let in_it = turns.iter().rfind(|(ns, _)| *ns < saved.taken_ns).unwrap().1;
        fs::rename(&scene.files.keyframe, &scene.files.replica).unwrap();
        Permit::withdraw(&scene.files.permit).unwrap();
        scene.read_all();
        let accounts = scene.accounts();
        drop(worker);

        let mut worker = Worker::open_standby(&scene.config).unwrap();
        let sent = scene.sent.load(Ordering::Relaxed);
        std::thread::scope(|scope| {
            scope.spawn(|| {
                eventually("samples", || scene.sent.load(Ordering::Relaxed) > sent + frames);
                scene.permit(2, u64::MAX);
            });
            assert!(worker.stand_by(&never).unwrap());
        });
        let before = scene.frames.load(Ordering::Relaxed);
        let first = first_frame(&scene, &mut worker);
        assert!(scene.frames.load(Ordering::Relaxed) > before);
        let is_warm = |quality: &Quality| !matches!(quality, Quality::Warmup { .. });
        assert!(first.iter().all(is_warm), "{first:?}");
        assert_eq!(first.len(), ROBOTS as usize);
        scene.until(&mut worker, "budgets of all", |_| scene.accounts().0 > accounts.0);
        let after = scene.accounts();
        assert!(after.1 >= accounts.1, "metered time continues: {accounts:?} {after:?}");
        let dropped = &worker.report().samples_dropped;
        assert!(!dropped.contains_key("Duplicate"), "no sample is taken twice: {dropped:?}");
        // Only the time before the second worker's port was open is unmetered.
        let lost = dropped.get("Overflow").map_or(0, |lost| lost / u64::from(ROBOTS));
        assert!(
            lost <= sent + 1 - in_it,
            "{lost} frames were lost, {in_it} to {sent} were sent while there was no worker"
        );
        // The worker may also refuse samples of a source that got no processor for a while.
        let dropped_frames = dropped.values().sum::<u64>().div_ceil(u64::from(ROBOTS));
        let gap_ns = (after.2 - accounts.2) / u64::from(ROBOTS);
        assert!(
            gap_ns <= (dropped_frames + 1) * PERIOD_NS,
            "{gap_ns} ns are unmetered, samples of {ROBOTS} robots dropped: {dropped:?}"
        );
        let _ = worker.finish();
        // The state with which the next worker on this host begins.
        let last = SavedState::read(&scene.files.keyframe).unwrap().unwrap();
        assert_eq!(last.term, 2);
    });
}

#[test]
fn when_its_permit_has_run_out_it_sends_nothing_more_and_ends_and_a_later_permit_does_not_help() {
    let _one = ONE_AT_A_TIME.lock().unwrap_or_else(std::sync::PoisonError::into_inner);
    let scene = Scene::new();
    let never = AtomicBool::new(false);
    scene.play(|| {
        let mut accounts = (0, 0, 0);
        for (term, how) in [(1, "it runs out"), (2, "it is withdrawn"), (3, "another term")] {
            let mut worker = Worker::open_standby(&scene.config).unwrap();
            scene.permit(term, u64::MAX);
            assert!(worker.stand_by(&never).unwrap());
            let before = scene.frames.load(Ordering::Relaxed);
            scene.until(&mut worker, how, |_| scene.frames.load(Ordering::Relaxed) > before + 3);
            // It continues where it ended itself, as after an outage of the store of leases.
            scene.until(&mut worker, "budgets", |_| scene.accounts() != accounts);
            let now = scene.accounts();
            assert!(now.0 >= accounts.0, "{accounts:?}, {now:?}");
            assert!(now.1 >= accounts.1 && now.2 >= accounts.2, "{accounts:?}, {now:?}");
            // Long enough for the thread that reads the permit, which was without an end, to get a
            // processor.
            let until_ns = clock::boot_ns() + 3_000_000_000;
            match how {
                "it runs out" => scene.permit(term, until_ns),
                "it is withdrawn" => Permit::withdraw(&scene.files.permit).unwrap(),
                "another term" => scene.permit(term + 1, u64::MAX),
                _ => {}
            }
            let ended = worker.run(&never).expect_err(how);
            let RunError::Permit(over) = ended else {
                panic!("{how}: {ended}");
            };
            assert_eq!(over.term, term);
            assert!(over.to_string().contains("stands by"), "{over}");
            scene.read_all();
            if how == "it runs out" {
                assert!(clock::boot_ns() >= until_ns);
                assert!(scene.sent_ns.load(Ordering::Relaxed) < until_ns);
                // Renewed too late.
                scene.permit(term, u64::MAX);
            }
            let frames = scene.frames.load(Ordering::Relaxed);
            assert!(worker.poll().is_err());
            scene.read_all();
            assert_eq!(scene.frames.load(Ordering::Relaxed), frames);
            accounts = scene.accounts();
            assert!(accounts.0 > 0, "{accounts:?}");
            let _report = worker.finish();
            Permit::withdraw(&scene.files.permit).unwrap();
        }
    });
}

#[test]
fn a_state_that_is_damaged_or_of_another_fleet_is_refused_and_the_next_newest_taken() {
    let _one = ONE_AT_A_TIME.lock().unwrap_or_else(std::sync::PoisonError::into_inner);
    let scene = Scene::new();
    let never = AtomicBool::new(false);
    scene.play(|| {
        let mut worker = Worker::open_standby(&scene.config).unwrap();
        scene.permit(1, u64::MAX);
        assert!(worker.stand_by(&never).unwrap());
        scene.until(&mut worker, "a warm fleet", |_| scene.is_warm());
        let is_kept = |least: i64| {
            let saved = SavedState::read(&scene.files.keyframe).unwrap();
            saved.is_some() && scene.accounts().0 > least
        };
        scene.until(&mut worker, "a keyframe", |_| is_kept(0));
        let saved = SavedState::read(&scene.files.keyframe).unwrap().unwrap();
        drop(worker);
        let whole = fs::read(&scene.files.keyframe).unwrap();
        let mut cut = saved.bytes.clone();
        cut.truncate(cut.len() / 2);
        let mut other = saved.bytes.clone();
        // The fleet's capacity, the first number behind the magic.
        other[8] ^= 1;
        for (term, replica) in
            [(2, &cut[..]), (3, &other[..]), (4, &[][..]), (5, &b"jbstate\xff"[..])]
        {
            fs::write(&scene.files.keyframe, &whole).unwrap();
            let of = (term + 10, clock::monotonic_ns(), i64::MIN);
            SavedState::write(&scene.files.replica, of, replica).unwrap();
            if term == 4 {
                fs::write(&scene.files.replica, b"nonsense").unwrap();
            }
            Permit::withdraw(&scene.files.permit).unwrap();
            let mut worker = Worker::open_standby(&scene.config).unwrap();
            scene.permit(term, u64::MAX);
            assert!(worker.stand_by(&never).unwrap());
            scene.read_all();
            let before = scene.accounts();
            let frames = scene.frames.load(Ordering::Relaxed);
            scene.until(&mut worker, "frames", |_| {
                scene.frames.load(Ordering::Relaxed) > frames + 5
            });
            // The accounts continue from the keyframe, which is not refused. The newest budgets may
            // still be the previous worker's, or those of a tick without samples.
            let mut after = before;
            scene.until(&mut worker, "budgets", |_| {
                after = scene.accounts();
                after != before && after.0 > 0 && after.2 > 0
            });
            assert!(after.0 > 0 && after.2 > 0, "term {term}: {before:?} {after:?}");
            assert_eq!(worker.report().robots, ROBOTS as usize, "term {term}");
            drop(worker);
        }
    });
}
