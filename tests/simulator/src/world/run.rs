//! Runs a scenario.

use std::path::Path;
use std::sync::atomic::AtomicBool;

use joulebus_capture_format::{Message, MessageKind};
use joulebus_config::Config;
use simulated_bus as bus;
use simulated_host::{self as host, disk, time};

use super::outcome::Outcome;
use super::state::{FOREIGN, World};
use crate::check::{Answers, Checked, Failure, failure};
use crate::ledger::LEDGER;
use crate::scenario::Scenario;

/// Runs a scenario, and the one without faults if answers must be equal. Setting `stop` ends it.
pub fn run(scenario: &Scenario, stop: &AtomicBool) -> Outcome {
    let (mut outcome, answers) = run_once(scenario, stop);
    if outcome.failure.is_some() || outcome.is_stopped || scenario.setup.everything {
        return outcome;
    }
    let (undisturbed, expected) = run_once(&scenario.undisturbed(), stop);
    outcome.simulated_ns += undisturbed.simulated_ns;
    if undisturbed.is_stopped {
        outcome.is_stopped = true;
        return outcome;
    }
    outcome.answers = (answers.forecasts.len() + answers.ledgers.len()) as u64;
    outcome.failure = undisturbed.failure.or_else(|| compare(&answers, &expected));
    outcome
}

/// Each sample of an undisturbed source is answered as in a run without faults.
fn compare(answers: &Answers, expected: &Answers) -> Option<Failure> {
    const NAME: &str = "robots that are not touched are answered as ever";
    for (key, answer) in &answers.forecasts {
        if let Some(expected) = expected.forecasts.get(key)
            && answer != expected
        {
            return Some(failure(NAME, format!("{key:?}: {answer:?}, expected {expected:?}")));
        }
    }
    for (key, entry) in &answers.ledgers {
        if let Some(expected) = expected.ledgers.get(key)
            && entry != expected
        {
            return Some(failure(NAME, format!("{key:?}: {entry:?}, expected {expected:?}")));
        }
    }
    let (found, wanted) = (answers.forecasts.len(), expected.forecasts.len());
    // The runs end at different samples.
    (found + 20 + found / 50 < wanted)
        .then(|| failure(NAME, format!("{found} samples answered, expected {wanted}")))
}

fn run_once(scenario: &Scenario, stop: &AtomicBool) -> (Outcome, Answers) {
    // Their tables are made once in a process, and would count as grown in the first run.
    for kind in MessageKind::all() {
        let _ = Message::decode(kind, &[]);
    }
    host::begin(scenario.seed, scenario.setup.uptime_ns);
    bus::begin();
    let text = scenario.setup.toml(LEDGER);
    let parsed = Config::parse(&text, Path::new("/"));
    let loaded = parsed.map_err(|error| error.to_string()).and_then(|config| {
        let models = joulebus_models::load_models(&config).map_err(|error| error.to_string())?;
        Ok((config, models))
    });
    let (config, models) = match loaded {
        Ok(loaded) => loaded,
        Err(error) => {
            let failure = Some(failure("the config is accepted", error));
            return (Outcome { failure, ..Outcome::default() }, Answers::default());
        }
    };
    for path in FOREIGN {
        disk::put(Path::new(path), path.as_bytes().to_vec());
    }
    let mut world = World::new(scenario, stop, config, models);
    if let Err(failure) = world.play()
        && !world.outcome.is_stopped
    {
        world.outcome.failure = Some(failure);
    }
    world.outcome.simulated_ns = time::now_ns();
    world.outcome.ticks = world.checker.ticks;
    world.outcome.captures = world.checker.captures;
    world.outcome.verified_ticks = world.checker.verified_ticks;
    let answers = world.checker.answers.take().unwrap_or_default();
    let outcome = world.outcome.clone();
    world.bury_all();
    (outcome, answers)
}

impl World<'_> {
    fn play(&mut self) -> Checked {
        let scenario = self.scenario;
        for (_, (at_ns, fault)) in &scenario.faults {
            self.run_until(*at_ns)?;
            self.happens(*fault)?;
            self.outcome.faults += 1;
        }
        self.run_until(scenario.duration_ns)?;
        self.everything_works_again()
    }
}
