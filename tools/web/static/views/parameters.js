// Parameters, read when somebody asks: the drive is not polled.

import { html, nothing } from "../vendor/lit-html/lit-html.js";
import { get } from "../api.js";
import { objectName } from "./state.js";

const held = { doId: null, rows: [], names: [], error: "", busy: false };

async function asking(draw, work) {
  Object.assign(held, { busy: true, error: "" });
  draw();
  try {
    await work();
  } catch (error) {
    held.error = error.message;
  }
  held.busy = false;
  draw();
}

const read = (draw, text) => asking(draw, async () => {
  const answer = await get(`/api/v1/objects/${held.doId}/parameters?${new URLSearchParams({ pnu: text })}`);
  const fresh = answer.elements.map((element) => ({ ...element, key: `${answer.do_id} ${element.parameter}`, doId: answer.do_id }));
  held.rows = [...fresh, ...held.rows.filter((row) => !fresh.some((element) => element.key === row.key))];
});

const list = (draw) => asking(draw, async () => {
  held.names = (await get(`/api/v1/objects/${held.doId}/parameters`)).parameters;
});

export function parameters(state, draw) {
  const items = [...state.status.axes, ...state.status.encoders];
  held.doId ??= items[0]?.do_id;
  const select = (event) => {
    held.doId = Number(event.target.value);
    held.names = [];
    draw();
  };
  const submit = (event) => {
    event.preventDefault();
    read(draw, event.target.querySelector("input").value);
  };
  return html`<h2>Parameters</h2>
    <form class="row" @submit=${submit}>
      <label>Of <select @change=${select}>${items.map((item) => html`<option value=${item.do_id} ?selected=${item.do_id === held.doId}>${objectName(item)}</option>`)}</select></label>
      <label>Parameter <input required size="12" placeholder="P922, 6041h" list="names" autocapitalize="off" spellcheck="false"></label>
      <datalist id="names">${held.names.map((item) => html`<option value=${item.pnu}>${item.name}</option>`)}</datalist>
      <button ?disabled=${held.busy}>Read</button>
      <button type="button" ?disabled=${held.busy} @click=${() => list(draw)}>List all</button>
      <a class="button" href=${`/api/v1/objects/${held.doId}/parameters/dump`} download>Save all as file</a>
    </form>
    <p role="alert" class="bad">${held.error}</p>
    ${held.rows.length ? html`<div class="scroll" tabindex="0"><table>
      <thead><tr><th>DO</th><th>Parameter</th><th>Name</th><th class="number">Value</th><th>Unit</th><th>Says</th></tr></thead>
      <tbody>${held.rows.map((row) => html`<tr><td>${row.doId}</td><td>${row.parameter}</td><td>${row.name}</td>
        <td class="number">${row.value ?? ""}</td><td>${row.unit}</td><td class=${row.error ? "bad" : ""}>${row.meaning}</td></tr>`)}</tbody>
    </table></div>` : html`<p>No parameter is read yet. Enter a profile parameter as P922, an object of the drive as 6041h or 1018h.1.</p>`}
    ${held.names.length ? html`<h3>What ${objectName(items.find((item) => item.do_id === held.doId) ?? {})} has</h3>
      <ul class="names">${held.names.map((item) => html`<li><button type="button" class="plain" ?disabled=${held.busy} @click=${() => read(draw, item.pnu)}>${item.pnu}</button> ${item.name}</li>`)}</ul>` : nothing}`;
}
