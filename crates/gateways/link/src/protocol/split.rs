//! Splits a source's frames into one for each shard.

use std::collections::BTreeMap;

use joulebus_wire::{Sample, SampleHeader};

use crate::protocol::shards::Shards;

/// Maximum number of remembered sources: as many as a worker may have, and departed ones.
const MAX_SOURCES: usize = 4_096;

/// Numbers of samples that a run of a source has sent, in all and to each shard.
#[derive(Debug, Clone)]
struct Account {
    epoch: u64,
    /// When it was last used, counted in frames of all sources.
    used: u64,
    all: u64,
    /// Samples sent to each shard before its next frame, by which its worker detects losses.
    of_shards: Vec<u64>,
}

/// The sources of a host.
#[derive(Debug)]
pub(crate) struct Split {
    shards: Shards,
    sources: BTreeMap<u64, Account>,
    frames: u64,
    /// Samples of robots that no shard has.
    pub(crate) unassigned: u64,
    rows: Vec<Vec<Sample>>,
}

impl Split {
    pub(crate) fn new(shards: Shards) -> Self {
        let rows = vec![Vec::new(); shards.all().len()];
        Self { shards, sources: BTreeMap::new(), frames: 0, unassigned: 0, rows }
    }

    /// Splits a frame, and passes the parts that have samples to `each`: shard, header, samples.
    /// Samples that were lost before they arrived here count as missing for every shard, because
    /// their robots are unknown.
    pub(crate) fn split(
        &mut self,
        header: &SampleHeader,
        samples: &[Sample],
        mut each: impl FnMut(usize, &SampleHeader, &[Sample]),
    ) {
        self.rows.iter_mut().for_each(Vec::clear);
        for sample in samples {
            match self.shards.of_robot(sample.robot) {
                Some(shard) => self.rows[shard].push(*sample),
                None => self.unassigned += 1,
            }
        }
        self.frames += 1;
        let used = self.frames;
        self.make_room(header.source_id);
        let new = || Account {
            epoch: header.source_epoch,
            used,
            all: header.samples_before,
            // Samples sent before we started may belong to any shard, so count them for all. The
            // count is never below the one from before a restart of this link.
            of_shards: vec![header.samples_before; self.rows.len()],
        };
        let account = self.sources.entry(header.source_id).or_insert_with(new);
        if account.epoch != header.source_epoch {
            *account = new();
        }
        account.used = used;
        let lost = header.samples_before.saturating_sub(account.all);
        account.all = header.samples_before.saturating_add(samples.len() as u64);
        for (shard, (rows, before)) in self.rows.iter().zip(&mut account.of_shards).enumerate() {
            *before = before.saturating_add(lost);
            if !rows.is_empty() {
                let samples_before = *before;
                *before = before.saturating_add(rows.len() as u64);
                let header = SampleHeader { samples_before, ..*header };
                each(shard, &header, rows);
            }
        }
    }

    /// Drops the half of the sources that was silent longest, if another source would be too many.
    fn make_room(&mut self, source: u64) {
        if self.sources.len() < MAX_SOURCES || self.sources.contains_key(&source) {
            return;
        }
        let mut used: Vec<u64> = self.sources.values().map(|account| account.used).collect();
        let half = used.len() / 2;
        let (_, middle, _) = used.select_nth_unstable(half);
        let middle = *middle;
        self.sources.retain(|_, account| account.used >= middle);
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;
    use crate::protocol::shards::Shard;

    fn shards(count: usize) -> Shards {
        let shard = |at: usize| Shard {
            name: format!("s{at}"),
            workers: vec![format!("w{at}")],
            robots: Vec::new(),
        };
        Shards::new((0..count).map(shard).collect())
    }

    fn header(source: u64, epoch: u64, before: u64) -> SampleHeader {
        SampleHeader {
            source_id: source,
            source_epoch: epoch,
            samples_before: before,
            ..SampleHeader::default()
        }
    }

    proptest! {
        #[test]
        fn every_sample_goes_to_the_shard_of_its_robot_and_each_shard_misses_only_what_was_lost(
            frames in prop::collection::vec((0_u64..3, 0_u64..2, 0_u64..9, prop::collection::vec(0_u32..30, 0..12)), 1..40),
            count in 1_usize..5,
        ) {
            let map = shards(count);
            let mut split = Split::new(map.clone());
            // Epoch and samples sent of each source, and the known number of each source and shard.
            let mut sent: BTreeMap<u64, (u64, u64)> = BTreeMap::new();
            let mut known: BTreeMap<(u64, usize), u64> = BTreeMap::new();
            let mut lost: BTreeMap<u64, u64> = BTreeMap::new();
            for (source, restarts, missing, robots) in frames {
                let is_first = !sent.contains_key(&source);
                let (epoch, before) = sent.entry(source).or_insert((1, 0));
                let is_new = is_first || restarts == 1;
                if is_new {
                    (*epoch, *before) = (*epoch + 1, 0);
                    known.retain(|(of, _), _| *of != source);
                    lost.insert(source, 0);
                }
                if !is_new {
                    *before += missing;
                    *lost.get_mut(&source).unwrap() += missing;
                }
                let samples: Vec<Sample> = robots.iter().map(|robot| Sample::new(*robot, 0, 0)).collect();
                let mut seen = Vec::new();
                split.split(&header(source, *epoch, *before), &samples, |shard, header, rows| {
                    let place = known.entry((source, shard)).or_default();
                    // Lost before it, and never more than this source lost.
                    let missed = header.samples_before - *place;
                    assert!(missed <= lost[&source], "{missed} of {lost:?}");
                    *place = header.samples_before + rows.len() as u64;
                    for row in rows {
                        assert_eq!(map.of_robot(row.robot), Some(shard));
                        seen.push(row.robot);
                    }
                });
                *before += samples.len() as u64;
                let mut all = robots.clone();
                all.sort_unstable();
                seen.sort_unstable();
                prop_assert_eq!(seen, all);
            }
            // A shard's known samples are those that it got and those that were lost.
            for ((source, _), place) in &known {
                prop_assert!(*place <= sent[source].1);
            }
        }
    }

    #[test]
    fn a_hundred_thousand_sources_take_the_memory_of_as_many_as_allowed() {
        let mut split = Split::new(shards(2));
        for source in 0..100_000 {
            split.split(&header(source, 1, 0), &[Sample::new(1, 0, 0)], |_, _, _| {});
        }
        let kept = split.sources.len();
        assert!((MAX_SOURCES / 2..=MAX_SOURCES).contains(&kept), "{kept}");
        assert!(split.sources.contains_key(&99_999));
    }

    #[test]
    fn a_robot_of_no_shard_is_counted() {
        let shard =
            Shard { name: "a".to_owned(), workers: vec!["w".to_owned()], robots: vec![(0, 1)] };
        let mut split = Split::new(Shards::new(vec![shard]));
        let samples = [Sample::new(1, 0, 0), Sample::new(2, 0, 0)];
        let mut rows = 0;
        split.split(&header(1, 1, 0), &samples, |_, _, part| rows += part.len());
        assert_eq!((rows, split.unassigned), (1, 1));
    }
}
