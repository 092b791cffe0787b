// What the stream has said so far: a whole view first, then only what changed.

const CHANGES_KEPT = 200;

export function emptyBoard() {
  return {
    seq: 0,
    fleet: null,
    total: 0,
    matched: 0,
    from: 0,
    order: [],
    rows: new Map(),
    robot: null,
    raised: [],
    changes: [],
  };
}

function takeView(board, view) {
  board.fleet = view.fleet;
  board.total = view.robots.total;
  board.matched = view.robots.matched;
  board.from = view.robots.from;
  board.rows = new Map(view.robots.robots.map((robot) => [robot.robot, robot]));
  board.order = view.robots.robots.map((robot) => robot.robot);
  board.robot = view.robot;
  board.raised = view.alarms.raised;
  board.changes = view.alarms.changes;
}

function takeRobots(board, robots) {
  board.total = robots.total ?? board.total;
  board.matched = robots.matched ?? board.matched;
  board.from = robots.from ?? board.from;
  for (const [id, changed] of Object.entries(robots.rows ?? {})) {
    const row = board.rows.get(Number(id));
    if (row) Object.assign(row, changed);
    else board.rows.set(Number(id), changed);
  }
  if (!robots.order) return;
  board.order = robots.order;
  const shown = new Set(robots.order);
  for (const id of board.rows.keys()) if (!shown.has(id)) board.rows.delete(id);
}

function takeDelta(board, delta) {
  if (delta.fleet) Object.assign(board.fleet, delta.fleet);
  if (delta.robots) takeRobots(board, delta.robots);
  if (delta.robot === null) board.robot = null;
  else if (delta.robot) board.robot = Object.assign(board.robot ?? {}, delta.robot);
  if (delta.alarms?.raised) board.raised = delta.alarms.raised;
  if (delta.alarms?.changes?.length > 0) {
    board.changes = [...delta.alarms.changes, ...board.changes].slice(0, CHANGES_KEPT);
  }
}

/**
 * Applies one message of the stream. False if it does not continue what was read before: the caller
 * then has to ask for a whole view.
 */
export function take(board, kind, message) {
  if (kind === "view") takeView(board, message);
  else if (board.fleet === null || message.seq !== board.seq + 1) return false;
  else takeDelta(board, message);
  board.seq = message.seq;
  return true;
}
