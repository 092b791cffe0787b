//! All robots' accounts, so that a restarted worker continues with them.

use std::collections::{BTreeMap, BTreeSet};
use std::sync::atomic::{AtomicU32, Ordering};

use joulebus_fleet::{
    ErrorCounts, Fleet, Ledger, SavedBattery, SavedLessons, SavedPause, StatedBattery,
};
use joulebus_wire::{Budget, BudgetHeader, budget_flag};
use serde::{Deserialize, Serialize};

/// Tolerance of a stamp later than its frame of budgets, ns. Beyond it the stamp is false. Samples
/// are stamped before they are sent, and links move stamps to this host's clock so that none looks
/// fresher than it is.
const MAX_AHEAD_NS: u64 = 1_000_000_000;

/// Statements this soon after a save are none, s.
const MARGIN_S: f32 = 0.5;

/// All robots' accounts at one moment.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct Checkpoint {
    /// Name of the fleet: another fleet's file is refused.
    pub fleet: String,
    /// Boot id that the stamps belong to.
    pub boot_id: String,
    /// When it was written, monotonic ns of that boot.
    pub written_ns: u64,
    /// When it was written, Unix ns.
    pub written_unix_ns: u64,
    /// Accounts by robot id.
    pub robots: BTreeMap<u32, SavedAccount>,
    /// The last 16 bits of the ids of robots whose account was given up for another. If one of
    /// these robots joins without an account, its battery is unknown.
    #[serde(default, skip_serializing_if = "BTreeSet::is_empty")]
    pub lost: BTreeSet<u16>,
    /// Errors of the energy of each platform, in the order of the config. None before version 4.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub errors: Vec<ModelErrors>,
    /// Capacities that were learned of a robot's batteries, the last of each month in which one
    /// was, the oldest first. None before version 7.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub capacities: BTreeMap<u32, Vec<LearnedCapacity>>,
}

/// A capacity that was learned of a battery.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct LearnedCapacity {
    /// When it was saved, Unix s.
    pub unix_s: u64,
    /// Capacity, J.
    pub capacity_j: f32,
    /// Its standard deviation, J.
    pub capacity_sd_j: f32,
}

impl LearnedCapacity {
    /// The month, since 1970.
    const fn month(&self) -> u64 {
        // A twelfth of a mean year of the Gregorian calendar.
        self.unix_s / 2_629_746
    }
}

/// Months of which a robot's learned capacity is kept.
const MONTHS: usize = 24;
/// A wall clock that shows less is not set, Unix s: 2025.
const CLOCK_IS_SET_S: u64 = 1_735_689_600;

/// The errors that a platform's robots have shown of its model, from which the bounds of the next
/// run's plans and outlooks continue.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct ModelErrors {
    pub(crate) model_hash: u64,
    pub(crate) seen: ErrorCounts<f32>,
}

/// The same on its way from the tick to the checkpointer, as bits. A save may catch some of one
/// tick and some of the next.
#[derive(Debug)]
pub(crate) struct SentErrors(Vec<(u64, ErrorCounts<AtomicU32>)>);

impl SentErrors {
    /// An empty exchange, with as many entries as the fleet has platforms.
    pub(crate) fn new(fleet: &Fleet) -> Self {
        let bits = |seen: &ErrorCounts<f32>| seen.map(|number| AtomicU32::new(number.to_bits()));
        Self(fleet.remembered_errors().map(|(hash, seen)| (hash, bits(seen))).collect())
    }

    pub(crate) fn send(&self, fleet: &Fleet) {
        for ((_, sent), (_, seen)) in self.0.iter().zip(fleet.remembered_errors()) {
            for (sent, seen) in sent.numbers().zip(seen.numbers()) {
                sent.store(seen.to_bits(), Ordering::Relaxed);
            }
        }
    }

    /// Receives the errors that were sent last. Levels are of this run alone, and older releases
    /// read another quantity in their place.
    pub(crate) fn receive(&self) -> Vec<ModelErrors> {
        let number = |bits: &AtomicU32| f32::from_bits(bits.load(Ordering::Relaxed));
        let platforms = self.0.iter();
        let errors = platforms.map(|(hash, sent)| ModelErrors {
            model_hash: *hash,
            seen: sent.map(number).without_levels(),
        });
        errors.collect()
    }
}

