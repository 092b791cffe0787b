//! Evaluations as text tables.

use std::fmt::{self, Formatter};

use super::cell::{Cell, ForecasterScore, Role, Skill};
use super::common::ModelReport;
use super::compare::{Comparison, Difference};
use super::design::DesignReport;
use super::report::ScoreReport;
use super::trained_on::{ScoredRows, TrainedOn};
use joulebus_statistics::bootstrap::{Bootstrap, Estimate, MIN_BLOCKS};

/// Maximum number of trials listed individually. Of more, only the worst.
const MAX_LISTED: usize = 24;
/// Number of worst trials listed.
const WORST: usize = 8;

impl fmt::Display for ScoreReport {
    fn fmt(&self, out: &mut Formatter<'_>) -> fmt::Result {
        for model in &self.models {
            write_model(out, "model", model)?;
        }
        self.write_data(out)?;
        writeln!(
            out,
            "\nCorrected: from real readings, one tick ahead ({:.1} ms){}",
            1e3 * self.period_s,
            whose(self.scored_rows, self.design.rows, self.untold_rows)
        )?;
        write_cell(out, &self.all, &self.bootstrap)?;
        if let Some(apart) = &self.trained_on {
            writeln!(
                out,
                "\nThe same on rows that a model was trained on: no measure of other recordings"
            )?;
            write_cell(out, apart, &self.bootstrap)?;
        }
        write_cells(out, "group", &self.groups)?;
        write_cells(out, "robot", &self.robots)?;
        write_trials(out, &self.trials)?;
        for model in &self.models {
            write_energy(out, model)?;
        }
        for left_out in self.left_out.iter().take(MAX_LISTED) {
            writeln!(out, "{left_out}")?;
        }
        if self.left_out.len() > MAX_LISTED {
            let more = self.left_out.len() - MAX_LISTED;
            writeln!(out, "and {more} further reasons and robots. --format json has all")?;
        }
        Ok(())
    }
}

impl ScoreReport {
    fn write_data(&self, out: &mut Formatter<'_>) -> fmt::Result {
        write_design(out, &self.design, &self.platform)?;
        for baseline in &self.baselines {
            let name = &baseline.name;
            let Some(line) = &baseline.line else {
                writeln!(out, "  {name}: too few rows to fit it on, left out")?;
                continue;
            };
            let of_folds = match self.design.folds {
                1 => String::new(),
                folds => format!(" (first of {folds} folds)"),
            };
            write!(out, "  {name} fitted on {} rows{of_folds}", line.rows)?;
            if line.unusable_rows > 0 {
                write!(out, ", {} not usable", line.unusable_rows)?;
            }
            let dropped = line.dropped.iter();
            let dropped: Vec<String> = dropped
                .map(|(feature, why)| format!("{feature} ({})", format!("{why:?}").to_lowercase()))
                .collect();
            if !dropped.is_empty() {
                write!(out, ", without {}", dropped.join(", "))?;
            }
            writeln!(out)?;
        }
        Ok(())
    }
}

fn write_model(out: &mut Formatter<'_>, what: &str, model: &ModelReport) -> fmt::Result {
    writeln!(out, "{what} {} ({})", model.name, model.hash)?;
    write!(out, "  scored: its {} forecast", model.forecast)?;
    match model.members.as_slice() {
        [] => writeln!(out)?,
        members => writeln!(out, ", learned for each robot from {}", members.join(", "))?,
    }
    let Some(training_data) = &model.training_data else {
        return Ok(());
    };
    writeln!(out, "  trained on: {training_data}")?;
    match model.trained_on {
        Some(TrainedOn { rows, untold, of, share }) => {
            match rows {
                0 => write!(out, "  none recognised of the {of} rows here")?,
                _ => write!(out, "  on {rows} of the {of} rows here ({:.1} %)", 100.0 * share)?,
            }
            match untold {
                0 => writeln!(out),
                _ => writeln!(out, "; {untold} cannot be told"),
            }
        }
        None => writeln!(
            out,
            "  its file does not state its rows: whether it was trained on these is unknown"
        ),
    }
}

