//! Figure 1: distribution and autocorrelation of power.

use super::document::{Cell, Column, Part, Section, Table};
use super::figure::{Axis, Colour, Direction, Figure, Layer, Mark, Panel};
use super::material::{Material, label};
use super::paper;
use joulebus_dataset::trial::{Column as Recorded, Trial};
use joulebus_eval::analyze::autocorrelation;
use joulebus_eval::score::{Contents, Recording};
use joulebus_statistics::metrics::{quantile, sorted};

/// Maximum lag shown, rows.
const MAX_LAG_ROWS: usize = 90;
/// Minimum number of trials whose curves are shown as a band.
const CURVES: usize = 8;
const BINS: usize = 70;

/// Readings of one recording.
struct Readings {
    name: String,
    count: u64,
    mean_w: f64,
    std_w: f64,
    ends_w: [f64; 2],
    held: f64,
    rate_hz: f64,
    /// By lag, from 0.
    correlation: Vec<f64>,
}

impl Readings {
    fn of_all(recordings: &[Recording]) -> impl Iterator<Item = Self> + '_ {
        let in_memory = recordings.iter();
        in_memory.filter_map(|recording| Some(Self::new(&recording.name, recording.in_memory()?)))
    }

    fn new(name: &str, contents: &Contents) -> Self {
        let trial = &contents.trial;
        let power_w: Vec<f64> = readings_w(trial).collect();
        let (mean_w, std_w) = mean_and_std(&power_w);
        let found = autocorrelation(trial, MAX_LAG_ROWS);
        let known = found.at_lag.iter().map(|value| value.unwrap_or(f64::NAN));
        let from_zero = std::iter::once(1.0).chain(known);
        Self {
            name: name.to_owned(),
            count: power_w.len() as u64,
            mean_w,
            std_w,
            ends_w: [
                power_w.iter().copied().fold(f64::NAN, f64::min),
                power_w.iter().copied().fold(f64::NAN, f64::max),
            ],
            held: trial.notes().held_readings as f64 / power_w.len() as f64,
            rate_hz: trial.notes().rate_hz,
            correlation: from_zero.collect(),
        }
    }

    fn at(&self, lag: usize) -> f64 {
        self.correlation.get(lag).copied().unwrap_or(f64::NAN)
    }
}

fn readings_w(trial: &Trial) -> impl Iterator<Item = f64> + '_ {
    let power = trial.column(Recorded::Power).unwrap_or_default();
    power.iter().copied().filter(|power_w| power_w.is_finite())
}

/// Mean, and standard deviation (divided by the number). NaN without a value.
fn mean_and_std(power_w: &[f64]) -> (f64, f64) {
    let count = power_w.len() as f64;
    let mean_w = power_w.iter().sum::<f64>() / count;
    let squares_w2 = power_w.iter().map(|power_w| (power_w - mean_w).powi(2));
    (mean_w, (squares_w2.sum::<f64>() / count).sqrt())
}

pub(super) struct Pooled {
    pub(super) mean_w: f64,
    pub(super) std_w: f64,
    pub(super) ends_w: [f64; 2],
    /// Minimum and maximum lag-1 autocorrelation of the trials.
    pub(super) lag1: [f64; 2],
}

pub(super) fn pooled(recordings: &[Recording]) -> Pooled {
    let contents = recordings.iter().filter_map(Recording::in_memory);
    let power_w = sorted(contents.flat_map(|contents| readings_w(&contents.trial)));
    let (mean_w, std_w) = mean_and_std(&power_w);
    Pooled {
        mean_w,
        std_w,
        ends_w: [quantile(&power_w, 0.0), quantile(&power_w, 1.0)],
        lag1: ends(Readings::of_all(recordings).map(|readings| readings.at(1))),
    }
}

/// The section, with the table of the figure's data.
pub(super) fn section(material: &Material<'_>) -> Section {
    let found: Vec<Readings> = Readings::of_all(material.recordings).collect();
    let mut parts = vec![
        Part::Words(
            "Distribution and autocorrelation of the power readings. A slow monitor that repeats its \
             readings inflates the autocorrelation: the table gives the share of repeated readings."
                .to_owned(),
        ),
        Part::Figure(figure(material, &found)),
    ];
    parts.push(Part::Table(table(material, &found)));
    Section {
        id: "power".to_owned(),
        title: "Power distribution and autocorrelation".to_owned(),
        parts,
    }
}

fn figure(material: &Material<'_>, found: &[Readings]) -> Figure {
    let panels = vec![distribution(material), memory(material, found)];
    material.noted(Figure::new(
        "figure-1-power",
        "Figure 1. Power distribution and autocorrelation.",
        "Left: share of readings by power, all recordings together. Right: autocorrelation of the \
         readings by lag, of each trial.",
        panels,
    ))
}

