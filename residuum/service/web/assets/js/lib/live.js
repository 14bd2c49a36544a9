// Server-sent events by fetch (so that an API key can be sent along), resumed after every break with the last event's id.

import { headers, Problem } from "./api.js";

const NO_KEY = [401, 403];
const SLOWEST = 10000;
const SILENCE = 45000; // the service says something every 15 s, if only that it is still there

export class Live {
  constructor(onEvent, onState) {
    this.onEvent = onEvent;
    this.onState = onState;
    this.last = null;
    this.wait = 500;
    this.run();
  }

  async run() {
    for (;;) {
      let state = "lost";
      try {
        await this.read();
      } catch (problem) {
        // the connection broke or could not be made: said by the state, tried again below
        if (NO_KEY.includes(problem.status)) state = "locked";
      }
      this.onState(state);
      await new Promise((resume) => setTimeout(resume, this.wait * (0.75 + Math.random() / 2)));
      this.wait = Math.min(this.wait * 1.7, SLOWEST);
    }
  }

  // Reads until the stream ends; a connection that has died in silence (a computer that slept) is given up.
  async read() {
    const silent = new AbortController();
    let waiting = null;
    const heard = () => {
      clearTimeout(waiting);
      waiting = setTimeout(() => silent.abort(), SILENCE);
    };
    try {
      heard();
      await this.listen(silent.signal, heard);
    } finally {
      clearTimeout(waiting);
    }
  }

  async listen(signal, heard) {
    const resume = this.last ? { "Last-Event-ID": this.last } : {};
    const response = await fetch("/api/v1/events", { headers: headers(resume), cache: "no-store", signal });
    if (!response.ok) throw new Problem(response.status, "no events");
    const missedNothing = this.last !== null;
    this.onState("connected", missedNothing);
    this.wait = 500;
    const reader = response.body.pipeThrough(new TextDecoderStream()).getReader();
    let text = "";
    for (;;) {
      const { done, value } = await reader.read();
      if (done) return;
      heard();
      text += value;
      const blocks = text.split("\n\n");
      text = blocks.pop();
      for (const block of blocks) this.block(block);
    }
  }

  block(block) {
    const fields = {};
    for (const line of block.split("\n")) {
      const colon = line.indexOf(": ");
      if (colon > 0) fields[line.slice(0, colon)] = line.slice(colon + 2);
    }
    if (fields.id) this.last = fields.id;
    if (fields.event) this.onEvent(fields.event, JSON.parse(fields.data));
  }
}
