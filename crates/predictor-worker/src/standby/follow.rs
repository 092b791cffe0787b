//! A standby worker's view of its robots: the leader's newest state, and the samples since.
//!
//! Frames are kept for some seconds and then dropped, because a later state contains them. If
//! states stop, as from a dead host whose lease runs on, or while the store is away, the fleet is
//! restored from the last state. It then takes the frames as they become old, as if it led. The
//! memory is bounded, and the wait is not.
//!
//! 1. [`Following::keep`] puts each frame into the backlog.
//! 2. [`Following::advance`] looks for a newer state once a second. It drops frames that are old
//!    enough for that state to contain them.
//! 3. Old frames that no state contains: the fleet is restored once, and takes them.
//! 4. [`Following::take_over`] restores the newest state if the fleet is not from it already, and
//!    takes the whole backlog. Frames that the state contains are passed over.

use std::sync::atomic::{AtomicU64, Ordering};

use joulebus_bus::clock;
use joulebus_connect::standby::StandbyFiles;
use joulebus_fleet::Fleet;
use joulebus_settings::FleetSettings;

use super::backlog::{Backlog, Held};
use super::restore::{RestoredState, newest, restore};

/// Interval of checks for a newer state.
const POLL_INTERVAL_NS: u64 = 1_000_000_000;
/// Age of a frame, when a state is taken, from which the state contains it or never will.
const CONTAINED_NS: u64 = 5_000_000_000;

/// The frames that were taken without output.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub(crate) struct Replayed {
    pub(crate) frames: u64,
    pub(crate) samples: u64,
}

/// The newest state in the files: its term, and when it was taken.
type Order = (u64, u64);

/// Follows a worker elsewhere.
#[derive(Debug)]
pub(crate) struct Following {
    backlog: Backlog,
    period_ns: u64,
    newest: Option<Order>,
    look_ns: u64,
    /// The newest state when one was restored last. It may have been refused.
    tried: Option<Order>,
    /// The state that the fleet was restored from.
    restored: Option<RestoredState>,
    replayed: Replayed,
    tick_ns: Option<u64>,
}

impl Following {
    /// `period_ns`: of the ticks.
    pub(crate) fn new(settings: &FleetSettings, period_ns: u64) -> Self {
        Self {
            backlog: Backlog::new(settings),
            period_ns,
            newest: None,
            look_ns: 0,
            tried: None,
            restored: None,
            replayed: Replayed::default(),
            tick_ns: None,
        }
    }

    /// Keeps a frame. False if there is room for no more until [`Following::advance`].
    pub(crate) fn keep(&mut self, held: Held) -> bool {
        self.backlog.keep(held);
        !self.backlog.is_full()
    }

    /// Forgets frames that have become old, or has the fleet take them if no state contains them.
    pub(crate) fn advance(&mut self, fleet: &mut Fleet, files: &StandbyFiles) {
        let now_ns = clock::monotonic_ns();
        if now_ns >= self.look_ns {
            self.look_ns = now_ns.saturating_add(POLL_INTERVAL_NS);
            self.look(files);
        }
        while let Some(held) = self.backlog.pop_due(now_ns) {
            if self.newest.is_some_and(|(_, taken_ns)| !is_contained(&held, taken_ns)) {
                self.begin(fleet, files);
                self.take(fleet, &held);
            }
        }
    }

    /// Has the fleet take all that is here, as if it had been there, without output. Counts each
    /// frame in `turns`: of a large fleet it takes seconds, in which a watchdog is to see that the
    /// worker works.
    pub(crate) fn take_over(
        &mut self,
        fleet: &mut Fleet,
        files: &StandbyFiles,
        turns: &AtomicU64,
    ) -> (Option<RestoredState>, Replayed) {
        self.look(files);
        self.begin(fleet, files);
        while let Some(held) = self.backlog.pop() {
            turns.fetch_add(1, Ordering::Relaxed);
            self.take(fleet, &held);
        }
        (self.restored, self.replayed)
    }

    /// Looks for the newest state. If its file cannot be read any more, nothing is undone: the
    /// samples in its state are not kept elsewhere.
    fn look(&mut self, files: &StandbyFiles) {
        self.newest = self.newest.max(newest(files));
    }

    /// Restores the newest state, if it is newer than the one that the fleet is from.
    fn begin(&mut self, fleet: &mut Fleet, files: &StandbyFiles) {
        if self.tried.is_some() && self.tried == self.newest {
            return;
        }
        self.tried = self.newest;
        let before = self.restored.map(|state| (state.term, state.taken_ns));
        if let Some(restored) = restore(fleet, files, before) {
            self.restored = Some(restored);
            (self.replayed, self.tick_ns) = (Replayed::default(), None);
        }
    }

    fn take(&mut self, fleet: &mut Fleet, held: &Held) {
        if fleet.has_accounted(&held.header, held.taken_ns) {
            return;
        }
        let after_ns = held.taken_ns.saturating_add(self.period_ns);
        let next_ns = *self.tick_ns.get_or_insert(after_ns);
        if held.taken_ns >= next_ns {
            fleet.tick(held.taken_ns, false);
            self.tick_ns = Some(after_ns);
        }
        fleet.take(&held.header, &held.samples, held.taken_ns);
        self.replayed.frames += 1;
        self.replayed.samples += held.samples.len() as u64;
    }
}

