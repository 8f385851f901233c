// The question: markers of start, goal and stops; a question to the service at each change; its routes on the map.

import { Latest, send } from "./api.js";
import { by, energy, make, metres } from "./dom.js";
import { inside, leaf, map, world } from "./map.js";
import { now, on, set } from "./state.js";

const latest = new Latest();
const routes = L.layerGroup().addTo(map), pins = L.layerGroup().addTo(map);
const guide = L.polyline([], { color: "#1d2329", weight: 1.5, dashArray: "4 6", interactive: false }).addTo(map);
export const COLOURS = { optimal: "#0072B2", shortest: "#D55E00", back: "#b1508a", other: "#3b3f45", before: "#6d6d6d" };
const MANY_CELLS = 250_000; // of a larger map a route along the grid is shown first, until the better one is there
let wanted = null;

/** What the next click on the map sets: "start", "goal" or "stop"; nothing once both ends are there, until a button asks for one click. */
export const expected = () => wanted ?? (!now.costmap ? null : !now.start ? "start" : !now.goal && !now.stops.length ? "goal" : null);
export function expect(what) {
  wanted = wanted === what ? null : what;
  hint();
}

export function hint(words) {
  const here = by("hint");
  here.textContent = words ?? { start: "Click where the robot starts", goal: "Click where it shall go", stop: "Click a place to visit on the way" }[expected()] ?? "";
  here.hidden = !here.textContent;
}

const past = [];
let last = {}, ground = null;
on("start goal stops avoid costmap", ({ start, goal, stops, avoid, costmap }) => {
  const before = last;
  last = { start, goal, stops, avoid };
  if (ground !== costmap?.heightmap_id) { ground = costmap?.heightmap_id; past.length = 0; } else if (Object.keys(last).some(name => last[name] !== before[name])) past.push(before);
});
/** Takes the last change of a place back. */
export const undo = () => { if (past.length) set(last = past.pop()); };
export const canUndo = () => past.length > 0;
document.addEventListener("keydown", event => {
  if (event.key !== "z" || !(event.ctrlKey || event.metaKey) || event.target.matches("input:not([type=range], [type=checkbox])")) return;
  event.preventDefault();
  undo();
});

/** A click that others have taken, such as for the corner of an area, is not for us. */
export const takers = [];
map.on("click", event => {
  const place = world(event.latlng).map(value => +value.toFixed(3));
  if (!now.costmap || takers.some(taker => taker(place, event)) || !inside(place)) return;
  const what = expected();
  wanted = null;
  if (what) set(what === "stop" ? { stops: [...now.stops, place] } : { [what]: place });
});

function pin(kind, place, label, change) {
  const mark = { start: "S", goal: "G" }[kind] ?? label;
  const icon = L.divIcon({ className: `pin ${kind}`, html: mark, iconSize: [28, 28] });
  const marker = L.marker(leaf(place), { icon, draggable: true, autoPan: true, keyboard: true, alt: label, title: `${label}: drag it, or move it with the arrow keys`, zIndexOffset: 1000 });
  marker.on("drag", () => drawGuide(kind, world(marker.getLatLng())));
  marker.on("dragend", () => { guide.setLatLngs([]); change(world(marker.getLatLng()).map(value => +value.toFixed(3))); });
  marker.addTo(pins);
  const node = marker.getElement();
  node.setAttribute("aria-label", `${label} at x ${place[0].toFixed(1)}, y ${place[1].toFixed(1)} metres; arrow keys move it`);
  node.addEventListener("keydown", event => {
    const [dx, dy] = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, 1], ArrowDown: [0, -1] }[event.key] ?? [0, 0];
    if (!dx && !dy) return;
    event.preventDefault();
    event.stopPropagation();
    const step = now.costmap.spacing_m * (event.shiftKey ? 10 : 1);
    change([place[0] + dx * step, place[1] + dy * step]);
    pins.getLayers().find(layer => layer.getElement()?.className.includes(kind))?.getElement().focus();
  });
}

function drawGuide(kind, place) {
  const other = kind === "start" ? now.goal : now.start;
  guide.setLatLngs(other ? [leaf(place), leaf(other)] : []);
}

