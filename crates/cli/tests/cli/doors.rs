//! Every kind of finding at every door, in every format: docs/reference/plausibility.md has the
//! table. Each refusal names the option with which the door reads the recording.
//! `JOULEBUS_WRITE=1 cargo test -p joulebus --test cli doors` writes it again.

use std::collections::BTreeMap;
use std::fs;
use std::io::Cursor;
use std::path::{Path, PathBuf};
use std::process::Output;

use joulebus_testkit::assert_page_contains;

use super::fleet::{Fleet, code, done, output, stderr, stdout};

/// Doors, with what stands for the recording.
const DOORS: [(&str, &str); 9] = [
    ("data check", "data check RECORDING"),
    ("import", "import RECORDING -o OUT"),
    ("config init", "config init --from RECORDING -o OUT"),
    ("train", "train trials RECORDING --split time --recipe RECIPE --out OUT.safetensors"),
    ("eval", "eval RECORDING@0 --config FLEET --resamples 0"),
    ("analyze", "analyze RECORDING --split time"),
    ("report", "report RECORDING --model builtin:gternal-sim -o OUT"),
    ("publish trial", "publish trial RECORDING@0 --config FLEET --no-wait --rate max"),
    (
        "model compare",
        "model compare builtin:gternal-sim builtin:gternal-sim RECORDING --resamples 0",
    ),
];

/// Planted faults: the finding, and its cause.
const PLANTED: [(&str, &str); 17] = [
    ("", "nothing"),
    ("sign", "a current that is negative while discharging"),
    ("unit", "V, A and W in columns of mV, mA and mW"),
    ("unit", "voltage and current without a unit"),
    ("unit", "a voltage in mV beside a current in A without a unit"),
    ("unit", "a charge of 0 to 100"),
    ("clock", "times of whole seconds"),
    ("clock", "a recording that was appended to another one"),
    ("hold", "a command that never ends"),
    ("never-came", "a column that is named and empty"),
    ("range", "a speed of 30 m/s in a tenth of the rows"),
    ("saturation", "a monitor at 2^15 − 1"),
    ("sentinel", "−999 in every tenth reading"),
    ("mismatch", "a power of another circuit"),
    ("constant", "a current of 0 in every reading"),
    ("constant", "a current of 0.25 A in every reading, and power made of it"),
    ("", "a charger in the second half"),
];

/// Options with which verbs read what was planted, in a text.
const REMEDIES: [(&str, &str); 2] = [
    ("a current that is negative while discharging", "--current discharge-negative"),
    ("voltage and current without a unit", "--map voltage_V=voltage,current_A=current"),
];

/// Columns that only a text has.
const OF_TEXT: [&str; 3] = [
    "voltage and current without a unit",
    "a voltage in mV beside a current in A without a unit",
    "a column that is named and empty",
];

const FORMATS: [&str; 4] = ["CSV", ".npy", "capture", "ROS 2 bag"];
const ROWS: u32 = 300;

/// A row of a robot of 12 V and some 0.25 A: time, voltage, current, power, commands, measured
/// speeds, charge.
fn row(number: u32, planted: &str) -> [f64; 9] {
    let step = f64::from(number);
    let load_a = 0.25 + 0.02 * (0.7 * step).sin() + 0.01 * (2.9 * step).cos();
    let volt = 12.0 - 0.1 * load_a + 0.001 * (5.1 * step).sin();
    let (v, omega) = (0.1 + 0.01 * (0.3 * step).sin(), 0.2 * (0.21 * step).cos());
    let soc = 0.8 - 1e-5 * step;
    let [mut t, mut u, mut i, mut p] = [step / 30.0, volt * 1e3, load_a * 1e3, volt * load_a * 1e3];
    let [mut v, mut omega, mut v_meas, mut soc] = [v, omega, 0.1, soc];
    match planted {
        "a current that is negative while discharging" => [i, p] = [-i, -p],
        "V, A and W in columns of mV, mA and mW" => [u, i, p] = [u * 1e-3, i * 1e-3, p * 1e-3],
        "voltage and current without a unit" => [u, i] = [u * 1e-3, i * 1e-3],
        "a voltage in mV beside a current in A without a unit" => i *= 1e-3,
        "a charge of 0 to 100" => soc *= 100.0,
        "a recording that was appended to another one" if number >= ROWS / 2 => {
            t -= f64::from(ROWS / 2) / 30.0;
        }
        "−999 in every tenth reading" if number.is_multiple_of(10) => [i, p] = [-999.0; 2],
        "a power of another circuit" => p *= 1.5,
        "times of whole seconds" => t = t.floor(),
        "a command that never ends" if number >= 100 => [v, omega, v_meas] = [0.1, 0.0, 0.0],
        "a speed of 30 m/s in a tenth of the rows" if number.is_multiple_of(10) => v = 30.0,
        "a monitor at 2^15 − 1" if number % 7 < 4 => i = 327.67,
        "a current of 0 in every reading" => i = 0.0,
        "a current of 0.25 A in every reading, and power made of it" => [i, p] = [250.0, 0.25 * u],
        "a current that nobody measures" => [i, p] = [1000.0, u],
        _ if is_docked(number, planted) => {
            [i, p, v, omega, v_meas] = [-2900.0 + i, u * (-2.9 + 1e-3 * i), 0.0, 0.0, 0.0];
        }
        _ => {}
    }
    [t, u, i, p, v, omega, v_meas, 0.0, soc]
}

