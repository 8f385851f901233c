// Fine pieces of a large map: where it is near enough to see more than its picture shows, at most a few at a time.

import { blob, Latest } from "./api.js";
import { map } from "./map.js";
import { now, on } from "./state.js";

const AT_A_TIME = 2; // others want the service too
const shown = new Map(), latest = new Latest();

function drop(path) {
  const piece = shown.get(path);
  shown.delete(path);
  piece.remove();
  URL.revokeObjectURL(piece._url);
}

/** Addresses and places of the pieces that are seen, those in the middle first; empty where the picture is fine enough. */
function seen() {
  const { costmap, layers } = now;
  if (!costmap || !layers?.piece_levels) return [];
  const { rows, cols, bounds: [west,,, north] } = costmap.frame, cell = costmap.spacing_m;
  const level = Math.max(0, Math.round(-Math.log2(2 ** map.getZoom() * cell * window.devicePixelRatio)));
  if (level >= layers.piece_levels) return [];
  const step = 2 ** level, side = layers.piece_pixels * step, view = map.getBounds(), middle = map.getCenter(), found = [];
  const look = `view=${now.view}&blocked=${now.show.blocked}${now.view === "heading" ? `&heading_deg=${now.heading}` : ""}`;
  const span = (from, to, cells) => [Math.max(0, Math.floor(from / cell / side)), Math.min(Math.ceil(cells / side), Math.ceil(to / cell / side))];
  const [top, bottom] = span(north - view.getNorth(), north - view.getSouth(), rows), [left, right] = span(view.getWest() - west, view.getEast() - west, cols);
  for (let row = top; row < bottom; row += 1) for (let col = left; col < right; col += 1) {
    const [tall, wide] = [rows - row * side, cols - col * side].map(rest => Math.min(layers.piece_pixels, Math.floor(rest / step)) * step * cell);
    const x = west + col * side * cell, y = north - row * side * cell;
    if (tall && wide) found.push({ path: `v1/costmaps/${costmap.id}/piece.png?level=${level}&row=${row}&col=${col}&${look}`, look, box: [[y - tall, x], [y, x + wide]], far: Math.hypot(x + wide / 2 - middle.lng, y - tall / 2 - middle.lat) });
  }
  return found.sort((a, b) => a.far - b.far);
}

async function show() {
  latest.stop();
  const wanted = seen(), paths = new Set(wanted.map(({ path }) => path)), look = `${now.costmap?.id}`, style = wanted[0]?.look;
  for (const path of [...shown.keys()]) if (!path.includes(look) || !path.endsWith(`&${style}`)) drop(path);
  const queue = wanted.filter(({ path }) => !shown.has(path));
  async function load(signal) {
    for (let next; (next = queue.shift());) {
      const picture = await blob(next.path, { signal });
      if (signal.aborted) return;
      shown.set(next.path, L.imageOverlay(URL.createObjectURL(picture), next.box, { pane: "pieces", className: "piece", alt: "" }).addTo(map));
    }
  }
  const loaded = await latest.run(signal => Promise.all(Array.from({ length: AT_A_TIME }, () => load(signal))));
  if (loaded) for (const path of [...shown.keys()]) if (!paths.has(path)) drop(path); // those seen before stay until now
}

map.on("moveend", show);
on("layers view heading show", show);
