//! Which robots the live view lists, in which order, and which of them is selected.

use joulebus_board::{Board, Platforms, Row, Search, Sort, SortKey};
use joulebus_wire::Level;

/// Maximum length of a search.
const MAX_SEARCH_CHARACTERS: usize = 40;

/// Orders in turn, with their names on the screen.
const ORDERS: [(Sort, &str); 4] = [
    (Sort::Urgency, "urgency"),
    (Sort::Robot, "name"),
    (Sort::Soc, "battery"),
    (Sort::Power, "power"),
];

#[derive(Debug)]
pub(crate) struct Choice {
    platforms: Platforms,
    /// The robot whose track is shown. The first one listed if it is not.
    selected: Option<u32>,
    /// Place in [`ORDERS`].
    order: usize,
    descending: bool,
    search: String,
    only_alarms: bool,
}

#[derive(Debug)]
pub(crate) struct Listed {
    /// Ids, in order.
    pub(crate) robots: Vec<u32>,
    /// Place of the selected robot. The first if it is not listed.
    pub(crate) selected: usize,
}

impl Listed {
    /// The robot that is selected. None if none is listed.
    pub(crate) fn robot(&self) -> Option<u32> {
        self.robots.get(self.selected).copied()
    }
}

impl Choice {
    /// All robots by urgency, optionally with a selected one.
    pub(crate) const fn new(platforms: Platforms, selected: Option<u32>) -> Self {
        Self {
            platforms,
            selected,
            order: 0,
            descending: false,
            search: String::new(),
            only_alarms: false,
        }
    }

    pub(crate) fn listed(&self, board: &Board) -> Listed {
        let search = Search::new(&self.search, &self.platforms);
        let (sort, _) = ORDERS[self.order];
        let mut keys: Vec<SortKey> = board
            .rows
            .iter()
            .filter(|(robot, row)| self.lists(&search, **robot, row))
            .map(|(robot, row)| sort.key(*robot, &row.newest()))
            .collect();
        keys.sort_unstable_by(|a, b| sort.compare(self.descending, a, b));
        let robots: Vec<u32> = keys.iter().map(SortKey::robot).collect();
        let selected = self.selected.and_then(|selected| {
            let is_it = |robot: &u32| *robot == selected;
            robots.iter().position(is_it)
        });
        Listed { robots, selected: selected.unwrap_or(0) }
    }

    fn lists(&self, search: &Search, robot: u32, row: &Row) -> bool {
        (!self.only_alarms || row.level() != Level::Ok)
            && (self.search.is_empty()
                || search.finds(robot, self.platforms.of_robot(robot), &row.newest()))
    }

    /// Moves the selection by `by` rows, within the list.
    pub(crate) fn step(&mut self, board: &Board, by: isize) {
        let listed = self.listed(board);
        let last = listed.robots.len().saturating_sub(1);
        let place = listed.selected.saturating_add_signed(by).min(last);
        if let Some(robot) = listed.robots.get(place) {
            self.selected = Some(*robot);
        }
    }

    /// Selects the next robot of the list with an alarm or without forecasts, if any.
    pub(crate) fn step_to_alarm(&mut self, board: &Board) {
        let listed = self.listed(board);
        let from = match self.selected {
            Some(_) => listed.selected + 1,
            None => 0,
        };
        let (before, after) = listed.robots.split_at(from.min(listed.robots.len()));
        let stands_out = |robot: &&u32| {
            let row = board.rows.get(robot);
            row.is_some_and(|row| row.level() != Level::Ok)
        };
        if let Some(robot) = after.iter().chain(before).find(stands_out) {
            self.selected = Some(*robot);
        }
    }

    pub(crate) const fn next_order(&mut self) {
        self.order = (self.order + 1) % ORDERS.len();
    }

    /// The other way round.
    pub(crate) const fn reverse(&mut self) {
        self.descending = !self.descending;
    }

    /// Only robots with an alarm or without forecasts, or all.
    pub(crate) const fn toggle_only_alarms(&mut self) {
        self.only_alarms = !self.only_alarms;
    }

    /// The searched text. Empty: no search.
    pub(crate) fn search(&self) -> &str {
        &self.search
    }

    /// Adds a character to the search. Control characters are none.
    pub(crate) fn type_in(&mut self, character: char) {
        if !character.is_control() && self.search.chars().count() < MAX_SEARCH_CHARACTERS {
            self.search.push(character);
        }
    }

    /// Removes the search's last character.
    pub(crate) fn delete(&mut self) {
        self.search.pop();
    }

    /// True if robots may be left out.
    pub(crate) const fn is_filtered(&self) -> bool {
        self.only_alarms || !self.search.is_empty()
    }

    pub(crate) fn clear_search(&mut self) {
        self.search.clear();
    }

    /// Lists all robots again.
    pub(crate) fn clear_filter(&mut self) {
        self.search.clear();
        self.only_alarms = false;
    }

    /// Order and filter in a few words. `listed` of `robots` are left.
    pub(crate) fn title(&self, listed: usize, robots: usize) -> String {
        let (_, order) = ORDERS[self.order];
        let arrow = if self.descending { "↓" } else { "↑" };
        let mut title = format!(" by {order} {arrow} ");
        if self.is_filtered() {
            title.push_str(&format!("  {listed} of {robots}:"));
        }
        if self.only_alarms {
            title.push_str(" alarms");
        }
        if !self.search.is_empty() {
            title.push_str(&format!(" \"{}\"", self.search));
        }
        if self.is_filtered() {
            title.push(' ');
        }
        title
    }
}
