// The panel "Drives": drives over this map, one of them watched: where the robot is, its battery, why it takes more, alarms.

import { ask, follow, Latest, send } from "./api.js";
import { attempt, button, by, draw, errorNote, fill, make, metres, note, patch, row, table, time, warn } from "./dom.js";
import { dropZone } from "./ground.js";
import { leaf, map } from "./map.js";
import { area, axes, curve } from "./profile.js";
import { TITLES } from "./route_panel.js";
import { now, on, set } from "./state.js";

const LIST_MS = 5000; // between two looks at the list while a drive is watched
let listed = 0;
const layer = L.layerGroup().addTo(map), watching = new Latest(), asking = new Latest(), replaying = new Latest();
const PLANNED = "#0072B2", DRIVEN = "#1d2329", ALARM = "#b3261e", TALL = 210;

const arrived = ({ left_m: left }) => left < 0.05; // which is written as 0.0 m

/** The drives over this map, newest first. */
async function list() {
  const here = by("drives-list");
  listed = performance.now();
  await attempt(here, async () => {
    const { items } = await ask(`v1/drives?limit=100&costmap_id=${now.costmap.id}`);
    const words = ({ forecast }) => (arrived(forecast) ? "arrived" : `${metres(forecast.at_m)} of ${metres(forecast.at_m + forecast.left_m)}`);
    const one = drive => button({ class: "plain", "aria-pressed": String(now.drive === drive.id), onclick: () => set({ drive: drive.id }) }, time(drive.created_at));
    fill(here, items.length ? table([["begun", "driven", "does it last?"], ...items.map(drive => [one(drive), words(drive), TITLES[drive.forecast.verdict]])], "Drives over this map") : note("None yet. A robot begins one over HTTP: ", make("code", {}, `POST v1/costmaps/${now.costmap.id}/drives`), "."));
  });
}

/** Follows the chosen drive until it is deleted, or another one is chosen. */
async function watch() {
  layer.clearLayers();
  asking.stop();
  fill(by("drive"));
  if (!now.drive || !now.costmap) { watching.stop(); return; }
  const { drive } = now, parts = { verdict: make("b", { role: "status" }), words: make("ul"), alarms: make("div", { role: "status" }), curve: make("div", { id: "drive-curve" }) };
  const box = make("div", { class: "verdict" }, parts.verdict, parts.words);
  fill(by("drive"), box, parts.alarms, parts.curve, row(button({ onclick: () => remove(drive) }, "Delete this drive")));
  list();
  const said = (node, words) => { if (node.textContent !== words) node.textContent = words; }; // else a screen reader says it again and again
  try {
    await watching.run(signal => follow(`v1/drives/${drive}/events`, state => {
      if (!state.forecast) return;
      const { forecast } = state;
      if (performance.now() > listed + LIST_MS) list();
      box.className = `verdict ${forecast.verdict}`;
      said(parts.verdict, arrived(forecast) ? "The robot has arrived" : TITLES[forecast.verdict]);
      fill(parts.words, sentences(forecast).map(words => make("li", {}, words)));
      if (parts.alarms.childElementCount !== forecast.alarms.length) fill(parts.alarms, forecast.alarms.map(({ text }) => warn(text)));
      asking.run(stop => ask(`v1/drives/${drive}/charge`, { signal: stop })).then(found => { if (found) { chart(parts.curve, found); place(found, forecast.alarms); } }, error => fill(parts.curve, errorNote(error)));
    }, signal, "deleted"));
    if (now.drive === drive) set({ drive: null });
  } catch (error) { fill(by("drive"), errorNote(error)); }
}

/** What the service says, without its alarms, in the lines of a list. */
const sentences = ({ text, alarms, at_m: at, left_m: left }) => [`${metres(at, at + left)} of ${metres(at + left)} driven`, ...alarms.reduce((words, alarm) => words.replace(alarm.text, ""), text).trim().replace(/\.$/, "").split(/; |\. |(?<=\)), /)];

async function remove(drive) {
  await attempt(by("drive"), () => ask(`v1/drives/${drive}`, { method: "DELETE" }));
  set({ drive: null });
}

/** Battery along the route: as planned, as it was, and what is expected with its 90 % band. */
function chart(here, { at_m: at, reserve, places }) {
  const wide = Math.max(here.clientWidth, 240), far = places.at(-1).distance_m, of = (name, some = places) => some.map(one => [one.distance_m, 100 * one[name]]);
  const behind = places.filter(one => one.distance_m <= at), ahead = places.filter(one => one.distance_m >= at), all = ["planned", "low", "high"].flatMap(name => of(name).map(([, value]) => value));
  const most = Math.max(...all), least = Math.min(...all), floor = 100 * reserve, near = least - floor < 2 * (most - least); // else the line of the reserve would leave no room for the curves
  const scale = axes("battery", "%", near ? Math.min(floor, least) : least, most, { left: 0, top: 0, width: wide, tall: TALL }, far), { x, y } = scale, now100 = behind.at(-1).charge * 100;
  fill(here, draw("svg", { viewBox: `0 0 ${wide} ${TALL}`, height: TALL, width: "100%", role: "img", "aria-label": `Battery along the route: ${now100.toFixed(0)} % now, ${(100 * places.at(-1).charge).toFixed(0)} % expected at the end` },
    ...scale.parts, draw("path", { d: area(of("high", ahead), of("low", ahead), scale), class: "band" }),
    ...(near ? [draw("line", { x1: x(0), x2: x(far), y1: y(floor), y2: y(floor), class: "reserve" }), draw("text", { x: x(0) + 4, y: y(floor) - 4, class: "axis" }, "reserve")] : []),
    draw("path", { d: curve(of("planned"), scale), class: "curve height", "stroke-dasharray": "2 4" }), draw("path", { d: curve(of("charge", ahead), scale), class: "curve" }),
    draw("path", { d: curve(of("charge", behind), scale), class: "curve driven" }), draw("circle", { cx: x(at), cy: y(now100), r: 5, class: "driven" })),
  note(patch("", "swatch"), "measured ", patch("", "swatch optimal"), "expected, shaded: 90 % of such drives ", patch("", "swatch planned"), "as planned"));
}