/// A number, or a dash if it is undefined.
struct Number(f64, usize, usize);

impl fmt::Display for Number {
    fn fmt(&self, out: &mut Formatter<'_>) -> fmt::Result {
        let Number(value, width, digits) = *self;
        if value.is_nan() {
            write!(out, "{:>width$}", "–")
        } else if value.abs() >= 1e5 {
            write!(out, "{value:>width$.1e}")
        } else {
            write!(out, "{value:>width$.digits$}")
        }
    }
}

fn write_design(out: &mut Formatter<'_>, design: &DesignReport, platform: &str) -> fmt::Result {
    let DesignReport { trials, rows, trained_on_rows, description, .. } = design;
    let apart = match trained_on_rows {
        0 => String::new(),
        rows => format!(", besides {rows} that a model was trained on"),
    };
    writeln!(out, "data: {trials} trials, {rows} rows{apart} of platform {platform}; {description}")
}

fn between(estimate: &Estimate, scale: f64, digits: usize) -> String {
    if estimate.lo.is_nan() {
        return String::new();
    }
    let (lo, hi) = (scale * estimate.lo, scale * estimate.hi);
    let (lo, hi) = (Number(lo, 0, digits), Number(hi, 0, digits));
    format!("[{lo}, {hi}]")
}

fn name_width<'a>(names: impl Iterator<Item = &'a str>, least: usize) -> usize {
    let longest = names.map(|name| name.chars().count()).max();
    longest.unwrap_or(0).max(least)
}

/// The heading's words for a table's rows.
fn whose(scored: ScoredRows, rows: usize, untold: usize) -> String {
    match scored {
        ScoredRows::NotTrainedOn => ", rows that no model was trained on".to_owned(),
        ScoredRows::NoneRecognised => {
            format!(", rows trained on: none recognised of {rows}; {untold} cannot be told")
        }
        ScoredRows::TrainedOn => ", ROWS THAT A MODEL WAS TRAINED ON".to_owned(),
        ScoredRows::Mixed => ", ROWS OF WHICH A MODEL WAS TRAINED ON SOME".to_owned(),
        ScoredRows::Unknown => String::new(),
    }
}

/// The forecasters one per line, with confidence intervals.
fn write_cell(out: &mut Formatter<'_>, cell: &Cell, bootstrap: &Bootstrap) -> fmt::Result {
    let width = name_width(cell.forecasters.iter().map(|one| one.name.as_str()), 12);
    writeln!(
        out,
        "{:width$} {:>8} {:>16} {:>8} {:>8} {:>7} {:>8} {:>8} {:>8} {:>9} {:>9}",
        "",
        "R²",
        "",
        "RMSE W",
        "MAE W",
        "MAPE %",
        "bias W",
        "q05 W",
        "q95 W",
        "energy %",
        "const. IS"
    )?;
    for one in &cell.forecasters {
        writeln!(
            out,
            "{:width$} {} {:>16} {} {} {} {} {} {} {} {}",
            one.name,
            Number(one.r2.value, 8, 4),
            between(&one.r2, 1.0, 3),
            Number(one.rmse_w.value, 8, 3),
            Number(one.mae_w.value, 8, 3),
            Number(100.0 * one.mape, 7, 2),
            Number(one.bias_w.value, 8, 4),
            Number(one.residual.q05_w, 8, 3),
            Number(one.residual.q95_w, 8, 3),
            Number(100.0 * one.energy_error.value, 9, 3),
            Number(one.hindsight.score_w, 9, 3),
        )?;
    }
    for one in &cell.forecasters {
        let Some(interval) = &one.interval else {
            continue;
        };
        let skills = one.skill.iter().map(|skill| {
            let against = &skill.against;
            let (value, spread) = (skill.skill.value, between(&skill.skill, 1.0, 3));
            format!("{} {spread} against {against}", Number(value, 0, 4))
        });
        writeln!(out, "{}: skill {}", one.name, skills.collect::<Vec<_>>().join("; "))?;
        let scores = &interval.scores;
        writeln!(
            out,
            "{}: {:.0} % interval holds {} % {} of the readings ({} % below, {} % above), {} W wide",
            one.name,
            100.0 * scores.nominal,
            Number(100.0 * scores.coverage, 0, 2),
            between(&interval.inside, 100.0, 1),
            Number(100.0 * scores.below, 0, 2),
            Number(100.0 * scores.above, 0, 2),
            Number(scores.width_w, 0, 3),
        )?;
        writeln!(
            out,
            "{}: interval score {} W {} (const. IS: the best constant interval, known afterwards), \
             pinball loss {} W, weighted interval score {} W",
            one.name,
            Number(scores.score_w, 0, 3),
            between(&interval.score, 1.0, 3),
            Number(interval.pinball_w, 0, 4),
            Number(interval.wis_w, 0, 4),
        )?;
    }
    write!(
        out,
        "{} rows, power {:.3} ± {:.3} W",
        cell.rows, cell.reading_mean_w, cell.reading_std_w
    )?;
    if cell.unscored > 0 {
        write!(out, "; {} rows left out, a model has no forecast for them", cell.unscored)?;
    }
    writeln!(out)?;
    write_blocks(out, cell, bootstrap)
}

