//! The seeds, made by our own writers: small, valid, and one of each kind.

#[path = "../../crates/capture/format/tests/format/bag.rs"]
#[allow(dead_code)] // Its tests import what they write.
mod bag;

use std::io::Write as _;
use std::path::Path;

use joulebus_capture_format::{Attachments, CaptureSettings, Message, Preset, Times, Writer};
use joulebus_config::Config;
use joulebus_dataset::trial::{Column, Row, Trial};
use joulebus_fleet::Fleet;
use joulebus_predictor::FeatureSet;
use joulebus_ros_messages::{RosError, TwistStamped, encode};
use joulebus_testkit_fleets::random::network;
use joulebus_testkit_fleets::{MS, PERIOD_NS, Source, healthy};
use joulebus_wire::{
    AnswerHeader, AnswerRow, QueryRecord, SampleHeader, Samples, answer_flag, push_record,
};
use mcap::WriteOptions;

use super::capture::damaged;
use super::frames::{encoded, setting};
use super::keyframes::beginning;

/// Directory, name and bytes of every seed.
pub fn seeds() -> Vec<(&'static str, String, Vec<u8>)> {
    let mut all = Vec::new();
    let mut add = |directory, seeds: Vec<(String, Vec<u8>)>| {
        all.extend(seeds.into_iter().map(|(name, bytes)| (directory, name, bytes)));
    };
    add("config", configs());
    add("frames", frames());
    add("import", recordings());
    add("keyframes", keyframes());
    add("mcap", captures());
    add("model", models());
    add("questions", questions());
    add("ros", ros_messages());
    add("trial_csv", tables());
    add("trial_npy", arrays());
    all
}

fn named(name: &str, bytes: impl Into<Vec<u8>>) -> (String, Vec<u8>) {
    (name.to_owned(), bytes.into())
}

/// Three rows of the published layout.
fn numbers(descr: &str, fortran_order: bool) -> Vec<u8> {
    let order = if fortran_order { "True" } else { "False" };
    let mut text = format!("{{'descr': '{descr}', 'fortran_order': {order}, 'shape': (3, 11), }}");
    while !(10 + text.len() + 1).is_multiple_of(64) {
        text.push(' ');
    }
    text.push('\n');
    let mut bytes = b"\x93NUMPY\x01\x00".to_vec();
    bytes.extend((text.len() as u16).to_le_bytes());
    bytes.extend(text.bytes());
    for place in 0..33_u8 {
        let (row, column) = match fortran_order {
            true => (place % 3, place / 3),
            false => (place / 11, place % 11),
        };
        let value = match column {
            0 => 7.0,
            1 => f64::from(row) / 30.0,
            _ => f64::from(row) + f64::from(column) / 8.0,
        };
        match descr {
            "<f8" => bytes.extend(value.to_le_bytes()),
            ">f8" => bytes.extend(value.to_be_bytes()),
            _ => bytes.extend((value as f32).to_le_bytes()),
        }
    }
    bytes
}

fn arrays() -> Vec<(String, Vec<u8>)> {
    let mut all = vec![
        named("doubles", numbers("<f8", false)),
        named("big-endian", numbers(">f8", false)),
        named("columns", numbers("<f8", true)),
        named("singles", numbers("<f4", false)),
    ];
    all.push(named("written", written("7", "seed.npy")));
    all
}

fn tables() -> Vec<(String, Vec<u8>)> {
    let several = "robot_id,timestamp_s,power_mW,v_mps,note\n\"a, \"\"b\"\"\",0,3600,0.1,x\n2,0.5,3700,,y\n\
                   \"a, \"\"b\"\"\",0.033,3650,NaN,\n2,1.5,nan,-1e-3,z\n";
    vec![
        named("several", several),
        named("written", written("a", "seed.csv")),
        named("zipped", written("a", "seed.csv.gz")),
    ]
}

/// A short trial, written by our writer.
fn written(robot: &str, name: &str) -> Vec<u8> {
    let rows = (0..5).map(|step| {
        let mut values = [f64::NAN; Column::ALL.len()];
        values[Column::Power as usize] = 3.5 + f64::from(step % 2) / 8.0;
        values[Column::V as usize] = 0.1 * f64::from(step);
        Row { timestamp_s: f64::from(step) / 30.0, values }
    });
    let trial = Trial::from_rows(Path::new("rows"), robot, rows).expect("rows are sound");
    let directory = tempfile::tempdir().expect("a directory");
    let path = directory.path().join(name);
    trial.to_table().write(&path).expect("it can be written");
    std::fs::read(path).expect("it was written")
}

