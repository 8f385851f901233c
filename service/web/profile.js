// Height, energy and battery along the route, in three panels with one cursor, which is on the map too.

import { by, draw, fill, joules, make, metres, number, percent } from "./dom.js";
import { leaf, map, world } from "./map.js";
import { now, on, set } from "./state.js";

const TALL = 190, LEFT = 46, RIGHT = 10, GAP = 16, POINTS = 500, NEAR_PX = 14;
const dot = L.circleMarker([0, 0], { radius: 7, color: "#fff", weight: 2.5, fillColor: "#1d2329", fillOpacity: 1, interactive: false });
let rows = [], scales = null;

/** At most so many points of the route: distance, place, energy used, charge left. */
function pointsOf(answer) {
  const { profile } = answer, wh = now.costmap.robot.battery_wh * 3600;
  const [x, y, z] = answer.path[0];
  const step = Math.max(1, Math.ceil(profile.length / POINTS));
  const kept = profile.filter((_, k) => (k + 1) % step === 0 || k === profile.length - 1);
  return [{ d: 0, x, y, z, used: 0 }, ...kept.map(p => ({ d: p.distance_m, x: p.x, y: p.y, z: p.z, used: p.cumulative_j }))].map(p => ({ ...p, charge: now.battery.charge - p.used / wh }));
}

/** The 90 % band of the energy as shares of its mean: errors along a route go together. */
function bandOf(answer) {
  const low = answer.energy_p05_j ?? answer.battery?.energy_p05_j, high = answer.energy_p95_j ?? answer.battery?.energy_p95_j;
  return typeof low === "number" && typeof high === "number" && answer.energy_j > 0 ? [low / answer.energy_j, high / answer.energy_j] : null;
}

function ticks(low, high, most) {
  const raw = (high - low) / most, power = 10 ** Math.floor(Math.log10(raw)), step = [1, 2, 5, 10].map(m => m * power).find(s => s >= raw);
  const found = [];
  for (let value = Math.ceil(low / step) * step; value <= high + step * 1e-6; value += step) found.push(Math.abs(value) < step * 1e-6 ? 0 : value);
  return [found, Math.max(0, -Math.floor(Math.log10(step) + 1e-9))];
}

function panel(name, unit, lowest, highest, left, width, tall) {
  const span = highest - lowest || 1, low = lowest - 0.06 * span, high = highest + 0.08 * span;
  const y = value => 18 + (tall - 40) * (1 - (value - low) / (high - low));
  const x = d => left + LEFT + (width - LEFT - RIGHT) * d / (rows.at(-1).d || 1);
  const parts = [draw("text", { x: left + LEFT, y: 11, class: "axis" }, `${name} [${unit}]`)];
  const [values, digits] = ticks(low, high, 3);
  for (const value of values) {
    parts.push(draw("line", { x1: x(0), x2: x(rows.at(-1).d), y1: y(value), y2: y(value), class: "grid" }), draw("text", { x: left + LEFT - 5, y: y(value) + 4, class: "axis", "text-anchor": "end" }, number(value, digits)));
  }
  const [ways, wayDigits] = ticks(0, rows.at(-1).d || 1, Math.max(2, width / 110));
  for (const d of ways) parts.push(draw("text", { x: x(d), y: tall - 6, class: "axis", "text-anchor": "middle" }, d === ways.at(-1) ? `${number(d, wayDigits)} m` : number(d, wayDigits)));
  return { x, y, parts, left, width };
}

const curve = (values, { x, y }) => values.map(([d, value], k) => `${k ? "L" : "M"}${x(d).toFixed(1)} ${y(value).toFixed(1)}`).join("");
const area = (upper, lower, scale) => `${curve(upper, scale)}L${curve([...lower].reverse(), scale).slice(1)}Z`;

