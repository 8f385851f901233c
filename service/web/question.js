// The question: markers of start, goal and stops; a question to the service at each change; its routes on the map.

import { keep } from "./answers.js";
import { send } from "./api.js";
import { by, energy, make, metres, touched } from "./dom.js";
import { inside, leaf, map, seeMap, world } from "./map.js";
import { capacity, draft, now, on, set } from "./state.js";

const routes = L.layerGroup().addTo(map), pins = L.layerGroup().addTo(map);
/** Of each kind of way: its colour, its width, and what is drawn and left out of its dashes. */
export const WAYS = { optimal: ["#0072B2", 5], shortest: ["#D55E00", 3.5], back: ["#b1508a", 3, 1, 7], other: ["#5a6069", 2, 6, 5], before: ["#6d6d6d", 3, 2, 7] };
const MANY_CELLS = 250_000; // of a larger map a route along the grid is shown first, until the better one is there
let wanted = null;

/** What the next click on the map sets: "start", "goal" or "stop"; nothing once both ends are there, until a button asks for one click. */
export const expected = () => wanted ?? (!now.costmap ? null : !now.start ? "start" : !now.goal && !now.stops.length ? "goal" : null);
export function expect(what) {
  wanted = wanted === what ? null : what;
  hint();
  if (wanted) seeMap();
}

export function hint(words) {
  const here = by("hint");
  here.textContent = touched(words ?? by("places").querySelector(`[value=${expected()}]`)?.dataset.says ?? "");
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
  if (takers.some(taker => taker(place, event)) || !now.costmap || !inside(place)) return;
  const what = expected();
  wanted = null;
  if (what) set(what === "stop" ? { stops: [...now.stops, place] } : { [what]: place });
});