fn is_docked(number: u32, planted: &str) -> bool {
    match planted {
        "a charger in the second half" => number >= ROWS / 2,
        planted => planted == "nothing but a charger",
    }
}

fn table(planted: &str, is_array: bool) -> String {
    let empty = planted == "a column that is named and empty";
    let unstated = OF_TEXT.contains(&planted) && !empty;
    let header = match (unstated, is_array) {
        (true, _) => "timestamp_s,voltage,current,v_cmd_mps,omega_cmd_radps",
        (_, true) => "timestamp_s,voltage_mV,current_mA,power_mW,v_cmd_mps,omega_cmd_radps",
        _ => {
            "timestamp_s,voltage_mV,current_mA,power_mW,v_cmd_mps,omega_cmd_radps,v_meas_mps,omega_meas_radps,soc"
        }
    };
    let mut text = header.to_owned() + if empty { ",charge\n" } else { "\n" };
    for number in 0..ROWS {
        let [t, u, i, p, v, omega, v_meas, omega_meas, soc] = row(number, planted);
        text += &match (unstated, is_array) {
            (true, _) => format!("{t},{u},{i},{v},{omega}"),
            (_, true) => format!("{t},{u},{i},{p},{v},{omega}"),
            (_, false) if empty => format!("{t},{u},{i},{p},{v},{omega},{v_meas},{omega_meas},,"),
            _ => format!("{t},{u},{i},{p},{v},{omega},{v_meas},{omega_meas},{soc}"),
        };
        text.push('\n');
    }
    text
}

