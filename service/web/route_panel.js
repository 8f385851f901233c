// The panel "Route": places, battery, planner, and the answer in words and numbers.

import { again } from "./answers.js";
import "./avoid.js";
import { bind } from "./controls.js";
import { button, by, energy, errorNote, fill, make, metres, minutes, note, number, ofBattery, patch, percent, table, touched, warn } from "./dom.js";
import "./homeward.js";
import { groundWarning, reasonWords } from "./map.js";
import { canUndo, expect, expected, snap, thicken, undo, WAYS, waysOf } from "./question.js";
import "./reach.js";
import { now, on, set } from "./state.js";

const share = name => [name, "battery", () => +(100 * now.battery[name]).toFixed(1), value => set({ battery: { ...now.battery, [name]: value / 100 } })];
const aim = changes => set({ aim: { ...now.aim, ...changes } });

const pickers = by("places").querySelectorAll("[value]");

function places() {
  for (const one of pickers) one.setAttribute("aria-pressed", expected() === one.value);
  by("stops").hidden = !now.stops.length;
  by("stops-how").textContent = !now.inOrder ? "The best order is found, and the tour returns to the start." : now.roundTrip ? "They are visited as numbered, and the tour returns to the start." : "They are visited as numbered; the tour ends at the last place.";
  by("stops").firstChild.textContent = `${now.stops.length} stop${now.stops.length > 1 ? "s" : ""}.`;
  by("swap").disabled = !now.start || !now.goal;
  by("undo").disabled = !canUndo();
}

for (const one of pickers) one.onclick = () => { expect(one.value); places(); };
by("no-stops").onclick = () => set({ stops: [] });
by("swap").onclick = () => set({ start: now.goal, goal: now.start });
by("undo").onclick = undo;

export function start(planners) {
  fill(by("planner"), planners.map(name => make("option", { value: name }, { astar: "A*", dijkstra: "Dijkstra" }[name] ?? name)));
  bind("capacity", "battery costmap", () => now.battery.capacity_wh ?? now.costmap?.robot.battery_wh, capacity_wh => set({ battery: { ...now.battery, capacity_wh } }));
  bind(...share("charge"));
  bind(...share("reserve"));
  bind("round-trip", "roundTrip", () => now.roundTrip, roundTrip => set({ roundTrip }));
  bind("in-order", "inOrder", () => now.inOrder, inOrder => set({ inOrder }));
  bind("confidence", "confidence", () => 100 * now.confidence, value => set({ confidence: value / 100 }));
  bind("turn-back", "turnBack", () => now.turnBack, turnBack => set({ turnBack }));
  bind("others", "alternatives", () => now.alternatives, alternatives => set({ alternatives }));
  bind("objective", "aim", () => now.aim.objective, objective => aim({ objective }));
  bind("quantile", "aim", () => 100 * now.aim.quantile, value => aim({ quantile: value / 100 }));
  bind("power", "aim", () => now.aim.max_power_w, value => aim({ max_power_w: value }));
  bind("planner", "planner", () => now.planner, planner => set({ planner }));
  on("aim", () => { by("share").hidden = now.aim.objective !== "quantile"; });
  for (const name of ["start", "goal"]) bind(`place-${name}`, name, () => now[name]?.map(one => +one.toFixed(2)).join(", "), text => set({ [name]: text?.split(/[\s,;]+/).filter(Boolean).map(Number) ?? null }));
  on("start goal stops inOrder roundTrip avoid costmap", places);
  places();
  answer();
}

export const TITLES = by("answer").dataset; // verdict -> its words

/** The name of a way in the table; pointed at or in focus, its line on the map is thick. */
function nameOf(kind, name, way) {
  const [colour, , on = 1, off = 0] = WAYS[kind], swatch = patch(`repeating-linear-gradient(90deg, ${colour} 0 ${on + 2}px, #fff ${on + 2}px ${on + off}px)`, "swatch way"), thick = out => () => thicken(way, kind, out);
  return make("span", { tabindex: "0", onmouseenter: thick(true), onfocus: thick(true), onmouseleave: thick(false), onblur: thick(false) }, swatch, name);
}

function answer() {
  const here = by("answer"), found = now.answer;
  if (!found) { fill(here, note(!now.costmap ? "Make a cost map first." : now.start && (now.goal || now.stops.length) ? "Searching…" : touched("Click a start and a goal on the map, or write them above."))); return; }
  if (found.error) {
    const { reason } = found.error.context ?? {};
    fill(here, errorNote({ message: found.error.message.replace(`: ${reason}`.replace("_", " "), `: ${reasonWords(reason)}`) }), found.error.name === "Unreachable" ? button({ onclick: () => again("answer") }, "Ask again") : found.error.code === "blocked" ? button({ id: "snap", onclick: snap }, "Use the nearest free place") : null);
    return;
  }
  const { verdict, shortest, objective, back } = found, ways = waysOf(found), sum = name => found[name] + (back?.[name] ?? 0);
  const [joules, long] = ["energy_j", "length_m"].map(name => Math.max(...ways.map(([,, way]) => way[name])));
  const [first, ...more] = verdict?.verdict_text.replace(/^\w+[:,] |\.$/g, "").split("; ") ?? [], open = here.querySelector(".verdict details")?.open;
  fill(here,
    verdict ? make("div", { class: `verdict ${verdict.verdict}` }, make("b", {}, TITLES[verdict.verdict]), make("p", {}, first), make("details", { open }, make("summary", {}, "More"), make("ul", {}, [...more, `charge ${percent(verdict.charge_at_start)} at the start, ${verdict.charge_at_end > 0 ? `${percent(verdict.charge_at_end, 1)} expected at the end` : "empty before the end"}`].map(words => make("li", {}, words))))) : null,
    objective ? note((objective.name === "quantile" ? [`${percent(objective.quantile)} of drives take at most ${energy(objective.quantile_j)}`, energy(objective.mean_quantile_j)] : [`It arrives with a probability of ${percent(objective.probability, 1)}`, percent(objective.mean_probability, 1)]).join("; on the way of least expected energy "), ".") : null,
    shortest ? make("p", {}, found.saving_j > 0.5 ? make("span", {}, "Going this way saves ", make("b", {}, energy(found.saving_j)), ` (${number(found.saving_percent, 1)} %) against the shortest way.`) : "The shortest way is also the cheapest.") : null,
    table([["way", "energy", "battery", "length"], ...ways.map(([kind, name, way]) => [nameOf(kind, name, way), energy(way.energy_j, joules), ofBattery(way.energy_j, joules, way.full_j ?? found.full_j), metres(way.length_m, long)])], "The ways"),
    note(`${back ? "There and back: " : ""}${minutes(sum("duration_s"))} at ${number(found.speed_mps, 1)} m/s, ${metres(sum("climb_m"))} up, ${metres(sum("descent_m"))} down`),
    found.warnings?.map(words => warn(groundWarning(words, found.profile))));
}

on("answer before", answer);
on("start goal stops costmap", () => { if (!now.answer) answer(); });
