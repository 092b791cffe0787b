//! The built-in platforms accept every row of the real recordings.

use std::io::Read as _;
use std::path::Path;

use flate2::read::GzDecoder;
use joulebus_config::Config;
use joulebus_settings::Platform;
use joulebus_testkit::recordings::trials;

/// Seconds, m/s, rad/s and W of each row. NaN if not recorded.
fn rows(path: &Path) -> Vec<[f64; 4]> {
    let mut text = String::new();
    let file = std::fs::File::open(path).expect("a recording");
    GzDecoder::new(file).read_to_string(&mut text).expect("gzip of text");
    let mut lines = text.lines();
    let names: Vec<&str> = lines.next().expect("a header").split(',').collect();
    let columns = ["timestamp_s", "v_cmd_mps", "omega_cmd_radps", "power_mW"]
        .map(|name| names.iter().position(|found| *found == name).expect("the column"));
    lines
        .map(|line| {
            let fields: Vec<&str> = line.split(',').collect();
            let row = columns.map(|at| fields[at].parse::<f64>().expect("a number"));
            [row[0], row[1], row[2], row[3] / 1000.0]
        })
        .collect()
}

fn platform(name: &str) -> Platform {
    let text = format!(
        "[fleet]\nname = \"recorded\"\n[[platform]]\nfile = \"builtin:{name}\"\nrobots = [0]\n"
    );
    let config = Config::parse(&text, Path::new(".")).unwrap_or_else(|error| panic!("{error}"));
    config.settings().platforms[0].clone()
}

/// Longest times, ns: between two rows, and of constant power.
#[derive(Default)]
struct Longest {
    gap_ns: f64,
    equal_ns: f64,
}

fn check_rows(platform: &Platform, rows: &[[f64; 4]], longest: &mut Longest, file: &str) {
    let (mut before, mut changed) = (rows[0], rows[0][0]);
    for row in rows {
        let [time_s, v_mps, omega_radps, power_w] = *row;
        assert!(
            f64::from(platform.power_min_w) <= power_w
                && power_w <= f64::from(platform.power_max_w),
            "{file}: {power_w} W"
        );
        // NaN means not recorded: such a row carries no command.
        let allowed = |value: f64, max: f32| value.is_nan() || value.abs() <= f64::from(max);
        assert!(allowed(v_mps, platform.v_max_mps), "{file}: {v_mps} m/s");
        assert!(allowed(omega_radps, platform.omega_max_radps), "{file}: {omega_radps} rad/s");
        if power_w != before[3] {
            changed = time_s;
        }
        longest.gap_ns = longest.gap_ns.max((time_s - before[0]) * 1e9);
        longest.equal_ns = longest.equal_ns.max((time_s - changed) * 1e9);
        before = *row;
    }
}

#[test]
fn no_recorded_row_is_out_of_its_platforms_limits() {
    let folders = [
        ("robotino", "robotino", 264_476),
        ("borealtc_husky", "husky", 54_151),
        ("ase_rover", "rover", 28_260),
    ];
    for (folder, name, expected) in folders {
        let Some(paths) = trials(folder) else {
            return;
        };
        let platform = platform(name);
        let mut longest = Longest::default();
        let mut count = 0;
        for path in paths {
            let rows = rows(&path);
            count += rows.len();
            check_rows(&platform, &rows, &mut longest, &path.to_string_lossy());
        }
        assert_eq!(count, expected, "{name}");
        assert!(longest.gap_ns < platform.stale_after_ns as f64, "{name}: {} ns", longest.gap_ns);
        assert!(longest.gap_ns < platform.hold_max_ns as f64, "{name}: {} ns", longest.gap_ns);
        assert!(
            longest.equal_ns < platform.stuck_after_ns as f64,
            "{name}: {} ns",
            longest.equal_ns
        );
    }
}
