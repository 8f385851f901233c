// Controls that several panels have.

import { make } from "./dom.js";

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

/** Calls `work` when nothing more came for a moment. */
export function settled(work, pause = 120) {
  let waiting = 0;
  return (...values) => { clearTimeout(waiting); waiting = setTimeout(() => work(...values), pause); };
}
