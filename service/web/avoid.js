// Areas to avoid: blocked in every question.

import { button, by, fill } from "./dom.js";
import { areaButton, styled } from "./drawing.js";
import { leaf, map } from "./map.js";
import { now, on, set } from "./state.js";

const COLOUR = "#b3261e", areas = L.layerGroup().addTo(map), begin = areaButton("Draw an area", COLOUR, ring => set({ avoid: [...now.avoid, ring] }));

function show() {
  areas.clearLayers();
  for (const ring of now.avoid) L.polygon(ring.map(leaf), styled(COLOUR)).bindTooltip("blocked: area to avoid", { sticky: true }).addTo(areas);
  fill(by("areas"), begin, now.avoid.map((_, k) => button({ "aria-label": `Remove area ${k + 1}`, onclick: () => set({ avoid: now.avoid.filter((_, i) => i !== k) }) }, `Area ${k + 1} ✕`)));
}

on("avoid", show);
show();
