//! `joulebus model`: networks of other programs in, models out.

use std::fmt::Write as _;
use std::path::{Path, PathBuf};

use super::fleet::{Exits as _, Fleet, code, done, json, output, stderr, stdout};
use joulebus_testkit::assert_contains;

const SHIPPED: &str =
    concat!(env!("CARGO_MANIFEST_DIR"), "/../../configs/models/gternal-sim.safetensors");

fn text(path: &Path) -> &str {
    path.to_str().unwrap()
}

/// A network of five readings that forecasts the first one of them, as `joulebus.models.convert`
/// writes it.
fn plain(path: PathBuf, lag_order: &str) -> PathBuf {
    let tensors: [(&str, &str, &[f32]); 8] = [
        ("layers.0.weight", "[2,5]", &[1.0, 0.0, 0.0, 0.0, 0.0, -1.0, 0.0, 0.0, 0.0, 0.0]),
        ("layers.0.bias", "[2]", &[0.0; 2]),
        ("layers.1.weight", "[1,2]", &[1.0, -1.0]),
        ("layers.1.bias", "[1]", &[0.0]),
        ("feature_mean", "[5]", &[3.6; 5]),
        ("feature_std", "[5]", &[1.0; 5]),
        ("power_mean", "[]", &[3.6]),
        ("power_std", "[]", &[1.0]),
    ];
    let mut header = format!(
        "{{\"__metadata__\":{{\"unit\":\"W\",\"lag_order\":\"{lag_order}\",\"activation\":\"relu\"}}"
    );
    let mut data: Vec<u8> = Vec::new();
    for (name, shape, values) in tensors {
        let begin = data.len();
        data.extend(values.iter().flat_map(|value| value.to_le_bytes()));
        let end = data.len();
        write!(
            header,
            ",\"{name}\":{{\"dtype\":\"F32\",\"shape\":{shape},\"data_offsets\":[{begin},{end}]}}"
        )
        .unwrap();
    }
    header.push('}');
    let length = (header.len() as u64).to_le_bytes();
    std::fs::write(&path, [&length[..], header.as_bytes(), &data].concat()).unwrap();
    path
}

/// A recording whose power changes slowly.
fn slow(path: PathBuf) -> PathBuf {
    let mut text = "timestamp_s,power_mW,v_cmd_mps,omega_cmd_radps\n".to_owned();
    for row in 0..400_u32 {
        let (time_s, power_mw) =
            (f64::from(row) / 30.0, 3_600.0 + 300.0 * (f64::from(row) / 10.0).sin());
        writeln!(text, "{time_s},{power_mw},0.1,0.2").unwrap();
    }
    std::fs::write(&path, text).unwrap();
    path
}

#[test]
fn info_describes_a_native_model() {
    let info = done(["model", "info", SHIPPED]);
    let parts = "11→64→64→32→1 | 7041 parameters | gelu_erf | power_lag5_w | simulation | R²";
    assert_contains(&stdout(&info), parts.split(" | "));
    let info = json(&output(["--format", "json", "model", "info", SHIPPED]));
    assert_eq!(info["parameters"], 7041);
    assert_eq!(info["features"].as_array().unwrap().len(), 11);
    let shown = output(["model", "info", SHIPPED]);
    assert_contains(&stdout(&shown), [info["model_hash"].as_str().unwrap()]);
}

#[test]
fn a_converted_network_is_imported_as_stated_and_exported() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    let data = slow(at("slow.csv"));
    let out = at("model.safetensors");
    let import = |file: &Path| {
        let (file, out, data) =
            (text(file).to_owned(), text(&out).to_owned(), text(&data).to_owned());
        let words = ["--format", "json", "model", "import", &file, "--out", &out, "--data", &data];
        output(words)
    };
    let oldest = plain(at("oldest.safetensors"), "oldest-first");
    let refused = import(&oldest).exits(1);
    let better =
        "convert it again with unit=\"W\", lag_order=\"newest-first\", activation=\"relu\"";
    assert_contains(&stderr(&refused), ["contradict the stated convention", better]);
    assert!(!out.exists());

    let newest = plain(at("newest.safetensors"), "newest-first");
    let imported = json(&import(&newest));
    assert_eq!(imported["widths"].as_array().unwrap().len(), 3);
    assert_contains(imported["convention"].as_str().unwrap(), ["newest-first"]);
    assert!(imported["scores"]["r2"].as_f64().unwrap() > 0.9);
    let info = json(&output(["--format", "json", "model", "info", text(&out)]));
    assert_eq!(info["model_hash"], imported["model_hash"]);
    assert_contains(info["source"].as_str().unwrap(), ["newest.safetensors", "newest-first"]);
    for exported in ["model.npz", "model.onnx", "again.safetensors", "model.py"] {
        done(["model", "export", text(&out), "--out", text(&at(exported))]);
    }
    let again = std::fs::read(at("again.safetensors")).unwrap();
    assert_eq!(again, std::fs::read(&out).unwrap());
    // Exports are for other programs.
    for exported in ["model.npz", "model.onnx"] {
        let refused = output(["model", "info", text(&at(exported))]).exits(1);
        assert_contains(&stderr(&refused), ["joulebus.models.convert("]);
    }
}

