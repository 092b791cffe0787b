#!/usr/bin/env python3
"""Puts defects into the sources, one at a time, and prints the seed of the simulator or the test that finds each.

    tools/mutations.py [--seeds N] [--only NAME,...]
    tools/mutations.py --check      only looks whether the texts to be replaced are still there

Each defect is a replacement of text, wherever it occurs in its file. The file is restored afterwards, also after Ctrl-C. Needs a clean work tree
below crates/. Exits with 1 if a defect was not found.
"""
import argparse
import json
import os
import pathlib
import subprocess
import sys
import time

ROOT = pathlib.Path(__file__).resolve().parent.parent


def has_test(file, test):
    """Whether the file's crate has a test, or a module of tests, that begins like the last word."""
    begin = test.split()[-1].split("::")[0]
    crate = next(folder for folder in source(file).parents if (folder / "Cargo.toml").exists())
    texts = (path.read_text() for path in crate.glob("**/*.rs"))
    return any(f"fn {begin}" in text or f"mod {begin}" in text for text in texts)


def source(file):
    """The source of a crate, whose folder is not named."""
    found = [path for path in (ROOT / "crates").glob(f"**/{file}") if "target" not in path.relative_to(ROOT).parts]
    if len(found) != 1:
        sys.exit(f"{file}: {len(found)} files of that name below crates/, wanted 1")
    return found[0]


