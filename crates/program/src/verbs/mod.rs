//! Arguments of the verbs that are separate programs. Two programs parse them: `joulebus`, for its
//! help, completions and manual pages, and the verb's own.

pub mod bench;
pub mod bridge;
pub mod export;
pub mod link;
pub mod mission;
pub mod report;
pub mod rosbag;
pub mod serve;
