//! Arguments of the verbs that are separate programs. Two programs parse them: `joulebus`, for its
//! help and completions, and the verb's own.

pub mod bench;
pub mod bridge;
pub mod mission;
pub mod report;
pub mod serve;
