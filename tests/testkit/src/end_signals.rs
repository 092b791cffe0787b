//! The signals that end a program cleanly.

use rustix::process::Signal;

/// SIGTERM, SIGINT and SIGHUP; without SIGHUP if this process ignores it (`nohup`), because its
/// children then do as well.
pub fn end_signals() -> Vec<Signal> {
    let mut signals = vec![Signal::TERM, Signal::INT];
    if ignores(std::process::id(), Signal::HUP) {
        println!("skipped: SIGHUP is ignored here, as under nohup");
    } else {
        signals.push(Signal::HUP);
    }
    signals
}

/// True if the process ignores the signal, by /proc. A shell without job control starts background
/// jobs with SIGINT ignored, and children inherit it.
///
/// # Panics
/// There is no such process.
pub fn ignores(pid: u32, signal: Signal) -> bool {
    let status = std::fs::read_to_string(format!("/proc/{pid}/status")).expect("a process");
    let ignored = status.lines().find_map(|line| line.strip_prefix("SigIgn:"));
    let ignored = ignored.and_then(|mask| u64::from_str_radix(mask.trim(), 16).ok());
    ignored.expect("Linux lists it") >> (signal.as_raw() - 1) & 1 == 1
}
