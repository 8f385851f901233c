// Height, energy and battery along the route, in three panels with one cursor, which is on the map too.

import { by, draw, energy, fill, make, metres, number, percent } from "./dom.js";
import { leaf, map, world } from "./map.js";
import { now, on, set } from "./state.js";

const TALL = 190, LOW = 104, LEFT = 46, RIGHT = 24, GAP = 16, POINTS = 500, NEAR_PX = 14;
const dot = L.circleMarker([0, 0], { pane: "route", radius: 7, color: "#fff", weight: 2.5, fillColor: "#1d2329", fillOpacity: 1, interactive: false });
let rows = [], scales = null;

/** At most so many points of the route: distance, place, energy used and the ends of its 90 % band, charge left. */
function pointsOf({ profile, path: [[x, y, z]], full_j: full, question: { body: { battery } } }) {
  const step = Math.max(1, Math.ceil(profile.length / POINTS));
  const kept = profile.filter((_, k) => (k + 1) % step === 0 || k === profile.length - 1);
  return [{ d: 0, x, y, z, used: 0, low: 0, high: 0 }, ...kept.map(p => ({ d: p.distance_m, x: p.x, y: p.y, z: p.z, used: p.cumulative_j, low: p.cumulative_p05_j, high: p.cumulative_p95_j }))].map(p => ({ ...p, charge: battery.charge - p.used / full }));
}

/** Whether the model knows its uncertainty. */
const banded = () => Number.isFinite(rows.at(-1)?.high);

/** Round numbers of a range, at most so many (five or more) and at least two, and their decimals. */
function ticks(low, high, most) {
  const power = 10 ** Math.floor(Math.log10(high - low)), first = step => Math.ceil(low / step - 1e-6), count = step => Math.floor(high / step + 1e-6) - first(step) + 1;
  const step = [0.1, 0.2, 0.5, 1, 2].map(share => share * power).find(one => count(one) <= most);
  return [Array.from({ length: count(step) }, (_, k) => (first(step) + k) * step), Math.max(0, -Math.floor(Math.log10(step) + 1e-9))];
}

/** Axes of a panel, and the scales of its place: x for distances up to `far`, y for values. */
export function axes(name, unit, lowest, highest, { left, top, width, tall }, far = rows.at(-1).d) {
  const finest = 5 * 10 ** (Math.floor(Math.log10(Math.max(Math.abs(lowest), Math.abs(highest)) || 1)) - 4); // longer numbers would be cut off
  const span = highest > lowest ? Math.max(highest - lowest, finest) : 1, low = lowest - 0.06 * span, high = lowest + 1.08 * span, bottom = top + tall - 22;
  const y = value => top + 18 + (tall - 40) * (1 - (value - low) / (high - low));
  const x = d => left + LEFT + (width - LEFT - RIGHT) * d / (far || 1);
  const parts = [draw("text", { x: left + LEFT, y: top + 11, class: "axis" }, `${name} [${unit}]`)];
  const [values, digits] = ticks(low, high, 5);
  for (const value of values) {
    parts.push(draw("line", { x1: x(0), x2: x(far), y1: y(value), y2: y(value), class: "grid" }), draw("text", { x: left + LEFT - 5, y: y(value) + 4, class: "axis", "text-anchor": "end" }, number(value, digits)));
  }
  const [ways, wayDigits] = ticks(0, far || 1, Math.max(5, width / 70));
  for (const d of ways) parts.push(draw("text", { x: x(d), y: top + tall - 6, class: "axis", "text-anchor": "middle" }, `${number(d, wayDigits)}${d === ways.at(-1) ? " m" : ""}`));
  return { x, y, parts, left, top, width, bottom };
}

export const curve = (values, { x, y }) => values.map(([d, value], k) => `${k ? "L" : "M"}${x(d).toFixed(1)} ${y(value).toFixed(1)}`).join("");
export const area = (upper, lower, scale) => `${curve(upper, scale)}L${curve([...lower].reverse(), scale).slice(1)}Z`;

