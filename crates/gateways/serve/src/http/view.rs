//! A client's view of the robots. It is sorted, filtered and cut here, so that the client's cost
//! does not grow with the fleet.

use joulebus_board::{Search, Sort};
use joulebus_wire::Level;

use super::entry::Entry;
use super::error::ApiError;
use super::snapshot::Snapshot;

/// Maximum number of robots in an answer or a stream.
const MAX_ROBOTS: usize = 200;
/// Maximum length of a search, bytes.
const MAX_SEARCH_BYTES: usize = 100;

/// A window on the fleet.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct View {
    pub(super) sort: Sort,
    pub(super) descending: bool,
    search: String,
    /// Selected levels by [`Level::code`]. If none is selected, all are.
    levels: [bool; 4],
    pub(super) from: usize,
    count: usize,
}

impl Default for View {
    fn default() -> Self {
        Self {
            sort: Sort::Urgency,
            descending: false,
            search: String::new(),
            levels: [false; 4],
            from: 0,
            count: 50,
        }
    }
}

/// The robots in a window.
#[derive(Debug, PartialEq, Eq)]
pub(super) struct Window {
    /// Robots of the fleet.
    pub(super) total: usize,
    /// Robots that the filter lets pass.
    pub(super) matched: usize,
    /// Ids in the window, in order.
    pub(super) robots: Vec<u32>,
}

impl View {
    /// Parses a query parameter. Returns false if it does not belong to a view.
    pub(super) fn take(&mut self, name: &str, value: &str) -> Result<bool, ApiError> {
        match name {
            "sort" => {
                let found = Sort::ALL.iter().find(|(_, named)| *named == value);
                let names = Sort::ALL.map(|(_, named)| named).join(", ");
                self.sort = found.ok_or_else(|| ApiError::value(name, value, &names))?.0;
            }
            "descending" => {
                self.descending = match value {
                    "0" => false,
                    "1" => true,
                    _ => return Err(ApiError::value(name, value, "0 or 1")),
                };
            }
            "search" if value.len() <= MAX_SEARCH_BYTES => value.clone_into(&mut self.search),
            "search" => {
                let found = format!("{} bytes", value.len());
                return Err(ApiError::value(name, &found, "at most 100 bytes"));
            }
            "level" => {
                for word in value.split(',').filter(|word| !word.is_empty()) {
                    let found = LEVELS.iter().find(|level| level.name() == word);
                    let level = found
                        .ok_or_else(|| ApiError::value(name, word, "ok, warn, error, stale"))?;
                    self.levels[usize::from(level.code())] = true;
                }
            }
            "from" => {
                let allowed = "a number from 0";
                let from: u32 = value.parse().map_err(|_| ApiError::value(name, value, allowed))?;
                self.from = from as usize;
            }
            "count" => {
                let count = value.parse().ok().filter(|count| (1..=MAX_ROBOTS).contains(count));
                self.count = count.ok_or_else(|| ApiError::value(name, value, "1 to 200"))?;
            }
            _ => return Ok(false),
        }
        Ok(true)
    }

    /// The robots that it shows of `snapshot`.
    pub(super) fn window(&self, snapshot: &Snapshot) -> Window {
        let search = Search::new(&self.search, snapshot.platforms());
        let any = !self.levels.contains(&true);
        let shown = |entry: &&Entry| {
            (any || self.levels[usize::from(entry.newest.level().code())])
                && search.finds(entry.robot, entry.platform, &entry.newest)
        };
        let order = snapshot.order(self.sort, self.descending);
        let mut matched = 0;
        let mut robots = Vec::new();
        for entry in order.iter().map(|place| snapshot.entry(*place)).filter(shown) {
            if matched >= self.from && robots.len() < self.count {
                robots.push(entry.robot);
            }
            matched += 1;
        }
        Window { total: order.len(), matched, robots }
    }
}

const LEVELS: [Level; 4] = [Level::Ok, Level::Warn, Level::Error, Level::Stale];
