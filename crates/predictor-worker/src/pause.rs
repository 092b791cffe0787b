//! What the time that a worker was off has cost the batteries, for its first lines.

use joulebus_settings::FleetSettings;
use joulebus_wire::{Budget, budget_flag};

use crate::checkpoint::RestoredAccount;

/// Robots that have a line each.
const MAX_LINES: usize = 8;

/// Lines for people about the accounts with which a worker starts at `now_ns`, monotonic.
pub(crate) fn first_lines(
    settings: &FleetSettings,
    accounts: &[RestoredAccount],
    now_ns: u64,
) -> Vec<String> {
    let note = |account: &RestoredAccount| {
        let of = |platform: &&joulebus_settings::Platform| platform.has(account.robot);
        let platform = settings.platforms.iter().find(of)?;
        let (pause_s, pause) = account.battery?.paused(platform, &account.ledger, now_ns)?;
        let budget = Budget {
            robot: account.robot,
            flags: budget_flag::BATTERY,
            pause_s,
            pause,
            ..Budget::default()
        };
        Some((pause, budget.robot, budget.pause_note()?))
    };
    let mut notes: Vec<(f32, u32, String)> = accounts.iter().filter_map(note).collect();
    // The most costly first.
    notes.sort_by(|one, other| other.0.total_cmp(&one.0).then(one.1.cmp(&other.1)));
    let more = notes.len().saturating_sub(MAX_LINES);
    let mut lines: Vec<String> = notes
        .into_iter()
        .take(MAX_LINES)
        .map(|(_, robot, note)| format!("robot {robot}: {note}"))
        .collect();
    if more > 0 {
        lines.push(format!("{more} more robots: `joulebus battery` lists them"));
    }
    lines
}

#[cfg(test)]
mod tests {
    use joulebus_config::Config;

    use super::*;
    use crate::checkpoint::Checkpoint;

    /// Saved by a worker that then was off for twelve minutes.
    fn lines(robots: u32, flags: u32) -> Vec<String> {
        let text = "[fleet]\nname = \"lab\"\ncapacity = 20\n\
                    [[platform]]\nfile = \"builtin:gternal\"\nrobots = [\"0-19\"]\n";
        let config = Config::parse(text, std::path::Path::new("/nowhere")).unwrap();
        let header = joulebus_wire::BudgetHeader { sent_ns: 1_000, ..Default::default() };
        let of = |robot| Budget {
            robot,
            flags: budget_flag::LEDGER | budget_flag::BATTERY | budget_flag::CHARGE | flags,
            soc: 0.8,
            soc_lo: 0.7,
            soc_hi: 0.9,
            idle_w: 0.1,
            stamp_ns: 1_000,
            ..Budget::default()
        };
        let mut ledger = Checkpoint::new("lab", "boot");
        let budgets: Vec<Budget> = (0..robots).map(of).collect();
        ledger.take(&header, &budgets, (20, |_| Some(100)));
        let text = serde_json::to_string(&ledger).unwrap();
        let read: Checkpoint = serde_json::from_str(&text).unwrap();
        assert_eq!(read, ledger);
        assert!(read.robots.values().all(|account| account.pause.is_some()));
        first_lines(config.settings(), &read.ledgers(), 1_000 + 720_000_000_000)
    }

    #[test]
    fn the_first_lines_say_what_the_time_away_has_cost_and_what_to_do() {
        let said = lines(1, 0);
        let [line] = &said[..] else { panic!("{said:?}") };
        assert!(
            line.starts_with("robot 0: 12 min without readings may have cost up to "),
            "{line}"
        );
        assert!(line.contains("joulebus battery 0 --full"), "{line}");
        // A robot that has said that it is switched off has cost a hundredth of that.
        assert!(lines(1, budget_flag::OFF).is_empty());
        let many = lines(20, 0);
        assert_eq!((many.len(), &*many[8]), (9, "12 more robots: `joulebus battery` lists them"));
    }
}
