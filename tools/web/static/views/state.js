// How a state, a reason and a fault look: symbol and word, never colour alone.

import { html, nothing } from "../vendor/lit-html/lit-html.js";
import { DASH, age, duration, integer, moment, withUnit } from "../format.js";

// States that need nobody, and states of a device that is away or in fault.
export const FINE = ["OBEYS", "OFF"];
export const BAD = ["FAULT", "NOT_ON_THE_BUS"];

export function stateWord(state, item) {
  const symbol = state.states[item.state_id]?.symbol ?? "";
  return html`<span class="state" data-state=${item.state_id}><span aria-hidden="true">${symbol}</span> ${item.state}</span>`;
}

// As in the gateway's sentences.
export const objectName = (item) => item.label[0].toUpperCase() + item.label.slice(1);

// Kind and symbol of a link of the chain of enables. What is missing while an axis is off is no defect.
export function lamp(item, link) {
  if (link.ok === null) return ["unknown", "·"];
  if (link.ok) return ["holds", "✓"];
  return FINE.includes(item.state_id) ? ["off", "○"] : ["broken", "✗"];
}

export function lamps(item) {
  const missing = item.chain.find((link) => link.ok === false);
  const text = `Enables: ${missing ? `missing: ${missing.text}` : "all OK"}`;
  const marks = item.chain.map((link) => lamp(item, link));
  return html`<span class="lamps" role="img" aria-label=${text} title=${text}>${marks.map(([kind, mark]) => html`<span class=${kind}>${mark}</span>`)}</span>`;
}

// Of a device that is away, the last speed with its age.
export function speed(item) {
  if (item.last) return html`<span class="past">last ${speed({ ...item, ...item.last, last: null })}, ${age(item.heard_age_ms)}</span>`;
  return item.speed_text || DASH;
}

export function position(item) {
  return withUnit(integer(item.position), item.position === null ? "" : item.position_unit ?? "position units");
}

export function lastFault(item) {
  const fault = item.cause ?? item.faults[0];
  if (!fault) return html`${DASH}`;
  return html`<span class=${fault.active ? "active" : "past"}>${fault.is_warning ? "Warning" : "Fault"} ${fault.number}${fault.active ? ", active" : nothing}</span>
    <small>${duration(fault.age_s)} ago</small>`;
}

export function faultTable(faults) {
  if (!faults.length) return html`<p>None.</p>`;
  return html`<div class="scroll" tabindex="0"><table>
    <thead><tr><th>Time</th><th>Number</th><th>Text</th></tr></thead>
    <tbody>${faults.map((fault) => html`<tr>
      <td class="number">${moment(fault.time)}</td>
      <td>${fault.is_warning ? "Warning" : "Fault"} ${fault.number}${fault.active ? html`, <strong>active</strong>` : nothing}</td>
      <td>${fault.text}</td></tr>`)}</tbody></table></div>`;
}