function pin(kind, place, label, change) {
  const mark = { start: "S", goal: "G" }[kind] ?? label;
  const icon = L.divIcon({ className: `pin ${kind}`, html: mark, iconSize: [28, 28] });
  const marker = L.marker(leaf(place), { icon, draggable: true, autoPan: true, keyboard: true, alt: label, title: `${label}: drag it, or move it with the arrow keys`, zIndexOffset: 1000 });
  marker.on("dragstart", () => draft("pin", "put the marker down"));
  marker.on("dragend", () => change(world(marker.getLatLng()).map(value => +value.toFixed(3))));
  marker.addTo(pins);
  const node = marker.getElement();
  node.setAttribute("aria-label", `${label} at x ${place[0].toFixed(1)}, y ${place[1].toFixed(1)} metres`);
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

function place() {
  pins.clearLayers();
  draft("pin");
  if (now.start) pin("start", now.start, "Start", start => set({ start }));
  now.stops.forEach((stop, k) => pin("stop", stop, `${k + 1}`, moved => set({ stops: now.stops.map((one, i) => (i === k ? moved : one)) })));
  if (now.goal) pin("goal", now.goal, "Goal", goal => set({ goal }));
  hint();
}

const places = () => JSON.stringify([now.start, now.goal, now.stops]);
/** Moves the places that are on blocked ground now to the nearest free ones. */
export const snap = () => set({ snap: places() });

/** The question as it is now. */
function question() {
  const { costmap, start, goal, stops, inOrder, battery, avoid, planner, alternatives, aim, roundTrip } = now, snap = now.snap === places();
  if (!costmap || !start || !(goal || stops.length)) return null;
  return { costmap: costmap.id, ...(stops.length ? { kind: "tours", body: { stops: [start, ...stops, ...(goal ? [goal] : [])], battery, avoid, snap, in_order: inOrder, one_way: inOrder && !roundTrip } } : { kind: "paths", roundTrip, body: { start, goal, battery, avoid, ...aim, planner, alternatives, snap } }) };
}

/** What a file of an answer is asked with: an address, and a body. */
export const asked = ({ back, question: { kind, body } }) => {
  const { planner, alternatives, ...both } = body;
  return back ? ["feasibility", { ...both, round_trip: true }] : [kind, body];
};

async function search(question, signal, first) {
  const { kind, body, roundTrip } = question, tour = kind === "tours", { frame: { rows, cols }, robot: { speed_mps } } = now.costmap;
  const own = { tour, alternatives: [], full_j: capacity(), speed_mps }, ask = ([kind, body]) => send(`v1/costmaps/${question.costmap}/${kind}`, body, { signal });
  if (!tour && rows * cols > MANY_CELLS && body.planner === "astar" && body.objective === "mean") first({ ...own, ...await ask([kind, { ...body, alternatives: 0, refine: false }]) });
  const [answer, both] = await Promise.all([asked({ question }), ...(roundTrip && !body.snap ? [asked({ question, back: true })] : [])].map(ask));
  if (body.snap && !tour) set({ start: answer.path[0].slice(0, 2), goal: answer.path.at(-1).slice(0, 2), snap: null }); // which is another question
  return { ...own, ...answer, verdict: both ?? answer.battery, back: both?.back };
}

/** The ways of an answer: kind, name and way. */
export const waysOf = found => [["optimal", found.tour ? "tour" : found.objective ? "this way" : "least energy", found], found.shortest && ["shortest", "shortest", found.shortest], found.back && ["back", "way back", found.back], ...found.alternatives.map((other, k) => ["other", `alternative ${k + 1}`, other]), now.before && ["before", `before: ${now.before.words}`, now.before]].filter(Boolean);

/** A question, but for the cost map and the battery. */
const bare = question => question && JSON.stringify({ ...question, costmap: null, body: { ...question.body, battery: null } });
on("any", () => { if (now.before && bare(now.before.question) !== bare(question())) set({ before: null }); });

const drawn = new Map(); // way -> its line

function line(way, kind, words) {
  const points = way.path.map(leaf), [color, weight, ...dash] = WAYS[kind];
  L.polyline(points, { pane: "route", color: "#fff", weight: weight + 3, opacity: 0.9, interactive: false }).addTo(routes);
  drawn.set(way, L.polyline(points, { pane: "route", color, weight, lineJoin: "round", dashArray: dash.join(" "), smoothFactor: 0.6 }).bindTooltip(make("span", {}, `${words}: ${energy(way.energy_j)}, ${metres(way.length_m)}`), { pane: "words", sticky: true }).addTo(routes));
}

/** Draws the line of a way thick, or as it was. */
export const thicken = (way, kind, on) => drawn.get(way)?.setStyle({ weight: WAYS[kind][1] + (on ? 4 : 0) })[on ? "bringToFront" : "redraw"]();

/** The number of an alternative, where it is farthest from the way of least energy. */
function numbered({ path }, words, answer) {
  const far = ([x, y]) => Math.min(...answer.path.map(([a, b]) => Math.hypot(x - a, y - b))), place = path.reduce((best, one) => (far(one) > far(best) ? one : best));
  L.tooltip({ pane: "words", permanent: true, direction: "center", className: "numbered" }).setLatLng(leaf(place)).setContent(words).addTo(routes);
}

function show() {
  const { answer } = now;
  routes.clearLayers();
  drawn.clear();
  if (!answer || answer.error) return;
  for (const [kind, name, way] of waysOf(answer).reverse()) line(way, kind, name);
  answer.alternatives.forEach((other, k) => numbered(other, `${k + 1}`, answer));
  document.dispatchEvent(new CustomEvent(answer.key ? "drawn" : "drawn-rough"));
}

on("start goal stops", place);
keep("answer", question, search, show);
on("before", show);

/** Lines for a picture. */
export function lines() {
  const answer = now.answer;
  if (!answer || answer.error) return [];
  return waysOf(answer).reverse().map(([kind,, { path }]) => ({ path, colour: WAYS[kind][0], width: WAYS[kind][1] + 1 }));
}
