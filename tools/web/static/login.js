// The token, once: the server answers with a cookie that scripts cannot read.

import { html } from "./vendor/lit-html/lit-html.js";

let told = "";

export function login(done) {
  const send = async (event) => {
    event.preventDefault();
    const field = event.target.querySelector("input");
    const message = event.target.querySelector("output");
    const answer = await fetch("/api/v1/login", { headers: { authorization: `Bearer ${field.value.trim()}` } }).catch(() => null);
    field.value = "";
    if (answer?.ok) {
      told = "";
      done();
      return;
    }
    told = answer ? ((await answer.json().catch(() => ({}))).error ?? "refused") : "the page's server does not answer";
    message.value = told;
    field.focus();
  };
  return html`<h2>Token</h2>
    <p>This page is open to who has the token of the gateway: the text of the file that <code>[web] token_file</code> names.</p>
    <form class="row" @submit=${send}>
      <label>Token <input type="password" autocomplete="current-password" required></label>
      <button>Open</button>
      <output role="alert">${told}</output>
    </form>`;
}
