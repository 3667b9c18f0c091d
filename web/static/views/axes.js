// Home: what is wrong in sentences, then one line for each drive object.

import { html } from "../vendor/lit-html/lit-html.js";
import { FINE, lastFault, objectName, position, speed, stateWord } from "./state.js";

function complaint(item) {
  return html`<li><a href=${`#/axis/${item.do_id}`}>${objectName(item)}</a> <strong>${item.state.toLowerCase()}</strong>${item.reason ? html`: ${item.reason}` : ""}.
    ${item.remedy ? html`<span class="todo">To do: ${item.remedy}.</span>` : ""}</li>`;
}

function row(state, item) {
  return html`<tr data-do=${item.do_id}>
    <th scope="row"><a href=${`#/axis/${item.do_id}`}>${objectName(item)}</a> <small>node ${item.node_id}, telegram ${item.telegram}</small></th>
    <td data-label="State">${stateWord(state, item)}</td>
    <td data-label="Why" class="why">${item.reason}</td>
    <td data-label="Speed" class="number" data-live>${speed(item)}</td>
    <td data-label="Position" class="number" data-live>${position(item)}</td>
    <td data-label="Last fault">${lastFault(item)}</td>
  </tr>`;
}

export function axes(state) {
  const items = [...state.status.axes, ...state.status.encoders];
  const blocked = items.filter((item) => !FINE.includes(item.state_id));
  return html`<h2>Axes</h2>
    ${blocked.length ? html`<ul class="complaints">${blocked.map(complaint)}</ul>` : ""}
    <table class="cards">
      <thead><tr><th>DO</th><th>State</th><th>Why</th><th class="number">Speed</th><th class="number">Position</th><th>Last fault</th></tr></thead>
      <tbody>${items.map((item) => row(state, item))}</tbody>
    </table>`;
}
