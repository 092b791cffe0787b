//! Clocks, rates and numbers near their limits: after ten years, after a jump to the end of the
//! clock, at a thousand samples a second and at one in ten seconds.

use joulebus_fleet::Fleet;
use joulebus_settings::FleetSettings;
use joulebus_testkit_fleets::{self as world, MS, PERIOD_NS, Source, healthy};
use joulebus_wire::{Quality, SampleHeader};

/// With a network and a battery.
const ROBOT: u32 = 7;
/// A sample period of a thousand a second, and of one in ten seconds.
const FASTEST_NS: u64 = MS;
const SLOWEST_NS: u64 = 10_000 * MS;
/// Steps with samples: between them it is silent for a few periods, until it is stale, and until it
/// has left.
const STEPS: [(u64, u64); 4] = [(0, 40), (45, 80), (130, 160), (400, 440)];
const END: u64 = 520;

fn settings(period_ns: u64) -> FleetSettings {
    let mut settings = world::learning(4);
    settings.intake.leave_after_ns = 80 * period_ns;
    settings.intake.max_jump_ns = u64::MAX;
    let platform = &mut settings.platforms[0];
    (platform.period_ns, platform.stale_after_ns) = (period_ns, 30 * period_ns);
    (platform.hold_max_ns, platform.stuck_after_ns) = (12 * period_ns, 60 * period_ns);
    settings.platforms.truncate(1);
    settings
}

/// The robot's published values of each tick, without instants.
type Shown = Option<(Quality, [u32; 6], [u64; 3])>;

fn shown(fleet: &Fleet) -> Shown {
    world::place(fleet, ROBOT)?;
    let (forecast, budget) = (world::forecast(fleet, ROBOT), world::budget(fleet, ROBOT));
    let floats = [
        forecast.power_w,
        forecast.lo_w,
        forecast.hi_w,
        budget.soc,
        budget.soc_lo,
        budget.time_to_empty_s,
    ];
    let account = [budget.drawn_uj.cast_unsigned(), budget.metered_ns, budget.unmetered_ns];
    Some((forecast.quality(), floats.map(f32::to_bits), account))
}

/// Runs a robot whose clock and the worker's begin at `begin_ns`.
fn run(begin_ns: u64, period_ns: u64) -> Vec<Shown> {
    let models = world::models().into_iter().take(1).collect();
    let mut fleet = Fleet::new(settings(period_ns), models).expect("they agree");
    let mut source = Source::new(1, begin_ns);
    let tick = |step| {
        let now_ns = begin_ns + step * period_ns;
        let sends = STEPS.iter().any(|(from, to)| (*from..*to).contains(&step));
        let sample = sends.then(|| healthy(ROBOT, step, now_ns, period_ns));
        source.tick(&mut fleet, sample.as_slice(), now_ns);
        shown(&fleet)
    };
    (0..END).map(tick).collect()
}

#[test]
fn the_same_is_published_whenever_the_clock_began_and_at_any_rate() {
    for period_ns in [FASTEST_NS, PERIOD_NS, SLOWEST_NS] {
        let usual = run(60_000_000 * MS, period_ns);
        let at = |step: usize| usual[step].expect("it is there").0;
        assert!(matches!(at(39), Quality::Fresh | Quality::Held), "{period_ns}: {:?}", at(39));
        assert!(matches!(at(43), Quality::OpenLoop { .. }), "{period_ns}: {:?}", at(43));
        assert!(matches!(at(120), Quality::Invalid(_)), "{period_ns}: {:?}", at(120));
        assert!(usual[300].is_none(), "{period_ns}: it has left");
        assert!(matches!(at(439), Quality::Fresh | Quality::Held), "{period_ns}: {:?}", at(439));
        let whole_ns = (END - 1) * period_ns;
        let ten_years_ns = 10 * 366 * 86_400_000 * MS;
        let begins_ns = [
            3 * period_ns,
            ten_years_ns,
            // The sign of a 64-bit number changes on the way.
            (1 << 63) - whole_ns / 2,
            u64::MAX - whole_ns,
        ];
        for begin_ns in begins_ns {
            for (step, (found, expected)) in run(begin_ns, period_ns).iter().zip(&usual).enumerate()
            {
                assert_eq!(found, expected, "from {begin_ns}, period {period_ns}, step {step}");
            }
        }
    }
}

#[test]
fn numbers_at_their_end_are_counted_and_stop_nobody() {
    let mut fleet = world::fleet(4);
    let (mut calm, mut ending) = (Source::new(1, 1), Source::new(2, u64::MAX).header);
    (ending.frame_seq, ending.samples_before) = (u64::MAX - 3, u64::MAX - 3);
    let mut sent = 0;
    for step in 0..40 {
        let now_ns = 60_000 * MS + step * PERIOD_NS;
        calm.send(&mut fleet, &[healthy(ROBOT, step, now_ns, PERIOD_NS)], now_ns);
        let number = (u64::MAX - 5).wrapping_add(step);
        let sample = healthy(ROBOT + 1, step, now_ns, PERIOD_NS);
        fleet.take(&ending, &[joulebus_wire::Sample { seq: number, ..sample }], now_ns);
        ending = SampleHeader {
            frame_seq: ending.frame_seq.wrapping_add(1),
            samples_before: ending.samples_before.wrapping_add(1),
            ..ending
        };
        sent += 2;
        fleet.tick(now_ns, false);
        if step > 5 {
            let found = world::quality(&fleet, ROBOT);
            assert!(matches!(found, Quality::Fresh | Quality::Held), "{found:?} in step {step}");
        }
    }
    // What the header claims was sent before counts as well.
    assert!(fleet.accepted() >= sent / 2, "{:?}", fleet.drops());
    assert!(fleet.accepted().saturating_add(fleet.drops().total()) >= sent, "{:?}", fleet.drops());
    assert_eq!(world::budget(&fleet, ROBOT).metered_ns, 39 * PERIOD_NS);
}
