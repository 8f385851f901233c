// The panel "Route": places, battery, planner, and the answer in words and numbers.

import * as avoid from "./avoid.js";
import { check, settled, slider } from "./controls.js";
import { button, by, errorNote, field, fill, fold, h2, joules, live, make, metres, minutes, note, number, percent, row, warn } from "./dom.js";
import * as homeward from "./homeward.js";
import { askAgain, expect, expected, hint } from "./question.js";
import * as reach from "./reach.js";
import { now, on, set } from "./state.js";

function placeField(name, label) {
  const value = now[name], text = value ? value.map(one => +one.toFixed(2)).join(", ") : "";
  const input = make("input", { type: "text", value: text, id: `place-${name}`, placeholder: "x, y in metres", inputmode: "decimal", onchange: () => {
    const values = input.value.split(/[\s,;]+/).filter(Boolean).map(Number);
    const good = values.length === 2 && values.every(Number.isFinite);
    input.setCustomValidity(good || !input.value ? "" : `write two numbers in metres, such as 12.5, 40; this is ${input.value}`);
    if (!input.reportValidity()) return;
    set({ [name]: good ? values : null });
  } });
  return field(label, input);
}

const slow = settled(() => set({ battery: { ...now.battery } }));

function form() {
  const pick = (what, label) => button({ "aria-pressed": String(expected() === what), onclick: () => { expect(what); places(); if (what === "goal") hint("Click where it shall go"); if (what === "start") hint("Click where the robot starts"); } }, label);
  const choice = make("select", { onchange: event => set({ planner: event.target.value }) }, planners.map(name => make("option", { value: name, selected: name === now.planner }, name)));
  const others = make("input", { type: "number", min: 0, max: 5, value: now.alternatives, onchange: event => set({ alternatives: Math.max(0, Math.min(5, Math.round(+event.target.value) || 0)) }) });
  const places = () => fill(by("places"),
    placeField("start", "Start"), placeField("goal", "Goal"),
    now.stops.length ? note(`${now.stops.length} stop${now.stops.length > 1 ? "s" : ""}: the service finds the best order and returns to the start. `, button({ class: "plain", onclick: () => set({ stops: [] }) }, "Remove the stops")) : null,
    make("div", { class: "row tight" }, pick("start", "Set start"), pick("goal", "Set goal"), pick("stop", "Add stop"),
      button({ onclick: () => set({ start: now.goal, goal: now.start }), disabled: !now.start || !now.goal }, "Swap")));
  fill(by("step-route"),
    make("div", { id: "places" }),
    live("answer"),
    h2("Battery"),
    slider("Charge at the start", now.battery.charge, { min: 0.05, max: 1, step: 0.01, words: value => percent(value) }, charge => { now.battery.charge = charge; slow(); }),
    slider("Reserve to keep", now.battery.reserve, { min: 0, max: 0.9, step: 0.01, words: value => percent(value) }, reserve => { now.battery.reserve = reserve; slow(); }),
    check("And back again", now.roundTrip, roundTrip => set({ roundTrip })),
    homeward.panel(),
    avoid.panel(), reach.panel(),
    fold("Search", {}, field("Alternatives to show", others, ""), field("Planner", choice)));
  places();
  answer();
  return places;
}

let planners = ["astar"];
export function start(known) {
  planners = known;
  let places = form();
  on("start goal stops costmap", () => { if (by("places") && !by("places").contains(document.activeElement)) places(); else settledPlaces(places); });
  on("costmap", () => { places = form(); });
}
const settledPlaces = settled(places => places(), 10);

const TITLES = { yes: "Yes, the battery lasts", likely: "It probably lasts", marginal: "It may not last", no: "No, the battery does not last" };

/** The verdict of an answer as a word: of the service, or from its probability. */
export function verdictOf(verdict) {
  if (verdict.verdict) return verdict.verdict;
  return verdict.feasible ? "yes" : "no";
}

function answer() {
  const here = by("answer"), found = now.answer;
  if (!here) return;
  if (!found) { fill(here, note(!now.costmap ? "Make a cost map first." : now.start && now.goal ? "Searching…" : "Click a start and a goal on the map, or write them above.")); return; }
  if (found.error) {
    fill(here, errorNote(found.error), found.error.name === "Unreachable" ? button({ onclick: () => askAgain() }, "Ask again") : found.error.code === "blocked" ? button({ id: "snap", onclick: () => askAgain(true) }, "Use the nearest free place") : null);
    return;
  }
  const { verdict, shortest } = found, word = verdict && verdictOf(verdict);
  const band = verdict?.energy_p05_j ?? found.energy_p05_j, top = verdict?.energy_p95_j ?? found.energy_p95_j;
  const line = (kind, name, route) => [make("span", {}, make("i", { class: `swatch ${kind}` }), name), make("span", { class: "number" }, joules(route.energy_j)), make("span", { class: "number" }, metres(route.length_m))];
  const rows = [line("optimal", found.tour ? "tour" : "least energy", found), ...(shortest ? [line("shortest", "shortest", shortest)] : []), ...found.alternatives.map((other, k) => line("other", `alternative ${k + 1}`, other)), ...(found.back ? [line("optimal", "way back", found.back)] : []), ...(now.before ? [line("before", `before: model ${now.before.model}`, now.before)] : [])];
  fill(here,
    verdict ? make("div", { class: `verdict ${word}` }, make("b", {}, TITLES[word] ?? word), verdict.verdict_text ?? verdict.message) : null,
    !verdict?.verdict_text && typeof band === "number" && typeof top === "number" ? note(`9 of 10 such drives take ${joules(band)} to ${joules(top)}.`) : null,
    shortest ? make("p", {}, found.saving_j > 0.5 ? make("span", {}, "Going this way saves ", make("b", {}, joules(found.saving_j)), ` (${number(found.saving_percent, 1)} %) against the shortest way.`) : "The shortest way is also the cheapest.") : null,
    tableOf(rows),
    note(`${minutes(found.duration_s)} at ${number(now.costmap.robot.speed_mps, 1)} m/s, ${metres(found.climb_m)} up, ${metres(found.descent_m)} down`),
    found.warnings?.map(words => warn(words)));
}

const tableOf = rows => make("table", {}, make("thead", {}, make("tr", {}, make("th", { scope: "col" }, "way"), make("th", { scope: "col", class: "number" }, "energy"), make("th", { scope: "col", class: "number" }, "length"))), make("tbody", {}, rows.map(cells => make("tr", {}, cells.map((cell, k) => make("td", k ? { class: "number" } : {}, cell))))));

on("answer", answer);
