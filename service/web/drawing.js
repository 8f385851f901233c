// Draws an area on the map, corner by corner: a button begins it, and what is drawn goes to whoever has the button.

import { button, by } from "./dom.js";
import { inside, leaf, map, seeMap } from "./map.js";
import { hint, takers } from "./question.js";
import { draft, now } from "./state.js";

const sketch = L.layerGroup().addTo(map);
let drawing = null; // the area that is begun: its corners, its style, its button, and who takes it

/** How areas of a colour look. */
export const styled = color => ({ color, weight: 2, dashArray: "6 4", fillColor: color, fillOpacity: 0.18 });

/** A button with these words that begins an area of this colour, and closes it; `take` is called with its corners. */
export function areaButton(words, color, take) {
  const own = button({ onclick: () => {
    if (drawing?.own === own) { close(); return; }
    if (drawing) give();
    drawing = { own, words, take, color, corners: [] };
    own.textContent = "Close the area";
    hint(by("areas").dataset.says);
    seeMap();
  } }, words);
  return own;
}

/** Ends the area, and returns it. */
function give() {
  const ended = drawing;
  drawing = null;
  ended.own.textContent = ended.words;
  draft("area");
  sketch.clearLayers();
  hint();
  return ended;
}

function close() {
  const { take, corners } = give();
  if (corners.length > 2) take(corners);
}

takers.push((place, event) => {
  if (!drawing) return false;
  const { corners } = drawing, first = corners.length > 2 && map.latLngToContainerPoint(leaf(corners[0]));
  if (first && first.distanceTo(event.containerPoint) < 12) close();
  else if (inside(place, now.heightmap?.bounds)) { corners.push(place); show(); }
  return true;
});

function show() {
  const { corners, color } = drawing;
  draft("area", corners.length > 0 && "close the area");
  sketch.clearLayers();
  L.polygon(corners.map(leaf), { ...styled(color), interactive: false }).addTo(sketch);
  for (const corner of corners) L.circleMarker(leaf(corner), { radius: 5, color, fillColor: "#fff", fillOpacity: 1, interactive: false }).addTo(sketch);
}

document.addEventListener("keydown", event => {
  if (!drawing || !["Enter", "Escape", "Backspace"].includes(event.key) || /^(INPUT|SELECT|BUTTON)$/.test(event.target.tagName)) return;
  event.preventDefault();
  if (event.key === "Backspace") { drawing.corners.pop(); show(); } else if (event.key === "Escape") give(); else close();
});
