// First steps: the sample, a heightmap of one's own, or a map that is kept.

import { ask, blob, kept } from "./api.js";
import { check } from "./controls.js";
import { alarm, button, by, errorNote, field, fill, fold, h2, h3, live, make, metres, note } from "./dom.js";
import { now } from "./state.js";

/** What a file may not say itself. */
const FIELDS = [["resolution_m", "Side of a cell", "m"], ["scale_m", "Metres per stored unit", "m"], ["nodata", "Value that means unknown", ""], ["band", "Band with the heights", ""]];

export const sizeWords = ({ cols, rows, resolution_m: cell }) => `${metres(cols * cell)} × ${metres(rows * cell)} in cells of ${+cell.toPrecision(4)} m`;

/** Calls `work` when a file is chosen or dropped. */
export function dropZone(words, properties, work) {
  const input = make("input", { type: "file", ...properties, onchange: () => { if (input.files.length) work([...input.files]); input.value = ""; } });
  const zone = make("label", { class: "drop" }, input, words);
  const over = on => event => { event.preventDefault(); zone.classList.toggle("over", on); };
  for (const [name, on] of [["dragover", true], ["dragleave", false]]) zone.addEventListener(name, over(on));
  zone.addEventListener("drop", event => { over(false)(event); if (event.dataTransfer.files.length) work([...event.dataTransfer.files]); });
  return zone;
}

/** What is dropped beside the zones would take the place of the page; on the first page it is a heightmap. */
let take = null;
for (const name of ["dragover", "drop"]) window.addEventListener(name, event => {
  event.preventDefault();
  if (name === "drop" && !by("welcome").hidden && !event.target.closest(".drop") && event.dataTransfer.files.length) take(event.dataTransfer.files[0]);
});

let known = {}, chosen = () => {}, waiting = null;

/** `choose` is called with a heightmap, or with a cost map that is done. */
export function use(start, choose) { known = start; chosen = choose; }

export function hide() { by("welcome").hidden = true; }

export async function welcome(message) {
  const here = by("welcome"), said = live(), list = make("div", {}, note("Looking…"));
  const extra = fold("What the file does not say", {}, FIELDS.map(([name, label, unit]) => field(label, make("input", { type: "number", step: "any", name }), unit)),
    field("CRS", make("input", { type: "text", name: "crs", placeholder: "EPSG:32630" })),
    check("Resample it to true metres (degrees, feet, Web Mercator, rotated)", false, () => {}, { name: "reproject", value: "auto" }), button({ onclick: () => waiting && upload(waiting) }, "Send again"));
  const upload = async file => {
    waiting = file;
    fill(said, make("p", {}, `Reading ${file.name}…`), make("progress", { "aria-label": "Reading the heightmap" }));
    const query = new URLSearchParams({ name: file.name });
    for (const field of extra.querySelectorAll("input")) if (field.type === "checkbox" ? field.checked : field.value.trim()) query.set(field.name, field.value.trim());
    try {
      const heightmap = await ask(`v1/heightmaps?${query}`, { method: "POST", body: file, headers: { "Content-Type": "application/octet-stream" } });
      hide();
      chosen({ heightmap });
    } catch (error) {
      const metres = /`reproject`/.test(error.message), field = extra.querySelector("[name=reproject]");
      fill(said, alarm(error.message.replace(/: give `reproject`.*/, ".")), metres ? button({ id: "reproject", class: "main", onclick: () => { field.checked = true; upload(file); } }, "Resample it to metres and go on") : null);
      extra.open = !metres && error.name === "Problem" && error.status === 422;
    }
  };
  take = upload;
  const sample = async () => {
    fill(said, make("p", {}, "Sending the sample…"), make("progress", { "aria-label": "Sending the sample" }));
    try {
      const { heightmaps, costmaps } = await kept();
      const before = heightmaps.find(one => one.name === known.sample.name), made = before && costmaps.find(one => one.heightmap_id === before.id && one.status === "done" && one.model === "default");
      const query = new URLSearchParams({ name: known.sample.name });
      const heightmap = before ?? await ask(`v1/heightmaps?${query}`, { method: "POST", body: await blob("page/sample.tif"), headers: { "Content-Type": "application/octet-stream" } });
      hide();
      chosen({ heightmap, costmap: made, sample: true });
    } catch (error) { fill(said, errorNote(error)); }
  };
  fill(here, make("div", {},
    h2("Where can the robot go, and does the battery last?"),
    make("p", {}, "Heights of the ground go in. Out come what every metre costs in every heading, the way of least energy, and whether the battery lasts."),
    message ? alarm(message) : null, said,
    make("div", { class: "cards" },
      make("div", { class: "card" }, h3("Look at the sample"), note("Rolling hills of 200 × 200 m with a steep knoll, and a route round it."), button({ class: "main", id: "sample", onclick: sample }, "Open the sample")),
      make("div", { class: "card" }, h3("Your own ground"), dropZone(make("span", {}, make("b", {}, "Choose a heightmap"), make("br"), "or drop it here"), { id: "heightmap-file", "aria-label": "Heightmap file" }, ([file]) => upload(file)), note(known.formats), extra),
      make("div", { class: "card" }, h3("What is kept"), list)),
    now.costmap ? make("p", {}, button({ onclick: hide }, "Back to the map")) : null));
  here.hidden = false;
  try {
    const { costmaps, heightmaps, names } = await kept();
    const done = costmaps.filter(one => ["done", "running", "queued"].includes(one.status)), bare = heightmaps.filter(one => one.rows && !done.some(map => map.heightmap_id === one.id));
    fill(list, done.length + bare.length ? make("ul", {},
      done.map(one => make("li", {}, button({ onclick: () => { hide(); chosen({ costmap: one }); } }, `${names.get(one.heightmap_id) ?? one.heightmap_id}, ${one.robot.name}, model ${one.model}${one.status === "done" ? "" : " (being made)"}`))),
      bare.map(one => make("li", {}, button({ onclick: () => { hide(); chosen({ heightmap: one }); } }, `${one.name} (no cost map yet)`)))) : note("Nothing yet. What you send is kept here."));
  } catch (error) { fill(list, errorNote(error)); }
}