/// True if a state that was taken at `taken_ns` contains a frame, or no later one of that worker
/// will.
const fn is_contained(held: &Held, taken_ns: u64) -> bool {
    held.taken_ns.saturating_add(CONTAINED_NS) <= taken_ns
}

#[cfg(test)]
mod tests {
    use std::fs;
    use std::path::Path;

    use joulebus_config::Config;
    use joulebus_connect::standby::SavedState;
    use joulebus_models::load_models;
    use joulebus_wire::{SCHEMA_VERSION, Sample, SampleHeader};

    use super::super::backlog::KEEP_NS;
    use super::*;

    const PERIOD_NS: u64 = 33_333_333;

    fn config() -> Config {
        let text = "[fleet]\nname = \"lab\"\ncapacity = 1\n\
                    [[platform]]\nfile = \"builtin:gternal\"\nrobots = [\"0\"]\n";
        Config::parse(text, "nowhere".as_ref()).unwrap()
    }

    fn fleet() -> Fleet {
        let config = config();
        let models = load_models(&config).unwrap();
        Fleet::new(config.settings().clone(), models).unwrap()
    }

    fn files(folder: &Path) -> StandbyFiles {
        let [permit, keyframe, replica] =
            ["permit", "keyframe", "replica"].map(|name| folder.join(name));
        StandbyFiles { permit, keyframe, replica }
    }

    /// Frame `seq` of the run of a source that has sent all before, taken at `taken_ns`.
    fn held(source_epoch: u64, seq: u64, taken_ns: u64) -> Held {
        let header = SampleHeader {
            schema: SCHEMA_VERSION,
            source_id: 1,
            source_epoch,
            frame_seq: seq,
            samples_before: seq,
            ..SampleHeader::default()
        };
        let sample = Sample::new(0, seq + 1, taken_ns).command(0.1, 0.5);
        Held { header, samples: vec![sample.reading(3.5, taken_ns)], taken_ns }
    }

    /// A fleet that has taken ten frames of the run 9, from `begun_ns` on, in a file.
    fn save(path: &Path, term: u64, begun_ns: u64) -> u64 {
        let mut fleet = fleet();
        for seq in 0..10 {
            let frame = held(9, seq, begun_ns + seq * PERIOD_NS);
            fleet.take(&frame.header, &frame.samples, frame.taken_ns);
            fleet.tick(frame.taken_ns, false);
        }
        let mut bytes = Vec::new();
        fleet.state().encode_into(&mut bytes);
        let taken_ns = begun_ns + 10 * PERIOD_NS;
        SavedState::write(path, (term, taken_ns, 0), &bytes).unwrap();
        taken_ns
    }

    #[test]
    fn samples_of_a_host_that_has_booted_are_taken_while_no_state_comes() {
        let folder = tempfile::tempdir().unwrap();
        let (files, mut fleet) = (files(folder.path()), fleet());
        let now_ns = clock::monotonic_ns();
        let taken_ns = save(&files.replica, 1, now_ns - KEEP_NS - 3_000_000_000);
        let mut following = Following::new(config().settings(), PERIOD_NS);
        // Its clock restarts, and its runs with it.
        for seq in 0..20 {
            let _ = following.keep(held(2, seq, taken_ns + 1_000_000_000 + seq * PERIOD_NS));
        }
        following.advance(&mut fleet, &files);
        let (restored, replayed) = following.take_over(&mut fleet, &files, &AtomicU64::new(0));
        assert_eq!(restored.map(|state| state.term), Some(1));
        assert_eq!((replayed.frames, replayed.samples), (20, 20));
        assert_eq!((fleet.accepted(), fleet.drops().total()), (30, 0));
    }

    #[test]
    fn a_state_that_cannot_be_read_any_more_takes_back_nothing_that_was_taken_into_it() {
        for damage in ["removed", "nonsense"] {
            let folder = tempfile::tempdir().unwrap();
            let (files, mut fleet) = (files(folder.path()), fleet());
            let now_ns = clock::monotonic_ns();
            let begun_ns = now_ns - KEEP_NS - 3_000_000_000;
            // This host's worker has served before the one elsewhere.
            save(&files.keyframe, 1, begun_ns - 1_000_000_000);
            let taken_ns = save(&files.replica, 2, begun_ns);
            let mut following = Following::new(config().settings(), PERIOD_NS);
            for seq in 0..20 {
                let _ = following.keep(held(9, 10 + seq, taken_ns + seq * PERIOD_NS));
            }
            following.advance(&mut fleet, &files);
            assert_eq!(fleet.accepted(), 30);
            match damage {
                "removed" => fs::remove_file(&files.replica).unwrap(),
                _ => fs::write(&files.replica, damage).unwrap(),
            }
            following.look_ns = 0;
            let _ = following.keep(held(9, 30, taken_ns + 20 * PERIOD_NS));
            following.advance(&mut fleet, &files);
            let (restored, replayed) = following.take_over(&mut fleet, &files, &AtomicU64::new(0));
            assert_eq!(restored.map(|state| state.term), Some(2), "{damage}");
            assert_eq!(replayed.frames, 21, "{damage}");
            let drops = fleet.drops().total();
            assert_eq!((fleet.accepted(), drops), (31, 0), "{damage}");
        }
    }
}