/// One robot's account. Fields as in [`joulebus_wire::Budget`].
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct SavedAccount {
    pub drawn_uj: i64,
    drawn_remainder: i64,
    forecast_uj: i64,
    metered_ns: u64,
    unmetered_ns: u64,
    stamp_ns: u64,
    /// Same as [`budget_flag::CHARGED`].
    charged: bool,
    /// `None` for a platform without one, and in files of version 2.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    battery: Option<SavedBattery>,
    /// Mean power at the last sample, W. `None` without a battery, and before version 5.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub mean_power_w: Option<f32>,
    /// Pauses of its battery. `None` without any, and before version 6.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub pause: Option<SavedPause>,
    /// What its battery has taught. `None` before that, and before version 7.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub lessons: Option<SavedLessons>,
}

impl SavedAccount {
    /// Sets the battery, with its parts apart.
    fn set_battery(&mut self, battery: SavedBattery) {
        let (pause, lessons) = (battery.pause(), battery.lessons());
        self.mean_power_w = battery.mean_power_w();
        self.pause = Some(pause).filter(|pause| *pause != SavedPause::default());
        self.lessons = Some(lessons).filter(|lessons| *lessons != SavedLessons::default());
        let bare = battery.with_mean_power_w(None);
        self.battery = Some(bare.with_pause(SavedPause::default(), SavedLessons::default()));
    }

    /// True if a budget of the same last sample, which contains a silence, says that its battery is
    /// known since: its pause is shorter than the silence would have made it.
    fn is_stated(&self, budget: &Budget, silent_ns: u64) -> bool {
        let Some(battery) = self.battery else {
            return false;
        };
        let contained_ns = battery.unmetered_ns().saturating_sub(self.unmetered_ns);
        let more_s = silent_ns.saturating_sub(contained_ns) as f32 * 1e-9;
        let pause_s = self.pause.map_or(0.0, |pause| pause.pause_s());
        budget.pause_s + MARGIN_S < pause_s + more_s
    }
}

/// One robot's account as the fleet takes it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct RestoredAccount {
    pub robot: u32,
    pub ledger: Ledger,
    /// True if it has been on its charger.
    pub charged: bool,
    pub battery: Option<SavedBattery>,
}

/// Grows with the time of the last sample. False ones come before all others.
type Age = (bool, u64);

impl Checkpoint {
    /// A checkpoint without accounts.
    pub(crate) fn new(fleet: &str, boot_id: &str) -> Self {
        Self {
            fleet: fleet.to_owned(),
            boot_id: boot_id.to_owned(),
            written_ns: 0,
            written_unix_ns: 0,
            robots: BTreeMap::new(),
            lost: BTreeSet::new(),
            errors: Vec::new(),
            capacities: BTreeMap::new(),
        }
    }

    /// Takes the accounts of a frame of budgets. Keeps at most `most`: the frame's robots first,
    /// then those of which the config states a period, then those with the newest last sample.
    /// Returns the number of dropped accounts.
    pub(crate) fn take(
        &mut self,
        header: &BudgetHeader,
        budgets: &[Budget],
        (most, period_ns): (usize, impl Fn(u32) -> Option<u64>),
    ) -> usize {
        (self.written_ns, self.written_unix_ns) = (header.sent_ns, header.sent_unix_ns);
        let of_frame = || {
            let rows = budgets.iter();
            rows.filter(|budget| budget.flags & budget_flag::LEDGER != 0)
        };
        for budget in of_frame() {
            // While a robot is silent its budget falls. The account begins at its last sample, and
            // counts the silence again: the battery is that of the sample, or contains the silence.
            let known = self.robots.get(&budget.robot);
            let silent = known.filter(|known| known.stamp_ns == budget.stamp_ns);
            let silent_ns = header.sent_ns.saturating_sub(budget.stamp_ns);
            let silent_ns = silent_ns.saturating_sub(period_ns(budget.robot).unwrap_or(0));
            // A person's statement ends the pause.
            let silent = silent.filter(|known| !known.is_stated(budget, silent_ns));
            let mut account = SavedAccount {
                drawn_uj: budget.drawn_uj,
                drawn_remainder: budget.drawn_remainder,
                forecast_uj: budget.forecast_uj,
                metered_ns: budget.metered_ns,
                unmetered_ns: budget.unmetered_ns,
                stamp_ns: budget.stamp_ns,
                charged: budget.flags & budget_flag::CHARGED != 0,
                battery: None,
                mean_power_w: None,
                pause: None,
                lessons: None,
            };
            if let Some(battery) = SavedBattery::new(budget, silent_ns) {
                account.set_battery(battery);
            }
            if let Some(known) = silent {
                account.battery = known.battery.or(account.battery);
                account.pause = known.pause.or(account.pause);
            }
            let before = self.robots.insert(budget.robot, account);
            self.remember_capacity(budget, before.and_then(|before| before.lessons));
        }
        let too_many = self.robots.len().saturating_sub(most);
        if too_many > 0 {
            let present: BTreeSet<u32> = of_frame().map(|budget| budget.robot).collect();
            let rank = |(age, robot)| {
                let is_present = present.contains(&robot);
                (is_present, period_ns(robot).is_some(), age, robot)
            };
            let mut oldest_first: Vec<(bool, bool, Age, u32)> = self.by_age().map(rank).collect();
            oldest_first.sort_unstable();
            for (.., robot) in oldest_first.iter().take(too_many) {
                self.robots.remove(robot);
                self.capacities.remove(robot);
                self.lost.insert(*robot as u16);
            }
        }
        too_many
    }

