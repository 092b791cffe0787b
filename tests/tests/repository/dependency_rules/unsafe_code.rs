//! Files allowed to contain `unsafe`, and the required SAFETY comments.

use std::fs;

use super::words::places;
use super::{Member, crates, members, sources};

#[test]
fn unsafe_code_is_only_in_the_listed_files() {
    let allowed = [
        "predictor/src/kernel/avx2.rs",
        "predictor/src/kernel/avx512.rs",
        "predictor/src/kernel/neon.rs",
        "predictor/src/kernel/forward.rs",
        "predictor/src/kernel/prefetch.rs",
        // A trait that guarantees initialisation, and its implementation for one lane.
        "predictor/src/kernel/lanes.rs",
        "predictor/src/kernel/scalar.rs",
        // Memory of C callers, and exported functions.
        "c/src/memory.rs",
        "c/src/question.rs",
        "c/src/abi/client.rs",
        "c/src/abi/errors.rs",
        "c/src/abi/predictor.rs",
        "c/src/abi/publisher.rs",
        "c/src/abi/questions.rs",
        "c/src/abi/subscriber.rs",
    ];
    for Member { name, directory, .. } in members().iter().filter(|member| member.name != "bus") {
        let src = directory.join("src");
        let found = places(
            &src,
            &["unsafe {", "unsafe impl", "unsafe fn", "unsafe extern", "unsafe trait"],
            &allowed,
        );
        assert_eq!(found, Vec::<String>::new());
        // A crate has a library, a binary, or both.
        let root = fs::read_to_string(src.join("lib.rs"));
        let root = root.or_else(|_| fs::read_to_string(src.join("main.rs"))).unwrap();
        let level = if ["predictor", "c"].contains(&name.as_str()) { "deny" } else { "forbid" };
        let lint = format!("#![{level}(unsafe_code)]");
        // The workspace denies it; `predictor` and `c` allow it in the files above.
        assert!(level == "deny" || root.contains(&lint), "{name} lacks {lint}");
    }
}

#[test]
fn every_unsafe_block_has_a_safety_comment() {
    for (path, text) in sources(&crates()) {
        let lines: Vec<&str> = text.lines().collect();
        for (number, line) in lines.iter().enumerate() {
            let opens = line.contains("unsafe {") || line.contains("unsafe impl");
            if !opens || line.trim_start().starts_with("//") {
                continue;
            }
            let above = &lines[number.saturating_sub(8)..number];
            let is_explained = above.iter().any(|line| line.contains("SAFETY:"));
            assert!(is_explained, "{}:{} has no SAFETY: above it", path.display(), number + 1);
        }
    }
}
