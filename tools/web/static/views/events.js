// What happened, newest first, one page at a time.

import { html, nothing } from "../vendor/lit-html/lit-html.js";
import { moment } from "../format.js";
import { objectName } from "./state.js";

const KINDS = ["fault", "warning", "reason", "plc", "node", "bus", "gateway"];
const PAGE = 25;
const held = { kind: "", text: "", copied: "", first: Infinity }; // `first`: id of the first event shown, Infinity for the newest

const times = (event) => (event.count > 1 ? ` (${event.count} times since ${moment(event.since)})` : "");
const line = (event, names) => `${event.time} ${event.kind} ${event.do_id === null ? "" : `${names.get(event.do_id)} `}${event.text}${times(event)}`;

function card(event, names) {
  return html`<li data-event=${event.id}><span class="number">${moment(event.time)}</span> <span class=${`kind ${event.kind}`}>${event.kind}</span>
    <span>${event.do_id === null ? nothing : html`<a href=${`#/axis/${event.do_id}`}>${names.get(event.do_id)}</a>`}</span>
    <span class="text">${event.text}<small>${times(event)}</small></span></li>`;
}

export function events(state, draw) {
  const wanted = held.text.toLowerCase();
  const names = new Map([...state.status.axes, ...state.status.encoders].map((item) => [item.do_id, objectName(item)]));
  const shown = state.events.filter((event) => (!held.kind || event.kind === held.kind) && line(event, names).toLowerCase().includes(wanted));
  const begin = Math.max(0, shown.findIndex((event) => event.id <= held.first));
  const turn = (place) => () => {
    held.first = place > 0 ? shown[place].id : Infinity;
    draw();
    scrollTo(0, 0);
  };
  const change = (key) => (event) => {
    Object.assign(held, { [key]: event.target.value, first: Infinity });
    draw();
  };
  const copy = async () => {
    const head = `${state.status.name}, pdgw ${state.status.version}, ${state.status.time}`;
    try {
      await navigator.clipboard.writeText([head, ...shown.map((event) => line(event, names))].join("\n"));
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
    ${shown.length ? html`<ol class="events">${shown.slice(begin, begin + PAGE).map((event) => card(event, names))}</ol>` : html`<p>Nothing.</p>`}
    ${shown.length > PAGE ? html`<div class="row">
      <button type="button" ?disabled=${begin === 0} @click=${turn(begin - PAGE)}>Newer</button>
      <button type="button" ?disabled=${begin + PAGE >= shown.length} @click=${turn(begin + PAGE)}>Older</button>
      <span>${begin + 1} to ${Math.min(begin + PAGE, shown.length)} of ${shown.length}</span></div>` : nothing}`;
}
