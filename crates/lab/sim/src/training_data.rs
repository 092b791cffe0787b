//! Training data from the simulated robots.

use joulebus_dataset::rows::{Dataset, Row, RowOrigin};
use joulebus_plant::protocol::{Protocol, SAMPLES};
use joulebus_plant::{Plant, SimReading};
use joulebus_predictor::{LAGS, ReadingAge, features};
use std::collections::VecDeque;

const TICK_S: f64 = 1.0 / 30.0;
/// Number of trials that train. The fifth validates and the sixth is held out, as in the paper.
const TRAINING_TRIALS: usize = 4;

/// Amount of simulated data to record, at 30 Hz.
///
/// Every robot is different and drives one trial: the training robots trials 1 to 4 in turn, the
/// validation robots trial 5, the held-out robots trial 6. Robots at full speed train, too: the
/// paper's trials end at 0.16 m/s, the Robotarium at 0.2.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct SimulatedData {
    /// Seed of the plant.
    pub seed: u64,
    /// Robots for training.
    pub training_robots: usize,
    /// Robots for validation.
    pub validation_robots: usize,
    /// Held-out robots.
    pub held_out_robots: usize,
    /// Robots for training that drive trials 1 to 4 in turn as fast as the Robotarium allows.
    pub full_speed_robots: usize,
    /// Control ticks recorded per robot. The first five give no rows.
    pub ticks: usize,
}

impl SimulatedData {
    /// The data of the shipped models: 12 robots for training and 8 at full speed, 4 for
    /// validation, 8 held out, one whole trial each.
    pub fn shipped(seed: u64) -> SimulatedData {
        SimulatedData {
            seed,
            training_robots: 12,
            validation_robots: 4,
            held_out_robots: 8,
            full_speed_robots: 8,
            ticks: SAMPLES,
        }
    }

    /// The protocol of each robot, in the order of the parts. Robots at full speed are the last, so
    /// that the others are the same with and without them.
    fn protocols(self) -> impl Iterator<Item = Protocol> {
        let training = Protocol::ALL[..TRAINING_TRIALS].iter().copied().cycle();
        let full_speed = training.clone().take(self.full_speed_robots);
        training
            .take(self.training_robots)
            .chain(std::iter::repeat_n(Protocol::RandomWalk, self.validation_robots))
            .chain(std::iter::repeat_n(Protocol::SteadyState, self.held_out_robots))
            .chain(full_speed)
    }
}

/// Records simulated robots. A row pairs the command just issued and the readings so far with the
/// reading of the next tick, as the live path does.
pub fn dataset_from_plant(data: SimulatedData) -> Dataset {
    let SimulatedData {
        seed,
        training_robots,
        validation_robots,
        held_out_robots,
        full_speed_robots,
        ticks,
    } = data;
    let published = training_robots + validation_robots + held_out_robots;
    let mut plant = Plant::driving(seed, data.protocols()).at_full_speed_from(published);
    let mut recorders = vec![Recorder::EMPTY; published + full_speed_robots];
    for _ in 0..ticks {
        for (recorder, reading) in recorders.iter_mut().zip(plant.step(TICK_S)) {
            recorder.add(*reading);
        }
    }
    let mut rows = recorders.into_iter().enumerate().map(|(robot, recorder)| {
        let origin = RowOrigin::recording(robot);
        recorder.rows.into_iter().map(move |row| row.of(origin)).collect::<Vec<Row>>()
    });
    let mut part = |robots: usize| rows.by_ref().take(robots).flatten().collect::<Vec<Row>>();
    let parts = [training_robots, validation_robots, held_out_robots].map(&mut part);
    let [mut training, validation, held_out] = parts;
    training.extend(part(full_speed_robots));
    Dataset {
        training,
        validation,
        held_out,
        period_s: TICK_S as f32,
        description: format!(
            "simulated GTernal robots, seed {seed}, 30 Hz, {ticks} ticks each; trials 1 to 4 of \
             {training_robots}, and of {full_speed_robots} at full speed, for training, trial 5 of {validation_robots} others for validation, \
             trial 6 of {held_out_robots} others held out"
        ),
    }
}

#[derive(Clone)]
struct Recorder {
    readings: VecDeque<SimReading>,
    reading_age: ReadingAge,
    rows: Vec<Row>,
}

impl Recorder {
    const EMPTY: Self =
        Self { readings: VecDeque::new(), reading_age: ReadingAge::UNKNOWN, rows: Vec::new() };
}

impl Recorder {
    fn add(&mut self, reading: SimReading) {
        if self.readings.len() == LAGS {
            let lag_w: [f32; LAGS] = std::array::from_fn(|lag| self.readings[lag].power_w);
            let (now, before) = (self.readings[0], self.readings[1]);
            let previous = Some((before.v_mps, before.omega_radps, TICK_S as f32));
            let mut features = features(now.v_mps, now.omega_radps, previous, &lag_w);
            self.reading_age.fill(&mut features);
            self.rows.push(Row::new(features, reading.power_w));
        }
        self.reading_age.read(!reading.held);
        self.readings.push_front(reading);
        self.readings.truncate(LAGS);
    }
}