# Name, file of a crate, text, replacement, and a test if it is none of the simulator that finds the defect.
MUTATIONS = [
    # Found before, each put back.
    ("worker runs by the wall clock", "predictor-worker/src/worker.rs",
     "worker_epoch: clock::monotonic_ns()", "worker_epoch: clock::unix_ns()"),
    ("source runs by the wall clock", "publisher/src/publisher.rs",
     "source_epoch: clock::monotonic_ns()", "source_epoch: clock::unix_ns()"),
    ("readers believe any process", "bus/src/liveness/worker_ports.rs",
     "owner.port_pid == process_of(port)", "owner.port_pid == process_of(port) || true"),
    ("silent sources keep their places", "fleet/src/ingest/sources.rs",
     "is_silent_for(self.leave_after_ns, now_ns).then_some(at)",
     "is_silent_for(u64::MAX, now_ns).then_some(at)"),
    ("the ledger's checksum is not compared", "predictor-worker/src/ledger_files.rs",
     "if content.fnv1a != expected {", "if content.fnv1a != expected && false {"),
    ("the ledger has one generation", "predictor-worker/src/ledger_files.rs",
     "disk::rename(&self.newest, self.older())", "disk::remove_file(&self.newest)"),
    ("saves are planned too late", "predictor-worker/src/save_schedule.rs",
     "(self.every_ns / 4 * 3)", "(self.every_ns * 4)"),
    # Found by the simulator, each put back.
    ("an earlier stamp counts time twice", "fleet/src/ledger/energy.rs",
     "self.stamp_ns.max(stamp_ns)", "stamp_ns"),
    ("accounts lose their order at a reboot", "predictor-worker/src/checkpoint.rs",
     "now_ns.saturating_sub(later)", "now_ns.saturating_sub(later * 0)"),
    ("the recorder's losses overflow", "capture/recorder/src/shared.rs",
     "lost.overwritten.saturating_add(overwritten)", "lost.overwritten + overwritten"),
    # Further ones.
    ("the ledger's file is not synced", "predictor-worker/src/ledger_files.rs",
     "        file.sync_all()?;\n", ""),
    ("renames of the ledger are not synced", "predictor-worker/src/ledger_files.rs",
     "disk::sync_directory(self.folder())", "Ok(())"),
    ("a capture's folder is not synced", "capture/recorder/src/capture_file.rs",
     "disk::sync_directory(folder.unwrap_or(Path::new(\".\")))", "Ok(drop(folder))"),
    ("the ledger is never saved", "predictor-worker/src/checkpointer.rs",
     "        self.changed |= changed;\n", "        let _ = changed;\n"),
    ("a save that was cut off is emptied", "predictor-worker/src/ledger_files.rs",
     "        if self.is_unfinished {\n", "        if self.is_unfinished && false {\n"),
    ("a save that was cut off is not secured", "predictor-worker/src/checkpointer.rs",
     "files.secure()", "Ok::<(), LedgerFileError>(())"),
    ("memory of each save is leaked", "predictor-worker/src/ledger_files.rs",
     "file.write_all(&encode(self.generation + 1, ledger)?)?;",
     "file.write_all(Vec::leak(encode(self.generation + 1, ledger)?))?;"),
    ("planners that poll take a shutdown for a death", "consumer/src/subscriber.rs",
     "polling.poller.watch_worker(header.pid);", "let _ = &polling.poller;"),
    ("accounts forget unmetered time", "predictor-worker/src/checkpoint.rs",
     "unmetered_ns: budget.unmetered_ns,", "unmetered_ns: 0,"),
    ("overwritten samples are not counted", "fleet/src/ingest/sources.rs",
     "        drops.add(reason, lost);\n", "        let _ = (&drops, reason);\n"),
    ("refused samples are not counted", "fleet/src/fleet/intake.rs",
     "        self.drops.add(reason, 1);\n", ""),
    ("every source may send for a robot", "fleet/src/ingest/check.rs",
     "return Err(DropReason::ForeignSource);", "let _ = DropReason::ForeignSource;"),
    ("planners take older frames", "consumer/src/newest.rs",
     "let newer = Some(order) > *at;", "let newer = Some(order) != *at;"),
    ("planners do not notice ends nor silence", "consumer/src/tracker.rs",
     "let changed = worse != self.reported;", "let changed = worse != self.reported && self.reported != Reported::Nothing;"),
    ("a failed flush stays in the file", "capture/recorder/src/capture_file.rs",
     "self.file.set_len(flushed_bytes)", "self.file.set_len(self.bytes)"),
    ("the journal states other times", "predictor-worker/src/journal.rs",
     "taken_ns: now_ns,", "taken_ns: now_ns / 2,"),
    ("robots without a sample take an account's place", "fleet/src/fleet/membership.rs",
     "if ledger.stamp_ns().is_none() {", "if ledger.stamp_ns().is_none() && false {"),
    ("frames of one number are taken for each other", "capture/verify/src/lib.rs",
     "= next.parts.ambiguous {", "= next.parts.ambiguous.filter(|_| false) {"),
    ("a false time ends a file", "capture/recorder/src/drain.rs",
     "log_ns: clock.unix_ns(clock::monotonic_ns()),", "log_ns: 0,"),
    ("a false number panics", "fleet/src/ingest/sources.rs",
     "header.samples_before.saturating_add(samples)", "(header.samples_before + samples)"),
    # Of questions.
    ("connections of clients that left are kept", "bus/src/ports/connection_leak.rs",
     "self.left >= MAX_LEFT || (self.left > 0", "self.left >= usize::MAX || (self.left == usize::MAX"),
    ("answers state another tick", "planner/src/planner.rs",
     "answer.tick = states.tick;", "answer.tick = states.tick + 1_000;"),
    ("answers are not counted", "plan-server/src/server.rs",
     "        self.counts.answered += 1;\n", ""),
    # Of boards and bridges.
    ("missed frames are not counted", "board/src/board.rs",
     "            self.frames_missed += missed;\n", "            let _ = missed;\n"),
    ("boards skip frames", "board/src/feed.rs",
     "            borrow().forecasts(header, robots, readable_ns);\n",
     "            if header.tick % 7 > 0 {\n                borrow().forecasts(header, robots, readable_ns);\n            }\n"),
    ("boards keep parts of an earlier forecast", "board/src/board.rs",
     "        row.forecast = *forecast;\n", "        row.forecast.power_w = forecast.power_w;\n"),
    ("a feed that ends keeps its ports", "board/src/feed.rs",
     "    fn finish(self) -> Result<(), FeedError> {\n",
     "    fn finish(self) -> Result<(), FeedError> {\n        std::mem::forget(self);\n"),
    ("a bridge stamps by half", "bridge/src/publishing.rs",
     "publish_stamped(intended_ns, stamp_ns, states)", "publish_stamped(intended_ns, stamp_ns / 2, states)"),
    # Of links: found by fleets over several hosts.
    ("a link takes messages again", "link/src/protocol/receiver.rs",
     "if (position.sent_ns, position.number) <= (last.sent_ns, last.number) {",
     "if position.sent_ns == 0 {"),
    ("samples of other hosts keep their times", "link/src/intake.rs",
     "        shift(sample, offset_ns);\n", "        let _ = (&sample, offset_ns);\n"),
    ("an acquisition by another counts as one's own", "link/src/protocol/lease.rs",
     "Reply::Acquired(true)) => {", "Reply::Acquired(_)) => {"),
    ("a lease lasts longer than the store says", "link/src/protocol/lease.rs",
     "ttl_ns.saturating_sub(apart_ns).min(MAX_TTL_NS)", "(ttl_ns + apart_ns).max(MAX_TTL_NS)"),
    ("runs go back when a worker's host boots", "link/src/output_port.rs",
     "(run, run.max(last.saturating_add(1)))", "(run, run.min(last.saturating_add(run)))"),
    ("a hang is forgotten with its term", "link/src/leadership.rs",
     "permit.is_some_and(|permit| !permit.holds(clock::boot_ns()))", "permit.is_some_and(|_| false)"),
    ("a link that starts again forgets a hang", "link/src/standby.rs",
     "        let ttl_ns = u64::from(lease.ttl_s)",
     "        if leader_lease.is_none() {\n            Permit::withdraw(&leadership.places().permit)?;\n        }\n        let ttl_ns = u64::from(lease.ttl_s)"),
    ("messages to a host that was paused are from the future", "link/src/protocol/receiver.rs",
     " && !self.has_stepped(status, now_ns)", ""),
    ("the lease of a worker that hangs is renewed", "link/src/protocol/lease.rs",
     "(!self.resigns && !self.is_idle).then_some", "(!self.resigns).then_some"),
    # Of links: found by their own tests.
    ("whoever polls first takes a free lease", "link/src/protocol/lease.rs",
     "self.rank * (self.poll_interval_ns() + ACQUISITION_NS)", "self.rank * ACQUISITION_NS",
     "--bin joulebus-link a_free_lease"),
    ("the margin of a lease is that of a crystal", "link/src/protocol/lease.rs",
     "const DRIFT_DIVISOR: u64 = 6;", "const DRIFT_DIVISOR: u64 = 200;", "--bin joulebus-link at_no_time"),
    ("lanes are dropped only at the limit", "link/src/protocol/stream.rs",
     "self.lanes.len() >= MAX_LANES", "self.lanes.len() == MAX_LANES", "--bin joulebus-link lanes_of_sources"),
    ("requests are of any certificate", "link/src/proof.rs",
     "        if own != name {\n", "        if own != name && false {\n", "--bin joulebus-link proof::"),
    ("a request needs no signature", "link/src/proof.rs",
     "return Ok(age_ns < TOKEN_TIMEOUT_NS);", "return Ok(true);", "--test hosts no_certificate_requests"),
    ("followers have no access rules", "link/src/network.rs",
     "settings.mode == Mode::Peer {\n            let value", "peers.is_worker {\n            let value",
     "--test hosts a_host_that_listens"),
    ("a link that gets nothing waits for ever", "link/src/network.rs",
     "self.session.close(now_ns);", "", "--test hosts a_link_whose_peer"),
]


