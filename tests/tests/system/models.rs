//! Row 12: damaged model files are refused with the path and the finding, and do not affect a
//! running worker.

use std::path::Path;

use joulebus_config::builtin_model;
use joulebus_tests::{Arena, Setup, figure, script};

const MODEL: &str = "gternal-sim";

/// Defect, file contents, and parts that the message must contain.
type Case = (String, Vec<u8>, Vec<&'static str>);

fn shipped() -> Vec<u8> {
    builtin_model(MODEL).expect("it ships").1.to_vec()
}

/// Offset of the tensor data.
fn data_at(bytes: &[u8]) -> usize {
    let header: [u8; 8] = bytes[..8].try_into().expect("eight");
    8 + u64::from_le_bytes(header) as usize
}

/// The file with `from` in its header replaced by `to` of the same length.
fn with_header(from: &str, to: &str) -> Vec<u8> {
    let mut bytes = shipped();
    assert_eq!(from.len(), to.len());
    let at = bytes
        .windows(from.len())
        .position(|window| window == from.as_bytes())
        .unwrap_or_else(|| panic!("the header lacks {from}"));
    bytes[at..at + to.len()].copy_from_slice(to.as_bytes());
    bytes
}

/// The file with one weight replaced.
fn with_number(position: usize, value: f32) -> Vec<u8> {
    let mut bytes = shipped();
    let at = data_at(&bytes) + 4 * position;
    bytes[at..at + 4].copy_from_slice(&value.to_le_bytes());
    bytes
}

/// The file with the correct digest for its contents, as an attacker could produce it: the refusal
/// of a wrong digest states the expected one.
fn signed(arena: &Arena, path: &Path, mut bytes: Vec<u8>) -> Vec<u8> {
    std::fs::write(path, &bytes).expect("writable directory");
    let errors = arena.run(&["run"]).errors();
    let after = |words: &str| errors.split(words).nth(1).and_then(|rest| rest.get(..64));
    if let (Some(found), Some(stated)) = (after("SHA-256 "), after("metadata says ")) {
        let is_it = |window: &[u8]| window == stated.as_bytes();
        let at = bytes.windows(64).position(is_it).expect("the message states the digest");
        bytes[at..at + 64].copy_from_slice(found.as_bytes());
    }
    bytes
}

/// Files with invalid contents and a valid digest.
fn forged() -> Vec<Case> {
    vec![
        (
            "a transposed weight matrix".to_owned(),
            with_header("[64,11]", "[11,64]"),
            vec!["layers.0.weight", "[11, 64]", "[64, 11]"],
        ),
        (
            "tensors of another type".to_owned(),
            with_header("\"dtype\":\"F32\"", "\"dtype\":\"I32\""),
            vec!["I32", "F32"],
        ),
        ("a NaN weight".to_owned(), with_number(100, f32::NAN), vec!["NaN", "finite"]),
        ("an infinite weight".to_owned(), with_number(3000, f32::INFINITY), vec!["inf", "finite"]),
        (
            "another format version".to_owned(),
            with_header("\"format_version\":\"1\"", "\"format_version\":\"2\""),
            vec!["`format_version` is 2", "allowed: 1"],
        ),
        (
            "a negative variance of residuals".to_owned(),
            with_header("residual_std_w\":\"0.", "residual_std_w\":\"-."),
            vec!["residual_std_w", "is -0."],
        ),
    ]
}

/// Truncated and extended files, and flipped bits.
fn damaged() -> Vec<Case> {
    let whole = shipped();
    let data = data_at(&whole);
    let mut cases = vec![
        ("an empty file".to_owned(), Vec::new(), vec!["refused"]),
        ("text".to_owned(), b"not a model at all".to_vec(), vec!["refused"]),
        ("another weight".to_owned(), with_number(2000, 0.125), vec!["SHA-256", "metadata says"]),
    ];
    for length in [4, 8, 100, data - 1, data, data + 4, whole.len() / 2, whole.len() - 1] {
        cases.push((
            format!("truncated to {length} bytes"),
            whole[..length].to_vec(),
            vec!["refused"],
        ));
    }
    let mut longer = whole.clone();
    longer.extend([0; 4]);
    cases.push(("four bytes too long".to_owned(), longer, vec!["refused"]));
    for at in (data..whole.len()).step_by((whole.len() - data) / 12) {
        let mut flipped = whole.clone();
        flipped[at] ^= 0x10;
        cases.push((format!("byte {at} flipped"), flipped, vec!["refused"]));
    }
    cases
}

#[test]
fn row_12_a_damaged_model_file_is_refused_with_path_and_both_values_and_leaves_no_files() {
    let arena = Arena::new(&Setup::default());
    let path = arena.files().join("model.safetensors");
    let setup = Setup { model: Some(path.clone()), ..Setup::default() };
    std::fs::write(&path, shipped()).unwrap();
    arena.configure(&setup);
    arena.worker().stop();
    let mut cases = damaged();
    for (what, bytes, parts) in forged() {
        cases.push((what, signed(&arena, &path, bytes), parts));
    }
    let refused = cases.len();
    for (what, bytes, parts) in cases {
        std::fs::write(&path, bytes).unwrap();
        let ended = arena.run(&["run"]);
        assert_eq!(ended.code(), Some(1), "{what}: {ended:?}");
        let errors = ended.errors();
        assert!(errors.contains(&path.display().to_string()), "{what}: no path in {errors}");
        assert!(!errors.contains("panicked"), "{what}: {errors}");
        let remedies = errors.matches("Copy or train the model again").count();
        assert!(remedies <= 1, "more than one remedy: {errors}");
        for part in parts {
            assert!(errors.contains(part), "{what}: {part:?} in {errors}");
        }
        assert_eq!(arena.stale_files(), Vec::<std::path::PathBuf>::new(), "{what}");
    }
    std::fs::remove_file(&path).unwrap();
    let missing = arena.run(&["run"]);
    assert!(matches!(missing.code(), Some(1 | 2)), "{missing:?}");
    assert!(missing.errors().contains(&path.display().to_string()), "{}", missing.errors());
    figure("row 12, wrong accepts", format_args!("0 of {refused} damaged files, panics 0"));
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
