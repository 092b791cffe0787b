//! The layouts as data. The C header and NumPy's types are made of them.

use crate::{
    Alarm, AnswerHeader, AnswerRow, Channel, ChargeState, DropCounts, DropReason, ForEachChannel,
    FrameRows, InvalidReason, Level, MAX_QUERY_CANDIDATES, MAX_QUERY_ROBOTS, MAX_QUERY_STEPS,
    MAX_QUERY_VALUES, PlatformMemory, Quality, QueryHeader, QueryKind, QueryRefusal, Refusal, Row,
    SCHEMA_VERSION, StructLayout, answer_flag, budget_flag, diagnostic_flag, each_channel,
    forecast_flag, outlook_flag, plan_state_flag, platform_flag, query_flag, sample_flag,
};

/// Constants that belong together: bits of a field, or its codes.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Constants {
    /// Their prefix, in capitals: `SAMPLE`, `ALARM`.
    pub of: &'static str,
    /// True if they are bits: each has a comment.
    pub bits: bool,
    /// Each of them.
    pub values: Vec<Constant>,
}

/// A bit of a field, or a code.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Constant {
    /// Its name, in capitals.
    pub name: String,
    /// Its value.
    pub value: u64,
    /// Its comment, as [`StructLayout::doc`], empty for codes.
    pub doc: &'static str,
}

/// Structs that controllers, planners and clients use, each before those that contain it: those of
/// the channels whose rows are of robots, and of questions.
#[must_use]
pub fn layouts() -> Vec<StructLayout> {
    struct OfRobots(Vec<StructLayout>);
    impl ForEachChannel for OfRobots {
        fn channel<C: Channel>(&mut self) {
            if C::ROWS == FrameRows::Robots {
                self.0.extend([C::Row::LAYOUT, C::Header::LAYOUT]);
            }
        }
    }
    let inner = [Refusal::LAYOUT, DropCounts::LAYOUT, PlatformMemory::LAYOUT];
    let mut all = OfRobots(inner.to_vec());
    each_channel(&mut all);
    all.0.extend([QueryHeader::LAYOUT, AnswerHeader::LAYOUT, AnswerRow::LAYOUT]);
    all.0
}

/// Bits and codes of the fields of [`layouts`].
#[must_use]
pub fn constants() -> Vec<Constants> {
    let bits = [
        ("SAMPLE", sample_flag::TABLE),
        ("FORECAST", forecast_flag::TABLE),
        ("DIAGNOSTIC", diagnostic_flag::TABLE),
        ("BUDGET", budget_flag::TABLE),
        ("OUTLOOK", outlook_flag::TABLE),
        ("PLAN_STATE", plan_state_flag::TABLE),
        ("PLATFORM", platform_flag::TABLE),
        ("QUERY", query_flag::TABLE),
        ("ANSWER", answer_flag::TABLE),
    ];
    let bits = bits.into_iter().map(|(of, table)| Constants {
        of,
        bits: true,
        values: table
            .iter()
            .map(|&(name, value, doc)| Constant { name: name.to_owned(), value, doc })
            .collect(),
    });
    bits.chain(codes()).collect()
}

fn codes() -> Vec<Constants> {
    let of = |of, values: Vec<(&str, u64)>| Constants {
        of,
        bits: false,
        values: values
            .into_iter()
            .map(|(name, value)| Constant { name: in_capitals(name), value, doc: "" })
            .collect(),
    };
    let quality = |quality: Quality| u64::from(quality.encode().0);
    let levels = [Level::Ok, Level::Warn, Level::Error, Level::Stale];
    let kinds =
        [("WhatIf", QueryKind::WhatIf), ("Idle", QueryKind::Idle), ("Follow", QueryKind::Follow)];
    let invalid = |reason: InvalidReason| (reason.name(), u64::from(reason.code()));
    let drop_reasons = DropReason::ALL.into_iter().enumerate();
    vec![
        of(
            "QUALITY",
            vec![
                ("Unknown", quality(Quality::Unknown)),
                ("Fresh", quality(Quality::Fresh)),
                ("Held", quality(Quality::Held)),
                ("Warmup", quality(Quality::Warmup { have: 0 })),
                ("OpenLoop", quality(Quality::OpenLoop { steps: 0 })),
                ("Invalid", quality(Quality::Invalid(InvalidReason::Stale))),
            ],
        ),
        of("INVALID", InvalidReason::ALL.map(invalid).to_vec()),
        of("LEVEL", levels.map(|level| (level.name(), u64::from(level.code()))).to_vec()),
        of("ALARM", Alarm::ALL.map(|alarm| (alarm.name(), u64::from(alarm.code()))).to_vec()),
        of(
            "CHARGE",
            vec![
                ("Unknown", ChargeState::Unknown.code().into()),
                ("Discharging", ChargeState::Discharging.code().into()),
                ("Charging", ChargeState::Charging.code().into()),
            ],
        ),
        of(
            "DROP",
            drop_reasons.map(|(position, reason)| (reason.name(), position as u64)).collect(),
        ),
        of("QUERY_KIND", kinds.map(|(name, kind)| (name, u64::from(kind.code()))).to_vec()),
        of(
            "REFUSAL",
            QueryRefusal::ALL.map(|reason| (reason.name(), u64::from(reason.code()))).to_vec(),
        ),
        of(
            "MAX_QUERY",
            vec![
                ("Values", MAX_QUERY_VALUES as u64),
                ("Robots", MAX_QUERY_ROBOTS as u64),
                ("Candidates", MAX_QUERY_CANDIDATES as u64),
                ("Steps", MAX_QUERY_STEPS as u64),
            ],
        ),
        of("SCHEMA", vec![("Version", SCHEMA_VERSION.into())]),
    ]
}

/// `NoData` as `NO_DATA`.
fn in_capitals(name: &str) -> String {
    let mut capitals = String::new();
    for (at, letter) in name.char_indices() {
        if at > 0 && letter.is_ascii_uppercase() {
            capitals.push('_');
        }
        capitals.push(letter.to_ascii_uppercase());
    }
    capitals
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn fields_follow_each_other_without_gaps() {
        for layout in layouts() {
            let mut end = 0;
            for field in layout.fields {
                assert_eq!(field.offset, end, "{} {}", layout.name, field.name);
                end += field.size;
            }
            assert_eq!(end, layout.size, "{}", layout.name);
        }
    }

    #[test]
    fn names_of_constants_are_unique() {
        let mut names: Vec<String> = constants()
            .iter()
            .flat_map(|of| of.values.iter().map(|constant| format!("{}_{}", of.of, constant.name)))
            .collect();
        let count = names.len();
        names.sort();
        names.dedup();
        assert_eq!(names.len(), count);
        assert_eq!(in_capitals("BatteryOutOfRange"), "BATTERY_OUT_OF_RANGE");
    }
}
