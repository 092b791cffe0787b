//! A replay in this process, without shared memory: the tick recomputes every forecast, diagnostic
//! and budget of a capture and compares the bits.
//!
//! Argument: a file of `joulebus record`.

use anyhow::Context;
use joulebus_capture_format::Reader;
use joulebus_capture_verify::Verifier;
use joulebus_config::Config;
use joulebus_models::load_models;

fn main() -> anyhow::Result<()> {
    let file = std::env::args().nth(1).context("name a capture")?;
    let mut reader = Reader::open(file)?;

    // The config and the models that the worker ran with are attached to the capture.
    let attachments = reader.attachments();
    let fleet = attachments.fleets().next().context("no fleet in it")?.to_owned();
    let config = attachments.config(&fleet).context("no config in it")?;
    let config = Config::parse_attached(config, &attachments.files(&fleet))?;

    let mut verifier = Verifier::new(config.settings().clone(), load_models(&config)?)?;
    while let Some(entry) = reader.next_entry()? {
        if *entry.fleet == *fleet {
            verifier.push(entry);
        }
    }
    let verification = verifier.finish();
    println!(
        "{}: {} of {} ticks recomputed, {} values differ",
        verification.verdict,
        verification.ticks_verified,
        verification.ticks,
        verification.differences,
    );
    Ok(())
}
