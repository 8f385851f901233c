// First steps: the sample, a heightmap of one's own, or a map that is kept.

import { ask, blob, kept } from "./api.js";
import { alarm, attempt, button, by, fill, make, metres, note } from "./dom.js";
import { now } from "./state.js";

export const sizeWords = ({ cols, rows, resolution_m: cell }) => `${metres(cols * cell)} × ${metres(rows * cell)} in cells of ${+cell.toPrecision(4)} m`;

/** Calls `work` when files are chosen by `input` or dropped on the label around it. */
export function dropZone(input, work) {
  const zone = input.parentElement, over = on => event => { event.preventDefault(); zone.classList.toggle("over", on); };
  input.onchange = () => { if (input.files.length) work([...input.files]); input.value = ""; };
  for (const [name, on] of [["dragover", true], ["dragleave", false]]) zone.addEventListener(name, over(on));
  zone.addEventListener("drop", event => { over(false)(event); if (event.dataTransfer.files.length) work([...event.dataTransfer.files]); });
}

/** What is dropped beside the zones would take the place of the page; on the first page it is a heightmap. */
for (const name of ["dragover", "drop"]) window.addEventListener(name, event => {
  event.preventDefault();
  if (name === "drop" && !by("welcome").hidden && !event.target.closest(".drop") && event.dataTransfer.files.length) upload(event.dataTransfer.files[0]);
});

let known = {}, chosen = () => {}, waiting = null;
const say = (...what) => fill(by("welcome-said"), ...what);
const busy = words => say(make("p", {}, words), make("progress", { "aria-label": words }));

/** `choose` is called with a heightmap, or with a cost map that is done. */
export function use(start, choose) {
  known = start;
  chosen = choose;
  fill(by("formats"), known.formats);
}

export function hide() { by("welcome").hidden = true; }

const sendHeightmap = (query, body) => ask(`v1/heightmaps?${query}`, { method: "POST", body, headers: { "Content-Type": "application/octet-stream" } });

async function upload(file) {
  const extra = by("unsaid"), query = new URLSearchParams({ name: file.name });
  waiting = file;
  busy(`Reading ${file.name}…`);
  for (const field of extra.querySelectorAll("input")) if (field.type === "checkbox" ? field.checked : field.value.trim()) query.set(field.name, field.value.trim());
  try {
    const heightmap = await sendHeightmap(query, file);
    hide();
    chosen({ heightmap });
  } catch (error) {
    const metres = /`reproject`/.test(error.message);
    say(alarm(error.message.replace(/: give `reproject`.*/, ".")), metres ? button({ id: "reproject", class: "main", onclick: () => { extra.querySelector("[name=reproject]").checked = true; upload(file); } }, "Resample it to metres and go on") : null);
    extra.open = !metres && error.name === "Problem" && error.status === 422;
  }
}

async function sample() {
  busy("Sending the sample…");
  await attempt(by("welcome-said"), async () => {
    const { name } = known.sample, { heightmaps, costmaps } = await kept();
    const before = heightmaps.find(one => one.name === name), made = before && costmaps.find(one => one.heightmap_id === before.id && one.status === "done" && one.model === "default");
    const heightmap = before ?? await sendHeightmap(new URLSearchParams({ name }), await blob("page/sample.tif"));
    hide();
    chosen({ heightmap, costmap: made, sample: true });
  });
}

dropZone(by("heightmap-file"), ([file]) => upload(file));
for (const [name, work] of [["sample", sample], ["send-again", () => waiting && upload(waiting)], ["back-to-map", hide]]) by(name).addEventListener("click", work);

/** The first steps, and what is kept. */
export async function welcome(message) {
  const here = by("welcome"), list = by("kept");
  say(message ? alarm(message) : null);
  fill(list, note("Looking…"));
  by("back-to-map").hidden = !now.costmap;
  here.hidden = false;
  await attempt(list, async () => {
    const { costmaps, heightmaps, label } = await kept();
    const done = costmaps.filter(one => ["done", "running", "queued"].includes(one.status)), bare = heightmaps.filter(one => one.rows && !one.layer && !done.some(map => map.heightmap_id === one.id));
    fill(list, done.length + bare.length ? make("ul", {},
      done.map(one => make("li", {}, button({ onclick: () => { hide(); chosen({ costmap: one }); } }, `${label(one)}${one.status === "done" ? "" : " (being made)"}`))),
      bare.map(one => make("li", {}, button({ onclick: () => { hide(); chosen({ heightmap: one }); } }, `${one.name} (no cost map yet)`)))) : note("Nothing yet. What you send is kept here."));
  });
}
