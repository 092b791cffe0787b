//! The paper's numbers beside the same numbers of simulated robots, over several draws.

use joulebus_eval::score::{Cell as Scores, ForecasterScore, Scored};
use joulebus_statistics::metrics::{quantile, sorted};
use joulebus_train::linear::Terms;

use super::document::{Cell, Column, Part, Section, Table};
use super::draw::{Draw, Plain};
use super::unit::Unit;
use super::{paper, power};

const MW: Unit = Unit::Milliwatt;

/// One number of a draw, and the paper's.
#[derive(Debug, Clone)]
pub(super) struct Number {
    quantity: String,
    paper: Cell,
    value: f64,
    decimals: usize,
}

/// Everything that is compared of one draw. All draws have the same numbers in the same order.
#[derive(Debug, Clone)]
pub(super) struct Numbers {
    pub(super) seed: u64,
    paper: Vec<Number>,
    product: Vec<Line>,
}

/// A forecast on one set of recordings.
#[derive(Debug, Clone)]
struct Line {
    set: &'static str,
    forecast: String,
    r2: f64,
    mae_w: f64,
    /// Recordings on which it has a smaller squared error than persistence, of all.
    better: Option<[u64; 2]>,
}

impl Numbers {
    pub(super) fn new(draw: &Draw) -> Self {
        let mut paper = Vec::new();
        power_numbers(&mut paper, draw);
        network_numbers(&mut paper, draw);
        robot_numbers(&mut paper, draw);
        let mut product = lines("trial 6", &draw.alone, &draw.plain_alone, 5);
        product.extend(lines("seven robots", &draw.together, &draw.plain_together, 0));
        Self { seed: draw.recordings.seed, paper, product }
    }
}

/// Position of the draw whose numbers are nearest to their means, in deviations.
pub(super) fn most_typical(draws: &[Numbers]) -> usize {
    let count = draws.first().map_or(0, |draw| draw.paper.len());
    let spreads: Vec<[f64; 2]> =
        (0..count).map(|at| spread(draws.iter().map(|draw| draw.paper[at].value))).collect();
    let distance = |draw: &Numbers| -> f64 {
        let numbers = draw.paper.iter().zip(&spreads);
        let off = numbers.map(|(number, [mean, std])| (number.value - mean) / std);
        off.filter(|off| off.is_finite()).map(|off| off * off).sum()
    };
    let places = (0..draws.len()).map(|at| (at, distance(&draws[at])));
    let nearest = places.min_by(|a, b| a.1.total_cmp(&b.1));
    nearest.map_or(0, |(at, _)| at)
}

/// Mean and standard deviation (divided by the number less one) of the known values.
fn spread(values: impl Iterator<Item = f64>) -> [f64; 2] {
    let values: Vec<f64> = values.filter(|value| value.is_finite()).collect();
    let count = values.len() as f64;
    let mean = values.iter().sum::<f64>() / count;
    let squares: f64 = values.iter().map(|value| (value - mean).powi(2)).sum();
    [mean, (squares / (count - 1.0)).sqrt()]
}

/// The first sentences of the report: the product's forecast, then the plain network.
pub(super) fn summary(draws: &[Numbers]) -> Vec<String> {
    let of = |forecast: &str, value: fn(&Line) -> f64| {
        let lines = draws.iter().flat_map(|draw| &draw.product);
        let lines = lines.filter(|line| line.set == "seven robots" && line.forecast == forecast);
        spread(lines.map(value))
    };
    let r2 = |forecast| Cell::Spread(of(forecast, |line| line.r2), 3).shown();
    let mae = |forecast| {
        let [mean, std] = of(forecast, |line| MW.scaled_w(line.mae_w));
        Cell::Spread([mean, std], 1).shown()
    };
    let better = |forecast: &str| {
        let lines = draws.iter().flat_map(|draw| &draw.product);
        let lines = lines.filter(|line| line.forecast == forecast && line.set == "seven robots");
        let counts = lines.filter_map(|line| line.better);
        counts.fold([0, 0], |[a, b], [better, all]| [a + better, b + all])
    };
    let [ours, all] = better(PUBLISHED);
    let [plain, _] = better(NETWORK);
    let seeds = draws.len();
    let [papers_mean, papers_std] = paper::R2_ROBOTS;
    vec![
        format!(
            "The forecast that the worker publishes reaches R² {} and a mean absolute error of {} \
             mW on seven simulated robots that are in no training data (mean ± deviation of \
             {seeds} draws). Persistence, the last reading again, reaches {} and {} mW. Its \
             squared error is smaller than persistence's on {ours} of {all} robots.",
            r2(PUBLISHED),
            mae(PUBLISHED),
            r2(PERSISTENCE),
            mae(PERSISTENCE)
        ),
        format!(
            "The plain network, trained by the paper's recipe and without learning online, reaches \
             R² {} and {} mW there, and beats persistence on {plain} of {all} robots. The paper's \
             network reached {papers_mean:.2} ± {papers_std:.3} on its seven real robots.",
            r2(NETWORK),
            mae(NETWORK)
        ),
    ]
}

