// The exchange with the PLC: who, how fast, and what became of every frame.

import { html, nothing } from "../vendor/lit-html/lit-html.js";
import { DASH, integer, number, withUnit } from "../format.js";

// The value below which a share of all lies, as far as the classes tell.
function below(times, share) {
  const all = times.counts.reduce((sum, count) => sum + count, 0);
  let sum = 0;
  for (const [place, count] of times.counts.entries()) {
    sum += count;
    if (all && sum >= all * share) return place < times.bounds_s.length ? `at most ${1000 * times.bounds_s[place]}\u00a0ms` : `more than ${1000 * times.bounds_s.at(-1)}\u00a0ms`;
  }
  return DASH;
}

export function plc(state) {
  const { plc: link, counters, cycle_times: cycles, response_times: responses, age_times: ages } = state.status;
  const count = (name) => counters.find((item) => item.part === "link" && item.name === name)?.value;
  const mean = (times) => {
    const all = times.counts.reduce((sum, value) => sum + value, 0);
    return all ? withUnit(number((1000 * times.sum_s) / all, 2), "ms") : DASH;
  };
  const rows = [
    ["Connected", link.connected ? "yes" : "no"],
    ["PLC", link.peer ? (link.peer.join?.(":") ?? link.peer) : "not connected yet"],
    ["Transport", link.type],
    ["Cycle, configured", withUnit(link.cycle_ms, "ms")],
    ["Cycle, measured", html`mean ${mean(cycles)}, p99 ${below(cycles, 0.99)}`],
    ["Answer time", html`mean ${mean(responses)}, p99 ${below(responses, 0.99)}`],
    ...(link.age_limit_ms ? [["Age of frames", html`p50 ${below(ages, 0.5)}, p99 ${below(ages, 0.99)}, max ${withUnit(number(1000 * ages.max_s, 1), "ms")}, limit ${withUnit(number(link.age_limit_ms, 0), "ms")}`]] : []),
    ["Watchdog", link.watchdog_ms ? withUnit(number(link.watchdog_ms, 0), "ms") : "the controller's"],
    ["Watchdog timeouts", withUnit(integer(count("watchdog_expiries")), "times")],
  ];
  const slugs = counters.filter((item) => item.part === "link" && item.unit === "frames");
  const usual = ["accepted", "sent", "no_tick", "after_loss"]; // each connect begins with frames without a tick
  const order = (item) => (usual.includes(item.name) ? 2 : item.value ? 0 : 1);
  return html`<h2>PLC</h2>
    ${link.refused ? html`<p class="banner bad" role="alert">${link.refused}</p>` : nothing}
    <dl class="facts">${rows.map(([name, value]) => html`<div><dt>${name}</dt><dd data-live>${value}</dd></div>`)}</dl>
    <h3>Frames</h3>
    <div class="scroll" tabindex="0"><table>
      <thead><tr><th class="number">Frames</th><th>Result</th></tr></thead>
      <tbody>${[...slugs].sort((one, other) => order(one) - order(other)).map((item) => html`
        <tr class=${order(item) === 0 ? "told" : ""}><td class="number" data-live>${integer(item.value)}</td><td>${item.name.replaceAll("_", " ")}${item.meaning.toLowerCase() === item.name.replaceAll("_", " ") ? nothing : html` <small>${item.meaning}</small>`}</td></tr>`)}</tbody>
    </table></div>`;
}
