// Reach: how far the battery takes the robot from the start, as shaded contours.

import { Latest, sendForOdds, superseded } from "./api.js";
import { by, errorNote, fill, fold, live, note, number, patch, percent, warn } from "./dom.js";
import { leaf, map } from "./map.js";
import { check, settled, slider } from "./controls.js";
import { now, on } from "./state.js";

const latest = new Latest(), contours = L.layerGroup().addTo(map);
const SHADES = ["#440154", "#3b528b", "#21918c", "#5ec962", "#fde725"];
const wish = { shown: false, confidence: 0.95, back: true };

export function panel() {
  const again = settled(ask, 250);
  return fold("How far can it go?", { id: "reach", open: wish.shown, ontoggle: event => { wish.shown = event.target.open; ask(); } },
    note("From the start, with the charge and the reserve above."),
    check("and come back", wish.back, back => { wish.back = back; ask(); }),
    slider("Confidence", wish.confidence, { min: 0.5, max: 0.99, step: 0.01, words: value => percent(value) }, value => { wish.confidence = value; again(); }),
    live("reach-said"));
}

const area = m2 => (m2 < 1e4 ? `${number(m2, 0)} m²` : m2 < 1e6 ? `${number(m2 / 1e4, 1)} hectares` : `${number(m2 / 1e6, 1)} km²`);

async function ask() {
  latest.stop();
  const said = by("reach-said");
  if (!wish.shown || !now.costmap || !now.start) {
    contours.clearLayers();
    if (said) fill(said, wish.shown ? note("Set a start first.") : "");
    return;
  }
  const { charge, reserve } = now.battery, levels = [0.25, 0.5, 0.75, 1].map(share => +(reserve + (charge - reserve) * share).toFixed(3));
  const body = { start: now.start, battery: { charge, reserve }, charges: charge > reserve ? levels : null, confidence: wish.confidence, round_trip: wish.back, avoid: now.avoid };
  fill(said, note("Searching…"));
  try {
    const [found, odds] = await latest.run(signal => sendForOdds(`v1/costmaps/${now.costmap.id}/reach?format=geojson&coordinates=map`, body, { signal }));
    contours.clearLayers();
    const order = found.features.filter(one => one.geometry).sort((a, b) => b.properties.charge - a.properties.charge);
    order.forEach(({ geometry, properties }, k) => {
      const shade = SHADES[Math.min(k, SHADES.length - 1)];
      const rings = geometry.type === "Polygon" ? [geometry.coordinates] : geometry.coordinates;
      L.polygon(rings.map(polygon => polygon.map(ring => ring.map(leaf))), { pane: "reach", color: shade, weight: 2, fillColor: shade, fillOpacity: 0.16, smoothFactor: 0.5, interactive: false }).addTo(contours);
      properties.shade = shade;
    });
    fill(said, order.length ? order.map(({ properties }) => note(patch(properties.shade), `starting at ${percent(properties.charge, 1)}${properties.round_trip ? ", there and back" : ""}: ${area(properties.area_m2)}`)).concat(odds ? [] : warn("This model gives no odds: the expected energy decides."), order.length > 1 && order[0].properties.area_m2 === order.at(-1).properties.area_m2 ? note("Each of these charges is enough for all ground that can be reached: lower the charge to see where it ends.") : []) : note("Nothing can be reached with this charge and reserve."));
  } catch (error) {
    if (superseded(error)) return;
    contours.clearLayers();
    fill(said, errorNote(error));
  }
}

on("start costmap battery avoid", ask);