fn write_blocks(out: &mut Formatter<'_>, cell: &Cell, bootstrap: &Bootstrap) -> fmt::Result {
    let count = cell.blocks.count;
    if bootstrap.resamples == 0 {
        return Ok(());
    }
    let block = if cell.blocks.whole_trials {
        "whole trials".to_owned()
    } else {
        format!("blocks of {} rows", bootstrap.block_rows)
    };
    if count < MIN_BLOCKS {
        return writeln!(out, "no confidence intervals: {count} {block}, {MIN_BLOCKS} are needed");
    }
    writeln!(
        out,
        "[ ]: {:.0} % confidence, {} draws of {count} {block}, seed {}",
        100.0 * bootstrap.confidence,
        bootstrap.resamples,
        bootstrap.seed
    )
}

/// The forecasters of tables with a column each: the models and the baselines.
fn compared(cell: &Cell) -> impl Iterator<Item = &ForecasterScore> + Clone {
    let all = cell.forecasters.iter();
    all.filter(|one| one.role != Role::Member)
}

/// One line per cell: R² and MAE of models and baselines, the models' skill and coverage.
fn write_cells(out: &mut Formatter<'_>, what: &str, cells: &[Cell]) -> fmt::Result {
    let Some(first) = cells.first() else {
        return Ok(());
    };
    let width = name_width(cells.iter().map(|cell| short(&cell.name)), what.len() + 3);
    writeln!(out)?;
    write_headings(
        out,
        &format!("{:width$} {:>6} {:>7}", format!("By {what}"), "trials", "rows"),
        compared(first).map(|one| one.name.as_str()),
        "skill vs persistence        inside %",
    )?;
    for cell in cells {
        write_line(out, cell, width)?;
    }
    Ok(())
}

/// Two heading lines of a table with R² and MAE of every forecaster: `left`, their names, `right`.
/// Then the column titles.
fn write_headings<'a>(
    out: &mut Formatter<'_>,
    left: &str,
    names: impl Iterator<Item = &'a str> + Clone,
    right: &str,
) -> fmt::Result {
    write!(out, "{left}")?;
    for name in names.clone() {
        write!(out, "  {:>16}", cut(name, 16))?;
    }
    writeln!(out, "  {right}")?;
    write!(out, "{:1$}", "", left.chars().count())?;
    for _ in names {
        write!(out, "  {:>7} {:>8}", "R²", "MAE W")?;
    }
    writeln!(out)
}

/// R² and MAE under these titles.
fn write_accuracy(out: &mut Formatter<'_>, r2: Estimate, mae_w: Estimate) -> fmt::Result {
    let (r2, mae_w) = (Number(r2.value, 7, 4), Number(mae_w.value, 8, 3));
    write!(out, "  {r2} {mae_w}")
}

/// The skill against the first baseline, with its confidence interval.
fn write_skill(out: &mut Formatter<'_>, skills: &[Skill]) -> fmt::Result {
    let first = skills.first().map(|skill| skill.skill);
    let skill = first.unwrap_or(Estimate::alone(f64::NAN));
    let (value, spread) = (Number(skill.value, 7, 4), between(&skill, 1.0, 3));
    write!(out, "  {value} {spread:18}")
}

