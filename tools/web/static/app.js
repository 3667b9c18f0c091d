// The page: one state, one stream, views as functions of the state. States, reasons and what to do come from the gateway.

import { html, render } from "./vendor/lit-html/lit-html.js";
import { get } from "./api.js";
import { keep } from "./curves.js";
import { banners, header } from "./frame.js";
import { login } from "./login.js";
import { Stream } from "./stream.js";
import { about } from "./views/about.js";
import { axes } from "./views/axes.js";
import { axis } from "./views/axis.js";
import { buses } from "./views/buses.js";
import { events } from "./views/events.js";
import { parameters } from "./views/parameters.js";
import { plc } from "./views/plc.js";

const EVENTS_MAX = 1000;

// Order of the navigation. `axis` has no entry of its own: it is reached from the table.
const VIEWS = { axes, plc, buses, parameters, events, about };
const TITLES = { axes: "Axes", plc: "PLC", buses: "Buses", parameters: "Parameters", events: "Events", about: "About" };

const state = {
  status: null, // the newest document of the gateway
  received: 0, // when it came, by this machine's clock
  connection: "connecting", // live, lost, closed, refused, login
  lostAt: null,
  events: [],
  states: {}, // word and symbol of each state
  route: { view: "axes", argument: null },
  titles: TITLES,
};

const stream = new Stream({
  onStatus: (status) => {
    state.status = status;
    if (!status.stale) {
      state.received = Date.now();
      keep(status, state.received / 1000);
    }
    document.title = `${status.name ?? "gateway"}: ${TITLES[state.route.view] ?? `Axis ${state.route.argument}`}`;
    draw();
  },
  onEvent: (event) => {
    if (state.events.some((known) => known.id === event.id)) return;
    if (event.count > 1) {
      const same = state.events.findIndex((known) => known.kind === event.kind && known.do_id === event.do_id && known.text === event.text);
      if (same >= 0) state.events.splice(same, 1);
    }
    state.events.unshift(event);
    state.events.length = Math.min(state.events.length, EVENTS_MAX);
  },
  onTrace: (samples) => axis.samples(samples),
  onState: (connection, why) => {
    state.why = why;
    if (connection === state.connection) return;
    if (connection === "live") state.lostAt = null;
    else state.lostAt ??= Date.now();
    state.connection = connection;
    draw();
  },
});

function route() {
  const [view, argument] = location.hash.replace(/^#\/?/, "").split("/");
  if (view === "axis" && /^\d+$/.test(argument ?? "")) return { view, argument: Number(argument) };
  return { view: view in VIEWS ? view : "axes", argument: null };
}

function draw() {
  const main = document.getElementById("main");
  render(header(state), document.getElementById("header"));
  render(banners(state), document.getElementById("banners"));
  main.classList.toggle("old", state.connection !== "live" || (state.status?.stale ?? false));
  if (state.connection === "login") render(login(() => stream.open()), main);
  else if (state.status?.axes) render((state.route.view === "axis" ? axis : VIEWS[state.route.view])(state, draw), main);
  else render(html`<p>${state.status ? "The gateway does not answer." : "Reading the status ..."}</p>`, main);
}

function go() {
  const before = state.route;
  state.route = route();
  if (before.view === "axis" && (state.route.view !== "axis" || before.argument !== state.route.argument)) axis.leave();
  stream.follow(state.route.view === "axis" ? state.route.argument : null);
  draw();
  const main = document.getElementById("main");
  if (before.view !== state.route.view || before.argument !== state.route.argument) {
    main.focus({ preventScroll: true }); // a jump would hide the first line under the header
    scrollTo(0, 0);
  }
}

document.getElementById("main").replaceChildren();
document.getElementById("skip").addEventListener("click", (event) => {
  event.preventDefault();
  document.getElementById("main").focus({ preventScroll: true });
});
window.addEventListener("hashchange", go);
setInterval(draw, 1000); // ages go on when nothing comes
get("/api/v1/states").then((states) => Object.assign(state.states, states)).catch(() => undefined).then(draw);
go();
stream.open();