fn distribution(material: &Material<'_>) -> Panel {
    let unit = material.unit;
    let contents = material.recordings.iter().filter_map(Recording::in_memory);
    let power_w = sorted(contents.flat_map(|contents| readings_w(&contents.trial)));
    let ends = [quantile(&power_w, 0.0005), quantile(&power_w, 0.9995)];
    let density = Mark::density(
        power_w.iter().map(|power_w| unit.scaled_w(*power_w)),
        ends.map(|end| unit.scaled_w(end)),
        BINS,
    );
    let mean_w = power_w.iter().sum::<f64>() / power_w.len() as f64;
    let rule = |at_w: f64| Mark::Rule { at: unit.scaled_w(at_w), direction: Direction::Up };
    let mut layers = vec![
        Layer::named("readings", Colour::Blue, density),
        Layer::named("their mean", Colour::Ink, rule(mean_w)),
    ];
    if material.beside_paper {
        layers.push(Layer::named("the paper's mean", Colour::Vermilion, rule(paper::POWER_MEAN_W)));
    }
    Panel {
        title: "distribution".to_owned(),
        x: Axis::new(format!("power ({})", unit.name())),
        y: Axis::new(format!("density (1/{})", unit.name())),
        layers,
    }
}

fn memory(material: &Material<'_>, found: &[Readings]) -> Panel {
    let curve = |readings: &Readings| -> Vec<[f64; 2]> {
        let values = readings.correlation.iter().enumerate();
        values.map(|(lag, value)| [lag as f64, *value]).collect()
    };
    let colours = [
        Colour::Blue,
        Colour::Orange,
        Colour::Green,
        Colour::Purple,
        Colour::Sky,
        Colour::Ink,
        Colour::Grey,
        Colour::Vermilion,
    ];
    let mut layers: Vec<Layer> = if found.len() <= CURVES {
        let pairs = found.iter().zip(colours);
        pairs
            .map(|(readings, colour)| {
                let points = curve(readings);
                Layer::named(label(&readings.name), colour, Mark::Line { points, dashed: false })
            })
            .collect()
    } else {
        let (middle, band) = middle_and_band(found);
        vec![
            Layer::named("middle 80 % of trials", Colour::Blue, Mark::Band(band)),
            Layer::named(
                "median trial",
                Colour::Blue,
                Mark::Line { points: middle, dashed: false },
            ),
        ]
    };
    if material.beside_paper {
        let middle = f64::midpoint(paper::LAG1[0], paper::LAG1[1]);
        let at = Mark::Points(vec![[1.0, middle]]);
        layers.push(Layer::named("the paper's at lag 1", Colour::Vermilion, at));
    }
    Panel {
        title: "autocorrelation".to_owned(),
        x: Axis::new("lag (rows)"),
        y: Axis::new("autocorrelation"),
        layers,
    }
}

/// Median and central 80 % over the trials, by lag.
fn middle_and_band(found: &[Readings]) -> (Vec<[f64; 2]>, Vec<[f64; 3]>) {
    let by_lag = (0..=MAX_LAG_ROWS).map(|lag| {
        let values = sorted(found.iter().map(|readings| readings.at(lag)));
        (lag as f64, [0.1, 0.5, 0.9].map(|share| quantile(&values, share)))
    });
    by_lag.map(|(lag, [low, middle, high])| ([lag, middle], [lag, low, high])).unzip()
}

fn table(material: &Material<'_>, found: &[Readings]) -> Table {
    let unit = material.unit;
    let row = |readings: &Readings| {
        vec![
            Cell::words(label(&readings.name)),
            Cell::Count(readings.count),
            Cell::Number(readings.rate_hz, 1),
            unit.cell(readings.mean_w, false),
            unit.cell(readings.std_w, false),
            unit.range(readings.ends_w, false),
            Cell::Number(100.0 * readings.held, 1),
            Cell::Number(readings.at(1), 3),
        ]
    };
    Table {
        id: "table-power".to_owned(),
        caption: "Power readings of each recording. ρ₁ is the autocorrelation at a lag of one row."
            .to_owned(),
        columns: vec![
            Column::new("recording", "recording"),
            Column::new("readings", "readings"),
            Column::new("rate_hz", "rate (Hz)"),
            unit.column("mean", "mean"),
            unit.column("std", "standard deviation"),
            unit.column("range", "least to greatest"),
            Column::new("repeated_percent", "repeated (%)"),
            Column::new("rho_1", "ρ₁"),
        ],
        rows: found.iter().map(row).collect(),
        folded: found.len() > 16,
    }
}

pub(super) fn ends(values: impl Iterator<Item = f64>) -> [f64; 2] {
    values.fold([f64::NAN; 2], |[low, high], value| [low.min(value), high.max(value)])
}
