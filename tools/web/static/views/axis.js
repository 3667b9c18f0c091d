// One drive object: why it does not obey, its trend, the words both sides send, its faults.

import { html, nothing } from "../vendor/lit-html/lit-html.js";
import { get, getOnce } from "../api.js";
import { DASH, age, hex } from "../format.js";
import { Trend } from "../trend.js";
import { explain } from "./explain.js";
import { faultTable, lamp, objectName, position, speed, stateWord } from "./state.js";

const ROOMY = matchMedia("(min-width: 46rem)").matches; // on a phone, bits of a word and a chain without a missing enable are unfolded by hand
const held = { doId: null, trend: null, telegram: null, faults: [], seen: "" };

function link(item, enable) {
  const [kind, mark] = lamp(item, enable);
  const word = enable.ok === null ? "not checked" : enable.ok ? "OK" : enable.evidence;
  return html`<li class=${kind}><span class="mark" aria-hidden="true">${mark}</span>
    <span>${enable.text}<small>${word}</small></span>
    ${enable.ok === false ? html`<strong class="todo">${enable.todo}</strong>` : nothing}</li>`;
}

function bit(field, raw) {
  const value = Math.floor(raw / 2 ** field.position) % 2 ** field.width;
  return html`<li class=${value ? "set" : ""}><span class="bit">${field.width > 1 ? `${field.position}–${field.position + field.width - 1}` : field.position}</span>
    <span class="value">${value}</span> <span>${field.name}<small>${field.meaning}</small></span></li>`;
}

function word(signal, raw, text) {
  const wire = hex(raw, signal.digits);
  if (!signal.bits.length) {
    return html`<div class="word"><div class="row"><b>${signal.name}</b> <span class="wire" data-live>${wire}</span>
      <span data-live>${text}</span></div><small>${signal.description}</small></div>`;
  }
  const unsigned = raw < 0 ? raw + 2 ** (4 * signal.digits) : raw;
  return html`<details class="word" ?open=${ROOMY}><summary><b>${signal.name}</b> <span class="wire" data-live>${wire}</span> <small>${signal.description}</small></summary>
    <ul class="bits">${signal.bits.map((field) => bit(field, unsigned))}</ul></details>`;
}

function words(title, signals, values, texts) {
  const known = signals.filter((signal) => values && signal.name in values);
  return html`<section><h3>${title}</h3>${values
    ? known.map((signal) => word(signal, values[signal.name], texts[signal.name]))
    : html`<p>No valid data yet.</p>`}</section>`;
}

function follow(item, draw) {
  if (held.doId !== item.do_id) {
    leave();
    held.doId = item.do_id;
    held.trend = new Trend(item.do_id, draw);
  }
  if (held.telegram?.number !== item.telegram) {
    getOnce(`/api/v1/telegrams/${item.telegram}`).then((telegram) => {
      if (held.doId === item.do_id && held.telegram?.number !== telegram.number) {
        held.telegram = telegram;
        draw();
      }
    }).catch(() => undefined);
  }
  const [newest] = item.faults;
  const seen = `${item.do_id} ${newest?.id} ${newest?.active}`;
  if (newest && seen !== held.seen) {
    held.seen = seen;
    get(`/api/v1/objects/${item.do_id}/faults`).then((answer) => {
      if (held.doId === item.do_id) held.faults = answer.faults;
      draw();
    }).catch(() => undefined);
  }
}

function leave() {
  held.trend?.destroy();
  Object.assign(held, { doId: null, trend: null, telegram: null, faults: [], seen: "" });
}

function facts(item) {
  const rows = [
    ["Speed", speed(item)],
    ...(item.position === null ? [] : [["Position", position(item)]]),
    ["Device", `node ${item.node_id} on ${item.bus}, telegram ${item.telegram}: ${item.drive}${item.drive_text ? `, ${item.drive_text}` : ""}`],
    ["Device state", item.drive_state ?? item.sensor_state ?? DASH],
    ["Last frame", age(item.heard_age_ms)],
  ];
  return html`<dl class="facts">${rows.map(([name, value]) => html`<div><dt>${name}</dt><dd data-live>${value}</dd></div>`)}</dl>`;
}

export function axis(state, draw) {
  const items = [...state.status.axes, ...state.status.encoders];
  const item = items.find((known) => known.do_id === state.route.argument);
  if (!item) return html`<h2>Axis ${state.route.argument}</h2><p>The gateway has no drive object with this number. <a href="#/axes">All axes</a></p>`;
  follow(item, draw);
  return html`<p class="back"><a href="#/axes">All axes</a></p>
    <h2>${objectName(item)}</h2>
    <p class="large">${stateWord(state, item)}</p>
    ${item.reason ? html`<p class="reason">${item.reason}</p>` : nothing}
    <details ?open=${ROOMY || item.chain.some((enable) => enable.ok === false)}><summary>Enables</summary>
      <ol class="chain" data-chain aria-label="Chain of enables">${item.chain.map((enable) => link(item, enable))}</ol></details>
    ${explain(item.do_id, draw)}
    ${held.trend.view(state)}
    ${facts(item)}
    <div class="columns">
      ${words("From the PLC", held.telegram?.setpoints ?? [], item.setpoints, item.setpoint_texts)}
      ${words("To the PLC", held.telegram?.actuals ?? [], item.actuals, item.actual_texts)}
    </div>
    ${item.iops_good ? nothing : html`<p>The PLC receives its values marked as bad (IOPS).</p>`}
    ${item.scaling?.length ? html`<details><summary>What 100 % is</summary><ul>${item.scaling.map((line) => html`<li>${line}</li>`)}</ul></details>` : nothing}
    ${item.protections ? html`<details><summary>Protections</summary><ul>${item.protections.map(({ name, text }) => html`<li>${name}: ${text}</li>`)}</ul></details>` : nothing}
    <h3>Faults and warnings</h3>
    ${faultTable(item.faults.length ? (held.faults.length ? held.faults : item.faults) : [])}`;
}

axis.samples = (samples) => held.trend?.samples(samples);
axis.leave = leave;