function show() {
  const here = by("profile"), answer = now.answer;
  here.hidden = !answer?.profile?.length;
  if (here.hidden) { dot.remove(); rows = []; return; }
  rows = pointsOf(answer);
  const wide = here.clientWidth - 26, narrow = wide < 640, tall = TALL;
  const shown = narrow ? [["height", 0.5], ["charge", 0.5]] : [["height", 0.36], ["energy", 0.32], ["charge", 0.32]];
  const svg = draw("svg", { viewBox: `0 0 ${wide} ${tall}`, preserveAspectRatio: "none", tabindex: 0, role: "slider", "aria-label": "Place along the route", "aria-valuemin": 0, "aria-valuemax": Math.round(rows.at(-1).d), "aria-valuenow": 0 });
  const band = bandOf(answer), capacity = now.costmap.robot.battery_wh * 3600;
  scales = [];
  let left = 0;
  for (const [kind, share] of shown) {
    const width = share * wide - (left + share * wide < wide - 1 ? GAP : 0);
    if (kind === "height") {
      const heights = rows.filter(row => row.z !== null), values = heights.map(row => row.z);
      const scale = panel("height", "m", Math.min(...values), Math.max(...values), left, width, tall), base = tall - 22;
      const top = heights.map(row => [row.d, row.z]);
      svg.append(...scale.parts, draw("path", { d: `${curve(top, scale)}L${scale.x(rows.at(-1).d)} ${base}L${scale.x(0)} ${base}Z`, class: "fill" }), draw("path", { d: curve(top, scale), class: "curve height" }));
      scales.push(scale);
    } else {
      const energy = kind === "energy", of = factor => rows.map(row => [row.d, energy ? row.used * factor / 1000 : 100 * (now.battery.charge - row.used * factor / capacity)]);
      const all = [...of(1), ...(band ? [...of(band[0]), ...of(band[1])] : [])].map(([, value]) => value);
      const floor = energy ? 0 : Math.min(100 * now.battery.reserve, ...all);
      const scale = panel(energy ? "energy used" : "battery", energy ? "kJ" : "%", Math.min(floor, ...all), Math.max(...all), left, width, tall);
      svg.append(...scale.parts);
      if (band) svg.append(draw("path", { d: area(of(band[1]), of(band[0]), scale), class: "band" }));
      if (!energy) {
        const level = scale.y(100 * now.battery.reserve);
        svg.append(draw("line", { x1: scale.x(0), x2: scale.x(rows.at(-1).d), y1: level, y2: level, class: "reserve" }), draw("text", { x: scale.x(rows.at(-1).d), y: level - 4, class: "axis", "text-anchor": "end" }, "reserve"));
      }
      svg.append(draw("path", { d: curve(of(1), scale), class: "curve" }));
      scales.push(scale);
    }
    left += share * wide;
  }
  svg.append(draw("g", { id: "cursors" }));
  svg.addEventListener("pointermove", event => {
    const box = svg.getBoundingClientRect(), at = (event.clientX - box.left) * wide / box.width;
    const scale = scales.find(one => at >= one.left && at <= one.left + one.width);
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
  fill(here, make("p", { class: "said", id: "along" }), svg);
  summary();
  cursor();
}

const point = d => set({ cursor: d === null ? null : Math.max(0, Math.min(rows.at(-1).d, d)) });

function summary() {
  const { answer } = now, band = bandOf(answer);
  fill(by("along"), make("b", {}, "Along the route"), `${metres(answer.length_m)}, ${joules(answer.energy_j)}`, make("span", { class: "quiet" }, band ? "shaded: 90 % of such drives" : "move over the curves to see where on the map"));
}

function cursor() {
  const marks = by("cursors");
  if (!marks || !rows.length) return;
  if (now.cursor === null) { marks.replaceChildren(); dot.remove(); summary(); return; }
  const row = rows.reduce((best, one) => (Math.abs(one.d - now.cursor) < Math.abs(best.d - now.cursor) ? one : best));
  fill(marks, scales.map(({ x }) => draw("line", { x1: x(row.d), x2: x(row.d), y1: 16, y2: TALL - 20, class: "cursor" })));
  dot.setLatLng(leaf([row.x, row.y])).addTo(map);
  const words = [`${metres(row.d)}`, row.z === null ? "height unknown" : `height ${number(row.z, 1)} m`, `${joules(row.used)} used`, `battery ${percent(row.charge, 1)}`];
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
on("answer", show);
on("cursor", cursor);
new ResizeObserver(() => requestAnimationFrame(show)).observe(by("stage"));
