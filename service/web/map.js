// The map: pictures of ground, energy and blocked ground, contours, scale bar, and what is under the pointer.

import { ask, blob, Latest } from "./api.js";
import { by, number } from "./dom.js";
import * as link from "./link.js";
import { now, on } from "./state.js";

/** Leaflet counts [y, x]. */
export const leaf = ([x, y]) => [y, x];
/** On a phone the map may be out of sight. */
export const seeMap = () => by("map").scrollIntoView({ block: "nearest" });
export const world = ({ lat, lng }) => [lng, lat];

export const map = L.map("map", {
  crs: L.CRS.Simple, zoomSnap: 0.25, wheelPxPerZoomLevel: 90, minZoom: -9, maxZoom: 9, attributionControl: false, zoomControl: true, doubleClickZoom: false, boxZoom: false,
}).setView([0, 0], 0);
L.control.scale({ imperial: false, position: "bottomleft" }).addTo(map);
for (const [name, order, of] of [["ground", 200], ["colour", 210], ["blocked", 220], ["pieces", 225], ["contours", 230], ["roses", 240], ["reach", 250, "reach"], ["route", 405, "answer"], ["runs", 410], ["drives", 415], ["return", 640, "homeward"], ["words", 655, "answer"]]) {
  const pane = map.createPane(name);
  pane.style.zIndex = order;
  if (order < 250) pane.style.pointerEvents = "none";
  if (of) pane.dataset.of = of;
}

const bounds = ([west, south, east, north]) => [[south, west], [north, east]];
const latest = { ground: new Latest(), colour: new Latest(), blocked: new Latest(), contours: new Latest(), at: new Latest() };
const pictures = {};
const lines = L.layerGroup().addTo(map), thin = L.canvas({ pane: "contours", padding: 0.3 });

/** Shows a picture of the service on the map in place of the one before, which is dim meanwhile. */
async function show(name, path, box) {
  const old = map.getPane(name).classList;
  latest[name].stop();
  old.add("stale");
  const picture = path && await latest[name].run(signal => blob(path, { signal }));
  if (picture === undefined) return;
  old.remove("stale");
  const before = pictures[name];
  pictures[name] = picture && L.imageOverlay(URL.createObjectURL(picture), bounds(box), { pane: name, className: name, alt: "" }).addTo(map);
  if (before) { before.remove(); URL.revokeObjectURL(before._url); }
}

/** The ground alone, before there is a cost map. */
export async function showHeightmap(heightmap) {
  for (const name of ["colour", "blocked"]) await show(name, null);
  lines.clearLayers();
  look(heightmap.bounds);
  await show("ground", `v1/heightmaps/${heightmap.id}/ground.png`, heightmap.bounds);
}

let whole = null, linked = null; // what is fitted into the view again when the view changes its size, until somebody moves the map

/** Shows a whole map, or of it what a link shows: its middle and how many metres are seen at least. */
function look(box, seen) {
  linked = seen;
  whole = seen ? [seen.x - seen.span / 2, seen.y - seen.span / 2, seen.x + seen.span / 2, seen.y + seen.span / 2] : box;
  map.setMaxBounds(L.latLngBounds(bounds(box)).pad(1));
  fit();
}

function fit() {
  map.invalidateSize({ animate: false, pan: !whole });
  if (whole) map.fitBounds(bounds(whole), { padding: linked ? [0, 0] : [18, 18], animate: false });
}
const moved = () => { whole = null; };
map.on("dragstart", moved);
for (const name of ["wheel", "keydown"]) map.getContainer().addEventListener(name, event => { if (!event.target.closest(".pin")) moved(); }, { passive: true });
map.zoomControl.getContainer().addEventListener("click", moved, true);

/** Shows a cost map; `seen` is the place and zoom of a link. */
export async function showCostmap(costmap, layers, seen) {
  look(costmap.frame.bounds, seen);
  await Promise.all([show("ground", `v1/costmaps/${costmap.id}/layer.png?layer=ground`, layers.bounds), colour(), hatch(), contours()]);
}

