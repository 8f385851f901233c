// The panel "Save": routes, the map and pictures as files, and a link that opens this view again.

import { blob } from "./api.js";
import { button, by, errorNote, fill, live, make, note, row } from "./dom.js";
import * as link from "./link.js";
import { asPicture } from "./map.js";
import { asked, lines } from "./question.js";
import { now, on } from "./state.js";

/** Formats of routes that this service writes. */
let formats = [];
const NAMES = { geojson: ["GeoJSON", "geojson"], "qgc-plan": ["QGroundControl", "plan"], waypoints: ["ArduPilot", "waypoints"], mcap: ["ROS 2 (MCAP)", "mcap"], "ros-path": ["ROS path (JSON)", "json"] };
export const use = known => { formats = known; };

function keep(data, name) {
  const node = make("a", { href: URL.createObjectURL(data), download: name });
  node.click();
  setTimeout(() => URL.revokeObjectURL(node.href), 5000);
}

/** Buttons that save something; `get` makes it. What becomes of it is said under them. */
function files(...kinds) {
  const said = live();
  const one = ([words, name, get]) => button({ onclick: async ({ target }) => {
    target.disabled = true;
    fill(said, note(`Making ${name}…`));
    try { keep(await get(), name); fill(said, note(`${name} is in your downloads.`)); } catch (error) { fill(said, errorNote(error)); }
    target.disabled = false;
  } }, words);
  return make("div", {}, row(...kinds.map(one)), said);
}

/** Buttons that save a route in every format; `question` gives what to ask for a format: an address and its options. */
export const routeButtons = (name, question) => files(...formats.filter(format => format !== "json").map(format => {
  const [words, ending] = NAMES[format] ?? [format.toUpperCase(), format];
  return [words, `${name}.${ending}`, () => blob(...question(format === "geojson" && !now.costmap.frame.crs ? "geojson&coordinates=map" : format))];
}));

export function show() {
  const id = now.costmap?.id, { answer } = now;
  if (!id) return;
  fill(by("save-route"), answer?.path ? routeButtons(answer.tour ? "tour" : "route", format => {
    const [question, body] = asked(answer);
    return [`v1/costmaps/${id}/${question}?format=${format}`, { method: "POST", body }];
  }) : note("Set a start and a goal first."));
  fill(by("save-picture"), files(["Picture (PNG)", "map.png", () => asPicture(lines())]));
  fill(by("save-map"), files(["GeoTIFF, a band per heading", `${id}.tif`, () => blob(`v1/costmaps/${id}/data?format=geotiff`)], ["Zarr", `${id}.zarr.zip`, () => blob(`v1/costmaps/${id}/data?format=zarr`)]));
}
by("copy").onclick = async () => {
  by("link").select();
  try { await navigator.clipboard.writeText(by("link").value); fill(by("copied"), note("Copied.")); } catch { fill(by("copied"), note("Selected: copy it with Ctrl-C.")); }
};

on("costmap answer", show);
on("any", () => {
  const seen = new URL(link.address(), window.location.href).href;
  if (by("link").value !== seen) { by("link").value = seen; fill(by("copied")); }
});
