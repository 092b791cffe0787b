//! `joulebus model`: import and export of foreign formats.

use std::io::Read as _;
use std::path::{Path, PathBuf};

use super::fleet::{Exits as _, Fleet, code, done, json, output, stderr, stdout};
use joulebus_testkit::assert_contains;

const SHIPPED: &str =
    concat!(env!("CARGO_MANIFEST_DIR"), "/../../configs/models/gternal-sim.safetensors");
const CONVENTION: &str = "mW+newest-first+lags-last+d-normalised-per-second+abs-as-velocity";

/// A model file of NumPy or PyTorch from the tests of `model-files`.
fn foreign(folder: &Path, name: &str) -> PathBuf {
    let packed = format!("../lab/model-files/tests/fixtures/{name}.gz");
    let packed = std::fs::File::open(Path::new(env!("CARGO_MANIFEST_DIR")).join(packed)).unwrap();
    let mut bytes = Vec::new();
    flate2::read::GzDecoder::new(packed).read_to_end(&mut bytes).unwrap();
    let path = folder.join(name);
    std::fs::write(&path, bytes).unwrap();
    path
}

fn text(path: &Path) -> &str {
    path.to_str().unwrap()
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
fn a_foreign_file_is_shown_imported_exported_and_read_back() {
    let fleet = Fleet::new();
    let folder = tempfile::tempdir().unwrap();
    let data = fleet.recording("a.csv", 400);
    let at = |name: &str| folder.path().join(name);
    for name in ["flat.npy", "checkpoint.pt", "state_dict_legacy.pt"] {
        let file = foreign(folder.path(), name);
        let info = json(&output(["--format", "json", "model", "info", text(&file)]));
        assert_eq!(info["network"]["layers"][3]["inputs"], 32, "{name}");

        let out = at("imported.safetensors");
        let import = ["model", "import", text(&file), "--out", text(&out)];
        let without_data = output(import).exits(2);
        assert!(stderr(&without_data).contains("--data"));
        let data = ["--data", text(&data), "--convention", CONVENTION];
        let data = data.iter().chain(&["--format", "json"]);
        let imported = json(&output(import.iter().chain(data)));
        assert_eq!(imported["convention"], CONVENTION);

        for exported in ["model.npz", "model.onnx", "model.safetensors"] {
            let exported = at(exported);
            done(["model", "export", text(&out), "--out", text(&exported)]);
        }
        let arrays = at(&format!("{name}-arrays"));
        let (from, to) = (text(&out), text(&arrays));
        done(["model", "export", from, "--to", "npy", "--out", to]);
        for exported in [at("model.npz"), at("model.safetensors"), arrays] {
            let again = at("again.safetensors");
            done(["model", "import", text(&exported), "--out", text(&again)]);
            assert_eq!(std::fs::read(&again).unwrap(), std::fs::read(&out).unwrap());
        }
    }
}

#[test]
fn an_unreadable_or_unwritable_file_sets_exit_code_and_reason() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    let canary = at("canary");
    let mut evil = b"\x80\x02\x8a\x0a\x6c\xfc\x9c\x46\xf9\x20\x6a\xa8\x50\x19.".to_vec();
    let command = format!("touch {}", canary.display());
    evil.extend(format!("cos\nsystem\n(S'{command}'\ntR.").bytes());
    std::fs::write(at("evil.pt"), evil).unwrap();
    let npy = foreign(folder.path(), "flat.npy");
    let out = at("out.bin");
    let names = [&at("evil.pt"), &at("nothing.pt"), &npy, &out].map(|path| text(path).to_owned());
    let [evil, nothing, npy, bin] = names;
    let full = text(folder.path());
    for (arguments, expected, expected_text) in [
        (format!("info {evil}"), 1, "os.system"),
        (format!("info {nothing}"), 1, "nothing.pt"),
        (format!("export {SHIPPED} --out {bin}"), 2, "--to"),
        (format!("export {npy} --to npz --out {bin}"), 2, "Import it"),
        (format!("import {npy} --out {bin} --convention x"), 2, "is not a convention"),
        (format!("export {SHIPPED} --to npy --out {full}"), 2, "not empty"),
    ] {
        let done = output(["model"].into_iter().chain(arguments.split(' ')));
        let errors = stderr(&done);
        assert_eq!(code(&done), expected, "{arguments}: {errors}");
        assert!(errors.contains(expected_text), "{arguments}: {errors}");
    }
    assert!(!canary.exists());
    assert!(!out.exists());
}
