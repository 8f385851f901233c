// Point of no return: the last place of the route from which the battery still lasts for the way home to the start.

import { current, keep } from "./answers.js";
import { sendForOdds } from "./api.js";
import { by, errorNote, fill, metres, note, percent } from "./dom.js";
import { leaf, map } from "./map.js";
import { now } from "./state.js";

const mark = L.layerGroup().addTo(map);

function question() {
  const { answer, start, battery, avoid } = now;
  if (!now.turnBack || !answer?.path || answer.tour) return null;
  return current("answer") ? { route: answer.key, body: { position: start, home: start, battery, avoid, confidence: 0.95 } } : undefined;
}

const ask = ({ body }, signal) => sendForOdds(`v1/costmaps/${now.costmap.id}/return`, { ...body, path: now.answer.path.map(([x, y]) => [x, y]) }, { signal });

function draw() {
  const said = by("homeward"), found = now.homeward;
  mark.clearLayers();
  if (!found || found.error) { fill(said, found && errorNote(found.error)); return; }
  const place = found.point_of_no_return, sure = found.odds ? `, with a probability of ${percent(0.95)}` : "";
  fill(said, note(!found.still_home ? "The charge is at the reserve already." : place ? `It must turn back after ${metres(place.distance_m)} of ${metres(found.length_m)} at the latest: up to there the battery lasts for the way home${sure}.` : `Anywhere: from the end of the route too the battery lasts for the way home${sure}.`));
  if (place) L.circleMarker(leaf([place.x, place.y]), { pane: "return", radius: 9, color: "#b3261e", weight: 3, fillColor: "#fff", fillOpacity: 1 }).bindTooltip("point of no return", { pane: "return", permanent: true, direction: "top", offset: [0, -8] }).addTo(mark);
}

keep("homeward", question, ask, draw);
