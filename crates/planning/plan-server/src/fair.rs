//! The choice of the process that is served next. Pure.

/// Processes without a question whose time is remembered, at most.
const MAX_REMEMBERED: usize = 64;

/// Start-time fair queueing: the time that each process has used, ns, on a common scale.
///
/// A process that asks again continues at its own time, so it pays for its last service. One that
/// returns after a pause starts at the time of the process served last, so that none can save up
/// time.
#[derive(Debug, Default)]
pub(crate) struct Fair {
    used: Vec<(u32, u64)>,
    /// The start time of the process served last. No waiting process has used less.
    floor_ns: u64,
}

impl Fair {
    /// A process has a question waiting.
    pub(crate) fn enter(&mut self, process: u32) {
        if !self.used.iter().any(|(known, _)| *known == process) {
            self.used.push((process, self.floor_ns));
        }
    }

    /// Forgets processes without questions that begin at the floor in any case, and the first of
    /// too many.
    pub(crate) fn keep(&mut self, waits: impl Fn(u32) -> bool) {
        let floor_ns = self.floor_ns;
        self.used.retain(|(process, used_ns)| *used_ns > floor_ns || waits(*process));
        let mut surplus = self.used.len().saturating_sub(MAX_REMEMBERED);
        self.used.retain(|(process, _)| {
            let goes = surplus > 0 && !waits(*process);
            surplus -= usize::from(goes);
            !goes
        });
    }

    /// The place among `waiting` of the process that has used least. Of several the first.
    pub(crate) fn next(&self, waiting: impl Iterator<Item = u32>) -> Option<usize> {
        let places = waiting.enumerate();
        let least = places.min_by_key(|(place, process)| (self.used_ns(*process), *place));
        least.map(|(place, _)| place)
    }

    /// A process was served for this long.
    pub(crate) fn served(&mut self, process: u32, took_ns: u64) {
        self.floor_ns = self.floor_ns.max(self.used_ns(process));
        if let Some((_, used_ns)) = self.used.iter_mut().find(|(known, _)| *known == process) {
            // Even a question that costs nothing counts.
            *used_ns = (*used_ns).max(self.floor_ns).saturating_add(took_ns.max(1));
        }
    }

    fn used_ns(&self, process: u32) -> u64 {
        let found = self.used.iter().find(|(known, _)| *known == process);
        found.map_or(self.floor_ns, |(_, used_ns)| (*used_ns).max(self.floor_ns))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Each process asks again as soon as it is answered, and has no question for a moment in
    /// between. Returns the time that each has used.
    fn ask_again_and_again(costs_ns: &[u64], rounds: usize) -> Vec<u64> {
        let mut fair = Fair::default();
        let mut used_ns = vec![0; costs_ns.len()];
        let all = || 0..costs_ns.len() as u32;
        for _ in 0..rounds {
            all().for_each(|process| fair.enter(process));
            let place = fair.next(all()).unwrap();
            fair.served(place as u32, costs_ns[place]);
            fair.keep(|process| process != place as u32);
            used_ns[place] += costs_ns[place];
        }
        used_ns
    }

    #[test]
    fn processes_share_the_time_equally_whatever_their_questions_cost() {
        for costs_ns in [
            &[10_000_000, 100][..],
            &[100, 10_000_000, 1_000],
            &[7, 7, 7, 7],
            &[1, 1_000, 30_000, 1_000_000],
        ] {
            let used_ns = ask_again_and_again(costs_ns, 500_000);
            let (least, most) = (used_ns.iter().min().unwrap(), used_ns.iter().max().unwrap());
            let longest = costs_ns.iter().max().unwrap();
            assert!(most - least <= 2 * longest, "{costs_ns:?}: {used_ns:?}");
        }
    }

    #[test]
    fn a_process_that_was_silent_is_next_but_has_saved_nothing_up() {
        let mut fair = Fair::default();
        fair.enter(1);
        for _ in 0..1_000 {
            fair.served(1, 1_000);
        }
        fair.enter(2);
        assert_eq!(fair.next([1, 2].into_iter()), Some(1));
        let mut in_a_row = 0;
        while fair.next([1, 2].into_iter()) == Some(1) {
            fair.served(2, 1_000);
            in_a_row += 1;
        }
        assert!(in_a_row <= 2, "{in_a_row}");
        assert_eq!(fair.next(std::iter::empty()), None);
    }

    #[test]
    fn of_processes_that_used_the_same_the_first_is_next() {
        let mut fair = Fair::default();
        [5, 3, 4].iter().for_each(|process| fair.enter(*process));
        assert_eq!(fair.next([4, 5, 3].into_iter()), Some(0));
    }

    #[test]
    fn processes_that_do_not_come_back_are_forgotten() {
        let mut fair = Fair::default();
        for process in 0..100_000 {
            fair.enter(process);
            fair.served(process, 1_000_000_000);
            fair.keep(|_| false);
            assert!(fair.used.len() <= MAX_REMEMBERED);
        }
        fair.enter(7);
        for _ in 0..2 {
            fair.served(7, u64::MAX);
        }
        fair.keep(|process| process == 7);
        assert_eq!(fair.used.len(), 1, "the floor has passed the others");
    }
}
