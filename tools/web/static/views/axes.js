// Home: each cause in a sentence, then one line for each drive object; many of them are tiles first.

import { html } from "../vendor/lit-html/lit-html.js";
import { curve } from "../curves.js";
import { explain } from "./explain.js";
import { lamps, lastFault, objectName, position, speed, stateWord } from "./state.js";

const MANY = 16;

function complaint(status, cause) {
  const only = cause.objects.length === 1 ? [...status.axes, ...status.encoders].find((item) => item.do_id === cause.objects[0]) : null;
  const who = only ? html`<a href=${`#/axis/${only.do_id}`}>${objectName(only)}</a>` : `${cause.who[0].toUpperCase()}${cause.who.slice(1)}`;
  return html`<li data-state=${cause.state_id}>${who} <strong>${cause.state.toLowerCase()}</strong>: ${cause.reason}.
    <span class="todo">To do: ${cause.remedy}.</span></li>`;
}

function tile(state, item) {
  const symbol = state.states[item.state_id]?.symbol ?? "";
  return html`<li><a href=${`#/axis/${item.do_id}`} data-state=${item.state_id} title=${item.sentence}><span aria-hidden="true">${symbol}</span> ${objectName(item)}<small>${item.state}</small></a></li>`;
}

function row(state, item) {
  return html`<tr data-do=${item.do_id}>
    <th scope="row"><a href=${`#/axis/${item.do_id}`}>${objectName(item)}</a> <small>node ${item.node_id}, telegram ${item.telegram}</small></th>
    <td data-label="State">${stateWord(state, item)}</td>
    <td data-label="Enables" class="why">${lamps(item)} ${item.reason}</td>
    <td data-label="Speed" class="number"><span data-live>${speed(item)}</span>${curve(item)}</td>
    <td data-label="Position" class=${item.position === null ? "number none" : "number"} data-live>${position(item)}</td>
    <td data-label="Last fault">${lastFault(item)}</td>
  </tr>`;
}

export function axes(state, draw) {
  const items = [...state.status.axes, ...state.status.encoders];
  const { causes } = state.status;
  return html`<h2>Axes</h2>
    ${causes.length ? html`<ul class="complaints">${causes.map((cause) => complaint(state.status, cause))}</ul>` : ""}
    ${explain(null, draw)}
    ${items.length > MANY ? html`<ul class="tiles">${items.map((item) => tile(state, item))}</ul>
      <details><summary>All values</summary>${table(state, items)}</details>` : table(state, items)}`;
}

function table(state, items) {
  return html`<table class="cards">
      <thead><tr><th>DO</th><th>State</th><th>Enables</th><th class="number">Speed</th><th class="number">Position</th><th>Last fault</th></tr></thead>
      <tbody>${items.map((item) => row(state, item))}</tbody>
    </table>`;
}