fn write_line(out: &mut Formatter<'_>, cell: &Cell, width: usize) -> fmt::Result {
    let name = short(&cell.name);
    write!(out, "{name:width$} {:>6} {:>7}", cell.trials, cell.rows)?;
    for one in compared(cell) {
        write_accuracy(out, one.r2, one.mae_w)?;
    }
    for one in cell.forecasters.iter().filter(|one| one.interval.is_some()) {
        write_skill(out, &one.skill)?;
        let coverage = one.interval.map_or(f64::NAN, |interval| interval.scores.coverage);
        write!(out, " {}", Number(100.0 * coverage, 6, 1))?;
    }
    writeln!(out)
}

/// All trials, or those in which the first model has the lowest skill.
fn write_trials(out: &mut Formatter<'_>, trials: &[Cell]) -> fmt::Result {
    if trials.len() <= MAX_LISTED {
        return write_cells(out, "trial", trials);
    }
    let skill = |cell: &Cell| {
        let first = cell.forecasters.first().and_then(|one| one.skill.first());
        first.map_or(f64::NAN, |skill| skill.skill.value)
    };
    let mut worst: Vec<&Cell> = trials.iter().collect();
    worst.sort_by(|a, b| skill(a).total_cmp(&skill(b)));
    let worst: Vec<Cell> = worst.into_iter().take(WORST).cloned().collect();
    write_cells(out, "trial", &worst)?;
    let losing = trials.iter().filter(|cell| skill(cell) < 0.0).count();
    writeln!(
        out,
        "(the {WORST} with the least skill of {}; in {losing} of them persistence is better; \
         --format json has all)",
        trials.len()
    )
}

fn write_energy(out: &mut Formatter<'_>, model: &ModelReport) -> fmt::Result {
    let Some(energy) = &model.energy else {
        return Ok(());
    };
    writeln!(
        out,
        "\nEnergy of the next seconds by {}, with the commands that were driven: sum of |forecast − measured| over \
         that of the measured energy. Then coverage and mean width of the 90 % interval, and the \
         narrowest that would have covered as much. The outlook, the last reading and the means \
         do not know the commands. Its score is the \
         interval score through the mean energy",
        model.name
    )?;
    if energy.horizons.is_empty() {
        return writeln!(out, "no stretch of evaluated rows is as long as 1 s");
    }
    write!(out, "{energy}")
}

impl fmt::Display for Comparison {
    fn fmt(&self, out: &mut Formatter<'_>) -> fmt::Result {
        write_model(out, "old: model", &self.old)?;
        write_model(out, "new: model", &self.new)?;
        write_design(out, &self.design, &self.platform)?;
        writeln!(
            out,
            "\nCorrected: from real readings, one tick ahead{}",
            whose(self.scored_rows, self.design.rows, self.untold_rows)
        )?;
        write_sides(out, &self.all)?;
        for member in &self.members {
            let (r2, mae_w) = (Number(member.r2, 0, 4), Number(member.mae_w, 0, 4));
            writeln!(out, "beside them: {}, R² {r2}, MAE {mae_w} W", member.name)?;
        }
        for (what, differences) in
            [("group", &self.groups), ("robot", &self.robots), ("trial", &self.trials)]
        {
            write_differences(out, what, differences)?;
        }
        writeln!(
            out,
            "\nskill: 1 − squared error of the new over that of the old; [ ]: {:.0} % confidence, {} \
             paired draws, seed {}",
            100.0 * self.bootstrap.confidence,
            self.bootstrap.resamples,
            self.bootstrap.seed
        )
    }
}

