//! Which of a fleet's frames a receiver requests.

use crate::protocol::carried::Carried;

/// Maximum number of robot ranges in a request.
pub(crate) const MAX_RANGES: usize = 64;

/// Services, decimation and robots.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub(crate) struct Selection {
    /// [`Carried::bit`]s.
    pub(crate) services: u32,
    /// Decimation: the frames of every n-th tick, n at least 1.
    pub(crate) every: u32,
    /// First and last ids, sorted and disjoint. Empty: all robots.
    ranges: Vec<(u32, u32)>,
}

impl Selection {
    /// Sorts and joins the ranges. Empty ranges, and those beyond [`MAX_RANGES`], are dropped.
    pub(crate) fn new(services: u32, every: u32, mut ranges: Vec<(u32, u32)>) -> Self {
        ranges.truncate(MAX_RANGES);
        ranges.retain(|(first, last)| first <= last);
        ranges.sort_unstable();
        ranges.dedup_by(|next, before| {
            let joins = next.0 <= before.1.saturating_add(1);
            if joins {
                before.1 = before.1.max(next.1);
            }
            joins
        });
        Self { services, every: every.max(1), ranges }
    }

    pub(crate) fn ranges(&self) -> &[(u32, u32)] {
        &self.ranges
    }

    pub(crate) const fn wants(&self, service: Carried) -> bool {
        self.services & service.bit() != 0
    }

    /// True if the frames of `tick` are selected. All services use the same ticks, so that their
    /// frames match.
    pub(crate) const fn wants_tick(&self, tick: u64) -> bool {
        tick.is_multiple_of(self.every as u64)
    }

    /// True if the robot is selected.
    pub(crate) fn has_robot(&self, robot: u32) -> bool {
        self.ranges.is_empty() || self.is_listed(robot)
    }

    fn is_listed(&self, robot: u32) -> bool {
        let at = self.ranges.partition_point(|(first, _)| *first <= robot);
        at > 0 && robot <= self.ranges[at - 1].1
    }

    /// The selected elements, as contiguous runs of bytes.
    pub(crate) fn runs<'a>(
        &'a self,
        service: Carried,
        elements: &'a [u8],
    ) -> impl Iterator<Item = &'a [u8]> + 'a {
        let bytes = service.sizes().1;
        let all = self.ranges.is_empty() || !service.is_by_robot();
        let mut rest = elements;
        std::iter::from_fn(move || {
            if all {
                let run = std::mem::take(&mut rest);
                return (!run.is_empty()).then_some(run);
            }
            let wanted = |row: &[u8]| {
                let id = row[..4].try_into().map_or(u32::MAX, u32::from_le_bytes);
                self.is_listed(id)
            };
            let skipped = rest.chunks_exact(bytes).take_while(|row| !wanted(row)).count();
            rest = &rest[skipped * bytes..];
            let taken = rest.chunks_exact(bytes).take_while(|row| wanted(row)).count();
            let (run, after) = rest.split_at(taken * bytes);
            rest = after;
            (!run.is_empty()).then_some(run)
        })
    }
}

#[cfg(test)]
mod tests {
    use joulebus_wire::Sample;
    use proptest::prelude::*;

    use super::*;

    #[test]
    fn ranges_are_sorted_joined_and_bounded() {
        for (given, kept) in [
            (vec![], vec![]),
            (vec![(5, 4)], vec![]),
            (vec![(8, 9), (1, 3), (4, 4)], vec![(1, 4), (8, 9)]),
            (vec![(0, u32::MAX), (7, 7)], vec![(0, u32::MAX)]),
        ] {
            assert_eq!(Selection::new(0, 0, given).ranges(), kept);
        }
        let many = (0..100).map(|at| (at * 2, at * 2)).collect();
        let selection = Selection::new(0, 0, many);
        assert_eq!((selection.every, selection.ranges().len()), (1, MAX_RANGES));
    }

    proptest! {
        #[test]
        fn the_runs_are_the_rows_of_the_robots_that_are_wanted(
            ids in prop::collection::vec(0_u32..40, 0..60),
            ranges in prop::collection::vec((0_u32..40, 0_u32..40), 0..5),
        ) {
            let selection = Selection::new(0, 1, ranges.clone());
            let wanted = |id: u32| {
                let holds: Vec<_> = ranges.iter().filter(|(first, last)| first <= last).collect();
                holds.is_empty() || holds.iter().any(|(first, last)| *first <= id && id <= *last)
            };
            let rows: Vec<Sample> = ids.iter().map(|id| Sample::new(*id, 0, 0)).collect();
            let bytes: &[u8] = bytemuck::cast_slice(&rows);
            let found: Vec<u8> = selection.runs(Carried::SAMPLES, bytes).flatten().copied().collect();
            let kept: Vec<Sample> = rows.iter().filter(|row| wanted(row.robot)).copied().collect();
            let expected: &[u8] = bytemuck::cast_slice(&kept);
            prop_assert_eq!(found.as_slice(), expected);
        }
    }
}