def run(command):
    return subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)


def find_by_test(test):
    """The test that fails."""
    os.environ["PROPTEST_DISABLE_FAILURE_PERSISTENCE"] = "1"
    failed = run(["cargo", "test", "-q", "-p", "joulebus-link", *test.split()]).returncode
    return {"seed": None, "failure": {"invariant": test}} if failed else None


def find(file, seeds):
    """The first seed that fails, of batches, with its failure."""
    linked = ["--linked"] if file.startswith("link/") else []
    target = pathlib.Path(os.environ.get("CARGO_TARGET_DIR", ROOT / "target"))
    program = target / "debug/joulebus-sim"
    first, batch = 1, 20
    while first <= seeds:
        done = run([program, "--from", str(first), "--seeds", str(batch), "--no-shrink", "--format", "json", *linked])
        failed = json.loads(done.stdout)["failed"] if done.stdout else []
        if failed:
            return failed[0]
        first += batch
    return None


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seeds", type=int, default=400, help="seeds tried for each defect")
    parser.add_argument("--only", help="names, separated by commas, or parts of them")
    parser.add_argument("--check", action="store_true", help="look for the texts, build nothing")
    asked = parser.parse_args()
    if asked.check:
        gone = [f"{name}: {file}" for name, file, old, *_ in MUTATIONS if old not in source(file).read_text()]
        gone += [f"{name}: no test {test[0]}" for name, file, _, _, *test in MUTATIONS if test and not has_test(file, test[0])]
        print("\n".join(gone) or f"{len(MUTATIONS)} defects can be put in")
        sys.exit(1 if gone else 0)
    wanted = [part.strip() for part in (asked.only or "").split(",")]
    build = ["cargo", "build", "-q", "-p", "joulebus-simulator", "--bin", "joulebus-sim"]
    missed = 0
    for name, file, old, new, *test in MUTATIONS:
        if not any(part in name for part in wanted):
            continue
        path = source(file)
        text = path.read_text()
        assert old in text, f"{name}: {file} does not contain the text that is to be replaced"
        begin = time.time()
        try:
            path.write_text(text.replace(old, new))
            # A defect that does not compile is found by nothing.
            built = run(["cargo", "check", "-q", "-p", "joulebus-link"] if test else build)
            if built.returncode:
                print(built.stderr, file=sys.stderr)
                found = None
            else:
                found = find_by_test(*test) if test else find(file, asked.seeds)
        finally:
            path.write_text(text)
        missed += found is None
        seed, invariant = (found["seed"], found["failure"]["invariant"]) if found else (None, None)
        what = (invariant if test else f"seed {seed}: {invariant}") if found else f"not found by {test[0] if test else asked.seeds}"
        print(f"| {name} | `{file}` | {what} | {time.time() - begin:.0f} s", flush=True)
    run(build)
    sys.exit(1 if missed else 0)


main()