/// Scores of both models, one score per line.
fn write_sides(out: &mut Formatter<'_>, all: &Difference) -> fmt::Result {
    let nothing = Estimate::alone(f64::NAN);
    writeln!(out, "\n{:20} {:>10} {:>10} {:>10}", "", "old", "new", "new − old")?;
    for (name, old, new, difference) in [
        ("R²", all.old.r2, all.new.r2, &all.r2),
        ("RMSE W", all.old.rmse_w, all.new.rmse_w, &all.rmse_w),
        ("MAE W", all.old.mae_w, all.new.mae_w, &all.mae_w),
        ("bias W", all.old.bias_w, all.new.bias_w, &nothing),
        ("inside interval", all.old.coverage, all.new.coverage, &all.coverage),
        ("interval width W", all.old.width_w, all.new.width_w, &nothing),
        ("skill vs persistence", all.old.skill_persistence, all.new.skill_persistence, &nothing),
    ] {
        writeln!(
            out,
            "{name:20} {} {} {} {}",
            Number(old, 10, 4),
            Number(new, 10, 4),
            Number(new - old, 10, 4),
            between(difference, 1.0, 4),
        )?;
    }
    let spread = between(&all.skill, 1.0, 4);
    let skill = Number(all.skill.value, 0, 4);
    writeln!(out, "new against old: skill {skill} {spread}: {}", all.verdict)?;
    if all.verdict == super::Verdict::CannotTell {
        let (trials, fewest) = (all.trials, super::FEWEST_TRIALS);
        writeln!(
            out,
            "{trials} of at least {fewest} trials: rows of one trial share its floor and load, so \
             that fewer do not tell which model is better. Compare on more recordings"
        )?;
    }
    write!(out, "{} rows", all.rows)?;
    if all.unscored > 0 {
        write!(out, "; {} left out, one of the models has no forecast for them", all.unscored)?;
    }
    writeln!(out)
}

fn write_differences(out: &mut Formatter<'_>, what: &str, all: &[Difference]) -> fmt::Result {
    if all.is_empty() {
        return Ok(());
    }
    let mut listed: Vec<&Difference> = all.iter().collect();
    if what == "trial" && all.len() > MAX_LISTED {
        listed.sort_by(|a, b| a.skill.value.total_cmp(&b.skill.value));
        listed.truncate(WORST);
    }
    let width = name_width(listed.iter().map(|one| short(&one.name)), what.len() + 3);
    writeln!(
        out,
        "\n{:width$} {:>7} {:>8} {:>8} {:>9} {:>9} {:>9} {:>20} {:>8}",
        format!("By {what}"),
        "rows",
        "old R²",
        "new R²",
        "old MAE W",
        "new MAE W",
        "Δ MAE W",
        "",
        "skill"
    )?;
    for one in listed {
        writeln!(
            out,
            "{:width$} {:>7} {} {} {} {} {} {:>20} {} {:18} {}",
            short(&one.name),
            one.rows,
            Number(one.old.r2, 8, 4),
            Number(one.new.r2, 8, 4),
            Number(one.old.mae_w, 9, 3),
            Number(one.new.mae_w, 9, 3),
            Number(one.mae_w.value, 9, 4),
            between(&one.mae_w, 1.0, 4),
            Number(one.skill.value, 8, 4),
            between(&one.skill, 1.0, 3),
            one.verdict,
        )?;
    }
    let count = |verdict| all.iter().filter(|one| one.verdict == verdict).count();
    writeln!(
        out,
        "({} {what}s: {} better, {} worse, {} undecided, {} with too few trials to tell)",
        all.len(),
        count(super::Verdict::Better),
        count(super::Verdict::Worse),
        count(super::Verdict::Undecided),
        count(super::Verdict::CannotTell)
    )
}

/// A file's name without its directory. Other names unchanged.
fn short(name: &str) -> &str {
    name.rsplit('/').next().unwrap_or(name)
}

fn cut(name: &str, most: usize) -> String {
    if name.chars().count() <= most {
        return name.to_owned();
    }
    // Keeps parentheses at the end, such as the forecast's.
    let (base, end) = name.split_at(name.rfind(" (").unwrap_or(name.len()));
    let (base, end) = match end.chars().count() + 1 < most {
        true => (base, end),
        false => (name, ""),
    };
    let kept = most - 1 - end.chars().count();
    let kept: String = base.chars().take(kept).collect();
    format!("{kept}…{end}")
}