const PUBLISHED: &str = "published";
const NETWORK: &str = "plain network";
const PERSISTENCE: &str = "persistence";

/// The forecasts on the trials from a position on. Scores are means over them, as the paper's.
fn lines(set: &'static str, scored: &Scored, plain: &[Plain], from: usize) -> Vec<Line> {
    let sets: Vec<&Scores> = scored.report.trials.iter().skip(from).collect();
    let count = sets.len() as f64;
    let at = |name: &str| -> Vec<&ForecasterScore> {
        let scores = sets.iter().flat_map(|cell| &cell.forecasters);
        scores.filter(|score| score.name == name).collect()
    };
    let first: Vec<&ForecasterScore> =
        sets.iter().filter_map(|cell| cell.forecasters.first()).collect();
    let last = at(PERSISTENCE);
    let rmse = |scores: &[&ForecasterScore]| -> Vec<f64> {
        scores.iter().map(|score| score.rmse_w.value).collect()
    };
    let persistence_w = rmse(&last);
    let better = |rmse_w: &[f64]| {
        let pairs = rmse_w.iter().zip(&persistence_w);
        let better = pairs.filter(|(ours, last)| ours < last).count();
        Some([better as u64, rmse_w.len() as u64])
    };
    let line = |forecast: &str, scores: &[&ForecasterScore]| Line {
        set,
        forecast: forecast.to_owned(),
        r2: scores.iter().map(|score| score.r2.value).sum::<f64>() / count,
        mae_w: scores.iter().map(|score| score.mae_w.value).sum::<f64>() / count,
        better: better(&rmse(scores)),
    };
    let plain: Vec<&Plain> = plain.iter().skip(from).collect();
    let plain_rmse: Vec<f64> = plain.iter().map(|one| one.tally.rmse_w()).collect();
    let linear = Terms::AR5_AND_VELOCITIES.to_string();
    vec![
        line(PUBLISHED, &first),
        Line {
            set,
            forecast: NETWORK.to_owned(),
            r2: plain.iter().map(|one| one.tally.r2()).sum::<f64>() / count,
            mae_w: plain.iter().map(|one| one.tally.mae_w()).sum::<f64>() / count,
            better: better(&plain_rmse),
        },
        Line { better: None, ..line(PERSISTENCE, &last) },
        line(&linear, &at(&linear)),
    ]
}

/// The product's forecast, and those it is compared with.
pub(super) fn product(draws: &[Numbers]) -> Section {
    let count = draws.first().map_or(0, |draw| draw.product.len());
    let row = |at: usize| -> Vec<Cell> {
        let lines: Vec<&Line> = draws.iter().map(|draw| &draw.product[at]).collect();
        let first = lines[0];
        let counts = lines.iter().filter_map(|line| line.better);
        let better = counts.fold([0, 0], |[a, b], [better, all]| [a + better, b + all]);
        let of = |value: fn(&Line) -> f64| spread(lines.iter().map(|line| value(line)));
        vec![
            Cell::words(first.set),
            Cell::words(&first.forecast),
            Cell::Spread(of(|line| line.r2), 3),
            Cell::Spread(of(|line| MW.scaled_w(line.mae_w)), 1),
            match better {
                [_, 0] => Cell::Nothing,
                [better, all] => Cell::words(format!("{better} of {all}")),
            },
        ]
    };
    let seeds = draws.len();
    Section {
        id: "forecasts".to_owned(),
        title: "The published forecast and the plain network".to_owned(),
        parts: vec![
            Part::Words(
                "The worker publishes what it learns online from the network, the readings and an \
                 autoregression. The plain network is what the paper scores. One tick ahead, \
                 corrected by each reading. Trial 6 is held out. The seven robots are other robots \
                 than the one that trained."
                    .to_owned(),
            ),
            Part::Table(Table {
                id: "table-forecasts".to_owned(),
                caption: format!("Mean ± standard deviation over {seeds} draws."),
                columns: vec![
                    Column::new("recordings", "recordings"),
                    Column::new("forecast", "forecast"),
                    Column::new("r2", "R²"),
                    Column::new("mae_mw", "MAE (mW)"),
                    Column::new("better", "smaller squared error than persistence"),
                ],
                rows: (0..count).map(row).collect(),
                folded: false,
            }),
        ],
    }
}

