// The panel "Save": routes, the map and pictures as files, and a link that opens this view again.

import { blob } from "./api.js";
import { by, errorNote, fill, make } from "./dom.js";
import * as link from "./link.js";
import { asPicture } from "./map.js";
import { lines } from "./question.js";
import { now, on } from "./state.js";

/** Formats of routes that this service writes, beyond GeoJSON. */
let formats = [];
const NAMES = { "qgc-plan": ["QGroundControl", "plan"], waypoints: ["ArduPilot", "waypoints"], mcap: ["ROS 2 (MCAP)", "mcap"], "ros-path": ["ROS path (JSON)", "json"] };
export const use = known => { formats = known; };

function keep(data, name) {
  const node = make("a", { href: URL.createObjectURL(data), download: name });
  node.click();
  setTimeout(() => URL.revokeObjectURL(node.href), 5000);
}

const ends = () => ({ start: now.start, goal: now.goal, planner: now.planner, alternatives: now.alternatives, battery: { charge: now.battery.charge, reserve: now.battery.reserve }, ...(now.avoid.length ? { avoid: now.avoid } : {}) });

export function show() {
  const here = by("step-save"), id = now.costmap?.id;
  if (!id) { fill(here, make("p", { class: "note" }, "Nothing to save yet: make a cost map first.")); return; }
  const said = make("div", { "aria-live": "polite" }), route = Boolean(now.answer?.path && now.start && now.goal && !now.answer.tour);
  const file = (words, name, get, able = true) => make("button", { type: "button", disabled: !able, onclick: async event => {
    const { target } = event;
    target.disabled = true;
    fill(said, make("p", { class: "note" }, `Making ${name}…`));
    try { keep(await get(), name); fill(said, make("p", { class: "note", role: "status" }, `${name} is in your downloads.`)); } catch (error) { fill(said, errorNote(error)); }
    target.disabled = false;
  } }, words);
  const routeAs = (format, accept) => blob(`v1/costmaps/${id}/paths?format=${format}`, { method: "POST", body: ends(), headers: { Accept: accept } });
  const text = make("input", { type: "text", readonly: "", "aria-label": "Link to this view", value: new URL(link.address(), window.location.href).href });
  fill(here,
    make("h2", {}, "The routes"), route ? null : make("p", { class: "note" }, "Set a start and a goal first."),
    make("div", { class: "row" }, file("GeoJSON", "route.geojson", () => routeAs(now.costmap.frame.crs ? "geojson" : "geojson&coordinates=map", "application/geo+json"), route),
      formats.filter(name => !["json", "geojson"].includes(name)).map(name => file(NAMES[name]?.[0] ?? name.toUpperCase(), `route.${NAMES[name]?.[1] ?? name}`, () => routeAs(name, "*/*"), route)),
      now.answer?.tour ? file("Tour as JSON", "tour.json", async () => new Blob([JSON.stringify(now.answer, null, 1)], { type: "application/json" })) : null),
    make("h2", {}, "The map"),
    make("div", { class: "row" }, file("Picture (PNG)", "map.png", () => asPicture(lines())), file("GeoTIFF, a band per heading", `${id}.tif`, () => blob(`v1/costmaps/${id}/data?format=geotiff`)), file("Zarr", `${id}.zarr.zip`, () => blob(`v1/costmaps/${id}/data?format=zarr`))),
    make("h2", {}, "This view"),
    make("p", { class: "note" }, "The link opens the same map, route and colours again, for whoever reaches this service."),
    make("div", { class: "row" }, text, make("button", { type: "button", onclick: async () => {
      text.select();
      try { await navigator.clipboard.writeText(text.value); fill(said, make("p", { class: "note", role: "status" }, "Copied.")); } catch { fill(said, make("p", { class: "note", role: "status" }, "Selected: copy it with Ctrl-C.")); }
    } }, "Copy")), said);
}

on("costmap answer", show);
on("view heading battery alternatives", () => { if (!by("step-save").hidden) show(); });
