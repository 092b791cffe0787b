//! Row 12: damaged model files are refused with the path and the finding, and do not affect a
//! running worker.

use joulebus_config::builtin_model;
use joulebus_testkit::assert_contains;
use joulebus_tests::{Arena, Setup, figure, script};

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

#[test]
fn row_12_overwriting_a_loaded_model_file_does_not_affect_the_worker() {
    let robots = [0, 1, 2];
    let play = |garbage: bool| {
        let arena = Arena::new(&Setup::default());
        let path = arena.files().join("model.safetensors");
        std::fs::write(&path, shipped()).unwrap();
        let setup = Setup { model: Some(path.clone()), ..Setup::default() };
        arena.configure(&setup);
        let mut worker = arena.worker();
        let mut planner = arena.planner();
        let mut source = arena.source("fleet");
        let frames = script(&robots, 60, setup.period_ns());
        for (at, frame) in frames.iter().enumerate() {
            if at == 20 && garbage {
                std::fs::write(&path, vec![0xa5; 30_000]).unwrap();
            }
            if at == 40 && garbage {
                std::fs::remove_file(&path).unwrap();
            }
            planner.play(&mut source, std::slice::from_ref(frame));
        }
        let answers = planner.answers(|_| true);
        source.leave();
        planner.leave();
        worker.stop();
        answers
    };
    let (clean, disturbed) = (play(false), play(true));
    assert!(disturbed.len() >= 160, "{}", disturbed.len());
    for (key, answer) in &disturbed {
        assert_eq!(clean.get(key).unwrap_or(answer), answer, "robot {} sample {}", key.0, key.1);
    }
    figure(
        "row 12, the old model keeps serving",
        format_args!("{} answers, 0 differ by a bit", disturbed.len()),
    );
}