/// The paper's numbers, one by one.
pub(super) fn section(draws: &[Numbers]) -> Section {
    let count = draws.first().map_or(0, |draw| draw.paper.len());
    let row = |at: usize| -> Vec<Cell> {
        let first = &draws[0].paper[at];
        let values = || draws.iter().map(|draw| draw.paper[at].value);
        let ends = power::ends(values());
        vec![
            Cell::words(&first.quantity),
            first.paper.clone(),
            Cell::Spread(spread(values()), first.decimals),
            Cell::Range(ends, first.decimals),
        ]
    };
    let seeds = draws.len();
    Section {
        id: "paper".to_owned(),
        title: "Compared with the paper".to_owned(),
        parts: vec![
            Part::Words(
                "The paper's figures for its real robots, and the same figures for the simulated ones: \
                 those of the plain network, since the paper has no other. The plant was fitted to \
                 some of these numbers (docs/measured/plant.md says which). The linear models are fitted on \
                 trials 1 to 4 and scored on all six."
                    .to_owned(),
            ),
            Part::Table(Table {
                id: "table-paper".to_owned(),
                caption: format!(
                    "The paper's numbers (real robots) and those of simulated robots over {seeds} draws."
                ),
                columns: vec![
                    Column::new("quantity", "quantity"),
                    Column::new("paper", "paper (real)"),
                    Column::new("here", "here (simulated), mean ± deviation"),
                    Column::new("ends", "least to greatest draw"),
                ],
                rows: (0..count).map(row).collect(),
                folded: false,
            }),
        ],
    }
}

fn number(quantity: impl Into<String>, paper: Cell, value: f64, decimals: usize) -> Number {
    Number { quantity: quantity.into(), paper, value, decimals }
}

/// A power in mW. A difference of powers gets one more decimal than a power.
fn power_mw(quantity: &str, paper_w: f64, value_w: f64, fine: bool) -> Number {
    let paper = MW.cell(paper_w, fine);
    number(quantity, paper, MW.scaled_w(value_w), usize::from(fine))
}

fn power_numbers(numbers: &mut Vec<Number>, draw: &Draw) {
    let found = power::pooled(&draw.recordings.trials);
    let [lowest_w, highest_w] = paper::POWER_RANGE_W;
    numbers.extend([
        power_mw("mean power (mW)", paper::POWER_MEAN_W, found.mean_w, false),
        power_mw("standard deviation of power (mW)", paper::POWER_STD_W, found.std_w, false),
        power_mw("lowest power (mW)", lowest_w, found.ends_w[0], false),
        power_mw("highest power (mW)", highest_w, found.ends_w[1], false),
        number(
            "lag-1 autocorrelation, least of the trials",
            Cell::Number(paper::LAG1[0], 3),
            found.lag1[0],
            3,
        ),
        number(
            "lag-1 autocorrelation, greatest of the trials",
            Cell::Number(paper::LAG1[1], 3),
            found.lag1[1],
            3,
        ),
    ]);
}