function place() {
  pins.clearLayers();
  if (now.start) pin("start", now.start, "Start", start => set({ start }));
  now.stops.forEach((stop, k) => pin("stop", stop, `${k + 1}`, moved => set({ stops: now.stops.map((one, i) => (i === k ? moved : one)) })));
  if (now.goal) pin("goal", now.goal, "Goal", goal => set({ goal }));
  hint();
}

/** The question as it is now: its address, and its body. */
export function asked() {
  if (now.stops.length) return ["tours", { stops: [now.start, ...now.stops, ...(now.goal ? [now.goal] : [])], battery: now.battery, avoid: now.avoid }];
  return ["paths", { start: now.start, goal: now.goal, battery: now.battery, planner: now.planner, alternatives: now.alternatives, avoid: now.avoid, ...now.aim }];
}

async function search(signal, snap) {
  const here = `v1/costmaps/${now.costmap.id}`, [kind, body] = asked(), tour = kind === "tours", { rows, cols } = now.costmap.frame;
  if (!tour && rows * cols > MANY_CELLS && now.planner === "astar" && now.aim.objective === "mean") show(await send(`${here}/paths`, { start: now.start, goal: now.goal, refine: false, snap, avoid: now.avoid, ...now.aim }, { signal }), true);
  const answer = await send(`${here}/${kind}`, { ...body, snap }, { signal });
  return { alternatives: [], ...answer, tour, verdict: answer.battery };
}

/** Asks again; the answer before stays on the map until the new one is there. With `snap`, places on blocked ground are moved to the nearest free one. */
export async function askAgain(snap = false) {
  latest.stop();
  if (!now.costmap || !now.start || !(now.goal || now.stops.length)) { show(null); set({ answer: null }); return; }
  try {
    const answer = await latest.run(signal => search(signal, snap));
    if (!answer) return;
    if (snap && !answer.tour) { set({ start: answer.path[0].slice(0, 2), goal: answer.path.at(-1).slice(0, 2) }); return; }
    show(answer);
    set({ answer });
    if (now.roundTrip && !answer.tour) {
      const body = { start: now.start, goal: now.goal, round_trip: true, battery: now.battery, avoid: now.avoid, ...now.aim };
      const both = await latest.run(signal => send(`v1/costmaps/${now.costmap.id}/feasibility`, body, { signal }));
      if (!both) return;
      set({ answer: { ...answer, verdict: both, back: both.back } });
      show(now.answer);
    }
  } catch (error) {
    show(null);
    set({ answer: { error } });
  }
}

function line(path, colour, weight, words, options = {}) {
  const points = path.map(leaf);
  L.polyline(points, { color: "#fff", weight: weight + 3, opacity: 0.9, interactive: false, ...options.halo }).addTo(routes);
  L.polyline(points, { color: colour, weight, lineJoin: "round", dashArray: options.dash, smoothFactor: 0.6 }).bindTooltip(make("span", {}, words), { sticky: true }).addTo(routes);
}

function show(answer, rough = false) {
  const words = route => `${energy(route.energy_j)}, ${metres(route.length_m)}`;
  routes.clearLayers();
  if (now.before) line(now.before.path, COLOURS.before, 3, `before, model ${now.before.model}: ${words(now.before)}`, { dash: "2 7" });
  if (!answer || answer.error) return;
  answer.alternatives.forEach((other, k) => line(other.path, COLOURS.other, 2, `alternative ${k + 1}: ${words(other)}`, { dash: "6 5" }));
  if (answer.shortest) line(answer.shortest.path, COLOURS.shortest, 3.5, `shortest: ${words(answer.shortest)}`);
  if (answer.back) line(answer.back.path, COLOURS.back, 3, `way back: ${words(answer.back)}`, { dash: "1 7" });
  line(answer.path, COLOURS.optimal, 5, `least energy: ${words(answer)}`);
  document.dispatchEvent(new CustomEvent(rough ? "drawn-rough" : "drawn"));
}

on("start goal stops", place);
on("start goal stops costmap planner alternatives roundTrip avoid battery aim", () => askAgain());
on("before", () => show(now.answer));

/** Lines for a picture. */
export function lines() {
  const answer = now.answer;
  if (!answer || answer.error) return [];
  return [...(answer.shortest ? [{ path: answer.shortest.path, colour: COLOURS.shortest, width: 4 }] : []), { path: answer.path, colour: COLOURS.optimal, width: 6 }];
}
