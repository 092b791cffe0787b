//! What recordings say by themselves: energy per metre, power by speed, how long a battery lasts,
//! and the worst run.

mod battery;
mod steps;
mod worst;

use joulebus_eval::score::Recording;
use joulebus_settings::Platform;

use super::document::{Cell, Column, Part, Section, Table, UNKNOWN};
use super::figure::{Axis, Colour, Figure, Layer, Mark, Panel};
use super::material::label;
use steps::{
    AtSpeed, MANY_RUNS, MIN_STEPS, Motion, Plausible, Run, Speeds, Sums, ends, range, significant,
    spanned,
};

/// What recordings say, before any model.
#[derive(Debug, Clone)]
pub(super) struct Usage {
    runs: Vec<Run>,
    sums: Sums,
    speeds: Speeds,
    at_speed: Vec<AtSpeed>,
    battery: Option<battery::Battery>,
    /// Kinds of what is implausible in the recordings, yet accepted, with their numbers.
    accepted: Vec<(String, usize)>,
}

impl Usage {
    /// Of recordings in memory. The capacity that is given goes before the platform's.
    pub(super) fn new(
        recordings: &[Recording],
        platform: Option<&Platform>,
        battery_wh: Option<f64>,
    ) -> Self {
        let plausible = Plausible::new(platform);
        let in_memory = recordings.iter();
        let runs = in_memory.filter_map(|recording| {
            let contents = recording.in_memory()?;
            Some(Run::new(recording, &contents.trial, plausible))
        });
        let runs: Vec<Run> = runs.collect();
        let speeds = Speeds::new(&runs);
        let steps = runs.iter().flat_map(|run| &run.steps);
        let at_speed = AtSpeed::of(&speeds, &steps);
        let mut accepted: Vec<(String, usize)> = Vec::new();
        for found in recordings.iter().flat_map(Recording::implausible) {
            let kind = found.finding.kind.name();
            match accepted.iter_mut().find(|(known, _)| known == kind) {
                Some((_, count)) => *count += 1,
                None => accepted.push((kind.to_owned(), 1)),
            }
        }
        let battery = battery::Battery::new(battery_wh, platform);
        Self { sums: Sums::of(steps), runs, speeds, at_speed, battery, accepted }
    }

    /// The first paragraphs of a report: energy per metre, battery, worst run.
    pub(super) fn summary(&self) -> Vec<String> {
        let lasts = battery::lasts(self.battery, &self.runs);
        vec![self.per_metre(), lasts, worst::worst_run(&self.runs, &self.speeds)]
    }

    /// Of the runs that moved, as the comparison of runs is. Of all together if none moved a metre by
    /// itself.
    fn per_metre(&self) -> String {
        let moved = self.runs.iter().filter(|run| run.sums().wh_per_m().is_finite());
        let moved: Vec<_> = moved.collect();
        let found = match moved.len() {
            0 => self.sums.wh_per_m(),
            _ => Sums::of(moved.iter().flat_map(|run| &run.steps)).wh_per_m(),
        };
        if found.is_nan() {
            let mean_w = significant(self.sums.mean_w());
            let why = match self.sums.driven_s > 0.0 {
                true => "the robots moved less than a metre",
                false => "no plausible speed is recorded",
            };
            let power = match mean_w.shown() {
                unknown if unknown == UNKNOWN => "The mean power is not known.".to_owned(),
                mean_w => format!("The mean power is {mean_w} W."),
            };
            return format!("Energy per metre is not known: {why}. {power}");
        }
        let per_run: Vec<f64> = self.runs.iter().map(|run| run.sums().wh_per_m()).collect();
        let range = match range(&per_run) {
            [low, high] if low.is_nan() || high.is_nan() => String::new(),
            ends if per_run.len() < MANY_RUNS => format!(" ({} by run)", spanned(ends)),
            ends => format!(" ({} for nine of ten runs)", spanned(ends)),
        };
        let left_out = match (moved.len(), self.runs.len()) {
            (0, _) => String::new(),
            (moved, runs) if moved == runs => String::new(),
            (moved, runs) => format!(" Of the {moved} of {runs} runs that moved a metre or more."),
        };
        format!("Energy per metre: {} Wh{range}.{left_out}", significant(found).shown())
    }

