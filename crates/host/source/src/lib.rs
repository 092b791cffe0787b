//! The shared part of programs that are sources of samples: a publisher that finds a worker,
//! follows its answers, and reports the fate of the samples.
//!
//! A part of the programs `joulebus` (`publish sim`, `replay`) and `joulebus-lab` (`publish
//! trial`). A controller of your own uses `joulebus-publisher`.
//!
//! **Three types to know.** A [`Link`](link::Link) publishes, and waits for a worker. A
//! [`Flow`](flow::Flow) follows the worker, so that it does not get more than it can take. A
//! [`PublishReport`](report::PublishReport) states how many samples were sent, and what became of
//! them. [`Window`](window::Window) has the frames that the worker has not answered yet. [`rate`]
//! has rates, speeds and times as the command line takes them.
//!
//! **Units** are ns, s and Hz.
//!
//! **Errors** are `anyhow::Error` with the remedy: the fleet cannot be joined, or its forecasts
//! cannot be opened. A frame that could not be sent is a [`Fate`](link::Fate), and is counted.
//!
//! **In the book**: [programs and verbs][1], [record everything, and replay it][2], [from CSV logs
//! to a worker][3].
//!
//! [1]: https://github.com/joulebus/joulebus/blob/main/docs/reference/programs.md
//! [2]: https://github.com/joulebus/joulebus/blob/main/docs/how-to/captures.md
//! [3]: https://github.com/joulebus/joulebus/blob/main/docs/tutorial/csv.md
#![forbid(unsafe_code)]

pub mod flow;
pub mod link;
pub mod rate;
pub mod report;
pub mod window;
