//! Config files: refused with position and remedy, or read, written and read again.

use std::path::Path;

use joulebus_config::{Config, ConfigError, explain};

/// Maximum length of an input, bytes: longer ones reach no further code.
const MAX_BYTES: usize = 64 << 10;

pub(crate) fn run(bytes: &[u8]) -> bool {
    let Ok(text) = std::str::from_utf8(bytes) else {
        return false;
    };
    if text.len() > MAX_BYTES {
        return false;
    }
    let nowhere = Path::new("/nonexistent");
    let config = match Config::parse(text, nowhere) {
        Ok(config) => config,
        Err(error) => {
            refused(&error, text);
            return false;
        }
    };
    config.settings().check().expect("what was read has been checked");
    assert_eq!(config.models().len(), config.settings().platforms.len());
    assert!(config.threads().count > 0 && config.tick_period_ns() > 0);
    let shown = config.to_toml();
    let again = Config::parse(shown, nowhere);
    let again = again.unwrap_or_else(|error| panic!("{error}\n---\n{shown}"));
    assert_eq!(again.settings(), config.settings());
    assert_eq!(again.models(), config.models());
    assert_eq!((again.fleet(), again.root()), (config.fleet(), config.root()));
    assert_eq!(again.prefix(), config.prefix());
    assert_eq!(again.policy(), config.policy());
    assert_eq!(again.tick_period_ns(), config.tick_period_ns());
    assert_eq!(again.buffer_frames(), config.buffer_frames());
    assert_eq!(again.max_planners(), config.max_planners());
    assert_eq!(again.checkpoint(), config.checkpoint());
    assert_eq!(again.checkpoint_every_ns(), config.checkpoint_every_ns());
    assert_eq!(again.scheduling(), config.scheduling());
    assert_eq!(again.threads(), config.threads());
    let thrice = Config::parse(again.to_toml(), nowhere).expect("read twice before");
    assert_eq!(thrice.to_toml(), again.to_toml());
    config.bundle().expect("no model is a file");
    true
}

fn refused(error: &ConfigError, text: &str) {
    let ConfigError::Refused(problems) = error else {
        panic!("{error}");
    };
    assert!(!problems.is_empty());
    let lines = 1 + text.bytes().filter(|byte| *byte == b'\n').count();
    for problem in problems {
        assert!(!problem.what.is_empty() && !problem.remedy.is_empty(), "{problem:?}");
        let named = problem.file == "<config>";
        let line = problem.line.unwrap_or(1);
        assert!(line >= 1 && (!named || line <= lines), "{problem:?}");
    }
    // Every key is explained, or the nearest key is named.
    let asked = problems.first().map(|problem| problem.key.as_str());
    match explain(asked) {
        Ok(explained) => assert!(!explained.is_empty()),
        Err(unknown) => assert!(!unknown.remedy.is_empty()),
    }
}
