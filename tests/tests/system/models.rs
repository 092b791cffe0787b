//! Damaged model files are refused with the path and the finding. A worker reads its model once, as
//! bytes: no later change of the file affects it.

use joulebus_config::builtin_model;
use joulebus_testkit::assert_contains;
use joulebus_tests::{Arena, Setup};

const MODEL: &str = "gternal-sim";

fn shipped() -> Vec<u8> {
    builtin_model(MODEL).expect("it ships").1.to_vec()
}

/// `predictor`'s tests of files have the other damages.
#[test]
fn row_12_a_damaged_model_file_is_refused_with_its_path_and_leaves_no_files() {
    let arena = Arena::new(&Setup::default());
    let path = arena.files().join("model.safetensors");
    arena.configure(&Setup { model: Some(path.clone()), ..Setup::default() });
    let mut flipped = shipped();
    *flipped.last_mut().unwrap() ^= 0x10;
    for (bytes, part) in [(flipped, "SHA-256"), (shipped()[..1_000].to_vec(), "refused")] {
        std::fs::write(&path, bytes).unwrap();
        let ended = arena.run(&["run"]);
        assert_eq!(ended.code(), Some(1), "{ended:?}");
        assert_contains(&ended.errors(), [part, &path.display().to_string()]);
        let remedies = ended.errors().matches("Copy or train the model again").count();
        assert!(remedies <= 1, "more than one remedy: {}", ended.errors());
        assert_eq!(arena.stale_files(), Vec::<std::path::PathBuf>::new());
    }
    std::fs::remove_file(&path).unwrap();
    let missing = arena.run(&["run"]);
    assert!(matches!(missing.code(), Some(1 | 2)), "{missing:?}");
    assert_contains(&missing.errors(), [&path.display().to_string()]);
}
