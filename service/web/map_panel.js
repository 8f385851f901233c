// The panel "Map": the ground, the robot, making the cost map, and how the map is coloured.

import { ask, send } from "./api.js";
import { alarm, attempt, by, fill, make, note, number, patch, percent, warn } from "./dom.js";
import { sizeWords } from "./ground.js";
import * as knownGround from "./known_ground.js";
import { groundWarning, reasonWords } from "./map.js";
import * as robots from "./robot.js";
import { bind, settled, watched } from "./controls.js";
import { draft, now, on, set } from "./state.js";

let opened = () => {}, known = {}, working = null;

/** What the service knows; `open` is called with a cost map that is done. */
export function use(about, open) { known = about; opened = open; }

async function allModels() {
  const found = await ask("v1/calibrations?limit=100").catch(() => ({ items: [] }));
  return [...known.models.map(name => [name, { default: "default (shipped network)", physics: "physics (rolling and climbing)" }[name] ?? name]),
    ...found.items.filter(one => one.calibrated_model).map(one => [one.calibrated_model, `calibrated ${one.calibrated_model} (from ${one.model})`])];
}

/** The form for a cost map of `heightmap`; `chosen` is the model that is selected first. */
export async function wish(heightmap, chosen = "default") {
  const models = await allModels(), cells = heightmap.rows * heightmap.cols * 16 / known.most_values;
  title(heightmap.name, `${sizeWords(heightmap)}, ${number(heightmap.height_min_m, 1)} to ${number(heightmap.height_max_m, 1)} m high${heightmap.known_share < 1 ? `, ${percent(1 - heightmap.known_share, 1)} unknown` : ""}${heightmap.crs ? `, ${heightmap.crs.slice(0, 40)}` : ""}`, ...heightmap.notes);
  robots.form(by("robot-form"), (words, bad) => fill(by("making"), bad ? alarm(words) : note(words)));
  fill(by("model"), models.map(([value, words]) => make("option", { value, selected: value === chosen }, words)));
  by("spacing").value = Math.max(1, Math.ceil(heightmap.resolution_m * Math.sqrt(cells)));
  by("make").onclick = () => {
    const invalid = by("wish").querySelector("input:invalid");
    if (invalid) { invalid.closest("details")?.setAttribute("open", ""); invalid.reportValidity(); return; }
    build({ heightmap_id: heightmap.id, robot: robots.robot(), model: by("model").value, spacing_m: by("spacing").valueAsNumber, headings: by("headings").valueAsNumber, ...knownGround.layers() });
  };
  by("keep").hidden = !now.costmap;
  panel("wish");
}
by("keep").onclick = () => show();
for (const name of ["input", "change"]) by("wish").addEventListener(name, () => draft("form", "this robot, model and ground have no cost map yet"));

function title(name, ...notes) { fill(by("ground-name"), name); fill(by("ground-said"), notes.map(words => note(words))); }

/** Which of both is seen: the form, or how the map looks. */
function panel(name) {
  for (const one of ["wish", "look"]) by(one).hidden = one !== name;
  fill(by("making"));
  draft("form");
}

/** Asks for a cost map and shows how far it is; another call takes its place. */
export async function build(body) {
  working?.abort();
  const mine = working = new AbortController();
  fill(by("making"), note("Asking…"));
  draft(mine, "making the cost map …");
  await attempt(by("making"), async () => watch(await send("v1/costmaps", body), mine.signal));
  draft(mine);
}

/** Shows how far a cost map is that is being made, until it is there. */
export async function watch(costmap, signal = (working = new AbortController()).signal) {
  const made = await watched(by("making"), `v1/costmaps/${costmap.id}`, "Cost map", signal);
  if (made.status === "done") opened(made);
}

const WINDS = ["north", "north-east", "east", "south-east", "south", "south-west", "west", "north-west"];
bind("views", "view", () => now.view, view => set({ view }));
bind("heading", "heading", () => now.heading, settled(heading => set({ heading }), 80), degrees => `° ${WINDS[Math.round(degrees / 45) % 8]}`);
for (const name of Object.keys(now.show)) bind(`show-${name}`, "show", () => now.show[name], on => set({ show: { ...now.show, [name]: on } }));

/** How the map is coloured, once there is a cost map. */
export function show() {
  const { costmap, heightmap } = now;
  title(heightmap.name, `${sizeWords(heightmap)} · ${costmap.robot.name} (${number(costmap.robot.mass_kg, 0)} kg) · model ${costmap.model} · ${costmap.headings} headings`);
  by("again").onclick = () => { robots.set(sentRobot(costmap.robot)); wish(heightmap, costmap.model); };
  fill(by("map-warnings"), costmap.warnings.map(words => warn(groundWarning(words))));
  panel("look");
  legend();
}

/** A robot without what the service filled in. */
export const sentRobot = robot => Object.fromEntries(Object.entries(robot).filter(([name, value]) => value !== null && name !== "turn_j_per_rad"));

function legend() {
  by("heading").hidden = now.view !== "heading";
  const here = by("legend"), scale = now.layers?.[now.view];
  if (!now.layers) { fill(here); return; }
  const { blocked = {} } = now.costmap, seen = now.layers.blocked.filter(({ reason }) => blocked[reason] > 0);
  fill(here, scale ? [make("div", { id: "scale", role: "img", "aria-label": `colours from ${number(scale.low, 0)} to ${number(scale.high, 0)} joules per metre` }, scale.colours.map(colour => patch(colour, ""))),
    make("div", { class: "ends number" }, make("span", {}, `${number(scale.low, 0)} J/m`), make("span", { class: "quiet" }, now.view === "directionality" ? "dearest less cheapest heading" : "energy per metre"), make("span", {}, `${number(scale.high, 0)} J/m`))] : null,
  seen.length ? note("Hatched: blocked in all headings; pale: in some.") : null,
  seen.map(({ reason, colour }) => note(patch(colour), `${reasonWords(reason)}: ${blocked[reason] < 0.001 ? "under 0.1 %" : percent(blocked[reason], 1)}`)));
}
on("view layers", legend);
