// The 3-D view: a document of its own inside a dialog, so that plotly.js is loaded only when somebody asks for it.

import { address, ask } from "./api.js";
import { button, make, row } from "./dom.js";
import { now } from "./state.js";

export async function open(plotly) {
  const frame = make("iframe", { src: address("page/view3d.html").href, title: "Ground and routes in three dimensions" });
  const box = make("dialog", { class: "large", "aria-label": "3-D view" }, row(make("b", {}, "3-D view"), make("span", { class: "quiet" }, "drag to turn, wheel to zoom; heights are exaggerated"), make("span", { class: "grow" }), button({ onclick: () => box.close() }, "Close")), frame);
  box.addEventListener("close", () => box.remove());
  document.body.append(box);
  box.showModal();
  const [surface] = await Promise.all([ask(`v1/costmaps/${now.costmap.id}/surface`), new Promise(done => window.addEventListener("message", event => event.source === frame.contentWindow && event.data === "ready" && done(), { once: false }))]);
  const { answer } = now, routes = answer?.path ? [["least energy", "#0072B2", answer], ["shortest", "#D55E00", answer.shortest], ["way back", "#56B4E9", answer.back], ...answer.alternatives.map((one, k) => [`alternative ${k + 1}`, "#777777", one])] : [];
  frame.contentWindow.postMessage({ surface, routes: routes.filter(([,, way]) => way).map(([name, colour, { path }]) => ({ name, colour, path })), plotly, dark: matchMedia("(prefers-color-scheme: dark)").matches }, window.location.origin);
}
