//! Recordings of every kind.

use std::fs;
use std::io::Write as _;
use std::path::{Path, PathBuf};

use joulebus_capture_format::{Attachments, CaptureSettings, Message, Times, Writer};
use joulebus_wire::{SCHEMA_VERSION, Sample, SampleHeader, Samples, sample_flag};

/// Unix time of the first sample of [`capture`], ns: ten seconds before a midnight.
pub(crate) const BEGIN_NS: u64 = 1_795_391_990_000_000_000;

/// A number from 0 to 1 that looks random.
fn noise(seed: u64) -> f64 {
    let mut value = seed.wrapping_mul(0x9e37_79b9_7f4a_7c15) ^ 0x1234_5678;
    value = (value ^ (value >> 29)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    (value >> 11) as f64 / (1_u64 << 53) as f64
}

fn power_mw(row: u64, seed: u64) -> f64 {
    let row_s = row as f64 / 30.0;
    12_000.0 + 3_000.0 * (row_s * 0.7).sin() + 400.0 * noise(row * 131 + seed)
}

/// A CSV of the published layout with everything that one may have: missing values, held readings,
/// gaps, an unknown column, whole numbers, −0.
pub(crate) fn full(folder: &Path, name: &str, rows: u64, seed: u64) -> PathBuf {
    let mut text = String::from(
        "robot_id,timestamp_s,phase,v_cmd_mps,omega_cmd_radps,x_m,y_m,theta_rad,voltage_mV,current_mA,power_mW,\
         v_meas_mps,omega_meas_radps,soc,mood\n",
    );
    for row in 0..rows {
        let gap_s = if row > rows / 2 { 3.25 } else { 0.0 };
        let time_s = row as f64 / 30.0 + gap_s;
        let v = 0.2 + 0.1 * noise(row / 9 + seed);
        let read_mw = power_mw(if row % 97 == 14 { row - 2 } else { row }, seed);
        let power = if row % 97 == 13 { "NaN".to_owned() } else { read_mw.to_string() };
        let voltage_mv = 7_400 - row / 100;
        let soc = if row % 30 == 0 { (1.0 - row as f64 / 1e5).to_string() } else { String::new() };
        text += &format!(
            "7,{time_s},{},{v},-0,{},,0.1,{},{},{power},{v},0,{soc},fine\n",
            row / 50,
            row as f64 * 0.01,
            voltage_mv,
            read_mw / voltage_mv as f64 * 1e3
        );
    }
    write(folder, name, text.trim_end())
}

/// A CSV of some robots with times and powers alone.
pub(crate) fn sparse(folder: &Path, name: &str, rows: u64, robots: u64) -> PathBuf {
    let mut text = String::from("robot_id,time_s,power_W\n");
    for row in 0..rows {
        for robot in 0..robots {
            let power_w = power_mw(row, robot) / 1000.0;
            let time_s = 1e5 + row as f64 / 10.0;
            // A name with quotes and an apparent escape.
            text += &format!("\"r/{robot} \"\"ü\"\" %41=,\",{time_s},{power_w}\n");
        }
    }
    write(folder, name, &text)
}

fn write(folder: &Path, name: &str, text: &str) -> PathBuf {
    let path = folder.join(name);
    let mut file = fs::File::create(&path).unwrap();
    file.write_all(text.as_bytes()).unwrap();
    path
}

/// A capture of several robots over a midnight, with a discontinuity, missing readings and a
/// battery.
pub(crate) fn capture(folder: &Path, name: &str, frames: u64, robots: u32) -> PathBuf {
    let path = folder.join(name);
    let settings = CaptureSettings::default();
    let mut writer =
        Writer::new(fs::File::create_new(&path).unwrap(), settings, &Attachments::default())
            .unwrap();
    let period_ns = 1_000_000_000 / 30;
    for frame in 0..frames {
        let stamp_ns = 5_000_000_000 + frame * period_ns;
        let sample = |robot: u32| sample(robot, frame, stamp_ns, frames / 2);
        let header = SampleHeader {
            schema: SCHEMA_VERSION,
            source_id: 3,
            source_epoch: 9,
            frame_seq: frame,
            ..SampleHeader::default()
        };
        let at_ns = BEGIN_NS + frame * period_ns;
        let times = Times { log_ns: at_ns, publish_ns: at_ns };
        let samples = (0..robots).map(sample).collect();
        let message = Message::of::<Samples>(header, samples);
        writer.write("yard 3", times, &message).unwrap();
    }
    writer.finish().unwrap();
    path
}

fn sample(robot: u32, frame: u64, stamp_ns: u64, broken_at: u64) -> Sample {
    let mut sample = Sample::new(robot, frame, stamp_ns);
    sample.v_mps = 0.1 + 0.1 * noise(frame / 11) as f32;
    sample.omega_radps = -0.0;
    sample.flags |= sample_flag::V | sample_flag::OMEGA;
    if robot == 1 && frame == broken_at {
        sample.flags |= sample_flag::DISCONTINUITY;
    }
    if frame % 41 != 40 {
        sample.power_w = (power_mw(frame, u64::from(robot)) / 1000.0) as f32;
        sample.measured_ns = stamp_ns - 1_000_000;
        sample.voltage_v = 7.4;
        sample.current_a = sample.power_w / sample.voltage_v;
        sample.flags |= sample_flag::POWER | sample_flag::VOLTAGE | sample_flag::CURRENT;
    }
    if robot == 2 {
        sample.soc = 0.75;
        sample.flags |= sample_flag::SOC;
    }
    sample
}

/// Recordings of every kind in a folder.
pub(crate) fn every_kind(folder: &Path) {
    fs::create_dir_all(folder.join("deep")).unwrap();
    for number in 0..4 {
        full(folder, &format!("full_{number}.csv"), 400, number);
    }
    sparse(folder, "deep/sparse.csv", 300, 3);
    capture(folder, "run.mcap", 600, 3);
}