#[test]
fn a_file_of_another_program_is_refused_at_every_verb_with_the_call_that_converts_it() {
    let fleet = Fleet::new();
    let trial = fleet.recording("trial.csv", 200);
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    let canary = at("canary");
    let legacy = b"\x80\x02\x8a\x0a\x6c\xfc\x9c\x46\xf9\x20\x6a\xa8\x50\x19.";
    let command = format!("cos\nsystem\n(S'touch {}'\ntR.", canary.display());
    let object =
        b"\x93NUMPY\x01\x00\x46\x00{'descr': '|O', 'fortran_order': False, 'shape': (), }\n";
    let foreign = b"\x40\0\0\0\0\0\0\0{\"net.0.weight\":{\"dtype\":\"F32\",\"shape\":[1],\"data_offsets\":[0,4]}}  \0\0\0\0";
    for (name, contents) in [
        ("evil.pt", [&legacy[..], command.as_bytes()].concat()),
        ("zip.pth", b"PK\x03\x04\x14\0\0\0".to_vec()),
        ("paper.npy", [&object[..], command.as_bytes()].concat()),
        ("model.pkl", [b"\x80\x04", command.as_bytes()].concat()),
        ("model.onnx", b"\x08\x08\x12\x07pytorch".to_vec()),
        ("state.safetensors", foreign.to_vec()),
    ] {
        let file = at(name);
        std::fs::write(&file, contents).unwrap();
        let (file, out, data) = (text(&file), text(&at("out")).to_owned(), text(&trial));
        for words in [
            format!("model info {file}"),
            format!("model import {file} --data {data} --out {out}"),
            format!("model export {file} --to npz --out {out}"),
            format!("model compare {file} {SHIPPED} {data}"),
            format!("eval {data} --model {file}"),
        ] {
            let refused = output(words.split(' ')).exits(1);
            let call = format!("joulebus.models.convert({file:?}, ");
            assert_contains(
                &stderr(&refused),
                [call.as_str(), "`joulebus model import ", "--data"],
            );
        }
    }
    assert!(!canary.exists() && !at("out").exists());
    // A converted one is not imported yet.
    let converted = plain(at("plain.safetensors"), "newest-first");
    let refused = output(["model", "info", text(&converted)]).exits(1);
    assert_contains(&stderr(&refused), ["a converted network", "`joulebus model import "]);
}

#[test]
fn an_unreadable_or_unwritable_file_sets_exit_code_and_reason() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    let out = at("out.bin");
    let (nothing, bin) = (text(&at("nothing.pt")).to_owned(), text(&out).to_owned());
    for (arguments, expected, expected_text) in [
        (format!("info {nothing}"), 1, "nothing.pt"),
        (format!("export {SHIPPED} --out {bin}"), 2, "--to"),
        (format!("import {SHIPPED} --data x.csv --out {bin}"), 2, "is a joulebus model already"),
        (format!("import {nothing} --out {bin}"), 2, "--data"),
        (format!("import {nothing} --out {bin} --convention x"), 2, "joulebus.models.convert"),
        (format!("info {nothing} --part x"), 2, "joulebus.models.convert"),
    ] {
        std::fs::write(at("there"), "").unwrap();
        let done = output(["model"].into_iter().chain(arguments.split(' ')));
        let errors = stderr(&done);
        assert_eq!(code(&done), expected, "{arguments}: {errors}");
        assert!(errors.contains(expected_text), "{arguments}: {errors}");
    }
    assert!(!out.exists());
}