fn configs() -> Vec<(String, Vec<u8>)> {
    let small =
        "[fleet]\nname = \"lab\"\n[[platform]]\nfile = \"builtin:rover\"\nrobots = [\"0-9\", 12]\n";
    let whole = Config::parse(small, Path::new("/nonexistent")).expect("a config that is sound");
    let inline = "fleet.name = \"x\"\nfleet.capacity = 5\nplatform = [{ file = \"builtin:gternal\", robots = [1] }]\n\
                  tick.policy = \"timer\"\nworker.cpus = \"0-1,3\"\n";
    let wrong =
        "[fleet]\nnmae = 7\ncapacity = -1\ncapacity = 2\n[[platform]]\nfile = \"builtin:rovre\"\n";
    vec![
        named("small", small),
        named("whole", whole.to_toml()),
        named("inline", inline),
        named("wrong", wrong),
    ]
}

/// Ticks of a few robots in the format of [`super::frames`].
fn frames() -> Vec<(String, Vec<u8>)> {
    let healthy = |options: u8, ticks: usize| {
        let mut steps = vec![options];
        for _ in 0..ticks {
            // A frame of run 1 with robots of three platforms, at once, without a change.
            steps.extend([3, 0, 1, 3, 0, 0, 0, 5, 0, 8, 0]);
            // A period later.
            steps.push(1);
            steps.extend((PERIOD_NS as u32).to_le_bytes());
        }
        steps
    };
    let mut faults = healthy(0, 7);
    // A header with losses, a NaN, a stamp that goes back, a long gap.
    faults.extend([3, 1, 1, 1, 1, 5, 255, 0, 0, 0, 0, 0, 0, 0, 0, 0]);
    faults.extend([3, 1, 1, 1, 0, 0, 1, 9, 0, 0, 0xc0, 0x7f, 0, 0, 0, 0]);
    faults.extend([3, 1, 1, 1, 0, 0, 1, 5, 0, 0, 0, 0xff, 0, 0, 0, 0]);
    faults.extend([0, 1, 3, 2, 0, 0, 0xca, 0x9a, 0x3b]);
    faults.extend(&healthy(0, 7)[1..]);
    vec![
        named("paper", healthy(0, 12)),
        named("freshness-and-learning", healthy(3, 16)),
        named("faults", faults),
    ]
}

fn keyframes() -> Vec<(String, Vec<u8>)> {
    let of = |options: u8| {
        let (settings, models) = setting(options);
        let mut fleet = Fleet::new(settings.clone(), models).expect("the settings agree");
        let begins = beginning(&fleet, settings.fingerprint(), settings.platforms.len()).len();
        let mut source = Source::new(1, 10);
        for step in 0..12 {
            let now_ns = 60_000 * MS + step * PERIOD_NS;
            let samples = [1, 101, 201].map(|robot| healthy(robot, step, now_ns, PERIOD_NS));
            source.tick(&mut fleet, &samples, now_ns);
        }
        [&[options | 4], &encoded(&fleet)[begins..]].concat()
    };
    vec![named("paper", of(0)), named("freshness-and-learning", of(3))]
}

fn questions() -> Vec<(String, Vec<u8>)> {
    let steps = |field: u8, value: u64| [&[1, field][..], &value.to_le_bytes(), &[0; 3]].concat();
    let row =
        AnswerRow { robot: 1, flags: answer_flag::ENERGY, verdict: 1, ..AnswerRow::default() };
    let mut words: Vec<u64> = bytemuck::cast_slice(&[row]).to_vec();
    let mut records = Vec::new();
    let answer = AnswerHeader { rows: 1, ..AnswerHeader::default() };
    let record = QueryRecord { answer, ..QueryRecord::default() };
    assert!(push_record(&mut records, record, &[1.0, 2.0], &words), "it fits");
    words.extend(records);
    let lengths = [[1_u32, 2, 0], [0, 0, 4]].map(|of| of.map(u32::to_le_bytes).concat());
    let bytes: &[u8] = bytemuck::cast_slice(&words);
    let mut all: Vec<_> = ["what-if", "idle", "follow", "rank"]
        .into_iter()
        .zip(0..)
        .map(|(name, choice)| named(name, [choice, 0, 0, 0, 0]))
        .collect();
    all.extend([
        named("nan-coverage", [&[0][..], &steps(9, f32::NAN.to_bits().into())].concat()),
        named("far-return", [&[3][..], &steps(13, 1e6_f64.to_bits())].concat()),
        named("answer-and-records", [&[4, 0][..], &lengths[0], bytes].concat()),
        named("records", [&[4, 0][..], &[0; 12], &bytes[64..]].concat()),
        named("refusal", [&[4, 7][..], &lengths[1], b"why \0\0\0\0"].concat()),
    ]);
    all
}

