// Every answer carries the question that it answers. Here a question is asked when it changes, and whatever shows the answer to another one is marked, until the new answer is there.

import { Latest } from "./api.js";
import { now, on, set } from "./state.js";

const PAUSE_MS = 120; // what changes again sooner than this is still being changed
const kept = new Map();

/**
 * Keeps a question asked: `question` makes it of the state (null: there is none; undefined: it waits for another answer), `ask` sends it, `draw` shows `now[name]`.
 * That is null, or an answer or `{ error }` with its `question` and the `key` of this; without a key it is a first answer, until the better one comes.
 */
export function keep(name, question, ask, draw) {
  const key = () => String(JSON.stringify(question()));
  kept.set(name, { question, ask, key, latest: new Latest(), asked: "null", at: -Infinity, waiting: 0 });
  on(name, draw);
}

/** Whether the answer is that to the question as it is now. */
export const answered = name => (now[name]?.key ?? "null") === kept.get(name).key();
/** Whether it may be shown as such: nothing is being typed, dragged or made that changes the question. */
export const current = name => !now.drafts.size && answered(name);

function check(name, one) {
  const key = one.key();
  if (key === one.asked) return;
  const soon = performance.now() - one.at < PAUSE_MS, question = one.question();
  Object.assign(one, { asked: key, at: performance.now() });
  one.latest.stop();
  clearTimeout(one.waiting);
  if (question === null) set({ [name]: null });
  else if (question && (now[name]?.key !== key || now[name].error)) one.waiting = setTimeout(send, soon ? PAUSE_MS : 0, name, one, question, key);
}

async function send(name, { ask, latest }, question, key) {
  const answer = await latest.run(signal => ask(question, signal, first => set({ [name]: { ...first, question } }))).catch(error => ({ error }));
  if (answer) set({ [name]: { ...answer, question, key } });
}

/** Asks once more, after an error. */
export function again(name) {
  kept.get(name).asked = null;
  check(name, kept.get(name));
}

/** All that shows something of an answer is `data-of` its name: what is of a question before is dim, busy and cannot be used, and the lines of the class "asked" say so. */
function mark() {
  for (const name of kept.keys()) {
    const old = now[name] && !current(name), [draft] = now.drafts.values();
    const words = !old ? "" : draft ? `For the question before: ${draft}` : now[name].key ? "For the question before; asking …" : "A first route; looking for a better one …";
    for (const here of document.querySelectorAll(`[data-of=${name}]`)) {
      if (here.classList.contains("asked")) { if (here.textContent !== words) here.textContent = words; continue; }
      here.classList.toggle("stale", Boolean(old));
      here.setAttribute("aria-busy", String(!answered(name)));
      if ("disabled" in here) here.disabled = old;
    }
  }
}

on("any", () => {
  for (const [name, one] of kept) check(name, one);
  mark();
});
