//! Diagnostics and budgets.

use std::cell::RefCell;

use joulebus_bus::{BudgetReader, DiagnosticReader};

use crate::index::RobotIndex;
use crate::planner::{check_schema, newer};
use crate::{Budgets, Diagnostics, ReadError};

/// Diagnostics, robot by robot. Belongs to the thread of its planner, and may outlive it.
pub struct DiagnosticFeed {
    reader: DiagnosticReader,
    place: Option<(u64, u64)>,
    frames: u64,
    index: RefCell<RobotIndex>,
}

impl DiagnosticFeed {
    pub(crate) fn new(reader: DiagnosticReader) -> Self {
        Self {
            reader,
            place: None,
            frames: 0,
            index: RefCell::default(),
        }
    }

    /// The newest frame, whether or not it was given before: its header tells the tick. `None`
    /// until the first has come. Borrowed until the next call.
    ///
    /// # Errors
    /// [`ReadError`]; the next call may succeed.
    pub fn latest(&mut self) -> Result<Option<Diagnostics<'_>>, ReadError> {
        let (mut place, mut schema) = (self.place, None);
        let found = self.reader.hold_latest(|header| {
            let at = (header.worker_epoch, header.tick);
            newer(header.schema, at, &mut place, &mut schema)
        })?;
        check_schema(found, schema)?;
        self.place = place;
        self.frames += u64::from(found);
        let held = self.reader.held();
        Ok(held.map(|held| Diagnostics::new(held, self.frames, |row| row.robot, &self.index)))
    }
}

/// Budgets, robot by robot. Belongs to the thread of its planner, and may outlive it.
pub struct BudgetFeed {
    reader: BudgetReader,
    place: Option<(u64, u64)>,
    frames: u64,
    index: RefCell<RobotIndex>,
}

impl BudgetFeed {
    pub(crate) fn new(reader: BudgetReader) -> Self {
        Self {
            reader,
            place: None,
            frames: 0,
            index: RefCell::default(),
        }
    }

    /// The newest frame, whether or not it was given before: its header tells the tick. A newcomer
    /// gets what was sent before it came as soon as the worker sends, or looks for newcomers. `None`
    /// until then. Borrowed until the next call.
    ///
    /// # Errors
    /// [`ReadError`]; the next call may succeed.
    pub fn latest(&mut self) -> Result<Option<Budgets<'_>>, ReadError> {
        let (mut place, mut schema) = (self.place, None);
        let found = self.reader.hold_latest(|header| {
            let at = (header.worker_epoch, header.tick);
            newer(header.schema, at, &mut place, &mut schema)
        })?;
        check_schema(found, schema)?;
        self.place = place;
        self.frames += u64::from(found);
        let held = self.reader.held();
        Ok(held.map(|held| Budgets::new(held, self.frames, |row| row.robot, &self.index)))
    }
}