    pub(super) fn section(&self) -> Section {
        let mut parts = vec![Part::Words(self.basis())];
        if self.speeds.parts > 0 {
            parts.push(Part::Figure(self.figure()));
        }
        parts.push(Part::Table(self.speed_table()));
        parts.extend(self.battery.map(|battery| Part::Table(battery::table(battery, &self.runs))));
        parts.push(Part::Table(self.run_table()));
        Section {
            id: "usage".to_owned(),
            title: "Energy per metre, power by speed, battery, worst run".to_owned(),
            parts,
        }
    }

    /// How many rows count, and why others do not.
    fn basis(&self) -> String {
        let sum = |of: fn(&Run) -> usize| self.runs.iter().map(of).sum::<usize>();
        let (rows, readings) = (sum(|run| run.rows), sum(|run| run.readings));
        let mut words = format!("{readings} of {rows} rows have a plausible power.");
        for (count, why) in [
            (sum(|run| run.left_out.missing), "have no power"),
            (sum(|run| run.left_out.implausible), "have an implausible power"),
            (sum(|run| run.left_out.on_charger), "are on the charger"),
            (sum(|run| run.left_out.clock), "have a time that does not advance"),
        ] {
            if count > 0 {
                words += &format!(" {count} {why} and count for nothing.");
            }
        }
        let speeds = sum(|run| run.left_out.speeds);
        if speeds > 0 {
            words += &format!(" The speed of {speeds} is implausible and taken as unknown.");
        }
        let pauses_s: f64 = self.runs.iter().map(|run| run.left_out.pauses_s).sum();
        if pauses_s > 0.0 {
            let pauses = significant(pauses_s).shown();
            words += &format!(" {pauses} s between readings that are far apart are not metered.");
        }
        let measured = self.runs.iter().filter(|run| run.is_measured).count();
        words += match measured {
            _ if self.sums.driven_s == 0.0 => " No plausible speed is recorded.",
            0 => " Speeds are the commanded ones: a robot that slips or is blocked drove less.",
            all if all == self.runs.len() => " Speeds are the measured ones.",
            _ => " Speeds are the measured ones where they are recorded, else the commanded ones.",
        };
        if !self.accepted.is_empty() {
            let kinds = self.accepted.iter().map(|(kind, count)| format!("{kind} ({count})"));
            let kinds = kinds.collect::<Vec<_>>().join(", ");
            words += &format!(" Implausible in recordings, and used all the same: {kinds}.");
        }
        words
    }

    fn figure(&self) -> Figure {
        let driven = self.at_speed.iter().filter_map(|one| match one.motion {
            Motion::Rests => Some((0.0, one)),
            Motion::Drives(_) => Some((one.sums.distance_m / one.sums.driven_s, one)),
            Motion::Turns | Motion::Unknown => None,
        });
        let driven: Vec<(f64, &AtSpeed)> = driven.collect();
        let mean: Vec<[f64; 2]> = driven.iter().map(|(x, one)| [*x, one.mean_w()]).collect();
        let band = driven.iter().map(|(x, one)| {
            let [low, high] = one.range_w();
            [*x, low, high]
        });
        let moving = driven.iter().filter(|(_, one)| one.motion != Motion::Rests);
        let per_metre: Vec<[f64; 2]> =
            moving.map(|(x, one)| [*x, one.mean_w() / 3600.0 / x]).collect();
        let line = |points| Mark::Line { points, dashed: false };
        Figure::new(
            "figure-speed",
            "Power by speed.",
            "Left: mean power by speed, with the middle 80 % of the readings. Right: energy for a \
             metre at that speed.",
            vec![
                Panel {
                    title: "power".to_owned(),
                    x: Axis::new("speed (m/s)"),
                    y: Axis::new("power (W)").including(0.0),
                    layers: vec![
                        Layer::named("middle 80 %", Colour::Blue, Mark::Band(band.collect())),
                        Layer::plain(Colour::Blue, Mark::Points(mean.clone())),
                        Layer::named("mean", Colour::Blue, line(mean)),
                    ],
                },
                Panel {
                    title: "energy per metre".to_owned(),
                    x: Axis::new("speed (m/s)").including(0.0),
                    y: Axis::new("energy per metre (Wh)").including(0.0),
                    layers: vec![
                        Layer::plain(Colour::Green, Mark::Points(per_metre.clone())),
                        Layer::plain(Colour::Green, line(per_metre)),
                    ],
                },
            ],
        )
    }

