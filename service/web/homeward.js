// Point of no return: the last place of the route from which the battery still lasts for the way home to the start.

import { Latest, send, superseded } from "./api.js";
import { by, errorNote, fill, make } from "./dom.js";
import { leaf, map } from "./map.js";
import { now, on } from "./state.js";

const latest = new Latest(), mark = L.layerGroup().addTo(map);
let there = false, wanted = false;

/** Whether this service answers questions about the way home. */
export const use = known => { there = known; };

export function panel() {
  if (!there) return null;
  return make("div", {}, make("label", { class: "check" }, make("input", { type: "checkbox", checked: wanted, onchange: event => { wanted = event.target.checked; ask(); } }), "Until where can it turn back? (point of no return)"), make("div", { id: "homeward", "aria-live": "polite" }));
}

async function ask() {
  const said = by("homeward"), path = now.answer?.path;
  latest.stop();
  mark.clearLayers();
  if (!said) return;
  fill(said);
  if (!wanted || !path || now.answer.tour) return;
  const body = { position: now.start, home: now.start, path: path.map(([x, y]) => [x, y]), battery: { charge: now.battery.charge, reserve: now.battery.reserve }, avoid: now.avoid };
  try {
    const found = await latest.run(async signal => {
      const here = `v1/costmaps/${now.costmap.id}/return`;
      try { return await send(here, body, { signal }); } catch (error) {
        if (error.status !== 422 || !/confidence/.test(error.message)) throw error;
        return send(here, { ...body, confidence: null }, { signal }); // the model gives no odds: the expected energy decides
      }
    });
    fill(said, make("p", { class: "note" }, found.text));
    const place = found.point_of_no_return;
    if (place) L.circleMarker(leaf([place.x, place.y]), { radius: 9, color: "#b3261e", weight: 3, fillColor: "#fff", fillOpacity: 1 }).bindTooltip("point of no return", { permanent: true, direction: "top", offset: [0, -8] }).addTo(mark);
  } catch (error) { if (!superseded(error)) fill(said, errorNote(error)); }
}

on("answer", ask);
