// Reach: how far the battery takes the robot from the start, as shaded contours.

import { Latest, sendForOdds } from "./api.js";
import { attempt, by, fill, metres, note, number, patch, percent, warn } from "./dom.js";
import { leaf, map } from "./map.js";
import { settled } from "./controls.js";
import { now, on } from "./state.js";

const latest = new Latest(), contours = L.layerGroup().addTo(map);
const SHADES = ["#440154", "#3b528b", "#21918c", "#5ec962", "#fde725"];
const area = m2 => (m2 < 1e4 ? `${number(m2, 0)} m²` : m2 < 1e6 ? `${number(m2 / 1e4, 1)} hectares` : `${number(m2 / 1e6, 1)} km²`);

async function ask() {
  const said = by("reach-said");
  latest.stop();
  contours.clearLayers();
  fill(said);
  if (!by("reach").open || !now.costmap) return;
  if (!now.start) { fill(said, note("Set a start first.")); return; }
  const { charge, reserve } = now.battery, back = now.roundTrip, levels = [0.25, 0.5, 0.75, 1].map(share => +(reserve + (charge - reserve) * share).toFixed(3));
  const body = { start: now.start, battery: now.battery, charges: charge > reserve ? levels : null, confidence: now.confidence, round_trip: back, avoid: now.avoid };
  fill(said, note("Searching…"));
  await attempt(said, async () => {
    const found = await latest.run(signal => sendForOdds(`v1/costmaps/${now.costmap.id}/reach?format=geojson&coordinates=map`, body, { signal }));
    if (!found) return;
    const all = found.features.filter(one => one.geometry).sort((a, b) => a.properties.charge - b.properties.charge);
    const order = all.filter(({ properties: { area_m2: size } }, k) => !k || size > 1.005 * all[k - 1].properties.area_m2).reverse(); // a charge that takes it no further is not shown
    order.forEach(({ geometry, properties }, k) => {
      const shade = SHADES[Math.min(k, SHADES.length - 1)];
      const rings = geometry.type === "Polygon" ? [geometry.coordinates] : geometry.coordinates;
      L.polygon(rings.map(polygon => polygon.map(ring => ring.map(leaf))), { pane: "reach", color: shade, weight: 1.2, fillColor: shade, fillOpacity: 0.16, smoothFactor: 0.5, interactive: false }).addTo(contours);
      properties.shade = shade;
      properties.far = Math.max(...rings.flat(2).map(([x, y]) => Math.hypot(x - now.start[0], y - now.start[1])));
    });
    fill(said, note(order.length ? `From the start ${back ? "and back to it" : "one way (tick \"And back again\" for there and back)"}, with the reserve kept:` : "Nothing can be reached with this charge and reserve."),
      order.map(({ properties }) => note(patch(properties.shade), `charge ${percent(properties.charge)}${properties === order[0].properties && levels.at(-1) > properties.charge ? ` to ${percent(levels.at(-1))}` : ""}: up to ${metres(properties.far)} away, ${area(properties.area_m2)}`)),
      all.length > 1 && order[0] !== all.at(-1) ? note("Every place of this map that the robot can get to is within reach; the map ends there.") : null, found.odds ? null : warn("This model gives no probability: the expected energy decides."));
  });
}

by("reach").addEventListener("toggle", ask);
on("start costmap battery avoid roundTrip", ask);
on("confidence", settled(ask, 250));
