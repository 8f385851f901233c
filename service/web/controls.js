// Controls that several panels have.

import { ask, follow, send } from "./api.js";
import { alarm, button, errorNote, fill, make, note, number, percent, row } from "./dom.js";

/** A slider with its value; `change` is called while it moves. */
export function slider(label, value, { min, max, step, words }, change) {
  const shown = make("b", {}, words(value));
  const input = make("input", { type: "range", min, max, step, value, "aria-label": label, "aria-valuetext": words(value), oninput: () => {
    shown.textContent = words(+input.value);
    input.setAttribute("aria-valuetext", shown.textContent);
    change(+input.value);
  } });
  return make("label", { class: "slider" }, make("span", {}, label, shown), input);
}

/** A box to tick; `change` is called with whether it is. */
export const check = (words, checked, change, own = {}) => make("label", { class: "check" }, make("input", { type: "checkbox", checked, onchange: event => change(event.target.checked), ...own }), words);

/** Calls `work` when nothing more came for a moment. */
export function settled(work, pause = 120) {
  let waiting = 0;
  return (...values) => { clearTimeout(waiting); waiting = setTimeout(() => work(...values), pause); };
}

/** Shows how far a job of the service is, with a button that cancels it. Returns it as it is when it is over. */
export async function watched(here, path, label, signal) {
  const bar = make("progress", { max: 1, value: 0, "aria-label": label }), words = note("Waiting for its turn"), began = performance.now();
  const stop = button({ id: "cancel", onclick: async () => { stop.disabled = true; await send(`${path}/cancel`).catch(error => fill(here, errorNote(error))); } }, "Cancel");
  fill(here, words, bar, row(stop));
  await follow(`${path}/events`, ({ status, progress }) => {
    bar.value = progress;
    words.textContent = status === "queued" ? "Waiting for its turn" : `${label}: ${percent(progress)} after ${number((performance.now() - began) / 1000, 0)} s`;
  }, signal);
  const made = await ask(path, { signal });
  fill(here, made.status === "failed" ? alarm(made.problem.detail) : made.status === "done" ? null : note("Cancelled. Nothing was kept of it but a record."));
  return made;
}
