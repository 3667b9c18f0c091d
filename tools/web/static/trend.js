// The trend of one drive object: history once, then samples from the stream. uPlot draws.

import { html, nothing } from "./vendor/lit-html/lit-html.js";
import uPlot from "./vendor/uplot/uPlot.esm.js";
import { get } from "./api.js";
import { DASH, clock, number } from "./format.js";

const WINDOWS = [[10, "10 s"], [60, "60 s"], [600, "10 min"]];
const BINS = 800;
const [HEIGHT, GAP_S] = [240, 2];
const KEPT_S = 660; // so that ten minutes are there after ten minutes, however far back the gateway remembers

const colour = (name) => getComputedStyle(document.documentElement).getPropertyValue(name).trim();

export class Trend {
  constructor(doId, draw) {
    this.doId = doId;
    this.draw = draw;
    this.window = 10;
    this.paused = false;
    this.signals = null;
    this.data = null;
    this.error = "";
    this.plot = null;
    this.element = document.createElement("div");
    this.element.className = "plot";
    this.resizing = new ResizeObserver(() => this.fit());
    this.resizing.observe(this.element);
    this.dark = matchMedia("(prefers-color-scheme: dark)");
    this.recolour = () => this.rebuild();
    this.dark.addEventListener("change", this.recolour);
    this.load();
  }

  destroy() {
    this.gone = true;
    this.resizing.disconnect();
    this.dark.removeEventListener("change", this.recolour);
    this.plot?.destroy();
  }

  async load() {
    const wanted = this.window;
    try {
      const answer = await get(`/api/v1/objects/${this.doId}/trace?seconds=${wanted}&bins=${BINS}`);
      if (this.gone || wanted !== this.window) return;
      this.error = "";
      this.take(answer.signals, this.longer([answer.time, ...answer.values], answer.signals));
    } catch (error) {
      this.error = error.message;
    }
    this.draw();
  }

  // What was seen before the gateway's memory begins is kept.
  longer(data, signals) {
    if (!this.data || JSON.stringify(signals) !== JSON.stringify(this.signals)) return data;
    const first = data[0][0] ?? Infinity;
    const before = this.data[0].findIndex((time) => time >= first);
    const kept = before < 0 ? this.data[0].length : before;
    return this.data.map((column, place) => column.slice(0, kept).concat(data[place]));
  }

  take(signals, data) {
    const changed = JSON.stringify(signals) !== JSON.stringify(this.signals);
    this.signals = signals;
    this.data = data;
    if (changed) this.rebuild();
    else this.show();
  }

  samples(chunk) {
    if (chunk.do_id !== this.doId || (!this.data && !this.error)) return;
    if (chunk.error || this.error) {
      if (!chunk.error) this.load();
      this.error = chunk.error;
      return;
    }
    if (JSON.stringify(chunk.signals) !== JSON.stringify(this.signals)) {
      this.load();
      return;
    }
    const last = this.data[0].at(-1) ?? 0;
    const first = chunk.time.findIndex((time) => time > last);
    if (first < 0) return;
    const oldest = chunk.time.at(-1) - KEPT_S;
    const drop = Math.max(0, this.data[0].findIndex((time) => time >= oldest));
    const end = (place) => (chunk.time[first] - last > GAP_S ? [place ? null : last + 0.001] : []); // the curve ends where no data came
    this.data = [chunk.time, ...chunk.values].map((column, place) => this.data[place].slice(drop).concat(end(place), column.slice(first)));
    if (!this.paused) this.show();
  }

  rebuild() {
    this.plot?.destroy();
    this.plot = null;
    if (!this.data || this.gone) return;
    const axis = { stroke: colour("--text"), grid: { stroke: colour("--line"), width: 1 }, ticks: { stroke: colour("--line"), width: 1 } };
    const times = { ...axis, space: 90, values: (plot, splits) => splits.map((moment) => clock(moment * 1000)), incrs: [1, 2, 5, 10, 30, 60, 120, 300] };
    const units = [...new Set(this.signals.map((signal) => signal.unit))];
    const [styles, dashes] = [["--actual", "--set", "--third", "--fourth"], [undefined, [6, 4], [2, 3], [8, 3, 2, 3]]];
    const legend = (text) => (plot, raw, place, index) => text((index === null ? plot.data[place].at(-1) : raw) ?? null); // without a pointer: the newest
    const options = {
      width: this.element.clientWidth || 600,
      height: HEIGHT,
      scales: { x: { time: true, range: (plot, low, high) => [high - this.window, high] } },
      legend: { live: true },
      cursor: { drag: { x: false, y: false } },
      series: [
        { value: legend((time) => (time === null ? DASH : new Date(time * 1000).toISOString().slice(11, 23))) },
        ...this.signals.map((signal, place) => ({
          label: `${signal.label} (${signal.unit})`,
          scale: signal.unit,
          stroke: colour(styles[place % styles.length]),
          dash: dashes[place % dashes.length],
          width: 2,
          points: { show: false },
          value: legend(number),
        })),
      ],
      axes: [times, ...units.map((unit, place) => ({ ...axis, scale: unit, label: unit, side: place ? 1 : 3, size: 78, labelSize: 18, grid: place ? { show: false } : axis.grid }))],
    };
    this.plot = new uPlot(options, this.data, this.element);
  }

  show() {
    this.plot?.setData(this.data);
  }

  fit() {
    const width = this.element.clientWidth;
    if (this.plot && width && width !== this.plot.width) this.plot.setSize({ width, height: HEIGHT });
  }

  view() {
    const choose = (seconds) => {
      this.window = seconds;
      this.paused = false;
      this.load();
      this.draw();
    };
    const pause = () => {
      this.paused = !this.paused;
      if (!this.paused) this.show();
      this.draw();
    };
    return html`<section class="trend" aria-label="Trend">
      <div class="row" role="group" aria-label="Trend">${WINDOWS.map(([seconds, text]) => html`
        <button type="button" aria-pressed=${this.window === seconds} @click=${() => choose(seconds)}>${text}</button>`)}
        <button type="button" aria-pressed=${this.paused} @click=${pause}>Pause</button>
        <a class="button" href=${`/api/v1/objects/${this.doId}/trace?seconds=${this.window}&format=csv`} download>CSV</a>
        <a class="button" href=${`/api/v1/capture?seconds=${this.window}`} download>Capture</a>
      </div>
      ${this.error ? html`<p>No trend: ${this.error}</p>` : nothing}
      ${this.element}
    </section>`;
  }
}
