//! The arguments of the verbs that are programs of their own. They stand here because two programs
//! read them: `joulebus` for its help and completions, and the verb's own.

pub mod bench;
pub mod report;
pub mod serve;