/** The robot, what it drove, the rest of its route, and where something changed. */
function place({ at_m: at, position, places }, alarms) {
  const fresh = !layer.getLayers().length, behind = places.filter(one => one.distance_m <= at), ahead = places.filter(one => one.distance_m >= at), line = (some, color, weight, dashArray) => L.polyline(some.map(({ x, y }) => leaf([x, y])), { pane: "drives", color, weight, dashArray, interactive: false }).addTo(layer);
  layer.clearLayers();
  line(places, "#fff", 8);
  line(ahead, PLANNED, 5, "1 9");
  line(behind, DRIVEN, 5);
  const circle = (where, radius, fillColor, words) => L.circleMarker(leaf(where), { pane: "drives", radius, color: "#fff", weight: 2.5, fillColor, fillOpacity: 1 }).bindTooltip(words).addTo(layer);
  for (const { since_m: since, text } of alarms) {
    const nearest = places.reduce((best, one) => (Math.abs(one.distance_m - since) < Math.abs(best.distance_m - since) ? one : best));
    circle([nearest.x, nearest.y], 6, ALARM, text);
  }
  const { x, y } = behind.at(-1), robot = position ?? [x, y];
  circle(robot, 10, "#0a7a4b", `the robot: ${metres(at)} driven`).getElement().setAttribute("id", "robot-now");
  if (fresh && now.drive) map.fitBounds(L.latLngBounds(places.map(one => leaf([one.x, one.y]))), { padding: [40, 40], maxZoom: 4 });
}

const SENT_MS = 500, NAMES = { t: /^(t|time|time_s)$/i, x: /^(x|x_m|east)$/i, y: /^(y|y_m|north)$/i, power: /^(power|power_w)$/i, voltage: /^(voltage|voltage_v)$/i, current: /^(current|current_a)$/i };

/** The samples of a table of text with time, place, and power or voltage and current. */
function samplesOf(text) {
  const [head, ...lines] = text.split(/\r?\n/).filter(line => line.trim() && !line.startsWith("#")), names = head.split(/[,;\t]/).map(name => name.trim());
  const at = Object.fromEntries(Object.entries(NAMES).map(([name, known]) => [name, names.findIndex(one => known.test(one))]));
  const missing = ["t", "x", "y"].filter(name => at[name] < 0), power = at.power >= 0 ? cells => cells[at.power] : cells => cells[at.voltage] * cells[at.current];
  if (missing.length || (at.power < 0 && (at.voltage < 0 || at.current < 0))) throw new Error(`The columns are ${names.join(", ")}; a replay needs t, x, y, and power or voltage and current.`);
  const found = lines.map(line => line.split(/[,;\t]/).map(cell => (cell.trim() ? +cell : NaN))).map(cells => ({ time_s: cells[at.t], position: [cells[at.x], cells[at.y]], power_w: power(cells) }));
  return found.filter(one => [one.time_s, ...one.position, one.power_w].every(Number.isFinite)).sort((a, b) => a.time_s - b.time_s);
}

/** Sends a log as if the robot were driving now, along the way that it drove. */
async function replay(file) {
  const said = by("replay-said"), speed = Math.max(1, +by("replay-speed").value || 1);
  await attempt(said, () => replaying.run(async signal => {
    const samples = samplesOf(await file.text()), path = samples.map(one => one.position).reduce((kept, [x, y]) => (kept.length && Math.hypot(x - kept.at(-1)[0], y - kept.at(-1)[1]) < 1 ? kept : [...kept, [x, y]]), []);
    const { id } = await send(`v1/costmaps/${now.costmap.id}/drives`, { path, battery: now.battery }, { signal });
    set({ drive: id });
    for (let sent = 0, began = performance.now(); sent < samples.length;) {
      await new Promise(done => setTimeout(done, SENT_MS));
      if (signal.aborted) return;
      const until = samples[0].time_s + speed * (performance.now() - began) / 1000, due = samples.slice(sent, sent + 500).filter(one => one.time_s <= until);
      if (due.length) await send(`v1/drives/${id}/updates`, { samples: due }, { signal });
      sent += due.length;
      fill(said, sent < samples.length ? row(note(`${sent} of ${samples.length} samples sent`), button({ onclick: () => { replaying.stop(); fill(said, note("Stopped.")); } }, "Stop")) : note("All of the log is sent."));
    }
    list();
  }));
}

dropZone(by("replay-file"), ([file]) => replay(file));
by("drives-again").onclick = list;
on("costmap", () => { replaying.stop(); fill(by("replay-said")); if (now.costmap) list(); });
on("drive costmap", watch);
