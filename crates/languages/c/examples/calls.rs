//! Times the calls of Rust that `crates/languages/c/tests/speed/calls.cpp` makes through the C++
//! layer, by the same protocol: each line on stdin is a call and its number, each line on stdout
//! the time of all of them, ns. For `tools/c_speed.py`.

use std::error::Error;
use std::hint::black_box;
use std::io::{self, Write as _};
use std::time::{Duration, Instant};

use joulebus_config::{Config, builtin_model};
use joulebus_plan::{Answer, Candidates};
use joulebus_planner::Planner as Questions;
use joulebus_predictor::{FEATURES, Features, INPUTS, Model, Network};
use joulebus_publisher::{Publisher, RobotState};

const CANDIDATES: usize = 16;
const STEPS: usize = 50;
const ROBOTS: u32 = 100;
const FIRST_ROBOT: u32 = 200;

fn waves(count: usize, scale: f32, from: usize) -> Vec<f32> {
    let wave = |at: usize| ((at * 7) % 19) as f32 * 0.01;
    (0..count).map(|at| scale * wave(at + from)).collect()
}

/// The objects of the calls.
struct Calls {
    model: Model,
    planner: joulebus_consumer::Subscriber,
    questions: Questions,
    publisher: Publisher,
    features: Vec<f32>,
    power_w: Vec<f32>,
    v_mps: Vec<f32>,
    omega_radps: Vec<f32>,
    answers: Vec<Answer>,
    states: Vec<RobotState>,
}

impl Calls {
    fn new(config: &Config) -> Result<Self, Box<dyn Error>> {
        let (_, builtin) = builtin_model("gternal-sim").ok_or("no such built-in model")?;
        let mut questions = Questions::with_config(config, "speed-rust")?;
        questions.wait(Duration::from_secs(60))?;
        Ok(Self {
            model: Model::Network(Network::from_safetensors(builtin)?),
            planner: joulebus_consumer::Subscriber::with_config(config, "speed-rust")?,
            questions,
            publisher: Publisher::with_config(config, "speed-rust")?,
            features: waves(1000 * FEATURES, 10.0, 0),
            power_w: vec![0.0; 1000],
            v_mps: waves(CANDIDATES * STEPS, 1.0, 0),
            omega_radps: waves(CANDIDATES * STEPS, 5.0, 3),
            answers: Vec::new(),
            states: (FIRST_ROBOT..FIRST_ROBOT + ROBOTS)
                .map(|robot| RobotState::new(robot).command(0.1, 0.0).reading(4.0))
                .collect(),
        })
    }

    /// As a program in Rust would, that has its features in rows of eleven.
    fn predict(&mut self, rows: usize) {
        let mut widened = [[f32::NAN; INPUTS]; 64];
        let parts = self.features[..rows * FEATURES].chunks(64 * FEATURES);
        for (part, power_w) in parts.zip(self.power_w[..rows].chunks_mut(64)) {
            for (to, row) in widened.iter_mut().zip(part.chunks_exact(FEATURES)) {
                to[..FEATURES].copy_from_slice(row);
            }
            let widened: &[Features] = &widened[..power_w.len()];
            self.model.predict(widened, power_w);
        }
        black_box(self.power_w[0]);
    }

    fn call(&mut self, name: &str) -> Result<(), Box<dyn Error>> {
        match name {
            "predict_1" => self.predict(1),
            "predict_100" => self.predict(100),
            "predict_1000" => self.predict(1000),
            "what_if" => {
                let plans =
                    Candidates::new(CANDIDATES, 1.0 / 30.0, &self.v_mps, &self.omega_radps)?;
                let view = self.questions.view()?.ok_or("no frame")?;
                let robot = view.robot(0).ok_or("no robot 0")?;
                self.answers = robot.what_if(&plans, 0.9)?;
                black_box(&self.answers);
            }
            "latest" => {
                let Some(frame) = self.planner.latest()? else {
                    return Ok(());
                };
                let powers_w = frame.iter().filter_map(|row| row.expected_w());
                black_box(powers_w.sum::<f32>());
            }
            "publish" => {
                self.publisher.publish(self.states.iter().copied())?;
            }
            other => return Err(format!("no call {other}").into()),
        }
        Ok(())
    }
}

fn main() -> Result<(), Box<dyn Error>> {
    let path = std::env::args().nth(1).ok_or("usage: calls CONFIG")?;
    let mut calls = Calls::new(&Config::load(path)?)?;
    for line in io::stdin().lines() {
        let line = line?;
        let (name, times) = line.split_once(' ').ok_or("a call and a count")?;
        let times: usize = times.parse()?;
        let begun = Instant::now();
        for _ in 0..times {
            calls.call(name)?;
        }
        println!("{}", begun.elapsed().as_nanos());
        io::stdout().flush()?;
    }
    Ok(())
}