    /// Takes the battery that a person has stated of a robot of which no sample has come since.
    pub(crate) fn state(&mut self, stated: &StatedBattery) {
        let account = self.robots.get_mut(&stated.robot);
        if let Some(account) = account.filter(|account| account.stamp_ns == stated.stamp_ns) {
            account.set_battery(stated.battery);
        }
    }

    /// Remembers a capacity that has changed since the lessons `before`.
    fn remember_capacity(&mut self, budget: &Budget, before: Option<SavedLessons>) {
        let Some((capacity_j, capacity_sd_j)) = budget.learned_capacity_j() else {
            return;
        };
        // A restart rounds it.
        let near = |one: f32, other: f32| (one - other).abs() <= 1e-5 * other;
        let before = before.map(|before| before.capacity_j());
        if before
            .is_some_and(|(joules, sd_j)| near(joules, capacity_j) && near(sd_j, capacity_sd_j))
        {
            return;
        }
        let unix_s = self.written_unix_ns / 1_000_000_000;
        if unix_s < CLOCK_IS_SET_S {
            return;
        }
        let newest = LearnedCapacity { unix_s, capacity_j, capacity_sd_j };
        let months = self.capacities.entry(budget.robot).or_default();
        // A clock that was ahead has left a month or two, which go. One that is behind takes none.
        let later = months.iter().filter(|known| known.month() > newest.month()).count();
        if later > 2 {
            return;
        }
        months.retain(|known| known.month() < newest.month());
        months.push(newest);
        months.drain(..months.len().saturating_sub(MONTHS));
    }

    /// Robots whose battery was exchanged, according to a frame, since the last frame taken.
    pub(crate) fn exchanged<'a>(&'a self, budgets: &'a [Budget]) -> impl Iterator<Item = u32> + 'a {
        let changed = |budget: &&Budget| {
            let known = self.robots.get(&budget.robot).and_then(|known| known.battery);
            known.is_some_and(|known| budget.battery_changes > known.changes())
        };
        budgets.iter().filter(changed).map(|budget| budget.robot)
    }