/// A bag with batteries and commands as ROS has them; `None` where it cannot have this.
pub(super) fn bag(planted: &str) -> Option<Vec<u8>> {
    let write = |f: &mut Vec<u8>, number: f32| f.extend(number.to_le_bytes());
    let mut writer =
        mcap::WriteOptions::new().profile("ros2").create(Cursor::new(Vec::new())).unwrap();
    let mut channel = |topic: &str, kind: &str| {
        let schema = writer.add_schema(kind, "ros2msg", b"").unwrap();
        writer.add_channel(schema, topic, "cdr", &BTreeMap::new()).unwrap()
    };
    let battery = channel("/battery_state", "sensor_msgs/msg/BatteryState");
    let command = channel("/cmd_vel", "geometry_msgs/msg/Twist");
    let odometry = channel("/odom", "nav_msgs/msg/Odometry");
    let mut message = |channel_id, at_ns: u64, data: &[u8]| {
        let header = mcap::records::MessageHeader {
            channel_id,
            sequence: 0,
            log_time: at_ns,
            publish_time: at_ns,
        };
        writer.write_to_known_channel(&header, data).unwrap();
    };
    for number in 0..ROWS {
        let [t, u, i, _, v, omega, v_meas, omega_meas, soc] = row(number, planted);
        let mut at_ns = 1_700_000_000_000_000_000 + u64::from(number) * 33_333_333;
        if planted == "a recording that was appended to another one" && number >= ROWS / 2 {
            at_ns -= u64::from(ROWS / 2) * 33_333_333;
        }
        let stamp_ns = match planted {
            "times of whole seconds" => 1_700_000_000_000_000_000 + t as u64 * 1_000_000_000,
            _ => at_ns,
        };
        let [sec, nanosec] = [stamp_ns / 1_000_000_000, stamp_ns % 1_000_000_000];
        let mut header = vec![0, 1, 0, 0];
        header.extend((sec as i32).to_le_bytes());
        header.extend((nanosec as u32).to_le_bytes());
        // An empty frame's name, and what aligns the numbers after it.
        header.extend([1, 0, 0, 0, 0, 0, 0, 0]);
        let mut data = header.clone();
        // The current is negative while discharging, in mA and mV above.
        let (volt, ampere) = match planted {
            "V, A and W in columns of mV, mA and mW" => (u * 1e6, -i * 1e3),
            _ => (u, -i),
        };
        for value in [volt * 1e-3, f64::NAN, ampere * 1e-3, f64::NAN, f64::NAN, f64::NAN, soc] {
            write(&mut data, value as f32);
        }
        // Charging or discharging, health and technology unknown, present; no cells, no names.
        let status = if is_docked(number, planted) { 1 } else { 2 };
        data.extend([
            status, 0, 0, 1, 0, 0, 0, 0, 0, 0, 0, 0, 1, 0, 0, 0, 0, 0, 0, 0, 1, 0, 0, 0, 0,
        ]);
        message(battery, at_ns, &data);
        if planted != "a command that never ends" || number < 100 {
            let mut data = vec![0, 1, 0, 0];
            for value in [v, 0.0, 0.0, 0.0, 0.0, omega] {
                data.extend(value.to_le_bytes());
            }
            message(command, at_ns, &data);
        }
        let mut data = header;
        data.extend([1, 0, 0, 0, 0, 0, 0, 0]);
        // Aligned to 8 after the encapsulation.
        while (data.len() - 4) % 8 != 0 {
            data.push(0);
        }
        let pose = [0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0];
        let twist = [v_meas, 0.0, 0.0, 0.0, 0.0, omega_meas];
        for values in [&pose[..], &[0.0; 36], &twist, &[0.0; 36]] {
            for value in values {
                data.extend(value.to_le_bytes());
            }
        }
        message(odometry, at_ns, &data);
    }
    writer.finish().unwrap();
    // Its power is voltage times current.
    let is_of_tables = OF_TEXT.contains(&planted) || planted == "a power of another circuit";
    (!is_of_tables).then(|| writer.into_inner().into_inner())
}

/// The recording in a format; `None` where the format cannot have what is planted.
fn recording(folder: &Path, planted: &str, format: &str) -> Option<PathBuf> {
    let csv = folder.join("recording.csv");
    fs::write(&csv, table(planted, format == ".npy")).unwrap();
    let made = |name: &str, words: &str| {
        let path = folder.join(name);
        let (csv, to) = (csv.display().to_string(), path.display().to_string());
        let words = words.replace("CSV", &csv).replace("TO", &to);
        done(words.split(' '));
        Some(path)
    };
    let accepted = "sign,unit,clock,hold,range,saturation,constant,never-came,sentinel,mismatch";
    let is_appended = planted == "a recording that was appended to another one";
    match format {
        "CSV" => Some(csv),
        _ if OF_TEXT.contains(&planted) => None,
        // joulebus writes a trial for each of them.
        "capture" if is_appended => None,
        // Without measured speeds and a charge.
        ".npy" if ["a charge of 0 to 100", "a command that never ends"].contains(&planted) => None,
        ".npy" => made("recording.npy", "data convert CSV --out TO"),
        // Its messages have no measured speed, and times that advance.
        "capture" if ["times of whole seconds", "a command that never ends"].contains(&planted) => {
            None
        }
        "capture" => made("recording.mcap", &format!("import CSV -o TO --accept {accepted}")),
        _ => {
            let path = folder.join("bag.mcap");
            fs::write(&path, bag(planted)?).unwrap();
            Some(path)
        }
    }
}

/// Words of an import's note about a fault that it corrects by itself.
fn notes_of(kind: &str) -> &'static [&'static str] {
    match kind {
        "unit" => &["percentage"],
        "clock" => &["the time of recording is used", "clock was set back"],
        "hold" => &["after the last command: it is unknown (command_holds_s)"],
        _ => &[],
    }
}

/// The outcome of a recording at a door.
fn cell(door: &str, kind: &str, printed: &Output) -> &'static str {
    let (out, errors) = (stdout(printed), stderr(printed));
    let refused = errors.contains("implausible") && errors.contains(&format!("  {kind}: "));
    let warns = |kind: &str| errors.contains(&format!("warning: {kind}: "));
    let is_read = matches!(code(printed), 0 | 3);
    let warns_of_any = PLANTED.iter().any(|(kind, _)| !kind.is_empty() && warns(kind));
    match code(printed) {
        _ if kind.is_empty() && is_read && !warns_of_any && !out.contains("fault: ") => "read",
        // Accepted, a current that nobody measures would be a number.
        1 if refused && errors.contains("it is not measured") => "refused",
        1 if refused && errors.contains(&format!("--accept {kind}")) => "refused",
        3 if door == "data check" && !kind.is_empty() && out.contains("fault: ") => "fault",
        _ if is_read && warns(kind) => "warned",
        _ if is_read && notes_of(kind).iter().any(|note| out.contains(note)) => "read, said",
        found => panic!("{door}: {kind:?}: exit code {found}\n{out}{errors}"),
    }
}

