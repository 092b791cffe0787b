//! Paths in files: CSV with a header.

use std::path::Path as FilePath;

use anyhow::Context as _;
use joulebus_plan::{Path, Point};
use joulebus_program::exit::UsageError;

/// Maximum size of a path file.
const MAX_BYTES: u64 = 16 << 20;

/// The columns of a path file. Beside the first two, each may be missing.
const COLUMNS: [&str; 6] = ["x_m", "y_m", "speed_mps", "dwell_s", "load_w", "time_s"];

/// Reads a path with `speed_mps` where the file states no speed. Without one, the highest that the
/// model was trained on.
pub(super) fn read(file: &FilePath, speed_mps: Option<f64>) -> anyhow::Result<Path> {
    let named = || format!("path {}", file.display());
    let text = joulebus_files::read_to_string(file, MAX_BYTES).with_context(named)?;
    parse(&text, speed_mps).map_err(|error| UsageError(format!("{}: {error}", named())).into())
}

fn parse(text: &str, speed_mps: Option<f64>) -> Result<Path, String> {
    let lines = text.trim_start_matches('\u{feff}').lines().zip(1..);
    let mut lines = lines.filter(|(line, _)| !line.trim().is_empty());
    let expected =
        format!("expected the columns x_m,y_m and, if wanted, {}", COLUMNS[2..].join(","));
    let (head, _) = lines.next().ok_or_else(|| format!("is empty: {expected}"))?;
    let names: Vec<&str> = head.split(',').map(str::trim).collect();
    let column = |name: &str| names.iter().position(|found| *found == name);
    let twice = (1..names.len()).find(|at| names[..*at].contains(&names[*at]));
    if let Some(at) = twice {
        return Err(format!("line 1 has {:?} twice: {expected}", names[at]));
    }
    let unknown = names.iter().find(|name| !COLUMNS.contains(name));
    let (Some(x), Some(y), None) = (column("x_m"), column("y_m"), unknown) else {
        return Err(format!("line 1 is {head:?}: {expected}"));
    };
    let mut path = Path::default();
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
        path.points.push(Point::new(value(x)?, value(y)?));
        let stated = column("speed_mps").filter(|at| !cells[*at].is_empty());
        let speed_mps = speed_mps.unwrap_or(f64::INFINITY);
        path.speed_mps.push(stated.map_or(Ok(speed_mps), value)?);
        for (name, values) in [("dwell_s", &mut path.dwell_s), ("load_w", &mut path.load_w)] {
            if let Some(at) = column(name) {
                values.push(if cells[at].is_empty() { 0.0 } else { value(at)? });
            }
        }
        if let Some(at) = column("time_s") {
            path.time_s.push(value(at)?);
        }
    }
    if path.points.is_empty() {
        return Err("has a header, but no points: the first is where the robot is".to_owned());
    }
    Ok(path)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn columns_are_found_by_name_and_may_be_left_out() {
        let text = "y_m, x_m ,speed_mps\n\n1,2,\r\n-3.5,4e-1,0.2\n";
        let path = parse(text, None).expect("valid");
        assert_eq!(path.points, [Point::new(2.0, 1.0), Point::new(0.4, -3.5)]);
        assert_eq!(path.speed_mps, [f64::INFINITY, 0.2]);
        assert_eq!(parse(text, Some(0.1)).expect("valid").speed_mps, [0.1, 0.2]);
        let path = parse("x_m,y_m\n0,0\n1,1", Some(0.3)).expect("valid");
        assert_eq!(path.speed_mps, [0.3, 0.3]);
        assert!(path.dwell_s.is_empty() && path.load_w.is_empty() && path.time_s.is_empty());
        let path = parse("x_m,y_m,dwell_s,load_w,time_s\n0,0,,,3\n1,1,5,-2.5,9", None);
        let path = path.expect("valid");
        assert_eq!((path.dwell_s, path.load_w), (vec![0.0, 5.0], vec![0.0, -2.5]));
        assert_eq!(path.time_s, [3.0, 9.0]);
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
            ("x_m,y_m,time_s\n0,0,\n", "line 2: time_s"),
            ("x_m,y_m,dwell_s\n0,0,inf\n", "line 2: dwell_s"),
        ] {
            let error = parse(text, None).expect_err(text);
            assert!(error.contains(expected), "{text:?}: {error}");
        }
    }
}
