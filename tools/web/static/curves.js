// A small curve of the speed of each drive object: the last minute, as far as this page has received it.

import { html } from "./vendor/lit-html/lit-html.js";

const SECONDS = 60;
const [EVERY_S, GAP_S] = [0.5, 3];
const [WIDTH, HEIGHT] = [120, 24];
const samples = new Map(); // by DO-ID: [time in seconds, speed or null]

// Keep the speeds of a new status. A device that is away has none: its curve ends.
export function keep(status, now) {
  for (const item of [...status.axes, ...status.encoders]) {
    const kept = (samples.get(item.do_id) ?? []).filter(([time]) => time > now - SECONDS);
    if (!kept.length || now - kept.at(-1)[0] >= EVERY_S) kept.push([now, item.speed_rpm ?? item.speed ?? item.velocity]);
    samples.set(item.do_id, kept);
  }
}

export function curve(item) {
  const kept = samples.get(item.do_id) ?? [];
  const speeds = kept.map(([, speed]) => speed ?? 0);
  const low = Math.min(0, ...speeds);
  const span = Math.max(Math.max(0, ...speeds) - low, (item.rated_speed ?? 100) / 100); // 1 %: noise stays flat
  const [newest, seconds] = [kept.at(-1)?.[0], Math.max(1, kept.at(-1)?.[0] - kept[0]?.[0])]; // less than a minute has the whole width
  let [path, before] = ["", -Infinity];
  for (const [time, speed] of kept) {
    if (speed === null) continue;
    const x = WIDTH * (1 - (newest - time) / seconds);
    path += `${time - before < GAP_S ? "L" : "M"}${x.toFixed(1)} ${(HEIGHT - 1 - (HEIGHT - 2) * (speed - low) / span).toFixed(1)}`;
    before = time;
  }
  return html`<svg class="curve" viewBox=${`0 0 ${WIDTH} ${HEIGHT}`} role="img" aria-label="Speed in the last minute"><path d=${path}/></svg>`;
}
