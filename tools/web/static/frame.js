// What every view has around it: name, navigation, how things stand, and banners for what makes all values doubtful.

import { html, nothing } from "./vendor/lit-html/lit-html.js";
import { clock } from "./format.js";
import { BAD, FINE } from "./views/state.js";

function sentence(state) {
  const { status } = state;
  if (state.connection === "login") return "token needed";
  if (!status?.axes) return state.connection === "live" ? "no gateway" : "connecting";
  if (state.connection !== "live" || status.stale) return `no data since ${clock(state.received || Date.now())}`;
  const obey = status.axes.filter(inOperation).length;
  const plc = status.plc.connected ? "PLC connected" : "no PLC";
  if (!status.axes.length) return `live, ${plc}`;
  const all = status.axes.length;
  return `live, ${plc}, ${obey} of ${all} ${all === 1 ? "axis" : "axes"} in operation`;
}

const inOperation = (item) => item.state_id === "OBEYS";

// Green is what is well: a PLC, and nothing that waits, stops or is in fault.
function wellness(state) {
  const { status } = state;
  if (state.connection !== "live" || !status?.axes || status.stale) return "old";
  const items = [...status.axes, ...status.encoders];
  if (!status.plc.connected || !status.buses.every((bus) => bus.healthy) || items.some((item) => BAD.includes(item.state_id))) return "old";
  return items.every((item) => FINE.includes(item.state_id)) ? "live" : "waits";
}

export function header(state) {
  const current = state.route.view === "axis" ? "axes" : state.route.view;
  return html`<h1>${state.status?.name ?? "gateway"}</h1>
    <nav aria-label="Views">${Object.entries(state.titles).map(([view, title]) => html`
      <a href=${`#/${view}`} aria-current=${view === current ? "page" : nothing}>${title}</a>`)}</nav>
    <p role="status" class=${wellness(state)}>${sentence(state)}</p>`;
}

const alert = (text) => html`<p class="banner bad" role="alert">${text}</p>`;
const note = (text) => html`<p class="banner note">${text}</p>`;

export function banners(state) {
  const { status } = state;
  const shown = [];
  if (["lost", "closed", "refused"].includes(state.connection)) {
    const why = state.why ?? `This page lost its connection at ${clock(state.lostAt)}`;
    shown.push(alert(`${why}. Values below are old. Trying again.`));
  } else if (state.connection === "live" && status?.stale) {
    const since = status.answered ? clock(status.answered * 1000) : "this page was opened";
    shown.push(alert(`The gateway does not answer since ${since}: ${status.failure}. Values below are old.`));
  }
  if (status?.axes && !status.stale) {
    if (!status.plc.connected) {
      const last = status.plc.peer ? ` (last: ${status.plc.peer.join?.(":") ?? status.plc.peer})` : "";
      shown.push(note(`${noPlc(state)}${last}. The axes are stopped; each needs OFF, then ON.`));
    }
    for (const bus of status.buses) {
      if (!bus.healthy) shown.push(html`<p class="banner bad" role="alert">Bus ${bus.name} is lost.</p>`);
    }
    shown.push(...status.notes.map(note));
    if (status.simulated) shown.push(note("Simulated devices: no real machine moves."));
  }
  return shown;
}

// The event says when; a page opened later has it from the list.
function noPlc(state) {
  const event = state.events.find((known) => known.kind === "plc");
  return state.status.plc.peer && event ? `No PLC since ${clock(event.time)}` : "No PLC yet";
}
