//! Messages that a neighbour may send over a link. The protocol is compiled in here: its crate is a
//! program.
#![cfg_attr(fuzzing, no_main)]
#![allow(dead_code, reason = "the link uses the rest")]

#[path = "../../crates/gateways/link/src/protocol/hostile.rs"]
mod hostile;
#[path = "../../crates/gateways/link/src/protocol/mod.rs"]
mod protocol;

#[cfg(fuzzing)]
libfuzzer_sys::fuzz_target!(|bytes: &[u8]| {
    let _ = hostile::run(bytes);
});

#[cfg(not(fuzzing))]
fn main() -> std::io::Result<()> {
    for path in std::env::args_os().skip(1).map(std::path::PathBuf::from) {
        let taken = hostile::run(&std::fs::read(&path)?);
        let how = if taken { "accepted" } else { "refused" };
        println!("{}: {how}", path.display());
    }
    Ok(())
}
