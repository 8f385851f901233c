// Reach: how far the battery takes the robot from the start, as shaded contours.

import { keep } from "./answers.js";
import { sendForOdds } from "./api.js";
import { by, errorNote, fill, metres, note, number, patch, percent, warn } from "./dom.js";
import { leaf, map } from "./map.js";
import { now, on, set } from "./state.js";

const contours = L.layerGroup().addTo(map);
const SHADES = ["#440154", "#3b528b", "#21918c", "#5ec962", "#fde725"];
const area = m2 => (m2 < 1e4 ? `${number(m2, 0)} m²` : m2 < 1e6 ? `${number(m2 / 1e4, 1)} hectares` : `${number(m2 / 1e6, 1)} km²`);

function question() {
  const { costmap, start, battery, battery: { charge, reserve }, avoid, confidence, roundTrip: round_trip } = now;
  if (!now.reachOpen || !costmap || !start) return null;
  const charges = charge > reserve ? [0.25, 0.5, 0.75, 1].map(share => +(reserve + (charge - reserve) * share).toFixed(3)) : null;
  return { costmap: costmap.id, body: { start, battery, charges, confidence, round_trip, avoid } };
}

const ask = ({ costmap, body }, signal) => sendForOdds(`v1/costmaps/${costmap}/reach?format=geojson&coordinates=map`, body, { signal });

function draw() {
  const said = by("reach-said"), found = now.reach;
  contours.clearLayers();
  if (!found) { fill(said, note(now.start ? "Searching…" : "Set a start first.")); return; }
  if (found.error) { fill(said, errorNote(found.error)); return; }
  const { start, battery, charges, round_trip: back } = found.question.body, most = charges?.at(-1) ?? battery.charge;
  const all = found.features.filter(one => one.properties.area_m2 > 0).sort((a, b) => a.properties.charge - b.properties.charge);
  const order = all.filter(({ properties: { area_m2: size } }, k) => !k || size > 1.005 * all[k - 1].properties.area_m2).reverse(); // a charge that takes it no further is not shown
  order.forEach(({ geometry, properties }, k) => {
    const shade = SHADES[Math.min(k, SHADES.length - 1)];
    const rings = geometry.type === "Polygon" ? [geometry.coordinates] : geometry.coordinates;
    L.polygon(rings.map(polygon => polygon.map(ring => ring.map(leaf))), { pane: "reach", color: shade, weight: 1.2, fillColor: shade, fillOpacity: 0.16, smoothFactor: 0.5, interactive: false }).addTo(contours);
    properties.shade = shade;
    properties.far = Math.max(...rings.flat(2).map(([x, y]) => Math.hypot(x - start[0], y - start[1])));
  });
  fill(said, note(order.length ? `From the start ${back ? "and back to it" : "one way (tick \"And back again\" for there and back)"}, with the reserve kept:` : "Nothing can be reached with this charge and reserve."),
    order.map(({ properties }) => note(patch(properties.shade), `charge ${percent(properties.charge)}${properties === order[0].properties && most > properties.charge ? ` to ${percent(most)}` : ""}: up to ${metres(properties.far)} away, ${area(properties.area_m2)}`)),
    all.length > 1 && order[0] !== all.at(-1) ? note("Every place of this map that the robot can get to is within reach; the map ends there.") : null, found.odds ? null : warn("This model gives no probability: the expected energy decides."));
}

keep("reach", question, ask, draw);
on("start", () => { if (!now.reach) draw(); });
by("reach").addEventListener("toggle", () => set({ reachOpen: by("reach").open }));
