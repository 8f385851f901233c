// Point of no return: the last place of the route from which the battery still lasts for the way home to the start.

import { Latest, sendForOdds, superseded } from "./api.js";
import { by, errorNote, fill, live, make, note } from "./dom.js";
import { check } from "./controls.js";
import { leaf, map } from "./map.js";
import { now, on } from "./state.js";

const latest = new Latest(), mark = L.layerGroup().addTo(map);
let wanted = false;

export function panel() {
  return make("div", {}, check("Until where can it turn back? (point of no return)", wanted, on => { wanted = on; ask(); }), live("homeward"));
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
    const [found] = await latest.run(signal => sendForOdds(`v1/costmaps/${now.costmap.id}/return`, body, { signal }));
    fill(said, note(found.text));
    const place = found.point_of_no_return;
    if (place) L.circleMarker(leaf([place.x, place.y]), { radius: 9, color: "#b3261e", weight: 3, fillColor: "#fff", fillOpacity: 1 }).bindTooltip("point of no return", { permanent: true, direction: "top", offset: [0, -8] }).addTo(mark);
  } catch (error) { if (!superseded(error)) fill(said, errorNote(error)); }
}

on("answer", ask);
