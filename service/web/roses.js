// Roses of direction: where the map is near enough, what a metre costs in every heading at a few cells.

import { ask, Latest } from "./api.js";
import { map } from "./map.js";
import { now, on } from "./state.js";

const NEAR_PX = 26; // a cell has so many pixels before roses are drawn
const APART_PX = 64;
const group = L.layerGroup().addTo(map), latest = new Latest();
const renderer = L.canvas({ pane: "roses", padding: 0.2 });

async function show() {
  latest.stop();
  group.clearLayers();
  const pixels = now.costmap ? 2 ** map.getZoom() * now.costmap.spacing_m : 0;
  if (!now.layers || !now.show.roses || now.view === "ground" || pixels < NEAR_PX) return;
  const seen = map.getBounds(), { x, y } = map.getSize();
  const across = Math.max(2, Math.min(40, Math.floor(Math.max(x, y) / APART_PX)));
  const query = `west=${seen.getWest()}&south=${seen.getSouth()}&east=${seen.getEast()}&north=${seen.getNorth()}&across=${across}`;
  const found = await latest.run(signal => ask(`v1/costmaps/${now.costmap.id}/roses?${query}`, { signal }));
  if (!found) return;
  const [[x0], [x1]] = found.points.length > 1 ? found.points : [[0], [now.costmap.spacing_m]], size = 0.46 * (Math.abs(x1 - x0) || now.costmap.spacing_m), full = Math.max(...found.energy_per_m.flat().map(value => value ?? 0), 1e-9);
  found.points.forEach(([px, py], k) => {
    const corners = found.headings_deg.map((degrees, j) => {
      const energy = found.energy_per_m[k][j], reach = energy === null ? 0 : size * energy / full;
      const heading = degrees * Math.PI / 180;
      return [py + reach * Math.cos(heading), px + reach * Math.sin(heading)];
    });
    L.polygon(corners, { renderer, color: "#1d2329", weight: 1, fillColor: "#ffffff", fillOpacity: 0.75, interactive: false }).addTo(group);
    L.circleMarker([py, px], { renderer, radius: 1.5, color: "#1d2329", fillColor: "#1d2329", fillOpacity: 1, interactive: false }).addTo(group);
  });
}

map.on("moveend", show);
on("layers show view", show);