fn models() -> Vec<(String, Vec<u8>)> {
    let of = |set: FeatureSet| {
        let file = network(1, set).to_safetensors().expect("a network of ours");
        let header = 8 + u64::from_le_bytes(std::array::from_fn(|at| file[at])) as usize;
        let weights = &file[header..header + 256];
        [&[1], file[8..header].trim_ascii_end(), &[0], weights].concat()
    };
    let sets = [FeatureSet::Full, FeatureSet::PowerOnly, FeatureSet::Freshness];
    let mut all: Vec<_> = sets.map(|set| named(set.name(), of(set))).into();
    let empty = b"\x00\x10\x00\x00\x00\x00\x00\x00\x00{\"__metadata__\":{}";
    all.push(named("as-it-is", *empty));
    all.push(named("plain", plain()));
    all
}

/// A network of five readings and one unit, as `joulebus.models.convert` states it: the header, and
/// the bytes of a half.
fn plain() -> Vec<u8> {
    let stated = "{\"unit\":\"W\",\"lag_order\":\"newest-first\",\"activation\":\"relu\"}";
    let mut header = format!("{{\"__metadata__\":{stated}");
    let mut end = 0;
    for (name, shape, count) in [
        ("layers.0.weight", "[1,5]", 5),
        ("layers.0.bias", "[1]", 1),
        ("layers.1.weight", "[1,1]", 1),
        ("layers.1.bias", "[1]", 1),
        ("feature_mean", "[5]", 5),
        ("feature_std", "[5]", 5),
        ("power_mean", "[]", 1),
        ("power_std", "[]", 1),
    ] {
        let begin = end;
        end += 4 * count;
        header.push_str(&format!(
            ",\"{name}\":{{\"dtype\":\"F32\",\"shape\":{shape},\"data_offsets\":[{begin},{end}]}}"
        ));
    }
    header.push('}');
    [&[2], header.as_bytes(), &[0], &0.5_f32.to_le_bytes()].concat()
}

fn captures() -> Vec<(String, Vec<u8>)> {
    let mut all: Vec<_> = damaged::KINDS
        .into_iter()
        .map(|kind| named(&kind.name.replace(' ', "-"), damaged::file(kind)))
        .collect();
    let settings = CaptureSettings::new(Preset::ZstdSmall);
    let mut writer = Writer::new(Vec::new(), settings, &Attachments::default()).expect("memory");
    for step in 0..3 {
        let header = SampleHeader { samples_before: step, ..Source::new(1, 10).header };
        let message = Message::of::<Samples>(header, vec![healthy(1, step, step, PERIOD_NS)]);
        let times = Times { log_ns: step, publish_ns: step };
        writer.write("lab", times, &message).expect("memory");
    }
    let (_, _, own) = writer.finish().expect("memory");
    all.push(named("own", own));
    all
}

fn recordings() -> Vec<(String, Vec<u8>)> {
    let of = |mapping: u8, options: WriteOptions| {
        let mut bag = bag::Bag::with(options);
        bag.channel("/r/battery", "sensor_msgs/msg/BatteryState", "cdr", bag::BATTERY);
        bag.channel("/r/cmd_vel", "geometry_msgs/msg/Twist", "cdr", "");
        bag.channel("/r/odom", "nav_msgs/msg/Odometry", "cdr", "");
        for step in 0..3_u64 {
            let now_ns = 1_700_000_000_000_000_000 + step * 100_000_000;
            bag.message("/r/battery", now_ns, &bag::battery(now_ns, 12.0, -0.5 - step as f32));
            bag.message("/r/cmd_vel", now_ns, &bag::twist(step as f64, -1.0));
        }
        bag.message("/r/odom", 1_700_000_000_000_000_001, &bag::odometry(1 << 60, 1.5, 0.5, 0.3));
        [vec![mapping], bag.bytes()].concat()
    };
    let plain = || WriteOptions::new().use_chunks(false);
    vec![
        named("chunks", of(0, WriteOptions::new())),
        named("plain", of(0, plain())),
        named("plain-by-publish-time", of(3, plain())),
    ]
}

fn ros_messages() -> Vec<(String, Vec<u8>)> {
    let of = |which: u8, message: &dyn Fn() -> Result<Vec<u8>, RosError>| {
        [vec![which, 0, 1, 0, 0], message().expect("short")].concat()
    };
    let (now_ns, twist) = (1_700_000_000_000_000_000, bag::twist(0.2, -1.0));
    let stamped = TwistStamped { header: bag::header(now_ns), twist };
    vec![
        named("battery", of(0, &|| encode(&bag::battery(now_ns, 12.0, -0.5)))),
        named("twist", of(1, &|| encode(&twist))),
        named("twist-stamped", of(2, &|| encode(&stamped))),
        named("odometry", of(3, &|| encode(&bag::odometry(now_ns, 1.5, 0.5, 0.3)))),
    ]
}

/// Writes every seed below `directory`.
///
/// # Errors
/// Errors of the file system.
pub fn write(directory: &Path) -> std::io::Result<()> {
    for (kind, name, bytes) in seeds() {
        let directory = directory.join(kind);
        std::fs::create_dir_all(&directory)?;
        std::fs::File::create(directory.join(name))?.write_all(&bytes)?;
    }
    Ok(())
}