const query = () => (now.view === "heading" ? `&heading_deg=${now.heading}` : "");

async function colour() {
  if (!now.layers || !now.costmap) return;
  const path = now.view === "ground" ? null : `v1/costmaps/${now.costmap.id}/layer.png?layer=energy&view=${now.view}${query()}`;
  await show("colour", path, now.layers.bounds);
}

async function hatch() {
  if (!now.layers || !now.costmap) return;
  await show("blocked", now.show.blocked ? `v1/costmaps/${now.costmap.id}/layer.png?layer=blocked${query()}` : null, now.layers.bounds);
}

async function contours() {
  lines.clearLayers();
  if (!now.costmap || !now.show.contours) return;
  const found = await latest.contours.run(signal => ask(`v1/costmaps/${now.costmap.id}/contours`, { signal }));
  for (const { geometry } of found?.features ?? []) {
    lines.addLayer(L.polyline(geometry.coordinates.map(line => line.map(leaf)), { renderer: thin, color: "#4c4338", weight: 0.8, opacity: 0.55, interactive: false, smoothFactor: 0.5 }));
  }
}

on("view heading", () => { colour(); hatch(); });
on("show", () => { hatch(); contours(); });

/** Latitude and longitude between the nine places that the service gave. */
export function latLon([x, y]) {
  const grid = now.layers?.lat_lon;
  if (!grid) return null;
  const [west, south, east, north] = now.costmap.frame.bounds;
  const weights = share => [2 * (share - 0.5) * (share - 1), 4 * share * (1 - share), 2 * share * (share - 0.5)];
  const across = weights((x - west) / (east - west)), down = weights((north - y) / (north - south));
  const sum = [0, 0];
  for (let i = 0; i < 3; i += 1) for (let j = 0; j < 3; j += 1) for (let k = 0; k < 2; k += 1) sum[k] += down[i] * across[j] * grid[i][j][k];
  return sum;
}

/** Why nothing can be driven at a place, in words. */
export function reasonWords(reason) {
  const { wheel_radius_m: radius, max_grade_deg: grade, max_cross_slope_deg: side } = now.costmap.robot;
  return { outside: "too near the edge of the map", unknown: "height unknown", step: `a step higher than the wheel radius of ${radius} m`, grade: `steeper than ${grade}°, the robot's limit`, cross_slope: `side slope above ${side}°, the robot's limit`, power: "more power than allowed", avoid: "area to avoid", obstacle: "an obstacle under the outline of the robot" }[reason] ?? reason;
}

/** A warning of the service, as far as it is one of the ground; `pieces` are those of a route that it may concern. */
export function groundWarning(words, pieces) {
  const [, share, limit] = /^(.*) of the map is steeper than the (.*) degrees/.exec(words) ?? [];
  if (!share) return words;
  const slope = degrees => Math.tan(degrees * Math.PI / 180), { max_cross_slope_deg: side } = now.costmap.robot;
  const far = pieces?.reduce((sum, { distance_m: d, z }, k) => {
    const { distance_m: before, z: from } = pieces[k - 1] ?? { distance_m: 0, z };
    return sum + (Math.hypot((z - from) / (d - before || 1), slope(side)) > slope(limit) ? d - before : 0);
  }, 0);
  return `The model was trained on slopes up to ${limit}°. ${share} of this map is steeper${pieces ? far ? `, and ${number(Math.ceil(far), 0)} m of this route may be: its energy is less certain there` : ", but nothing of this route is" : ": energies are less certain there"}.`;
}

