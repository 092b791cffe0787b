//! Every bit pattern that another process could write decodes, each code decodes to the value
//! it encodes, and each field is as named.

use joulebus_wire::{
    Alarm, AlarmSet, Channel, ChargeState, DiagnosticHeader, DropCounts, DropReason, FieldRole,
    ForEachChannel, Forecast, ForecastHeader, FrameHeader as _, FrameOrder, FrameRows,
    InvalidReason, Level, Quality, Row, TickHeader, each_channel,
};

#[test]
fn every_quality_survives_the_round_trip_and_every_pattern_decodes() {
    let reasons = (0..=u16::MAX).map(InvalidReason::decode);
    for quality in [
        Quality::Fresh,
        Quality::Held,
        Quality::Warmup { have: 3 },
        Quality::OpenLoop { steps: 900 },
        Quality::Unknown,
    ]
    .into_iter()
    .chain(reasons.map(Quality::Invalid))
    {
        let (code, detail) = quality.encode();
        assert_eq!(Quality::decode(code, detail), quality);
    }
    for code in 6..=u16::MAX {
        assert_eq!(Quality::decode(code, 1), Quality::Unknown);
    }
}

#[test]
fn an_unknown_code_never_decodes_to_ok() {
    for code in 0..=u16::MAX {
        assert_eq!(Level::decode(code) == Level::Ok, code == 0);
        assert_eq!(Alarm::decode(code) == Alarm::None, code == 0);
        assert_ne!(ChargeState::decode(u32::from(code) + 3), ChargeState::Discharging);
    }
    for alarm in Alarm::ALL {
        assert_eq!(Alarm::decode(alarm.code()), alarm);
    }
}

#[test]
fn the_first_alarm_is_the_most_important_and_the_level_the_worst() {
    let set = AlarmSet::default().with(Alarm::BiasHigh).with(Alarm::StuckSensor);
    assert_eq!(set.first(), Alarm::StuckSensor);
    assert_eq!(set.level(), Level::Error);
    // An alarm of a worse level comes first, whatever its code.
    let set = set.without(Alarm::StuckSensor).with(Alarm::CannotReturn);
    assert_eq!(set.first(), Alarm::CannotReturn);
    assert_eq!(AlarmSet::default().first(), Alarm::None);
    assert_eq!(AlarmSet::default().with(Alarm::None), AlarmSet::default());
    assert_eq!(set.iter().count(), 2);
}

#[test]
fn drops_are_counted_by_reason_and_in_total_without_wrapping() {
    let mut counts = DropCounts::default();
    for (index, reason) in DropReason::ALL.into_iter().enumerate() {
        counts.add(reason, index as u64);
        assert_eq!(counts.get(reason), index as u64);
    }
    assert_eq!(counts.total(), (0..17).sum());
    counts.add(DropReason::Overflow, u64::MAX);
    assert_eq!(counts.total(), u64::MAX);
}

/// Checks the fields of each channel's header and rows.
struct Fields;

impl ForEachChannel for Fields {
    fn channel<C: Channel>(&mut self) {
        let durations = ["period_ns", "reading_age_ns", "metered_ns", "unmetered_ns"];
        let layouts = [<C::Header as Row>::LAYOUT, <C::Row as Row>::LAYOUT];
        for (of, field) in
            layouts.iter().flat_map(|of| of.fields.iter().map(move |field| (of, field)))
        {
            let role = match field.name {
                name if durations.contains(&name) || name.ends_with("_unix_ns") => FieldRole::Value,
                name if name.ends_with("_ns") => FieldRole::Instant,
                name if name.ends_with("_epoch") => FieldRole::Run,
                _ => FieldRole::Value,
            };
            assert_eq!(field.role, role, "{}.{}", of.name, field.name);
        }
        if C::ROWS == FrameRows::Robots {
            assert_eq!(layouts[1].fields[0].name, "robot", "{}", layouts[1].name);
        }
    }
}

#[test]
fn times_are_instants_runs_or_mean_the_same_everywhere_and_rows_begin_with_their_robot() {
    each_channel(&mut Fields);
}

#[test]
fn instants_and_runs_of_a_row_are_those_that_are_marked() {
    let mut row = Forecast {
        stamp_ns: 1,
        target_ns: 2,
        reading_age_ns: 3,
        source_epoch: 4,
        ..Forecast::default()
    };
    let mut seen = Vec::new();
    row.instants(|stamp_ns| {
        seen.push(*stamp_ns);
        *stamp_ns += 10;
    });
    row.runs(|run| *run += 100);
    assert_eq!(seen, [1, 2]);
    let moved = (row.stamp_ns, row.target_ns, row.reading_age_ns, row.source_epoch);
    assert_eq!(moved, (11, 12, 3, 104));
}

#[test]
fn a_header_states_its_place_and_when_it_was_sent_where_it_has_fields_for_that() {
    let (order, mut seen) = (FrameOrder { run: 7, number: 9 }, Vec::new());
    let mut forecasts = ForecastHeader::default();
    forecasts.set_order(3, order);
    forecasts.set_sent(5, 6);
    seen.push((forecasts.order(), forecasts.sent_ns(), forecasts.sent_unix_ns()));
    let mut ticks = TickHeader::default();
    ticks.set_order(3, order);
    ticks.set_sent(5, 6);
    seen.push((ticks.order(), ticks.sent_ns(), ticks.sent_unix_ns()));
    let mut diagnostics = DiagnosticHeader::default();
    diagnostics.set_order(3, order);
    diagnostics.set_sent(5, 6);
    seen.push((diagnostics.order(), diagnostics.sent_ns(), diagnostics.sent_unix_ns()));
    assert_eq!(seen, [(order, Some(5), Some(6)), (order, Some(5), None), (order, None, None)]);
    assert_eq!((forecasts.pid, ticks.pid, diagnostics.pid), (3, 3, 3));
}
