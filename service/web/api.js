// Talks to the service: questions, files, pictures and progress. Errors carry the words of the service.

import { by, time } from "./dom.js";

const ROOT = new URL("../", import.meta.url);
const KEY = "joulemap-key";
let tell = () => {};

/** An answer that is no success; `message` says what is wrong and what to do. */
export class Problem extends Error {
  constructor(body, status) {
    super(body.detail ?? `the service answered ${status}`);
    Object.assign(this, { name: "Problem", status, code: body.code, context: body.context ?? {} });
  }
}

/** The service could not be reached. */
export class Unreachable extends Error {
  constructor() { super("The service does not answer. Is it still running?"); this.name = "Unreachable"; }
}

export const address = path => new URL(path.replace(/^\//, ""), ROOT);
export const onConnection = listener => { tell = listener; };

async function request(path, { method = "GET", body, headers = {}, signal } = {}) {
  const key = sessionStorage.getItem(KEY);
  const sent = { ...headers, ...(key ? { Authorization: `Bearer ${key}` } : {}) };
  let payload = body;
  if (body !== undefined && !(body instanceof FormData) && !(body instanceof Blob)) {
    sent["Content-Type"] = "application/json";
    payload = JSON.stringify(body);
  }
  let answer;
  try {
    answer = await fetch(address(path), { method, body: payload, headers: sent, signal });
  } catch (error) {
    if (error.name === "AbortError") throw error;
    watchConnection();
    throw new Unreachable();
  }
  if (answer.ok) return answer;
  const text = await answer.text();
  let said;
  try { said = JSON.parse(text); } catch { said = { detail: `The service answered ${answer.status}: ${text.slice(0, 200)}` }; }
  if (answer.status === 401 && await askKey(said.detail)) return request(path, { method, body, headers, signal });
  throw new Problem(said, answer.status);
}

export async function ask(path, options) {
  const answer = await request(path, { ...options, headers: { Accept: "application/json", ...options?.headers } });
  return answer.status === 204 ? null : answer.json();
}

/** Asks with a confidence, and where the model gives no odds without one: then the expected energy decides. The answer has `odds`, whether there are any. */
export async function sendForOdds(path, body, options) {
  try { return { ...await send(path, body, options), odds: true }; } catch (error) {
    if (error.status !== 422 || !/confidence/.test(error.message)) throw error;
    return { ...await send(path, { ...body, confidence: null }, options), odds: false };
  }
}

export const send = (path, body, options) => ask(path, { method: "POST", body, ...options });
/** What is kept: cost maps and heightmaps, the names of these, and what tells one cost map from the others. */
export async function kept() {
  const [costmaps, heightmaps] = (await Promise.all(["costmaps", "heightmaps"].map(kind => ask(`v1/${kind}?limit=100`)))).map(({ items }) => items);
  const named = new Map(heightmaps.map(one => [one.id, one.name])), name = id => named.get(id) ?? id;
  const words = ({ heightmap_id: ground, robot, model }) => `${name(ground)} · ${robot.name}, ${robot.mass_kg} kg · ${model}`;
  const label = one => words(one) + (costmaps.some(other => other !== one && words(other) === words(one)) ? ` · ${time(one.created_at)}` : "");
  return { costmaps, heightmaps, name, label };
}
export const blob = async (path, options) => (await request(path, options)).blob();

/** Follows a job, or a drive, until its last event; `report` is called with each state. Connects again when the connection breaks. */
export async function follow(path, report, signal, last = "end") {
  for (;;) {
    try {
      const answer = await request(path, { headers: { Accept: "text/event-stream" }, signal });
      for await (const { event, data } of events(answer.body)) {
        report(data);
        if (event === last) return data;
      }
    } catch (error) {
      if (!(error instanceof Unreachable || error instanceof TypeError)) throw error;
    }
    await new Promise(done => setTimeout(done, 1000));
  }
}

async function* events(stream) {
  const reader = stream.pipeThrough(new TextDecoderStream()).getReader();
  let text = "";
  for (;;) {
    const { value, done } = await reader.read();
    if (done) return;
    text += value.replace(/\r/g, "");
    const parts = text.split("\n\n");
    text = parts.pop();
    for (const part of parts) {
      const event = /^event: ?(.*)$/m.exec(part)?.[1], data = /^data: ?(.*)$/m.exec(part)?.[1];
      if (event && data) yield { event, data: JSON.parse(data) };
    }
  }
}

/** Of questions asked in a row only the last counts: the one before is aborted, which stops its work in the service, and gives undefined. */
export class Latest {
  #abort = null;

  async run(work) {
    this.stop();
    const { signal } = this.#abort = new AbortController();
    try {
      const result = await work(signal);
      return signal.aborted ? undefined : result;
    } catch (error) { if (!signal.aborted) throw error; }
  }

  stop() { this.#abort?.abort(); }
}

let watching = false;
async function watchConnection() {
  if (watching) return;
  watching = true;
  tell(false);
  for (let there = false; !there;) {
    await new Promise(done => setTimeout(done, 2000));
    there = await fetch(address("healthz")).then(answer => answer.ok, () => false);
  }
  watching = false;
  tell(true);
}

let asking = null;
function askKey(why) {
  asking ??= new Promise(done => {
    const box = by("key-dialog"), input = box.querySelector("input");
    box.querySelector("p").textContent = why;
    box.onsubmit = () => sessionStorage.setItem(KEY, input.value);
    box.onclose = () => { asking = null; done(input.value !== ""); };
    box.showModal();
  });
  return asking;
}