function placeWords(found, place) {
  const lines = [`x ${number(place[0], 1)}  y ${number(place[1], 1)} m`];
  const earth = latLon(place);
  if (earth) lines.push(`${earth[0].toFixed(6)}°, ${earth[1].toFixed(6)}°`);
  if (!found) return lines.join("\n");
  if (found.elevation_m !== null) lines.push(`height ${number(found.elevation_m, 2)} m`);
  const free = found.energy_per_m.filter(value => value !== null), reasons = [...new Set(found.blocked.filter(Boolean))];
  if (free.length) {
    const mean = free.reduce((sum, value) => sum + value, 0) / free.length;
    lines.push(`${number(mean, 0)} J/m (${number(Math.min(...free), 0)} to ${number(Math.max(...free), 0)} by heading)`);
  }
  if (reasons.length) lines.push(`${free.length ? "blocked in some headings" : "blocked"}: ${reasons.map(reasonWords).join(", ")}`);
  return lines.join("\n");
}

let pausing = 0;
function say(latlng) {
  const place = world(latlng), here = by("readout");
  clearTimeout(pausing);
  latest.at.stop();
  if (!inside(place)) { here.textContent = ""; return; }
  here.textContent = placeWords(null, place);
  pausing = setTimeout(async () => {
    const { id } = now.costmap;
    try {
      const found = await latest.at.run(signal => ask(`v1/costmaps/${id}/at?x=${place[0]}&y=${place[1]}`, { signal }));
      if (found) here.textContent = placeWords(found, place);
    } catch (error) { here.textContent = error.message; }
  }, 50);
}
map.on("mousemove", ({ latlng }) => say(latlng));
const silent = () => { clearTimeout(pausing); latest.at.stop(); by("readout").textContent = ""; };
map.on("mouseout", silent);
on("costmap", silent);

// By keyboard the middle of the map is the pointer: the arrow keys move the map under it, Space is a click.
const byKeyboard = () => map.getContainer().matches(":focus-visible");
map.getContainer().addEventListener("keydown", event => {
  if (event.key !== " " || event.target !== event.currentTarget) return;
  event.preventDefault();
  map.fire("click", { latlng: map.getCenter(), containerPoint: map.getSize().divideBy(2) });
});
for (const [name, how] of [["focus", "polite"], ["blur", "off"]]) map.getContainer().addEventListener(name, () => by("readout").setAttribute("aria-live", how));
map.on("moveend", () => { if (byKeyboard()) say(map.getCenter()); });

export function inside([x, y], bounds = now.costmap?.frame?.bounds) {
  if (!bounds) return false;
  const [west, south, east, north] = bounds;
  return x > west && x < east && y > south && y < north;
}

map.on("moveend", () => {
  const [x, y] = world(map.getCenter()), { x: wide, y: tall } = map.getSize();
  link.sees(whole ? linked : { x, y, span: Math.min(wide, tall) / 2 ** map.getZoom() });
});
new ResizeObserver(fit).observe(by("map"));

/** What is seen now as a picture, for a file: pictures and the given lines, over the whole map. */
export async function asPicture(routes) {
  const [west, south, east, north] = now.layers.bounds;
  const scale = 1600 / Math.max(east - west, north - south);
  const canvas = document.createElement("canvas"), pen = canvas.getContext("2d");
  canvas.width = Math.round((east - west) * scale);
  canvas.height = Math.round((north - south) * scale);
  pen.fillStyle = "#fff";
  pen.fillRect(0, 0, canvas.width, canvas.height);
  for (const name of ["ground", "colour", "blocked"]) {
    const image = pictures[name]?.getElement();
    if (image) { await image.decode(); pen.drawImage(image, 0, 0, canvas.width, canvas.height); }
  }
  for (const { path, colour: ink, width } of routes) {
    for (const [stroke, wide] of [["#fff", width + 4], [ink, width]]) {
      pen.beginPath();
      path.forEach(([x, y], k) => pen[k ? "lineTo" : "moveTo"]((x - west) * scale, (north - y) * scale));
      Object.assign(pen, { strokeStyle: stroke, lineWidth: wide, lineJoin: "round", lineCap: "round" });
      pen.stroke();
    }
  }
  return new Promise(done => canvas.toBlob(done, "image/png"));
}
