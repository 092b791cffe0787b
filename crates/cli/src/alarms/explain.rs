//! `joulebus alarms --explain`: what alarms mean.

use std::fmt;

use joulebus_board::CardRecord;
use joulebus_program::exit::{Outcome, UsageError};
use joulebus_program::output::Output;
use joulebus_wire::AlarmCard;
use serde::Serialize;

/// Value of `--explain` without a name.
pub(super) const ALL: &str = "all";

/// Cards, as asked for.
#[derive(Serialize)]
#[serde(transparent)]
struct Cards(Vec<CardRecord>);

pub(super) fn run(name: &str, output: Output) -> anyhow::Result<Outcome> {
    let cards = if name == ALL {
        AlarmCard::all().map(CardRecord::from).collect()
    } else {
        let card = AlarmCard::named(name).ok_or_else(|| {
            let names: Vec<&str> = AlarmCard::all().map(|card| card.name).collect();
            UsageError(format!("there is no alarm {name:?}, allowed: {}", names.join(", ")))
        })?;
        vec![CardRecord::from(card)]
    };
    output.report(&Cards(cards))?;
    Ok(Outcome::Done)
}

impl fmt::Display for Cards {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        for (at, card) in self.0.iter().enumerate() {
            if at > 0 {
                writeln!(out)?;
            }
            writeln!(out, "{} ({})", card.alarm, card.level)?;
            writeln!(out, "  meaning  {}", card.meaning)?;
            writeln!(out, "  check    {}", card.check)?;
            if !card.keys.is_empty() {
                writeln!(out, "  set by   {}", card.keys.join(", "))?;
            }
            writeln!(out, "  found    {}", card.found_within)?;
        }
        Ok(())
    }
}
