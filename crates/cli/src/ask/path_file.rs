//! Paths in files: CSV with a header.

use std::path::Path as FilePath;

use anyhow::Context as _;
use joulebus_plan::{Path, Point};
use joulebus_program::exit::UsageError;

/// Maximum size of a path file.
const MAX_BYTES: u64 = 16 << 20;

/// The rows of a path file: at least one.
#[derive(Debug, PartialEq)]
pub(super) struct Rows {
    points: Vec<Point>,
    /// m/s. `None` where the file states none.
    speed_mps: Vec<Option<f64>>,
}

impl Rows {
    /// Converts it to a path, with `speed_mps` where the file states no speed. Without one, as fast
    /// as the platform can.
    pub(super) fn path(&self, speed_mps: Option<f64>) -> Path {
        let otherwise_mps = speed_mps.unwrap_or(f64::INFINITY);
        let speeds = self.speed_mps.iter();
        Path {
            points: self.points.clone(),
            speed_mps: speeds.map(|speed| speed.unwrap_or(otherwise_mps)).collect(),
            heading_rad: None,
        }
    }
}

pub(super) fn read(file: &FilePath) -> anyhow::Result<Rows> {
    let named = || format!("path {}", file.display());
    let text = joulebus_files::read_to_string(file, MAX_BYTES).with_context(named)?;
    parse(&text).map_err(|error| UsageError(format!("{}: {error}", named())).into())
}

fn parse(text: &str) -> Result<Rows, String> {
    let lines = text.trim_start_matches('\u{feff}').lines().zip(1..);
    let mut lines = lines.filter(|(line, _)| !line.trim().is_empty());
    let expected = "expected the columns x_m,y_m and, if wanted, speed_mps";
    let (head, _) = lines.next().ok_or_else(|| format!("is empty: {expected}"))?;
    let names: Vec<&str> = head.split(',').map(str::trim).collect();
    let column = |name: &str| names.iter().position(|found| *found == name);
    let twice = (1..names.len()).find(|at| names[..*at].contains(&names[*at]));
    if let Some(at) = twice {
        return Err(format!("line 1 has {:?} twice: {expected}", names[at]));
    }
    let unknown = names.iter().find(|name| !["x_m", "y_m", "speed_mps"].contains(name));
    let (Some(x), Some(y), None) = (column("x_m"), column("y_m"), unknown) else {
        return Err(format!("line 1 is {head:?}: {expected}"));
    };
    let mut rows = Rows { points: Vec::new(), speed_mps: Vec::new() };
    for (line, number) in lines {
        let cells: Vec<&str> = line.split(',').map(str::trim).collect();
        if cells.len() != names.len() {
            let (found, allowed) = (cells.len(), names.len());
            return Err(format!("line {number} has {found} values, the header {allowed}"));
        }
        let value = |at: usize| {
            let parsed = cells[at].parse::<f64>().ok().filter(|value| value.is_finite());
            parsed.ok_or_else(|| {
                format!("line {number}: {} = {:?} is no number", names[at], cells[at])
            })
        };
        rows.points.push(Point::new(value(x)?, value(y)?));
        let stated = column("speed_mps").filter(|at| !cells[*at].is_empty());
        rows.speed_mps.push(stated.map(value).transpose()?);
    }
    if rows.points.is_empty() {
        return Err("has a header, but no points: the first is where the robot is".to_owned());
    }
    Ok(rows)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn columns_are_found_by_name_and_speeds_may_be_left_out() {
        let rows = parse("y_m, x_m ,speed_mps\n\n1,2,\r\n-3.5,4e-1,0.2\n").expect("valid");
        assert_eq!(rows.points, [Point::new(2.0, 1.0), Point::new(0.4, -3.5)]);
        assert_eq!(rows.speed_mps, [None, Some(0.2)]);
        assert_eq!(rows.path(None).speed_mps, [f64::INFINITY, 0.2]);
        assert_eq!(rows.path(Some(0.1)).speed_mps, [0.1, 0.2]);
        let rows = parse("x_m,y_m\n0,0\n1,1").expect("valid");
        assert_eq!(rows.path(Some(0.3)).speed_mps, [0.3, 0.3]);
    }

    #[test]
    fn wrong_files_are_refused_with_the_line() {
        for (text, expected) in [
            ("", "empty"),
            ("0,0\n1,1\n", "x_m,y_m"),
            ("x_m,y_m,z_m\n0,0,0\n", "x_m,y_m"),
            ("x_m,y_m,x_m\n0,0,1\n", "\"x_m\" twice"),
            ("x_m,y_m\n", "no points"),
            ("x_m,y_m\n0,0\n1\n", "line 3"),
            ("x_m,y_m\n0,0\n1,one\n", "line 3: y_m"),
            ("x_m,y_m\nNaN,0\n", "line 2: x_m"),
            ("x_m,y_m,speed_mps\n0,0,fast\n", "line 2: speed_mps"),
        ] {
            let error = parse(text).expect_err(text);
            assert!(error.contains(expected), "{text:?}: {error}");
        }
    }
}
