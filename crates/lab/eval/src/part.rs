//! Parts of an evaluation in files. Processes on any hosts make one each. Merged they give the
//! report of a single run, to the bit.

use joulebus_wire::fnv1a;
use serde::{Deserialize, Serialize};

use crate::report::EvalReport;
use crate::score::{Misfit, Portion, Reported, ScoreError};

/// The start of a file. The last byte is the version of the contents after the hash.
const MAGIC: &[u8; 16] = b"joulebus.eval.1\n";
/// Bytes of the hash after it: FNV-1a of the rest.
const HASH_BYTES: usize = 8;
/// The release that writes and reads parts. Another release may compute other sums.
const RELEASE: &str = env!("CARGO_PKG_VERSION");

/// One part of an evaluation.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub struct EvalPart {
    release: String,
    /// Its number, from 1.
    number: u32,
    /// Number of parts.
    of: u32,
    /// One for each platform.
    portions: Vec<Portion>,
}

/// Reason that parts cannot be read or merged.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum PartError {
    /// No part was given.
    #[error("found no part to merge. Name the files that `joulebus eval --partition` wrote")]
    None,
    /// The file is of another kind.
    #[error(
        "{name}: is no part of an evaluation, allowed are files that `joulebus eval --partition` \
            wrote"
    )]
    Foreign {
        /// The file.
        name: String,
    },
    /// The file is damaged.
    #[error(
        "{name}: is damaged or cut short: {bytes} bytes with another hash than they state. Make \
            it again"
    )]
    Damaged {
        /// The file.
        name: String,
        /// Bytes of the file.
        bytes: usize,
    },
    /// Another release wrote it.
    #[error(
        "{name}: was written by release {found}, this is {RELEASE}. Make all parts and merge them \
            with one release"
    )]
    Release {
        /// The file.
        name: String,
        /// The release that wrote it.
        found: String,
    },
    /// Parts of different partitions.
    #[error(
        "{name}: is part {number} of {found}, {first} is one of {expected}. Merge the parts of \
            one evaluation"
    )]
    Count {
        /// The file.
        name: String,
        /// Its number.
        number: u32,
        /// Its number of parts.
        found: u32,
        /// The first file.
        first: String,
        /// The first file's number of parts.
        expected: u32,
    },
    /// Two files are the same part.
    #[error("{name}: is part {number}, as {first} is. Name each part once")]
    Twice {
        /// The file.
        name: String,
        /// The other file.
        first: String,
        /// Their number.
        number: u32,
    },
    /// Parts are missing.
    #[error(
        "parts {missing} of {of} are missing. Make them with `joulebus eval --partition`, and \
            name all"
    )]
    Missing {
        /// Their numbers.
        missing: String,
        /// Number of parts.
        of: u32,
    },
    /// Parts of different evaluations.
    #[error(
        "platform {platform}: the parts are of different evaluations, allowed are parts of the \
            same recordings in \
         the same order, with the same models, config and options"
    )]
    Different {
        /// Name of the platform.
        platform: String,
    },
    /// A recording is in several parts or in none. Never caused by files that were written here.
    #[error(
        "platform {platform}: recording {place} is not in exactly one part. Make the parts again"
    )]
    Recording {
        /// Name of the platform.
        platform: String,
        /// Number of the recording, from 1.
        place: usize,
    },
    /// There is nothing to score.
    #[error(transparent)]
    Score(#[from] ScoreError),
}

/// The result of merging all parts.
#[derive(Debug)]
pub struct Merged {
    /// The report of a single run.
    pub report: EvalReport,
    /// Platforms that nothing can be scored of, with the reason, beside others.
    pub refused: Vec<(String, ScoreError)>,
}

impl EvalPart {
    /// Part `number` of `of`, from 1. One portion for each platform.
    pub fn new(number: u32, of: u32, portions: Vec<Portion>) -> Self {
        Self { release: RELEASE.to_owned(), number, of, portions }
    }

    /// The contents of a file.
    pub fn to_bytes(&self) -> Vec<u8> {
        // Serialisation into a growing vector of known lengths cannot fail.
        let body = postcard::to_allocvec(self).unwrap_or_default();
        let hash = fnv1a(body.iter().copied()).to_le_bytes();
        [MAGIC.as_slice(), &hash, &body].concat()
    }

