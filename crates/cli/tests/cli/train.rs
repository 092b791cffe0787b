//! `joulebus train trials`: from recordings to a model that the worker loads.

use super::fleet::{Fleet, code, done, json, output, stderr, stdout};

#[test]
fn a_model_is_trained_and_its_split_is_reported() {
    let fleet = Fleet::new();
    let folder = tempfile::tempdir().unwrap();
    let data: Vec<String> = (0..4)
        .map(|trial| {
            let path = fleet.recording(&format!("run_{trial}.csv"), 300 + 20 * trial);
            path.to_str().unwrap().to_owned()
        })
        .collect();
    let out = folder.path().join("model.safetensors");
    let out = out.to_str().unwrap();
    let recipe = folder.path().join("recipe.toml");
    std::fs::write(&recipe, "[training]\nmax_epochs = 3\nbatch = 64\n").unwrap();
    let recipe = recipe.to_str().unwrap();

    let mut wanted = vec!["--format", "json", "train", "trials"];
    wanted.extend(data.iter().map(String::as_str));
    wanted.extend(["--recipe", recipe, "--seed", "5", "--out", out]);
    let trained = done(wanted.clone());
    let report = json(&trained);
    assert_eq!(report["epochs"], 3);
    assert_eq!(report["model"], "model");
    assert_eq!(report["split"]["by"], "trial");
    for part in ["training", "validation", "held_out"] {
        assert!(!report["split"][part].as_array().unwrap().is_empty(), "{report}");
    }
    let info = done(["model", "info", out]);
    let hash = report["model_hash"].as_str().unwrap();
    assert!(stdout(&info).contains(hash), "{}", stdout(&info));

    let again = output(wanted);
    assert_eq!(json(&again)["model_hash"], hash, "the same seed, the same bytes");
}

#[test]
fn unusable_recordings_are_refused_with_a_remedy() {
    let fleet = Fleet::new();
    let folder = tempfile::tempdir().unwrap();
    let files = [("one.csv", 300), ("two.csv", 320), ("copy.csv", 300)];
    let files = files.map(|(name, rows)| fleet.recording(name, rows));
    let [one, two, copy] = files.each_ref().map(|file| file.to_str().unwrap());
    let out = folder.path().join("model.safetensors");
    let out = out.to_str().unwrap();
    for (arguments, named) in [
        (vec![one], "at least 3 are needed"),
        (vec![one, "--resume", "--split", "time"], "there is no checkpoint"),
        (vec![one, "--validate", one, "--hold-out", one], "is in two parts"),
        (vec![one, "--validate", two, "--hold-out", copy], "are the same recording"),
    ] {
        let mut wanted = vec!["train", "trials"];
        wanted.extend(arguments);
        wanted.extend(["--out", out]);
        let refused = output(wanted);
        assert_eq!(code(&refused), 2, "{named}: {}", stderr(&refused));
        assert!(stderr(&refused).contains(named), "{}", stderr(&refused));
    }
    assert!(!std::path::Path::new(out).exists());
}

#[test]
fn what_lies_in_the_place_of_a_checkpoint_is_neither_overwritten_nor_removed() {
    let fleet = Fleet::new();
    let folder = tempfile::tempdir().unwrap();
    let one = fleet.recording("one.csv", 300);
    let one = one.to_str().unwrap();
    let out = folder.path().join("model.safetensors");
    let saved = folder.path().join("model.safetensors.training");
    let out = out.to_str().unwrap();
    let trials = ["train", "trials", one, "--split", "time", "--out", out];
    let resumed = [trials.as_slice(), &["--resume"]].concat();
    let simulated = ["train", "sim", "--seed", "1", "--out", out];
    std::fs::write(&saved, "somebody's").unwrap();
    for (arguments, wanted, named) in [
        (trials.as_slice(), 2, "--resume"),
        (&simulated, 2, "--resume"),
        (&resumed, 1, "cannot continue"),
    ] {
        let refused = output(arguments.iter().copied());
        assert_eq!(code(&refused), wanted, "{arguments:?}: {}", stderr(&refused));
        assert!(stderr(&refused).contains(named), "{}", stderr(&refused));
        assert_eq!(std::fs::read_to_string(&saved).unwrap(), "somebody's");
    }
    assert!(!std::path::Path::new(out).exists());
}