    fn speed_table(&self) -> Table {
        let row = |one: &AtSpeed| {
            let is_enough = one.steps >= MIN_STEPS && matches!(one.motion, Motion::Drives(_));
            vec![
                Cell::words(&one.words),
                Cell::Count(one.steps as u64),
                significant(one.sums.time_s / 60.0),
                significant(one.mean_w()),
                ends(one.range_w()),
                if is_enough { significant(one.sums.wh_per_m()) } else { Cell::Nothing },
            ]
        };
        Table {
            id: "table-speed".to_owned(),
            caption: format!(
                "Power by speed. A step is the time between two readings. Of fewer than \
                 {MIN_STEPS} steps there is no mean."
            ),
            columns: vec![
                Column::new("speed", "speed"),
                Column::new("steps", "steps"),
                Column::new("time_min", "time (min)"),
                Column::new("mean_w", "mean power (W)"),
                Column::new("middle_w", "middle 80 % (W)"),
                Column::new("energy_per_metre_wh", "energy per metre (Wh)"),
            ],
            rows: self.at_speed.iter().map(row).collect(),
            folded: false,
        }
    }

    fn run_table(&self) -> Table {
        let mut runs: Vec<(&Run, Sums)> = self.runs.iter().map(|run| (run, run.sums())).collect();
        // The worst first, what is not known last.
        let key = |(_, sums): &(&Run, Sums)| [sums.wh_per_m(), sums.mean_w()];
        let known = |value: f64| if value.is_nan() { f64::NEG_INFINITY } else { value };
        runs.sort_by(|a, b| {
            let [[a_wh, a_w], [b_wh, b_w]] = [key(a).map(known), key(b).map(known)];
            b_wh.total_cmp(&a_wh).then(b_w.total_cmp(&a_w))
        });
        let row = |(run, sums): &(&Run, Sums)| {
            let rests = run.steps.iter().filter(|step| self.speeds.motion(step) == Motion::Rests);
            let rests_s: f64 = rests.map(|step| step.duration_s).sum();
            let has_speed = sums.driven_s > 0.0;
            let of_speed = |value: f64| if has_speed { value } else { f64::NAN };
            vec![
                Cell::words(&run.name),
                Cell::words(label(&run.robot)),
                Cell::Count(run.readings as u64),
                Cell::Count(run.rows as u64),
                significant(sums.time_s / 60.0),
                significant(sums.mean_w()),
                significant(sums.energy_j / 3600.0),
                significant(of_speed(sums.distance_m)),
                significant(sums.wh_per_m()),
                Cell::Number(of_speed(100.0 * rests_s / sums.driven_s), 0),
            ]
        };
        Table {
            id: "table-runs".to_owned(),
            caption: "The runs, the worst first. A dash: not known.".to_owned(),
            columns: vec![
                Column::new("run", "run"),
                Column::new("robot", "robot"),
                Column::new("readings", "readings used"),
                Column::new("rows", "of rows"),
                Column::new("time_min", "time (min)"),
                Column::new("mean_w", "mean power (W)"),
                Column::new("energy_wh", "energy (Wh)"),
                Column::new("distance_m", "distance (m)"),
                Column::new("energy_per_metre_wh", "energy per metre (Wh)"),
                Column::new("at_rest_percent", "at rest (%)"),
            ],
            rows: runs.iter().map(row).collect(),
            folded: runs.len() > 16,
        }
    }
}
