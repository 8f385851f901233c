// Controls that several panels have.

import { ask, follow, send } from "./api.js";
import { alarm, button, by, errorNote, fill, make, note, number, percent, row } from "./dom.js";
import { draft, now, on } from "./state.js";

/** Controls of the document that show a part of the state, such as a slider and its box: `get` is what they show, `put` is called with what somebody chose. */
export function bind(id, parts, get, put, words) {
  const here = by(id), all = here.matches("input, select") ? [here] : [...here.querySelectorAll("input")];
  function show() {
    const value = get(), said = words?.(value);
    for (const one of all) {
      if (one.type === "checkbox") one.checked = value;
      else if (one.type === "radio") one.checked = one.value === value;
      else if (one !== document.activeElement) { one.value = value ?? ""; draft(one); }
      if (said) one.setAttribute("aria-valuetext", `${value}${said}`);
    }
    if (said) here.querySelector(".unit").textContent = said;
  }
  function take(one) {
    draft(one);
    put(one.type === "checkbox" ? one.checked : one.value === "" ? null : Number.isNaN(+one.value) ? one.value : +one.value);
  }
  for (const one of all) {
    one.addEventListener("input", () => { // a text is taken when it is finished, all else at once
      if (one.type !== "text" && one.checkValidity()) take(one);
      else if (here.closest("#step-route")) draft(one, one.value !== `${get() ?? ""}` && "finish what is being typed");
    });
    one.addEventListener("change", () => { if (one.reportValidity() && one.type === "text") take(one); });
    one.addEventListener("blur", () => { if (now.drafts.has(one) && one.checkValidity()) take(one); });
  }
  on(parts, show);
  show();
}

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
