//! After warm-up the tick allocates nothing, and the allocation at start is bounded.

use joulebus_fleet::Fleet;
use joulebus_testkit::counting;
use joulebus_testkit_fleets::{
    self as world, MS, PERIOD_NS, SLOW_NS, Source, healthy, models, settings,
};
use joulebus_wire::{Budget, Diagnostic, Forecast, Outlook, PlanState, Sample, sample_flag};

const START_NS: u64 = 60_000 * MS;
const ROBOTS: u32 = 100;

/// A frame with faults of most robots at some time: gaps, refused values, missing readings, bursts,
/// more robots than the capacity, and robots that join and leave.
fn fill(frame: &mut Vec<Sample>, step: u64, now_ns: u64) {
    frame.clear();
    for place in 0..u64::from(ROBOTS) + 5 {
        let id = ((place + step / 200 * 9) % 300) as u32;
        let period_ns = if id / 100 == 1 { SLOW_NS } else { PERIOD_NS };
        let mut sample = healthy(id, 2 * step, now_ns, period_ns);
        match (step * 31 + place * 17) % 23 {
            0 => continue,
            1 => sample.power_w = f32::NAN,
            2 => sample.flags &= !sample_flag::POWER,
            3 => sample.v_mps = 9.0,
            4 => sample.robot += 1_000,
            5 => {
                let mut earlier = sample;
                earlier.seq -= 1;
                earlier.stamp_ns -= period_ns / 3;
                earlier.measured_ns = earlier.measured_ns.min(earlier.stamp_ns);
                frame.push(earlier);
            }
            6 => sample = sample.state_of_charge(0.5).return_energy(100.0),
            7 => sample = sample.with(sample_flag::CHARGING),
            _ => {}
        }
        frame.push(sample);
    }
}

#[test]
fn taking_ticking_and_writing_out_allocate_nothing() {
    let mut fleet = Fleet::new(world::learning(ROBOTS), models()).expect("the settings are valid");
    let mut source = Source::new(1, 1);
    let mut frame = Vec::with_capacity(4 * ROBOTS as usize);
    let mut forecasts = vec![Forecast::default(); ROBOTS as usize];
    let mut diagnostics = vec![Diagnostic::default(); ROBOTS as usize];
    let mut budgets = vec![Budget::default(); ROBOTS as usize];
    let mut plan_states = vec![PlanState::default(); ROBOTS as usize];
    let mut outlooks = vec![Outlook::default(); ROBOTS as usize];
    let mut least_and_most = (usize::MAX, 0);
    for step in 1..4_000u64 {
        let now_ns = START_NS + step * PERIOD_NS;
        // Periodically all are silent for so long that they leave.
        let silent = step % 1_000 > 900;
        fill(&mut frame, step, now_ns);
        let before = counting::calls();
        if !silent {
            source.send(&mut fleet, &frame, now_ns);
        }
        fleet.tick(now_ns, step % 50 == 0);
        for place in 0..fleet.len() {
            forecasts[place] = fleet.forecast(place);
            diagnostics[place] = fleet.diagnostic(place);
            budgets[place] = fleet.budget(place);
            plan_states[place] = fleet.plan_state(place);
            outlooks[place] = fleet.outlook(place);
        }
        assert_eq!(counting::calls() - before, 0, "allocations in tick {step}");
        if step > 1_000 {
            let (least, most) = least_and_most;
            least_and_most = (fleet.len().min(least), fleet.len().max(most));
        }
    }
    assert_eq!(least_and_most, (0, ROBOTS as usize), "robots joined and left");
    assert!(fleet.drops().iter().count() >= 4, "{:?}", fleet.drops());
}

fn without_batteries(capacity: u32) -> joulebus_settings::FleetSettings {
    let mut settings = settings(capacity);
    for platform in &mut settings.platforms {
        platform.battery = None;
    }
    settings
}

/// Bytes that an empty fleet takes.
fn taken(settings: joulebus_settings::FleetSettings) -> u64 {
    let (models, capacity) = (models(), settings.capacity);
    let before = counting::bytes();
    let fleet = Fleet::new(settings, models).expect("the settings are valid");
    let taken = counting::bytes() - before;
    assert!(fleet.is_empty());
    assert_eq!(fleet.capacity(), capacity);
    taken
}

/// Additional memory if a platform has a battery, including a departed robot's account, per robot
/// of the capacity.
#[test]
fn batteries_take_at_most_500_bytes_a_robot_more() {
    let more = taken(settings(10_000)) - taken(without_batteries(10_000));
    let each = more as f64 / 10_000.0;
    println!("{each:.1} bytes a robot more");
    assert!(each > 0.0 && each <= 500.0, "{each:.1} bytes a robot more");
}

/// Memory of a robot in the fleet and of a departed one's account, of which there may be as many.
#[test]
fn a_robot_takes_at_most_710_bytes_with_the_account_of_a_departed_one() {
    let bytes = |capacity: u32| taken(without_batteries(capacity));
    // Memory independent of the fleet's size: the batch of one tile, the platforms.
    let fixed = 2 * bytes(16_384) - bytes(32_768);
    for capacity in [5_000u32, 10_000, 14_337, 16_384, 57_345, 100_000] {
        let each = (bytes(capacity) - fixed) as f64 / f64::from(capacity);
        println!("{each:.1} bytes per robot at a capacity of {capacity}");
        assert!(each <= 710.0, "{each:.1} bytes per robot at a capacity of {capacity}");
    }
    println!("{fixed} bytes for the fleet");
    assert!(fixed < 200_000, "{fixed} bytes for the fleet");
}

/// Additional memory of a platform that learns online, per robot of the capacity.
#[test]
fn learning_online_takes_at_most_156_bytes_a_robot_more() {
    let more = taken(world::learning(10_000)) - taken(settings(10_000));
    let each = more as f64 / 10_000.0;
    println!("{each:.1} bytes a robot more");
    assert!(each > 0.0 && each <= 156.0, "{each:.1} bytes a robot more");
}