fn network_numbers(numbers: &mut Vec<Number>, draw: &Draw) {
    let all = &draw.alone.report.all;
    let line = |name: &str| {
        let found = all.forecasters.iter().find(|score| score.name == name);
        found.map_or(f64::NAN, |score| score.r2.value)
    };
    for (quantity, papers, name) in [
        ("velocities alone", paper::R2_VELOCITIES, "velocities"),
        ("velocities and one past reading", paper::R2_ONE_LAG, "velocities + 1 lag"),
    ] {
        let quantity = format!("R² of {quantity}");
        numbers.push(number(quantity, Cell::Number(papers, 2), line(name), 3));
    }
    let trials = &draw.plain_alone;
    let r2 = || trials.iter().map(|trial| trial.tally.r2());
    let [least, greatest] = power::ends(r2());
    for (quantity, papers, value) in [
        ("least", paper::R2_TRIALS[0], least),
        ("mean", paper::R2_TRIALS_MEAN, r2().sum::<f64>() / trials.len() as f64),
        ("greatest", paper::R2_TRIALS[1], greatest),
    ] {
        let quantity = format!("R² of the network, {quantity} of the six trials");
        numbers.push(number(quantity, Cell::Number(papers, 2), value, 3));
    }
    let sixth = trials.last().map(|trial| trial.tally);
    let (r2, mae_w) = sixth.map_or((f64::NAN, f64::NAN), |tally| (tally.r2(), tally.mae_w()));
    let papers = Cell::Number(paper::R2_TRIAL_6, 2);
    numbers.push(number("R² on trial 6", papers, r2, 3));
    numbers.push(power_mw("MAE on trial 6 (mW)", paper::MAE_TRIAL_6_W, mae_w, true));
    let residuals_w = sorted(trials.iter().flat_map(|trial| trial.residuals_w.iter().copied()));
    let mean_w = residuals_w.iter().sum::<f64>() / residuals_w.len() as f64;
    let [low_w, high_w] = paper::RESIDUAL_90_W;
    numbers.extend([
        power_mw(
            "mean of reading − forecast, all trials (mW)",
            paper::RESIDUAL_MEAN_W,
            mean_w,
            true,
        ),
        power_mw(
            "5 % of the residuals of all trials are below (mW)",
            low_w,
            quantile(&residuals_w, 0.05),
            false,
        ),
        power_mw(
            "95 % of the residuals of all trials are below (mW)",
            high_w,
            quantile(&residuals_w, 0.95),
            false,
        ),
    ]);
}

fn robot_numbers(numbers: &mut Vec<Number>, draw: &Draw) {
    let robots = &draw.plain_together;
    let [mean, std] = spread(robots.iter().map(|robot| robot.tally.r2()));
    let [papers_mean, papers_std] = paper::R2_ROBOTS;
    let mae_w = robots.iter().map(|robot| robot.tally.mae_w()).sum::<f64>() / robots.len() as f64;
    let is_hungry = |robot: usize| paper::HUNGRY_ROBOTS.contains(&(robot as u32 + 1));
    let power_w = |hungry: bool| {
        let robots = robots.iter().enumerate();
        let robots = robots.filter(move |(robot, _)| is_hungry(*robot) == hungry);
        robots.map(|(_, robot)| robot.tally.reading_mean_w())
    };
    let lead_w = power_w(true).fold(f64::INFINITY, f64::min)
        - power_w(false).fold(f64::NEG_INFINITY, f64::max);
    let errors: Vec<f64> = robots.iter().map(|robot| robot.tally.energy_error().abs()).collect();
    let exact = errors.iter().filter(|error| **error < paper::MAX_ENERGY_ERROR_FOUR);
    numbers.extend([
        number("R² over seven robots, mean", Cell::Number(papers_mean, 2), mean, 3),
        number("R² over seven robots, standard deviation", Cell::Number(papers_std, 3), std, 3),
        power_mw("MAE over seven robots (mW)", paper::MAE_ROBOTS_W, mae_w, true),
        number(
            "least of robots 1, 2, 3, 6 above the most of 4, 5, 7 (mW)",
            Cell::words("above 0"),
            MW.scaled_w(lead_w),
            0,
        ),
        number(
            "largest energy error of a robot (%)",
            Cell::words(format!("below {:.1}", 100.0 * paper::MAX_ENERGY_ERROR_ALL)),
            100.0 * errors.iter().copied().fold(f64::NAN, f64::max),
            2,
        ),
        number("robots with an energy error below 0.1 %", Cell::Count(4), exact.count() as f64, 1),
    ]);
}
