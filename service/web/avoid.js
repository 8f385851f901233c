// Areas to avoid: drawn corner by corner, blocked in every question.

import { button, by, fill } from "./dom.js";
import { inside, leaf, map, seeMap } from "./map.js";
import { hint, takers } from "./question.js";
import { draft, now, on, set } from "./state.js";

const STYLE = { color: "#b3261e", weight: 2, dashArray: "6 4", fillColor: "#b3261e", fillOpacity: 0.18 };
const areas = L.layerGroup().addTo(map), sketch = L.layerGroup().addTo(map);
let corners = null;

function list() {
  fill(by("areas"), button({ onclick: corners ? close : begin }, corners ? "Close the area" : "Draw an area"),
    now.avoid.map((_, k) => button({ "aria-label": `Remove area ${k + 1}`, onclick: () => set({ avoid: now.avoid.filter((_, i) => i !== k) }) }, `Area ${k + 1} ✕`)));
}

function begin() { corners = []; hint(by("areas").dataset.says); list(); seeMap(); }

function close() {
  const ring = corners;
  corners = null;
  draft("area");
  sketch.clearLayers();
  hint();
  if (ring.length > 2) set({ avoid: [...now.avoid, ring] });
  list();
}

takers.push((place, event) => {
  if (!corners) return false;
  const first = corners.length > 2 && map.latLngToContainerPoint(leaf(corners[0]));
  if (first && first.distanceTo(event.containerPoint) < 12) close();
  else if (inside(place)) { corners.push(place); draw(); }
  return true;
});

function draw() {
  draft("area", corners.length > 0 && "close the area");
  sketch.clearLayers();
  L.polygon(corners.map(leaf), { ...STYLE, interactive: false }).addTo(sketch);
  for (const corner of corners) L.circleMarker(leaf(corner), { radius: 5, color: "#b3261e", fillColor: "#fff", fillOpacity: 1, interactive: false }).addTo(sketch);
}

document.addEventListener("keydown", event => {
  if (!corners || !["Enter", "Escape", "Backspace"].includes(event.key) || /^(INPUT|SELECT|BUTTON)$/.test(event.target.tagName)) return;
  event.preventDefault();
  if (event.key === "Backspace") { corners.pop(); draw(); return; }
  if (event.key === "Escape") corners = [];
  close();
});

on("avoid", () => {
  areas.clearLayers();
  for (const ring of now.avoid) L.polygon(ring.map(leaf), STYLE).bindTooltip("blocked: area to avoid", { sticky: true }).addTo(areas);
  list();
});
list();
