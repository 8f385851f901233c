// The 3-D view: a document of its own inside a dialog, so that plotly.js is loaded only when somebody asks for it.

import { address, ask } from "./api.js";
import { by, make } from "./dom.js";
import { now } from "./state.js";

export async function open(plotly) {
  const frame = make("iframe", { src: address("page/view3d.html").href, title: "Ground and routes in three dimensions" });
  const box = make("dialog", { class: "large", "aria-label": "3-D view" }, make("div", { class: "row" }, make("b", {}, "3-D view"), make("span", { class: "quiet" }, "drag to turn, wheel to zoom; heights are exaggerated"), make("span", { class: "grow" }), make("button", { type: "button", onclick: () => box.close() }, "Close")), frame);
  box.addEventListener("close", () => box.remove());
  document.body.append(box);
  box.showModal();
  const [surface] = await Promise.all([ask(`v1/costmaps/${now.costmap.id}/surface`), new Promise(done => window.addEventListener("message", event => event.source === frame.contentWindow && event.data === "ready" && done(), { once: false }))]);
  const { answer } = now, routes = answer?.path ? [{ name: "least energy", colour: "#0072B2", path: answer.path }, ...(answer.shortest ? [{ name: "shortest", colour: "#D55E00", path: answer.shortest.path }] : [])] : [];
  frame.contentWindow.postMessage({ surface, routes, plotly, dark: matchMedia("(prefers-color-scheme: dark)").matches }, window.location.origin);
}