fn cells(
    number: usize,
    (kind, planted): (&str, &str),
    fleet: &Fleet,
) -> Vec<(&'static str, String)> {
    let mut lines = Vec::new();
    let recipe = fleet.path("recipe.toml").display().to_string();
    for format in FORMATS {
        let folder = fleet.path(&format!("{number}{format}").replace(' ', ""));
        fs::create_dir(&folder).unwrap();
        let mut line = Vec::new();
        let recording = recording(&folder, planted, format);
        for (at, (door, words)) in DOORS.iter().enumerate() {
            let takes = match format {
                // Other verbs read what it makes.
                "ROS 2 bag" => *door == "import",
                _ => true,
            };
            let Some(recording) = recording.as_ref().filter(|_| takes) else {
                line.push("–");
                continue;
            };
            let replaced = |word: &str| {
                let out = folder.join(format!("out{at}")).display().to_string();
                let word = word.replace("RECORDING", &recording.display().to_string());
                let word = word.replace("FLEET", &fleet.config().display().to_string());
                word.replace("OUT", &out).replace("RECIPE", &recipe)
            };
            let mut words: Vec<String> = words.split(' ').map(replaced).collect();
            if kind == "never-came" {
                words.extend(["--map", "soc=charge"].map(str::to_owned));
            }
            let refused = output(&words);
            line.push(cell(door, kind, &refused));
            let has_remedy = |(of, _): &&(&str, &str)| *of == planted && format == "CSV";
            if let Some((_, remedy)) = REMEDIES.iter().find(has_remedy) {
                let (out, told) = (folder.join(format!("out{at}")), stdout(&refused));
                let told = told + &stderr(&refused);
                assert!(told.contains(remedy.split(',').next().unwrap()), "{door}: {told}");
                assert!(!out.exists() && !out.with_extension("safetensors").exists(), "{door}");
                words.extend(remedy.split(' ').map(str::to_owned));
                assert_eq!(cell(door, "", &output(&words)), "read", "{door} {remedy}");
            }
        }
        let alike = line[2..].iter().all(|cell| *cell == line[2]);
        assert!(alike, "{kind}: {planted}, {format}: verbs differ: {line:?}");
        lines.push((format, line[..3].join(" | ")));
    }
    lines
}

#[test]
fn no_door_is_silent_about_any_kind_in_any_format() {
    let fleet = Fleet::new();
    // All kinds may be published at the same time.
    let config = fs::read_to_string(fleet.config()).unwrap();
    fs::write(fleet.config(), config.replace("max_sources = 4", "max_sources = 32")).unwrap();
    fs::write(fleet.path("recipe.toml"), "[training]\nmax_epochs = 1\n").unwrap();
    let found: Vec<_> = std::thread::scope(|scope| {
        let all = PLANTED.iter().enumerate();
        let fleet = &fleet;
        let start = |(number, planted)| scope.spawn(move || cells(number, planted, fleet));
        let threads: Vec<_> = all.map(|(number, planted)| start((number, *planted))).collect();
        threads.into_iter().map(|thread| thread.join().unwrap()).collect()
    });
    let mut text = "| finding | planted | in | data check | import | each other verb |\n\
        |---|---|---|---|---|---|\n"
        .to_owned();
    for ((kind, planted), lines) in PLANTED.iter().zip(found) {
        let mut same: Vec<(Vec<&str>, String)> = Vec::new();
        for (format, line) in lines {
            let nowhere = line.split(" | ").all(|cell| cell == "–");
            match same.iter_mut().find(|(_, known)| *known == line) {
                _ if nowhere => {}
                Some((formats, _)) => formats.push(format),
                None => same.push((vec![format], line)),
            }
        }
        for (formats, line) in same {
            text += &format!("| `{kind}` | {planted} | {} | {line} |\n", formats.join(", "))
                .replace("``", "");
        }
    }
    assert_page_contains("docs/reference/plausibility.md", &[text]);
}