    fn by_age(&self) -> impl Iterator<Item = (Age, u32)> + '_ {
        let robots = self.robots.iter();
        robots.map(|(robot, account)| (self.age(account), *robot))
    }

    /// Orders accounts by age. A false stamp, far in the future, must not keep its robot's account
    /// ahead of all others.
    const fn age(&self, account: &SavedAccount) -> Age {
        let latest_ns = self.written_ns.saturating_add(MAX_AHEAD_NS);
        (account.stamp_ns <= latest_ns, account.stamp_ns)
    }

    /// Converts the accounts to the current boot. After a reboot the stamps restart, and the time
    /// in between, known only from the wall clock, is unmetered. If the wall clock shows less than
    /// the time since this boot (it is not set yet, or was set back), the time is unknown, and so
    /// is the charge of the batteries.
    #[must_use]
    pub(crate) fn carried_over(mut self, boot_id: &str, now_ns: u64, now_unix_ns: u64) -> Self {
        if self.boot_id == boot_id {
            return self;
        }
        let by_wall_ns = now_unix_ns.saturating_sub(self.written_unix_ns);
        let (away_ns, is_known) = (by_wall_ns.max(now_ns), by_wall_ns >= now_ns);
        let mut newest_first: Vec<(Age, u32)> = self.by_age().collect();
        newest_first.sort_unstable_by(|one, other| other.cmp(one));
        for (later, (_, robot)) in (0..).zip(newest_first) {
            if let Some(account) = self.robots.get_mut(&robot) {
                account.unmetered_ns = account
                    .unmetered_ns
                    .saturating_add(away_ns)
                    .saturating_add(self.written_ns.saturating_sub(account.stamp_ns));
                // Apart by one ns each: those that were silent longest are still given up first.
                account.stamp_ns = now_ns.saturating_sub(later);
                if !is_known {
                    account.battery = account.battery.map(SavedBattery::without_bounds);
                }
            }
        }
        (self.written_ns, self.written_unix_ns) = (now_ns, now_unix_ns);
        boot_id.clone_into(&mut self.boot_id);
        self
    }

    /// Lets the fleet continue with the errors of an earlier run. Returns the number of platforms
    /// that do. Others have another model now.
    pub(crate) fn restore_errors(&self, fleet: &mut Fleet) -> usize {
        let errors = self.errors.iter().enumerate();
        errors
            .filter(|(index, errors)| fleet.restore_errors(*index, errors.model_hash, &errors.seen))
            .count()
    }

    /// The accounts as ledgers, the robot that was silent longest first. Accounts with false stamps
    /// come before it, and get one shortly before the file was written: until its time had come,
    /// such an account would count nothing.
    pub(crate) fn ledgers(&self) -> Vec<RestoredAccount> {
        let mut robots: Vec<(&u32, &SavedAccount)> = self.robots.iter().collect();
        robots.sort_by_key(|(_, account)| self.age(account));
        let ledger = |(robot, account): (&u32, &SavedAccount)| {
            let drawn = (account.drawn_uj, account.drawn_remainder);
            let (metered_ns, unmetered_ns) = (account.metered_ns, account.unmetered_ns);
            let (is_true, stamp_ns) = self.age(account);
            let before_ns = self.written_ns.saturating_sub(MAX_AHEAD_NS);
            let stamp_ns = if is_true { stamp_ns } else { before_ns };
            let forecast_uj = account.forecast_uj;
            let ledger = Ledger::restored(drawn, forecast_uj, metered_ns, unmetered_ns, stamp_ns);
            let mean_power_w = account.mean_power_w;
            let pause = account.pause.unwrap_or_default();
            let whole = |battery: SavedBattery| battery.with_mean_power_w(mean_power_w);
            let lessons = account.lessons.unwrap_or_default();
            let battery = account.battery.map(|battery| whole(battery).with_pause(pause, lessons));
            RestoredAccount { robot: *robot, ledger, charged: account.charged, battery }
        };
        robots.into_iter().map(ledger).collect()
    }
}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;

    fn sent(sent_ns: u64) -> BudgetHeader {
        BudgetHeader { sent_ns, sent_unix_ns: 50_000, ..BudgetHeader::default() }
    }

    pub(crate) fn checkpoint() -> Checkpoint {
        let budget = Budget {
            robot: 3,
            flags: budget_flag::LEDGER,
            drawn_uj: i64::MAX,
            drawn_remainder: 1_999_999_999,
            metered_ns: u64::MAX - 50,
            unmetered_ns: 20,
            stamp_ns: 900,
            ..Budget::default()
        };
        let absent = Budget { robot: 4, ..Budget::default() };
        let mut checkpoint = Checkpoint::new("lab", "boot-a");
        assert_eq!(checkpoint.take(&sent(1_000), &[budget, absent], (9, |_| Some(100))), 0);
        checkpoint
    }

    #[test]
    fn a_hundred_thousand_robots_take_the_memory_of_as_many_as_allowed_and_the_newest_stay() {
        let mut ledger = Checkpoint::new("lab", "boot-a");
        let mut gone = 0;
        let of = |robot, stamp_ns| Budget {
            robot,
            flags: budget_flag::LEDGER,
            stamp_ns,
            ..Budget::default()
        };
        for name in 0..100_000 {
            let stamp_ns = u64::from(name) + 1;
            let frame = [of(u32::MAX, stamp_ns), of(name, stamp_ns)];
            gone += ledger.take(&sent(stamp_ns), &frame, (50, |_| Some(100)));
            assert!(ledger.robots.len() <= 50, "robot {name}");
        }
        assert_eq!(gone, 100_001 - 50);
        let newest: Vec<u32> = (100_000 - 49..100_000).chain([u32::MAX]).collect();
        assert_eq!(ledger.robots.keys().copied().collect::<Vec<_>>(), newest);
        let oldest_first = ledger.ledgers();
        assert!(oldest_first.is_sorted_by_key(|restored| restored.ledger.stamp_ns()));
    }

    #[test]
    fn accounts_of_robots_that_the_config_no_longer_names_are_given_up_first() {
        let mut ledger = Checkpoint::new("lab", "boot-a");
        let of = |robot, stamp_ns| Budget {
            robot,
            flags: budget_flag::LEDGER,
            stamp_ns,
            ..Budget::default()
        };
        let renumbered = |robot: u32| (robot < 20).then_some(100);
        for robot in (0..20).chain(100..120) {
            let stamp_ns = 1_000 + u64::from(robot);
            ledger.take(&sent(stamp_ns), &[of(robot, stamp_ns)], (30, renumbered));
        }
        let kept: Vec<u32> = ledger.robots.keys().copied().collect();
        let wanted: Vec<u32> = (0..20).chain(110..120).collect();
        assert_eq!(kept, wanted);
        assert_eq!(ledger.lost, (100..110).collect());
    }

    #[test]
    fn after_a_reboot_the_time_in_between_is_unmetered() {
        let same = checkpoint().carried_over("boot-a", 5_000, 60_000);
        assert_eq!(same, checkpoint());
        let other = checkpoint().carried_over("boot-b", 5, 60_000);
        let account = &other.robots[&3];
        assert_eq!(account.unmetered_ns, 20 + 10_000 + 100);
        assert_eq!(account.stamp_ns, 5);
    }

    #[test]
    fn the_mean_power_is_kept_with_an_account_and_comes_back_with_its_battery() {
        for (power_w, kept) in [(6.5, Some(6.5)), (f32::NAN, None)] {
            let budget = Budget {
                robot: 3,
                flags: budget_flag::LEDGER | budget_flag::BATTERY,
                mean_power_w: power_w,
                stamp_ns: 1_000,
                ..Budget::default()
            };
            let mut ledger = Checkpoint::new("lab", "boot-a");
            ledger.take(&sent(1_000), &[budget], (9, |_| Some(100)));
            let text = serde_json::to_string(&ledger).unwrap();
            assert_eq!(text.contains("mean_power_w"), kept.is_some(), "{text}");
            let read: Checkpoint = serde_json::from_str(&text).unwrap();
            assert_eq!(read, ledger);
            let battery = read.ledgers()[0].battery.unwrap();
            assert_eq!(battery.mean_power_w(), kept);
        }
    }

    #[test]
    fn a_silence_in_the_saved_battery_counts_once() {
        let of = |stamp_ns| Budget {
            robot: 3,
            flags: budget_flag::LEDGER | budget_flag::BATTERY | budget_flag::CHARGE,
            soc: 0.5,
            soc_hi: 1.0,
            unmetered_ns: 7_000,
            stamp_ns,
            ..Budget::default()
        };
        // The first frame of the robot's last sample, or one in the middle of its silence.
        for (sent_ns, contained_ns) in [(1_000, 0), (1_050, 0), (1_100, 0), (1_900, 800)] {
            let mut ledger = Checkpoint::new("lab", "boot-a");
            ledger.take(&sent(sent_ns), &[of(1_000)], (9, |_| Some(100)));
            let saved = ledger.robots[&3].battery;
            let wanted = SavedBattery::new(&of(1_000), contained_ns);
            let none = (SavedPause::default(), SavedLessons::default());
            let bare = |of: SavedBattery| of.with_mean_power_w(None).with_pause(none.0, none.1);
            assert_eq!(saved, wanted.map(bare), "{sent_ns}");
            // It stays as it was first seen, and the account begins at the sample.
            ledger.take(&sent(9_000), &[of(1_000)], (9, |_| Some(100)));
            let account = ledger.robots[&3];
            assert_eq!((account.battery, account.unmetered_ns), (saved, 7_000), "{sent_ns}");
        }
    }

    /// The robot was silent when a person stated its battery: its last sample is the same.
    #[test]
    fn what_a_person_states_of_a_silent_robot_is_saved() {
        let of = |soc, pause_s| Budget {
            robot: 3,
            flags: budget_flag::LEDGER | budget_flag::BATTERY | budget_flag::CHARGE,
            soc,
            soc_hi: 1.0,
            stamp_ns: 1_000,
            pause_s,
            ..Budget::default()
        };
        let second = 1_000_000_000;
        let mut ledger = Checkpoint::new("lab", "boot-a");
        let mut saved = |sent_ns, budget| {
            ledger.take(&sent(sent_ns), &[budget], (9, |_| Some(100)));
            ledger.robots[&3].battery
        };
        let first = saved(60 * second, of(0.5, 60.0));
        assert_eq!(saved(90 * second, of(0.4, 90.0)), first, "only the silence went on");
        let stated = saved(100 * second, of(0.9, 4.0));
        assert_ne!(stated, first);
        assert_eq!(saved(130 * second, of(0.8, 34.0)), stated);
        assert_eq!(ledger.robots[&3].pause.map(|pause| pause.pause_s()), Some(4.0));
    }

    #[test]
    fn the_last_capacity_of_each_of_24_months_is_kept_and_read_again() {
        let mut ledger = Checkpoint::new("lab", "boot-a");
        for day in 0..1_000_u64 {
            // Rounded by a restart: nothing was learned.
            let rounded = |value: f32| value * (1.0 + (day % 2) as f32 * f32::EPSILON);
            // A host begins without a clock, another is years ahead, and one is 20 months behind.
            let wall = match day {
                700..710 => day - 700,
                720..730 => 60_000 + day,
                800..805 => 19_700 + day,
                _ => 20_300 + day,
            };
            let header = BudgetHeader {
                sent_ns: 1_000 + day,
                sent_unix_ns: wall * 86_400_000_000_000,
                ..BudgetHeader::default()
            };
            let budget = Budget {
                robot: 3,
                flags: budget_flag::LEDGER | budget_flag::BATTERY | budget_flag::CHARGE,
                soc_hi: 1.0,
                stamp_ns: day + 1,
                // It is learned every fifth day, and falls.
                capacity_j: rounded(36_000.0 - (2 * (day / 5)) as f32),
                capacity_sd_j: 900.0,
                capacity_weight: 2.0,
                charge_rate: [400; joulebus_wire::CHARGE_TENTHS],
                ..Budget::default()
            };
            ledger.take(&header, &[budget], (9, |_| Some(100)));
        }
        let text = serde_json::to_string(&ledger).unwrap();
        let read: Checkpoint = serde_json::from_str(&text).unwrap();
        assert_eq!(read, ledger);
        let months = &read.capacities[&3];
        let newest_j = 36_000.0 - 398.0;
        assert!((months[MONTHS - 1].capacity_j - newest_j).abs() < 0.1, "{months:?}");
        assert_eq!(months.len(), MONTHS);
        assert_eq!(months[MONTHS - 1].unix_s, (20_300 + 995) * 86_400);
        assert!(months.is_sorted_by(|one, next| one.month() < next.month()), "{months:?}");
        let lessons = read.ledgers()[0].battery.unwrap().lessons();
        assert_eq!(Some(lessons), ledger.robots[&3].lessons);
    }

    #[test]
    fn after_a_reboot_without_a_clock_nobody_knows_what_is_left() {
        let budget = Budget {
            robot: 3,
            flags: budget_flag::LEDGER | budget_flag::BATTERY | budget_flag::CHARGE,
            soc: 0.7,
            soc_lo: 0.6,
            soc_hi: 0.8,
            stamp_ns: 1_000,
            ..Budget::default()
        };
        let mut ledger = Checkpoint::new("lab", "boot-a");
        assert_eq!(ledger.take(&sent(1_000), &[budget], (9, |_| Some(100))), 0);
        let whole = ledger.robots[&3].battery;
        let carried = |now_unix_ns| ledger.clone().carried_over("boot-b", 500, now_unix_ns);
        assert_eq!(carried(50_500).robots[&3].battery, whole);
        for now_unix_ns in [0, 49_999, 50_499] {
            let account = carried(now_unix_ns).robots[&3];
            assert_eq!(account.unmetered_ns, 500, "at least since this boot");
            assert_eq!(account.battery, whole.map(SavedBattery::without_bounds));
            assert_ne!(account.battery, whole);
        }
    }

    #[test]
    fn after_a_reboot_the_accounts_of_robots_that_were_silent_longest_still_come_first() {
        let mut ledger = Checkpoint::new("lab", "boot-a");
        let of = |(robot, stamp_ns)| Budget {
            robot,
            flags: budget_flag::LEDGER,
            stamp_ns,
            ..Budget::default()
        };
        let frame = [(7, 300), (1, 900), (5, 100), (9, 300)].map(of);
        assert_eq!(ledger.take(&sent(1_000), &frame, (9, |_| Some(100))), 0);
        let carried = ledger.carried_over("boot-b", 5_000, 0);
        let order: Vec<u32> =
            carried.ledgers().into_iter().map(|restored| restored.robot).collect();
        assert_eq!(order, [5, 7, 9, 1]);
    }

    /// The robots that a fleet of eight keeps when it starts.
    fn restored(ledger: &Checkpoint) -> Vec<u32> {
        let all = ledger.ledgers();
        let mut newest: Vec<u32> = all.iter().rev().take(8).map(|account| account.robot).collect();
        newest.sort_unstable();
        newest
    }

    #[test]
    fn false_stamps_of_robots_that_left_cost_no_robot_its_account() {
        let of = |(robot, stamp_ns)| Budget {
            robot,
            flags: budget_flag::LEDGER,
            stamp_ns,
            ..Budget::default()
        };
        let far_ns = [u64::MAX, u64::MAX - 1, 5_000 * MAX_AHEAD_NS];
        let mut ledger = Checkpoint::new("lab", "boot-a");
        let mut now_ns = 1_000_000;
        let mut gone = 0;
        for liar in 0..30 {
            now_ns += MAX_AHEAD_NS;
            let stamp_ns = far_ns[liar as usize % 3];
            // One of the robots is stamped a little ahead.
            let frame = [(1, now_ns), (2, now_ns + MAX_AHEAD_NS / 9), (900 + liar, stamp_ns)];
            gone += ledger.take(&sent(now_ns), &frame.map(of), (16, |_| Some(100)));
            assert!(ledger.robots.contains_key(&(900 + liar)), "it is there");
        }
        assert_eq!((ledger.robots.len(), gone), (16, 16));
        // As many as there are slots, the two among them. Then only the two.
        now_ns += MAX_AHEAD_NS;
        let all = [1, 2, 10, 11, 12, 13, 14, 15].map(|robot| of((robot, now_ns)));
        assert_eq!(ledger.take(&sent(now_ns), &all, (16, |_| Some(100))), 6);
        assert_eq!(restored(&ledger), [1, 2, 10, 11, 12, 13, 14, 15]);
        let rebooted = ledger.clone().carried_over("boot-b", 5_000, 0);
        assert_eq!(restored(&rebooted), [1, 2, 10, 11, 12, 13, 14, 15]);
        let again = ledger.clone().carried_over("boot-a", now_ns + 5_000, 0);
        assert_eq!(restored(&again), [1, 2, 10, 11, 12, 13, 14, 15]);
        let stamps_ns = again.ledgers().into_iter().filter_map(|one| one.ledger.stamp_ns());
        assert!(stamps_ns.into_iter().all(|stamp_ns| stamp_ns <= now_ns), "they count on");
        // Robots that have been silent for a minute come before those with false stamps.
        assert!(again.by_age().filter(|((is_true, _), _)| !is_true).count() > 0);
        now_ns += MAX_AHEAD_NS;
        let two = [1, 2].map(|robot| of((robot, now_ns)));
        assert_eq!(ledger.take(&sent(now_ns), &two, (2, |_| Some(100))), 14);
        assert_eq!(restored(&ledger), [1, 2]);
    }
}
