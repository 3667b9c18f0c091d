// What happened, newest first.

import { html } from "../vendor/lit-html/lit-html.js";
import { moment } from "../format.js";

const KINDS = ["fault", "warning", "reason", "plc", "node", "bus", "gateway"];
const held = { kind: "", text: "", copied: "" };

const times = (event) => (event.count > 1 ? ` (${event.count} times since ${moment(event.since)})` : "");
const line = (event) => `${event.time} ${event.kind} ${event.do_id === null ? "" : `DO ${event.do_id} `}${event.text}${times(event)}`;

export function events(state, draw) {
  const wanted = held.text.toLowerCase();
  const shown = state.events.filter((event) => (!held.kind || event.kind === held.kind) && line(event).toLowerCase().includes(wanted));
  const change = (key) => (event) => {
    held[key] = event.target.value;
    draw();
  };
  const copy = async () => {
    const head = `${state.status.name}, pdgw ${state.status.version}, ${state.status.time}`;
    try {
      await navigator.clipboard.writeText([head, ...shown.map(line)].join("\n"));
      held.copied = `${shown.length} lines copied`;
    } catch {
      held.copied = "not copied: the browser does not allow it; the support file in About contains these lines";
    }
    draw();
  };
  return html`<h2>Events</h2>
    <form class="row" @submit=${(event) => event.preventDefault()}>
      <label>Kind <select @change=${change("kind")}><option value="">all</option>${KINDS.map((kind) => html`<option ?selected=${kind === held.kind}>${kind}</option>`)}</select></label>
      <label>Contains <input type="search" @input=${change("text")}></label>
      <button type="button" @click=${copy}>Copy for support</button>
      <output>${held.copied}</output>
    </form>
    ${shown.length ? html`<div class="scroll"><table>
      <thead><tr><th>Time</th><th>Kind</th><th>DO</th><th>What</th></tr></thead>
      <tbody>${shown.map((event) => html`<tr data-event=${event.id}><td class="number">${moment(event.time)}</td><td class=${`kind ${event.kind}`}>${event.kind}</td>
        <td class="number">${event.do_id === null ? "" : html`<a href=${`#/axis/${event.do_id}`}>${event.do_id}</a>`}</td><td>${event.text}<small>${times(event)}</small></td></tr>`)}</tbody>
    </table></div>` : html`<p>Nothing.</p>`}`;
}
