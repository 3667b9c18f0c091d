// What happened around the last fault or stop: a button, ten lines, the support file beside them.

import { html } from "../vendor/lit-html/lit-html.js";
import { get } from "../api.js";
import { moment } from "../format.js";

const held = { path: "", lines: null, error: "" };

export function explain(doId, draw) {
  const path = doId === null ? "/api/v1/explain" : `/api/v1/objects/${doId}/explain`;
  const ask = async () => {
    try {
      Object.assign(held, { path, lines: (await get(path)).lines, error: "" });
    } catch (error) {
      Object.assign(held, { path, lines: null, error: error.message });
    }
    draw();
  };
  const lines = held.path === path ? held.lines : null;
  return html`<p class="row"><button type="button" @click=${ask}>What happened</button> <a class="button" href="/api/v1/support" download>Support file</a>
      <output>${held.path === path ? held.error : ""}</output></p>
    ${lines ? html`<ol class="happened">${lines.length ? lines.map((line) => html`<li><span class="number">${moment(line.time)}</span> <b>${line.who}</b> ${line.text}</li>`) : html`<li>No fault or stop since the gateway started.</li>`}</ol>` : ""}`;
}
