// Numbers as text: unit after a thin space, "–" where a value is unknown.

export const UNKNOWN = "–";
const NO_BATTERY = "no [battery]: add its capacity_wh and initial_soc_lo to the platform's file";
const CHARGE_UNKNOWN =
  "charge unknown: say it with `joulebus battery ROBOT --full`, --charge or --exchanged, or let " +
  "the source send state_of_charge, or report a full or exchanged battery";
const SPACE = "\u202f";

export const isKnown = (value) => typeof value === "number" && Number.isFinite(value);

/**
 * Why the charge of a robot whose energy is counted is unknown, or what a pause has cost, and what to
 * do; else empty.
 */
export function chargeHint(robot) {
  if (!isKnown(robot.metered_s)) return "";
  if (isKnown(robot.soc)) return robot.battery_note ?? "";
  return typeof robot.soc_measured === "boolean" ? CHARGE_UNKNOWN : NO_BATTERY;
}

/** Rounded to so many decimals, or null; never "-0". */
export function fixed(value, decimals) {
  if (!isKnown(value)) return null;
  const text = value.toFixed(decimals);
  return Number(text) === 0 ? text.replace("-", "") : text.replace("-", "\u2212");
}

function withUnit(text, unit) {
  return text === null ? UNKNOWN : text + SPACE + unit;
}

/**
 * Decimals of a power that show a hundredth of a watt of a small robot and no noise of a large one.
 */
export function wattDecimals(scaleW) {
  const size = Math.abs(scaleW);
  if (!(size >= 20)) return 2;
  return size < 200 ? 1 : 0;
}

export const wattNumber = (value, scaleW = value) => fixed(value, wattDecimals(scaleW)) ?? UNKNOWN;

export function watts(value, scaleW = value) {
  if (isKnown(value) && Math.abs(value) >= 10_000) return withUnit(fixed(value / 1000, 1), "kW");
  return withUnit(fixed(value, wattDecimals(scaleW)), "W");
}

/** A signed difference of powers; differences of a few milliwatts are the usual case. */
export function wattDifference(value) {
  if (!isKnown(value)) return UNKNOWN;
  const text = fixed(value, Math.abs(value) < 20 ? 3 : 1);
  return withUnit(value > 0 ? `+${text}` : text, "W");
}

/** An energy: J below one watt-hour, Wh above. */
export function energy(joules) {
  if (!isKnown(joules)) return UNKNOWN;
  const wattHours = joules / 3600;
  if (Math.abs(wattHours) < 1) return withUnit(fixed(joules, Math.abs(joules) < 100 ? 1 : 0), "J");
  if (Math.abs(wattHours) < 1000) return withUnit(fixed(wattHours, wattHours < 100 ? 2 : 1), "Wh");
  return withUnit(fixed(wattHours / 1000, 2), "kWh");
}

export const percent = (share, decimals = 0) =>
  withUnit(fixed(isKnown(share) ? share * 100 : null, decimals), "%");

/** A time to plan with: seconds, minutes, then hours. */
export function duration(seconds) {
  if (!isKnown(seconds)) return UNKNOWN;
  if (seconds < 100) return withUnit(fixed(seconds, 0), "s");
  if (seconds < 600 * 60) return withUnit(fixed(seconds / 60, seconds < 600 ? 1 : 0), "min");
  return withUnit(fixed(seconds / 3600, seconds < 360_000 ? 1 : 0), "h");
}

/** A time of a computation: µs to s. */
export function latency(seconds) {
  if (!isKnown(seconds)) return UNKNOWN;
  if (seconds < 1e-3) return withUnit(fixed(seconds * 1e6, 0), "µs");
  if (seconds < 1) return withUnit(fixed(seconds * 1e3, seconds < 0.01 ? 2 : 1), "ms");
  return withUnit(fixed(seconds, 2), "s");
}

/** How old something is, for values that should be a fraction of a second old. */
export function age(seconds) {
  if (!isKnown(seconds)) return UNKNOWN;
  if (seconds < 1) return withUnit(fixed(seconds * 1e3, 0), "ms");
  if (seconds < 100) return withUnit(fixed(seconds, seconds < 10 ? 1 : 0), "s");
  return duration(seconds);
}

const grouped = new Intl.NumberFormat("en", { maximumFractionDigits: 0 });
export const count = (value) =>
  isKnown(value) ? grouped.format(value).replaceAll(",", SPACE) : UNKNOWN;

const clock = new Intl.DateTimeFormat(undefined, {
  hour: "2-digit", minute: "2-digit", second: "2-digit", hourCycle: "h23",
});
const day = new Intl.DateTimeFormat(undefined, { day: "numeric", month: "short" });

/** Time of day in the browser's zone, with the date where it is not today's. */
export function timeOfDay(unixMs, nowMs = Date.now()) {
  if (!isKnown(unixMs)) return UNKNOWN;
  const text = clock.format(unixMs);
  return day.format(unixMs) === day.format(nowMs) ? text : `${day.format(unixMs)} ${text}`;
}

export const unixMs = (unixNs) => (isKnown(unixNs) ? unixNs / 1e6 : null);

export const LEVELS = ["ok", "warn", "error", "stale"];
export const levelName = (level) => (LEVELS.includes(level) ? level : "unknown");

/** Quality and its detail: "Held", "OpenLoop 12", "Invalid: NoCommand". */
export function quality(robot) {
  const { quality: name, quality_detail: detail } = robot;
  if (!name) return UNKNOWN;
  if (!detail) return name;
  return name === "Invalid" ? `${name}: ${detail}` : `${name} ${detail}`;
}

/** Two ends of a range with the unit once: "3.46 – 3.72 W"; empty if an end is unknown. */
export function range(lo, hi, text) {
  if (!isKnown(lo) || !isKnown(hi)) return "";
  const [from, fromUnit] = text(lo).split(SPACE);
  const [to, toUnit] = text(hi).split(SPACE);
  return fromUnit === toUnit ? `${from} – ${to}${SPACE}${toUnit}` : `${from}${SPACE}${fromUnit} – ${to}${SPACE}${toUnit}`;
}

/**
 * Age of a robot's newest reading, s, or null: its age in the newest sample, and that of the sample
 * where it is late.
 * @param agedS how old the newest frame is where it should be newer, s
 */
export function readingAgeS(robot, agedS) {
  if (!isKnown(robot.reading_age_ns)) return null;
  const lateS = isKnown(robot.sample_age_s) && robot.sample_age_s > 0.5 ? robot.sample_age_s : 0;
  return robot.reading_age_ns * 1e-9 + lateS + agedS;
}

/** A sentence whose words between backticks are code. */
export function setSentence(node, text) {
  if (node.said === text) return;
  node.said = text;
  node.replaceChildren(...text.split("`").map((piece, at) => {
    const made = document.createElement(at % 2 === 1 ? "code" : "span");
    made.textContent = piece;
    return made;
  }));
}
