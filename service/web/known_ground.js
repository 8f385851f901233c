// What the ground is, beside its height: areas that are drawn for the next cost map, each with what it is.

import { button, by, field, fill, make, select } from "./dom.js";
import { areaButton, styled } from "./drawing.js";
import { leaf, map } from "./map.js";
import { now, on, set } from "./state.js";

/** What an area may be: its words and its colour; of its number the label, the unit and the limits. */
const WHAT = {
  kinds: ["a kind of ground", "#8a5a00", "Rolling resistance", "", 0, 2],
  obstacles: ["an obstacle", "#4a4f54"],
  free: ["the only ground to drive on", "#1b7f4b"],
  factor: ["ground with more or less energy", "#7a3fa0", "Times the energy", "×", 0, 100],
  height: ["a bridge", "#0072b2", "Height of its deck", "m", -50_000, 50_000],
};
const areas = L.layerGroup().addTo(map);
let known = {};

/** Kinds of ground that the service knows, with their rolling resistance. */
export function use(kinds) {
  known = kinds;
  fill(by("kinds-known"), Object.keys(kinds).map(value => make("option", { value })));
}

function changed(ground = [...now.ground]) {
  set({ ground });
  by("wish").dispatchEvent(new Event("change"));
}
const begin = areaButton("Draw ground", WHAT.kinds[1], ring => { changed([...now.ground, { ring, what: "kinds", kind: "mud", value: null }]); list(); });

function list() {
  fill(by("ground-areas"), now.ground.map((area, k) => {
    const [,, label, unit, min, max] = WHAT[area.what], name = `Area ${k + 1}`;
    const value = label && make("input", { type: "number", step: "any", min, max, required: area.what !== "kinds", value: area.value ?? "", placeholder: known[area.kind] ?? "", oninput: ({ target }) => { area.value = target.value === "" ? null : target.valueAsNumber; changed(); } });
    const kind = area.what === "kinds" && make("input", { type: "text", list: "kinds-known", required: true, maxlength: "100", value: area.kind, oninput: ({ target }) => { area.kind = target.value.trim().toLowerCase(); changed(); }, onchange: list });
    return make("fieldset", {}, make("legend", {}, name, " ", button({ class: "plain", "aria-label": `Remove ${name} of the ground`, onclick: () => { changed(now.ground.filter(one => one !== area)); list(); } }, "✕")),
      field("It is", select(Object.entries(WHAT).map(([what, [words]]) => [what, words]), area.what, what => { Object.assign(area, { what, value: null }); changed(); list(); })),
      kind ? field("Kind", kind) : null, value ? field(label, value, unit) : null);
  }), begin);
}

const words = ({ what, kind, value }) => (what === "kinds" ? kind : WHAT[what][0]) + (value === null ? "" : `, ${value} ${WHAT[what][3]}`);

on("ground", () => {
  areas.clearLayers();
  for (const area of now.ground) L.polygon(area.ring.map(leaf), styled(WHAT[area.what][1])).bindTooltip(words(area), { sticky: true }).addTo(areas);
});
on("heightmap", list);

/** The areas as a cost map takes them. */
export function layers() {
  const found = {}, legend = {};
  for (const { ring, what, kind, value } of now.ground) {
    const said = what === "kinds" ? { kind } : value === null ? {} : { [what]: value };
    (found[what] ??= { type: "FeatureCollection", features: [] }).features.push({ type: "Feature", properties: said, geometry: { type: "Polygon", coordinates: [ring] } });
    if (what === "kinds" && value !== null) legend[kind] = { rolling_resistance: value };
  }
  return { layers: found, legend };
}
