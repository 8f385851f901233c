// The panel "Map": the ground, the robot, making the cost map, and how the map is coloured.

import { ask, send, superseded } from "./api.js";
import { button, by, errorNote, field, fill, fold, h2, live, make, note, number, patch, percent, row, warn } from "./dom.js";
import { sizeWords } from "./ground.js";
import { reasonWords } from "./map.js";
import * as robots from "./robot.js";
import { check, settled, slider, watched } from "./controls.js";
import { now, on, set } from "./state.js";

let opened = () => {}, known = {}, working = null;

/** What the service knows; `open` is called with a cost map that is done. */
export function use(about, open) { known = about; opened = open; }

async function allModels() {
  const found = await ask("v1/calibrations?limit=100").catch(() => ({ items: [] }));
  return [...known.models.map(name => [name, { default: "default (shipped network)", physics: "physics (rolling and climbing)" }[name] ?? name]),
    ...found.items.filter(one => one.calibrated_model).map(one => [one.calibrated_model, `calibrated ${one.calibrated_model} (from ${one.model})`])];
}

const making = () => by("making") ?? by("step-map").appendChild(live("making"));

/** The form for a cost map of `heightmap`; `chosen` is the model that is selected first. */
export async function wish(heightmap, chosen = "default") {
  const model = make("select", { id: "model" }), said = live("making");
  const spacing = make("input", { type: "number", min: 0.01, max: 10000, step: "any", value: Math.max(1, Math.ceil(heightmap.resolution_m * Math.sqrt(heightmap.rows * heightmap.cols * 16 / known.most_values))) }), headings = make("input", { type: "number", min: 4, max: 360, step: 1, value: 16 });
  const say = (words, bad) => fill(said, make("p", { class: bad ? "error" : "note", role: bad ? "alert" : "status" }, words));
  const go = button({ class: "main", id: "make", onclick: () => {
    const invalid = by("step-map").querySelector("input:invalid");
    if (invalid) { invalid.closest("details")?.setAttribute("open", ""); invalid.reportValidity(); return; }
    build({ heightmap_id: heightmap.id, robot: robots.robot(), model: model.value, spacing_m: spacing.valueAsNumber, headings: headings.valueAsNumber });
  } }, "Make the cost map");
  fill(by("step-map"), h2(heightmap.name), note(`${sizeWords(heightmap)}, ${number(heightmap.height_min_m, 1)} to ${number(heightmap.height_max_m, 1)} m high${heightmap.known_share < 1 ? `, ${percent(1 - heightmap.known_share, 1)} unknown` : ""}${heightmap.crs ? `, ${heightmap.crs.slice(0, 40)}` : ""}`),
    heightmap.notes.map(one => note(one)), robots.form(say), field("Model", model),
    fold("Cells and headings", {}, field("Side of a cell", spacing, "m"), field("Headings", headings, "")),
    row(go), said);
  for (const [name, words] of await allModels()) model.append(make("option", { value: name, selected: name === chosen }, words));
}

/** Asks for a cost map and shows how far it is; another call takes its place. */
export async function build(body) {
  working?.abort();
  const mine = working = new AbortController();
  const said = making();
  try {
    fill(said, note("Asking…"));
    await watch(await send("v1/costmaps", body), mine.signal);
  } catch (error) {
    if (!superseded(error)) fill(making(), errorNote(error));
  }
}

/** Shows how far a cost map is that is being made, until it is there. */
export async function watch(costmap, signal = (working = new AbortController()).signal) {
  const said = making();
  const made = await watched(said, `v1/costmaps/${costmap.id}`, "Cost map", signal);
  if (made.status === "done") opened(made);
}

const VIEWS = { mean: "Energy per metre, mean of the headings", heading: "Energy per metre in one heading", directionality: "How much the heading matters", ground: "Ground only" };
const WINDS = ["north", "north-east", "east", "south-east", "south", "south-west", "west", "north-west"];
const headingWords = degrees => `${degrees}° ${WINDS[Math.round(degrees / 45) % 8]}`;

/** How the map is coloured, once there is a cost map. */
export function show() {
  const { costmap, heightmap } = now;
  const turn = settled(heading => set({ heading }), 80);
  const radios = Object.entries(VIEWS).map(([name, words]) => make("label", { class: "check" }, make("input", { type: "radio", name: "view", value: name, checked: now.view === name, onchange: () => { set({ view: name }); by("turn").hidden = name !== "heading"; } }), words));
  const also = (name, words) => check(words, now.show[name], on => set({ show: { ...now.show, [name]: on } }));
  const again = button({ onclick: () => { robots.set(sentRobot(costmap.robot)); wish(heightmap, costmap.model); } }, "Another robot or model");
  fill(by("step-map"), h2(heightmap?.name ?? costmap.heightmap_id), note(heightmap ? sizeWords(heightmap) : "", ` · ${costmap.robot.name} (${number(costmap.robot.mass_kg, 0)} kg) · model ${costmap.model} · ${costmap.headings} headings`),
    row(again),
    make("fieldset", {}, make("legend", {}, "Colour"), radios, make("div", { id: "turn", hidden: now.view !== "heading" }, slider("Heading", now.heading, { min: 0, max: 355, step: 5, words: headingWords }, turn))),
    make("div", { id: "legend" }),
    make("fieldset", {}, make("legend", {}, "Also show"), also("contours", "Contour lines"), also("blocked", "Blocked ground"), also("roses", "Energy by heading at single cells, when zoomed in")),
    note("Zoomed in, a rose shows what a metre costs in each heading: the longer, the more."),
    costmap.warnings.map(words => warn(words)), live("making"));
  legend();
}

/** A robot without what the service filled in. */
const sentRobot = robot => Object.fromEntries(Object.entries(robot).filter(([, value]) => value !== null));

function legend() {
  const here = by("legend"), scale = now.layers?.[now.view];
  if (!here || !now.layers) return;
  const blocked = now.costmap.blocked ?? {};
  fill(here, scale ? [make("div", { id: "scale", role: "img", "aria-label": `colours from ${number(scale.low, 0)} to ${number(scale.high, 0)} joules per metre` }, scale.colours.map(colour => patch(colour, ""))),
    make("div", { class: "ends number" }, make("span", {}, `${number(scale.low, 0)} J/m`), make("span", { class: "quiet" }, now.view === "directionality" ? "dearest less cheapest heading" : "energy per metre"), make("span", {}, `${number(scale.high, 0)} J/m`))] : null,
  Object.values(blocked).some(Boolean) ? note("Hatched: blocked in all headings; pale: in some.") : null,
  now.layers.blocked.filter(({ reason }) => blocked[reason] > 0).map(({ reason, colour }) => note(patch(colour), `${reasonWords(reason)}: ${blocked[reason] < 0.001 ? "under 0.1 %" : percent(blocked[reason], 1)}`)));
}
on("view layers", legend);