function show() {
  const here = by("profile"), curves = by("curves"), answer = now.answer, empty = !answer?.profile?.length;
  here.hidden = !now.costmap;
  here.classList.toggle("empty", empty);
  const wide = Math.max(here.clientWidth - 26, 240), narrow = wide < 640, tall = narrow ? 3 * LOW : TALL;
  if (empty) { // of the same height, so that the map does not move when a route comes
    dot.remove();
    rows = [];
    fill(curves, make("p", { class: "said quiet" }, "The curves along the route come here."), draw("svg", { height: tall }));
    return;
  }
  rows = pointsOf(answer);
  const { charge, reserve } = answer.question.body.battery;
  const places = [0.36, 0.32, 0.32].map((share, k) => (narrow ? { left: 0, top: k * LOW, width: wide, tall: LOW } : { left: k ? (0.04 + 0.32 * k) * wide : 0, top: 0, width: share * wide - (k < 2 ? GAP : 0), tall: TALL }));
  const svg = draw("svg", { viewBox: `0 0 ${wide} ${tall}`, height: tall, preserveAspectRatio: "none", tabindex: 0, role: "slider", "aria-label": "Place along the route", "aria-valuemin": 0, "aria-valuemax": Math.round(rows.at(-1).d), "aria-valuenow": 0 });
  const heights = rows.filter(row => row.z !== null).map(row => [row.d, row.z]), all = heights.map(([, z]) => z);
  const ground = axes("height", "m", Math.min(...all), Math.max(...all), places[0]);
  svg.append(...ground.parts, draw("path", { d: `${curve(heights, ground)}L${ground.x(rows.at(-1).d)} ${ground.bottom}L${ground.x(0)} ${ground.bottom}Z`, class: "fill" }), draw("path", { d: curve(heights, ground), class: "curve height" }));
  const kinds = [["energy used", "Wh", j => j / 3600, 0], ["battery", "%", j => 100 * (charge - j / answer.full_j), 100 * reserve]];
  scales = [ground, ...kinds.map(([name, unit, value, floor], k) => {
    const of = key => rows.map(row => [row.d, value(row[key])]), band = banded() ? [of("high"), of("low")] : [];
    const seen = [of("used"), ...band].flat().map(([, one]) => one), scale = axes(name, unit, Math.min(floor, ...seen), Math.max(...seen), places[k + 1]);
    svg.append(...scale.parts, ...(band.length ? [draw("path", { d: area(...band, scale), class: "band" })] : []));
    if (k) {
      const level = scale.y(floor);
      svg.append(draw("line", { x1: scale.x(0), x2: scale.x(rows.at(-1).d), y1: level, y2: level, class: "reserve" }), draw("text", { x: scale.x(rows.at(-1).d), y: level - 4, class: "axis", "text-anchor": "end" }, "reserve"));
    }
    svg.append(draw("path", { d: curve(of("used"), scale), class: "curve" }));
    return scale;
  })];
  svg.append(draw("g", { id: "cursors" }));
  svg.addEventListener("pointermove", event => {
    const box = svg.getBoundingClientRect(), at = (event.clientX - box.left) * wide / box.width, scale = scales.find(one => at >= one.left && at <= one.left + one.width);
    if (scale) point((at - scale.x(0)) / (scale.x(rows.at(-1).d) - scale.x(0)) * rows.at(-1).d);
  });
  svg.addEventListener("pointerleave", () => point(null));
  svg.addEventListener("keydown", event => {
    const step = { ArrowRight: 1, ArrowUp: 1, ArrowLeft: -1, ArrowDown: -1, PageUp: 10, PageDown: -10 }[event.key];
    const end = { Home: 0, End: rows.at(-1).d }[event.key];
    if (step === undefined && end === undefined) return;
    event.preventDefault();
    point(end ?? Math.max(0, Math.min(rows.at(-1).d, (now.cursor ?? 0) + step * rows.at(-1).d / 100)));
  });
  fill(curves, make("p", { class: "said", id: "along" }), svg);
  summary();
  cursor();
}

const point = d => set({ cursor: d === null ? null : Math.max(0, Math.min(rows.at(-1).d, d)) });

function summary() {
  const { answer } = now;
  fill(by("along"), make("b", {}, "Along the route"), `${metres(answer.length_m)}, ${energy(answer.energy_j)}${answer.back ? ", way out" : ""}`, banded() ? make("span", { class: "quiet" }, "shaded: 90 % of such drives") : null);
}

function cursor() {
  const marks = by("cursors");
  if (!marks || !rows.length) return;
  if (now.cursor === null) { marks.replaceChildren(); dot.remove(); summary(); return; }
  const row = rows.reduce((best, one) => (Math.abs(one.d - now.cursor) < Math.abs(best.d - now.cursor) ? one : best));
  fill(marks, scales.map(({ x, top, bottom }) => draw("line", { x1: x(row.d), x2: x(row.d), y1: top + 16, y2: bottom + 2, class: "cursor" })));
  dot.setLatLng(leaf([row.x, row.y])).addTo(map);
  const full = rows.at(-1).used, words = [metres(row.d, rows.at(-1).d), row.z === null ? "height unknown" : `height ${number(row.z, 1)} m`, `${energy(row.used, full)} used${banded() && row.d ? ` (90 %: ${energy(row.low, full)} to ${energy(row.high, full)})` : ""}`, `battery ${percent(row.charge, 1)}`];
  fill(by("along"), words.map(text => make("span", {}, text)));
  const svg = by("profile").querySelector("svg");
  svg.setAttribute("aria-valuenow", Math.round(row.d));
  svg.setAttribute("aria-valuetext", words.join(", "));
}

map.on("mousemove", ({ latlng, containerPoint }) => {
  if (!rows.length) return;
  const [x, y] = world(latlng);
  const near = rows.reduce((best, row) => { const far = Math.hypot(row.x - x, row.y - y); return far < best.far ? { far, d: row.d } : best; }, { far: Infinity });
  const onRoute = near.far * 2 ** map.getZoom() < NEAR_PX && containerPoint;
  if (onRoute) point(near.d);
  else if (now.cursor !== null) point(null);
});
on("answer costmap", show);
on("cursor", cursor);
new ResizeObserver(() => requestAnimationFrame(show)).observe(by("map"));
