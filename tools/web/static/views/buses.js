// The CAN buses: load, nodes, what was counted.

import { html, nothing } from "../vendor/lit-html/lit-html.js";
import { DASH, age, integer, percent, withUnit } from "../format.js";
import { objectName } from "./state.js";

function nodes(status, bus) {
  const known = new Map();
  for (const item of [...status.axes, ...status.encoders]) {
    if (item.bus !== bus.name) continue;
    const node = known.get(item.node_id) ?? { ...item, names: [] };
    node.names.push(item);
    known.set(item.node_id, node);
  }
  return [...known.values()];
}

function one(status, bus) {
  const counters = status.counters.filter((item) => item.part === `bus ${bus.name}` || item.part.endsWith(` on ${bus.name}`));
  return html`<section>
    <h3>${bus.name}: ${bus.healthy ? "healthy" : html`<strong class="bad">■ lost</strong>: ${bus.outage}`}</h3>
    <dl class="facts">
      <div><dt>Interface</dt><dd>${bus.interface} ${bus.channel ?? ""}</dd></div>
      <div><dt>Bit rate</dt><dd>${bus.bitrate ? withUnit(integer(bus.bitrate / 1000), "kbit/s") : DASH}</dd></div>
      <div><dt>Load, worst case planned</dt><dd>${percent(bus.load_planned)}</dd></div>
      <div><dt>Load, measured</dt><dd data-live>${percent(bus.load_measured, 1)}</dd></div>
    </dl>
    <div class="scroll" tabindex="0"><table>
      <thead><tr><th>Node</th><th>State</th><th class="number">Last frame</th><th>Used by</th></tr></thead>
      <tbody>${nodes(status, bus).map((node) => html`<tr>
        <td>${node.node_id}</td>
        <td><span class=${node.drive === "online" ? "good" : "bad"}>${node.drive === "online" ? "●" : "■"} ${node.drive}</span>${node.drive_text ? html` <small>${node.drive_text}</small>` : nothing}</td>
        <td class="number" data-live>${age(node.heard_age_ms)}</td>
        <td>${node.names.map((item) => html`<a href=${`#/axis/${item.do_id}`}>${objectName(item)}</a> `)}</td></tr>`)}
        ${bus.unconfigured.map((number) => html`<tr class="past"><td>${number}</td><td>? not in the configuration</td><td class="number">${DASH}</td><td></td></tr>`)}</tbody>
    </table></div>
    <details><summary>Counters</summary><div class="scroll" tabindex="0"><table>
      <tbody>${counters.map((item) => html`<tr><td class="number" data-live>${integer(item.value)}</td><td>${item.part}: ${item.name.replaceAll("_", " ")} <small>${item.unit} ${item.meaning}</small></td></tr>`)}</tbody>
    </table></div></details>
  </section>`;
}

export function buses(state) {
  return html`<h2>Buses</h2>${state.status.buses.map((bus) => one(state.status, bus))}`;
}
