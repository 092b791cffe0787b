// What is shown is part of the page's address, so that a link shows the same.

export const SORTS = ["urgency", "robot", "soc", "left", "power", "level"];
const LEVELS = ["ok", "warn", "error", "stale"];
const VIEWS = ["robots", "alarms", "worker"];

/**
 * @returns {{view: string, robot: number|null, sort: string, descending: boolean, search: string,
 * levels: string[]}}
 */
export function read(search) {
  const query = new URLSearchParams(search);
  const robot = /^\d{1,10}$/.test(query.get("robot") ?? "") ? Number(query.get("robot")) : null;
  const sort = query.get("sort");
  const view = query.get("view");
  return {
    view: VIEWS.includes(view) ? view : "robots",
    robot,
    sort: SORTS.includes(sort) ? sort : "urgency",
    descending: query.get("descending") === "1",
    search: (query.get("search") ?? "").slice(0, 100),
    levels: (query.get("level") ?? "").split(",").filter((level) => LEVELS.includes(level)),
  };
}

/** The address of a state; what is the default is left out. */
export function write(state) {
  const query = new URLSearchParams();
  if (state.view !== "robots") query.set("view", state.view);
  if (state.robot !== null) query.set("robot", String(state.robot));
  if (state.sort !== "urgency") query.set("sort", state.sort);
  if (state.descending) query.set("descending", "1");
  if (state.search) query.set("search", state.search);
  if (state.levels.length > 0) query.set("level", state.levels.join(","));
  const text = query.toString().replaceAll("%2C", ",");
  return text === "" ? "/" : `/?${text}`;
}

/** The parameters by which the server sorts, filters and cuts. */
export function viewQuery(state, from, count) {
  const query = new URLSearchParams({ sort: state.sort, from: String(from), count: String(count) });
  if (state.descending) query.set("descending", "1");
  if (state.search) query.set("search", state.search);
  if (state.levels.length > 0) query.set("level", state.levels.join(","));
  if (state.robot !== null) query.set("robot", String(state.robot));
  return query;
}
