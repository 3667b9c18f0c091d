// Numbers, times and ages as text. Nothing here knows what a value means.

export const DASH = "–";

export function number(value, digits = 1) {
  return value === null || value === undefined ? DASH : value.toFixed(digits);
}

export function integer(value) {
  return value === null || value === undefined ? DASH : String(value).replace(/\B(?=(\d{3})+$)/g, "\u2009");
}

export function withUnit(text, unit) {
  return text === DASH || !unit ? text : `${text}\u00a0${unit}`;
}

export function hex(value, digits) {
  const mask = digits >= 8 ? 0xffffffff : 2 ** (4 * digits) - 1;
  return `${((value & mask) >>> 0).toString(16).toUpperCase().padStart(digits, "0")}h`;
}

export function percent(share, digits = 0) {
  return share === null || share === undefined ? DASH : `${(share * 100).toFixed(digits)}\u00a0%`;
}

export function duration(seconds) {
  const whole = Math.max(0, Math.floor(seconds));
  const units = [["d", Math.floor(whole / 86400)], ["h", Math.floor(whole / 3600) % 24], ["min", Math.floor(whole / 60) % 60], ["s", whole % 60]];
  const first = units.findIndex(([, value]) => value > 0);
  if (first < 0) return "0\u00a0s";
  return units.slice(first, first + 2).filter(([, value]) => value > 0).map(([name, value]) => `${value}\u00a0${name}`).join(" ");
}

// How long ago, from milliseconds.
export function age(ms) {
  if (ms === null) return DASH;
  return `${ms < 1000 ? withUnit(number(ms, 0), "ms") : duration(ms / 1000)} ago`;
}

export function clock(time) {
  const date = new Date(time);
  return [date.getHours(), date.getMinutes(), date.getSeconds()].map((part) => String(part).padStart(2, "0")).join(":");
}

// With the day where it is not today's.
export function moment(time) {
  const date = new Date(time);
  const day = [date.getFullYear(), date.getMonth() + 1, date.getDate()].map((part) => String(part).padStart(2, "0")).join("-");
  return date.toDateString() === new Date().toDateString() ? clock(time) : `${day} ${clock(time)}`;
}
