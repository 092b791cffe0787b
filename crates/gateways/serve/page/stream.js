// Server-sent events read with fetch, because EventSource hides the status of an answer (401,
// 503). Reconnects by itself: .25 s after the first failure, doubled up to 8 s, with a random part.

const FIRST_DELAY_MS = 250;
const LAST_DELAY_MS = 8000;
/** The server sends at least a comment every 5 s. */
const SILENCE_MS = 12_000;

/** One event of the stream's text: its name and its data. */
export function parseEvent(block) {
  let kind = "message";
  const data = [];
  for (const line of block.split("\n")) {
    if (line.startsWith("event:")) kind = line.slice(6).trim();
    else if (line.startsWith("data:")) data.push(line.slice(5).replace(/^ /, ""));
  }
  return data.length > 0 ? { kind, data: data.join("\n") } : null;
}

/** Why the server refused: what it says in JSON, otherwise the status. */
async function refusal(answer) {
  const said = await answer.json().catch(() => null);
  return said?.error ?? `the server answers ${answer.status} ${answer.statusText}`;
}

export class Stream {
  #handlers;
  #url = null;
  #abort = null;
  #retry = null;
  #silence = null;
  #failures = 0;

  /** @param handlers onMessage(kind, object) → false if out of step; onState(state, detail) */
  constructor(handlers) {
    this.#handlers = handlers;
  }

  /** Reads this address from now on, whatever was read before. */
  open(url) {
    this.#url = url;
    this.#connect();
  }

  /** Reads nothing until the next `open`. */
  close() {
    this.#abort?.abort();
    clearTimeout(this.#retry);
    clearTimeout(this.#silence);
  }

  #connect() {
    this.#abort?.abort();
    clearTimeout(this.#retry);
    const abort = new AbortController();
    this.#abort = abort;
    this.#read(abort).then(
      () => this.#failed(abort, { reason: "the server ended the stream" }),
      (error) => this.#failed(abort, error.refused ?? { reason: "no connection to the server" }),
    );
  }

  async #read(abort) {
    this.#guard(abort);
    const answer = await fetch(this.#url, {
      signal: abort.signal,
      headers: { Accept: "text/event-stream" },
      cache: "no-store",
    });
    if (!answer.ok) {
      const error = new Error("refused");
      error.refused = { status: answer.status, reason: await refusal(answer) };
      throw error;
    }
    const reader = answer.body.pipeThrough(new TextDecoderStream()).getReader();
    let rest = "";
    for (;;) {
      const { value, done } = await reader.read();
      if (done || abort.signal.aborted) return;
      this.#guard(abort);
      const blocks = (rest + value.replaceAll("\r", "")).split("\n\n");
      rest = blocks.pop();
      for (const block of blocks) this.#deliver(abort, block);
    }
  }

  #deliver(abort, block) {
    const event = parseEvent(block);
    if (event === null || abort.signal.aborted) return;
    const inStep = this.#handlers.onMessage(event.kind, JSON.parse(event.data));
    if (!inStep) {
      this.#connect();
      return;
    }
    if (this.#failures > 0 || event.kind === "view") this.#handlers.onState("open", {});
    this.#failures = 0;
  }

  /** A connection that says nothing at all is dead, whatever TCP believes. */
  #guard(abort) {
    clearTimeout(this.#silence);
    this.#silence = setTimeout(() => {
      if (this.#abort === abort) this.#connect();
    }, SILENCE_MS);
  }

  #failed(abort, detail) {
    if (this.#abort !== abort || abort.signal.aborted) return;
    clearTimeout(this.#silence);
    const limit = Math.min(LAST_DELAY_MS, FIRST_DELAY_MS * 2 ** this.#failures);
    const delay = limit * (0.5 + Math.random() / 2);
    this.#failures += 1;
    this.#handlers.onState("closed", { ...detail, retryAt: performance.now() + delay });
    this.#retry = setTimeout(() => this.#connect(), delay);
  }
}
