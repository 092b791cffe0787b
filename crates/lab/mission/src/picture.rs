//! A mission as a figure.

use joulebus_figure::{Axis, Colour, Figure, FigureError, Layer, Mark, Panel};

use crate::error::MissionError;
use crate::policy::Policy;
use crate::run::{Doing, Look, watched};
use crate::scenario::Scenario;

/// Time between two points, s, and time shown, min.
const EVERY_S: f64 = 2.0;
const SHOWN_MIN: (f64, f64) = (10.0, 25.0);
/// Robots whose state of charge is drawn.
const DRAWN: [(usize, Colour); 4] =
    [(0, Colour::Blue), (4, Colour::Green), (8, Colour::Orange), (12, Colour::Purple)];

/// Errors of drawing a mission.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum PictureError {
    /// The mission.
    #[error(transparent)]
    Mission(#[from] MissionError),
    /// The figure.
    #[error(transparent)]
    Figure(#[from] FigureError),
}

/// An SVG of the mission of a seed: the activity of every robot, and the true state of charge of
/// some.
///
/// # Errors
/// [`PictureError`].
pub fn picture(scenario: &Scenario, policy: Policy, seed: u64) -> Result<String, PictureError> {
    let (outcome, looks) = watched(scenario, policy, seed, Some(EVERY_S))?;
    let hours = scenario.duration_s / 3600.0;
    let title = format!(
        "A mission with {}: seed {seed}, {:.0} tasks an hour, {} robots stranded.",
        policy.name(),
        outcome.tasks as f64 / hours,
        outcome.stranded
    );
    let end_min = scenario.duration_s / 60.0;
    let ends = if SHOWN_MIN.1 <= end_min { SHOWN_MIN } else { (0.0, end_min) };
    let figure = Figure {
        columns: 1,
        panel_height_px: 300,
        ..Figure::new(
            "mission",
            title,
            "Above: what each of the robots does over time. Below: the true state of charge of four of \
             them. The policy sees only the fleet's account.",
            vec![jobs(&looks, ends), charge(&looks, ends)],
        )
    };
    Ok(figure.svg()?)
}

fn jobs(looks: &[Look], ends: (f64, f64)) -> Panel {
    let layer = |label: &str, colour: Colour, doing: Doing| {
        let robots = looks.first().map_or(0, |(_, robots)| robots.len());
        // One line through all robots, with gaps between them and during other activities.
        let points = (0..robots).map(|robot| {
            let at = looks.iter().map(move |(at_s, robots)| {
                let y = if robots[robot].0 == doing { robot as f64 } else { f64::NAN };
                [at_s / 60.0, y]
            });
            at.filter(move |[at_min, _]| (ends.0..=ends.1).contains(at_min)).collect()
        });
        let lines = points.map(|points| Mark::Line { points, dashed: false });
        let mut layers: Vec<Layer> = lines.map(|mark| Layer::plain(colour, mark)).collect();
        if let Some(first) = layers.first_mut() {
            first.label = Some(label.to_owned());
        }
        layers
    };
    let layers = [
        layer("on a task", Colour::Blue, Doing::Works),
        layer("to a charger, or waiting", Colour::Orange, Doing::InLine),
        layer("on a charger", Colour::Green, Doing::Charges),
        layer("without a task", Colour::Grey, Doing::Rests),
        layer("stranded", Colour::Vermilion, Doing::Stranded),
    ];
    Panel {
        title: String::new(),
        x: Axis::new("time (min)").within(ends.0, ends.1),
        y: Axis::new("robot"),
        layers: layers.into_iter().flatten().collect(),
    }
}

fn charge(looks: &[Look], ends: (f64, f64)) -> Panel {
    let robots = looks.first().map_or(0, |(_, robots)| robots.len());
    let drawn = DRAWN.iter().filter(|(robot, _)| *robot < robots);
    let layers = drawn.map(|(robot, colour)| {
        let points = looks.iter().map(|(at_s, robots)| {
            let (doing, soc) = robots[*robot];
            [at_s / 60.0, if doing == Doing::Off { f64::NAN } else { 100.0 * soc }]
        });
        let points = points.filter(|[at_min, _]| (ends.0..=ends.1).contains(at_min));
        let mark = Mark::Line { points: points.collect(), dashed: false };
        Layer::named(format!("robot {robot}"), *colour, mark)
    });
    Panel {
        title: String::new(),
        x: Axis::new("time (min)").within(ends.0, ends.1),
        y: Axis::new("state of charge (%)").within(0.0, 100.0),
        layers: layers.collect(),
    }
}