    /// Reads the contents of the file `name`.
    ///
    /// # Errors
    /// [`PartError`]: another file, a damaged one, or one of another release.
    pub fn from_bytes(name: &str, bytes: &[u8]) -> Result<Self, PartError> {
        let foreign = || PartError::Foreign { name: name.to_owned() };
        let damaged = || PartError::Damaged { name: name.to_owned(), bytes: bytes.len() };
        let rest = bytes.strip_prefix(MAGIC).ok_or_else(foreign)?;
        let (hash, body) = rest.split_first_chunk::<HASH_BYTES>().ok_or_else(damaged)?;
        if u64::from_le_bytes(*hash) != fnv1a(body.iter().copied()) {
            return Err(damaged());
        }
        // Before the rest, which another release may lay out otherwise.
        let (found, _) = postcard::take_from_bytes::<String>(body).map_err(|_| damaged())?;
        if found != RELEASE {
            let name = name.to_owned();
            return Err(PartError::Release { name, found });
        }
        postcard::from_bytes(body).map_err(|_| damaged())
    }

    /// Merges all parts, each with the name of its file, in any order.
    ///
    /// # Errors
    /// [`PartError`]: parts are missing, twice there, or of different evaluations, or nothing can
    /// be scored.
    pub fn merge(mut parts: Vec<(String, Self)>) -> Result<Merged, PartError> {
        parts.sort_by_key(|(_, part)| part.number);
        check_numbers(&parts)?;
        let platforms = parts.first().map_or(0, |(_, part)| part.portions.len());
        let mut by_platform: Vec<Vec<Portion>> = vec![Vec::new(); platforms];
        for (name, part) in parts {
            if part.portions.len() != platforms {
                return Err(PartError::Different { platform: name });
            }
            for (all, portion) in by_platform.iter_mut().zip(part.portions) {
                all.push(portion);
            }
        }
        let (mut evaluations, mut refused) = (Vec::new(), Vec::new());
        for portions in by_platform {
            let platform = portions[0].platform().to_owned();
            match merged(platform.clone(), portions)? {
                Ok(reported) => evaluations.push(reported),
                Err(error) => refused.push((platform, error)),
            }
        }
        match refused.pop_if(|_| evaluations.is_empty()) {
            Some((_, error)) => Err(error.into()),
            None => Ok(Merged { report: EvalReport::of_reported(evaluations), refused }),
        }
    }
}

fn merged(
    platform: String,
    portions: Vec<Portion>,
) -> Result<Result<Reported, ScoreError>, PartError> {
    Portion::merged(portions).map_err(|misfit| match misfit {
        Misfit::Different | Misfit::Size => PartError::Different { platform },
        Misfit::Recording(place) => PartError::Recording { platform, place: place + 1 },
    })
}

/// Checks that each part, in ascending order, is there once.
fn check_numbers(parts: &[(String, EvalPart)]) -> Result<(), PartError> {
    let Some((first, EvalPart { of, .. })) = parts.first() else {
        return Err(PartError::None);
    };
    if let Some((name, part)) = parts.iter().find(|(_, part)| part.of != *of) {
        return Err(PartError::Count {
            name: name.clone(),
            number: part.number,
            found: part.of,
            first: first.clone(),
            expected: *of,
        });
    }
    let is_twice = |pair: &&[(String, EvalPart)]| pair[0].1.number == pair[1].1.number;
    if let Some(pair) = parts.windows(2).find(is_twice) {
        return Err(PartError::Twice {
            name: pair[1].0.clone(),
            first: pair[0].0.clone(),
            number: pair[1].1.number,
        });
    }
    let is_there = |number: &u32| parts.iter().any(|(_, part)| part.number == *number);
    let missing = (1..=*of).filter(|number| !is_there(number));
    let missing: Vec<String> = missing.take(10).map(|number| number.to_string()).collect();
    match missing.is_empty() {
        true => Ok(()),
        false => Err(PartError::Missing { missing: missing.join(", "), of: *of }),
    }
}
