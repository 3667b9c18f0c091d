// The one stream of the page. It is closed while the page is hidden: a browser has six connections for all its tabs.

const SILENT_MS = 2500;
const RETRY_MS = 1000;

export class Stream {
  constructor({ onStatus, onEvent, onTrace, onState }) {
    this.on = { status: onStatus, event: onEvent, trace: onTrace };
    this.onState = onState;
    this.lastId = 0;
    this.trace = null;
    this.heard = 0;
    this.source = null;
    this.retry = null;
    document.addEventListener("visibilitychange", () => (document.hidden ? this.close() : this.open()));
    window.addEventListener("pagehide", () => this.close());
    setInterval(() => this.look(), 500);
  }

  // The axis whose samples are wanted, or null.
  follow(doId) {
    if (this.trace === doId) return;
    this.trace = doId;
    if (this.source) this.open();
  }

  open() {
    this.close();
    if (document.hidden) return;
    const query = new URLSearchParams({ after: this.lastId });
    if (this.trace !== null) query.set("trace", this.trace);
    const source = new EventSource(`/api/v1/events?${query}`);
    this.source = source;
    this.heard = Date.now();
    for (const kind of ["status", "event", "trace"]) {
      source.addEventListener(kind, (message) => {
        if (source !== this.source) return;
        this.heard = Date.now();
        if (message.lastEventId) this.lastId = Math.max(this.lastId, Number(message.lastEventId));
        this.onState("live");
        this.on[kind](JSON.parse(message.data));
      });
    }
    source.onerror = () => {
      if (source !== this.source) return;
      this.close();
      this.lost();
    };
  }

  close() {
    clearTimeout(this.retry);
    this.source?.close();
    this.source = null;
  }

  look() {
    if (this.source && Date.now() - this.heard > SILENT_MS) {
      this.close();
      this.lost();
    }
  }

  async lost() {
    const [state, text] = await this.cause();
    this.onState(state, text);
    clearTimeout(this.retry);
    this.retry = setTimeout(() => this.open(), RETRY_MS);
  }

  // EventSource has no text of a refusal. A second request reads it.
  async cause() {
    const stop = new AbortController();
    setTimeout(() => stop.abort(), 2000);
    try {
      const answer = await fetch(`/api/v1/events?after=${this.lastId}`, { cache: "no-store", signal: stop.signal });
      if (answer.status === 401) return ["login"];
      return answer.ok ? ["closed", "The server closed the connection of this page"] : ["refused", (await answer.json()).error];
    } catch {
      return ["lost"];
    } finally {
      stop.abort();
    }
  }
}
