// The gateway itself.

import { html } from "../vendor/lit-html/lit-html.js";
import { getOnce } from "../api.js";
import { DASH, duration, moment } from "../format.js";

const held = { document: null, error: "" };

export function about(state, draw) {
  if (!held.document) {
    getOnce("/api/v1/about").then((document) => Object.assign(held, { document, error: "" }), (error) => Object.assign(held, { error: error.message })).then(() => {
      if (held.document && !about.drawn) {
        about.drawn = true;
        draw();
      }
    });
  }
  const { status } = state;
  return html`<h2>About</h2>
    <dl class="facts">
      <div><dt>Name</dt><dd>${status.name}</dd></div>
      <div><dt>Version</dt><dd>${status.version}</dd></div>
      <div><dt>Running for</dt><dd data-live>${duration(status.uptime_s)}</dd></div>
      <div><dt>Its time</dt><dd data-live>${moment(status.time)}</dd></div>
      <div><dt>Parameters kept in</dt><dd>${status.store || DASH}</dd></div>
    </dl>
    <p><a class="button" href="/api/v1/support" download>Support file</a> Status, events, configuration and the last half minute of both buses in one file, for who helps you.</p>
    <h3>Configuration</h3>
    ${held.document ? html`<pre tabindex="0">${held.document.configuration}</pre>
      <h3>Licences</h3><div class="scroll" tabindex="0"><table><tbody>${held.document.licences.map((item) => html`<tr><td>${item.name}</td><td>${item.version}</td><td>${item.licence}</td></tr>`)}</tbody></table></div>`
    : html`<p>${held.error || "..."}</p>`}`;
}
