//! Every bit pattern that another process could write decodes, and each code decodes to the value
//! it encodes.

use joulebus_wire::{
    Alarm, AlarmSet, ChargeState, DropCounts, DropReason, InvalidReason, Level, Quality,
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
        assert_ne!(
            ChargeState::decode(u32::from(code) + 3),
            ChargeState::Discharging
        );
    }
    for alarm in Alarm::ALL {
        assert_eq!(Alarm::decode(alarm.code()), alarm);
    }
}

#[test]
fn the_first_alarm_is_the_most_important_and_the_level_the_worst() {
    let set = AlarmSet::default()
        .with(Alarm::BiasHigh)
        .with(Alarm::StuckSensor);
    assert_eq!(set.first(), Alarm::StuckSensor);
    assert_eq!(set.level(), Level::Error);
    // Of a worse level, whatever its code.
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
