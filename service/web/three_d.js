// The 3-D view: a document of its own inside a dialog, so that plotly.js is loaded only when somebody asks for it.

import { current } from "./answers.js";
import { address, ask } from "./api.js";
import { by, make } from "./dom.js";
import { WAYS, waysOf } from "./question.js";
import { now } from "./state.js";

export async function open(plotly) {
  const frame = make("iframe", { src: address("page/view3d.html").href, title: "Ground and routes in three dimensions" });
  const box = by("dialog-3d");
  box.append(frame);
  box.onclose = () => frame.remove();
  box.showModal();
  const [surface] = await Promise.all([ask(`v1/costmaps/${now.costmap.id}/surface`), new Promise(done => window.addEventListener("message", event => event.source === frame.contentWindow && event.data === "ready" && done()))]);
  const routes = now.answer?.path && current("answer") ? waysOf(now.answer).map(([kind, name, { path }]) => ({ name, colour: WAYS[kind][0], path })) : [];
  frame.contentWindow.postMessage({ surface, routes, plotly, dark: matchMedia("(prefers-color-scheme: dark)").matches }, window.location.origin);
}
