// Reach: how far the battery takes the robot from the start, as shaded contours.

import { Latest, send, superseded } from "./api.js";
import { by, errorNote, fill, make, number, percent } from "./dom.js";
import { leaf, map } from "./map.js";
import { settled, slider } from "./controls.js";
import { now, on } from "./state.js";

const latest = new Latest(), contours = L.layerGroup().addTo(map);
const SHADES = ["#440154", "#3b528b", "#21918c", "#5ec962", "#fde725"];
const wish = { shown: false, confidence: 0.95, back: true };
let there = false;

/** Whether this service answers questions about reach. */
export const use = known => { there = known; };

export function panel() {
  if (!there) return null;
  const again = settled(ask, 250);
  return make("details", { id: "reach", open: wish.shown, ontoggle: event => { wish.shown = event.target.open; ask(); } },
    make("summary", {}, "How far can it go?"),
    make("p", { class: "note" }, "From the start, with the charge and the reserve above."),
    make("label", { class: "check" }, make("input", { type: "checkbox", checked: wish.back, onchange: event => { wish.back = event.target.checked; ask(); } }), "and come back"),
    slider("Confidence", wish.confidence, { min: 0.5, max: 0.99, step: 0.01, words: value => percent(value) }, value => { wish.confidence = value; again(); }),
    make("div", { id: "reach-said", "aria-live": "polite" }));
}

const area = m2 => (m2 < 1e4 ? `${number(m2, 0)} m²` : m2 < 1e6 ? `${number(m2 / 1e4, 1)} hectares` : `${number(m2 / 1e6, 1)} km²`);

async function ask() {
  latest.stop();
  const said = by("reach-said");
  if (!wish.shown || !now.costmap || !now.start) {
    contours.clearLayers();
    if (said) fill(said, wish.shown ? make("p", { class: "note" }, "Set a start first.") : "");
    return;
  }
  const { charge, reserve } = now.battery, levels = [0.25, 0.5, 0.75, 1].map(share => +(reserve + (charge - reserve) * share).toFixed(3));
  const body = { start: now.start, battery: { charge, reserve }, charges: charge > reserve ? levels : null, confidence: wish.confidence, round_trip: wish.back, avoid: now.avoid };
  fill(said, make("p", { class: "note" }, "Searching…"));
  try {
    let odds = true;
    const found = await latest.run(async signal => {
      const here = `v1/costmaps/${now.costmap.id}/reach?format=geojson&coordinates=map`;
      try { return await send(here, body, { signal }); } catch (error) {
        if (error.status !== 422 || !/confidence/.test(error.message)) throw error;
        odds = false;
        return send(here, { ...body, confidence: null }, { signal });
      }
    });
    contours.clearLayers();
    const order = found.features.filter(one => one.geometry).sort((a, b) => b.properties.charge - a.properties.charge);
    order.forEach(({ geometry, properties }, k) => {
      const shade = SHADES[Math.min(k, SHADES.length - 1)];
      const rings = geometry.type === "Polygon" ? [geometry.coordinates] : geometry.coordinates;
      L.polygon(rings.map(polygon => polygon.map(ring => ring.map(leaf))), { pane: "reach", color: shade, weight: 2, fillColor: shade, fillOpacity: 0.16, smoothFactor: 0.5, interactive: false }).addTo(contours);
      properties.shade = shade;
    });
    fill(said, order.length ? order.map(({ properties }) => {
      const box = make("i", { class: "box" });
      box.style.background = properties.shade;
      return make("p", { class: "note" }, box, `starting at ${percent(properties.charge, 1)}${properties.round_trip ? ", there and back" : ""}: ${area(properties.area_m2)}`);
    }).concat(odds ? [] : make("p", { class: "note warn" }, "This model gives no odds: the expected energy decides.")) : make("p", { class: "note" }, "Nothing can be reached with this charge and reserve."));
  } catch (error) {
    if (superseded(error)) return;
    contours.clearLayers();
    fill(said, errorNote(error));
  }
}

on("start costmap battery avoid", ask);
