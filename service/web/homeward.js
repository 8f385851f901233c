// Point of no return: the last place of the route from which the battery still lasts for the way home to the start.

import { Latest, sendForOdds } from "./api.js";
import { attempt, by, fill, metres, note, percent } from "./dom.js";
import { leaf, map } from "./map.js";
import { now, on } from "./state.js";

const latest = new Latest(), mark = L.layerGroup().addTo(map);

async function ask() {
  const said = by("homeward"), path = now.answer?.path;
  latest.stop();
  mark.clearLayers();
  fill(said);
  if (!now.turnBack || !path || now.answer.tour) return;
  const body = { position: now.start, home: now.start, path: path.map(([x, y]) => [x, y]), battery: now.battery, avoid: now.avoid };
  await attempt(said, async () => {
    const found = await latest.run(signal => sendForOdds(`v1/costmaps/${now.costmap.id}/return`, body, { signal }));
    if (!found) return;
    const place = found.point_of_no_return, sure = found.odds ? `, with a probability of ${percent(0.95)}` : "";
    fill(said, note(!found.still_home ? "The charge is at the reserve already." : place ? `It must turn back after ${metres(place.distance_m)} of ${metres(found.length_m)} at the latest: up to there the battery lasts for the way home${sure}.` : `Anywhere: from the end of the route too the battery lasts for the way home${sure}.`));
    if (place) L.circleMarker(leaf([place.x, place.y]), { radius: 9, color: "#b3261e", weight: 3, fillColor: "#fff", fillOpacity: 1 }).bindTooltip("point of no return", { permanent: true, direction: "top", offset: [0, -8] }).addTo(mark);
  });
}

on("answer turnBack", ask);
