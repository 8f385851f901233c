// The loop: send measured runs, see what was read of them, calibrate the model, compare before and after.

import { ask, send } from "./api.js";
import { alarm, attempt, button, by, errorNote, fill, energy, h2, h3, make, metres, note, number, patch, percent, row, table, time, warn } from "./dom.js";
import { dropZone } from "./ground.js";
import * as columns from "./columns.js";
import { watched } from "./controls.js";
import { build, sentRobot } from "./map_panel.js";
import * as measured from "./measured.js";
import { leaf, map } from "./map.js";
import { routeButtons } from "./save_panel.js";
import { now, on } from "./state.js";

const drawn = L.layerGroup().addTo(map);
const BEFORE = "#6d6d6d", AFTER = "#00634a", DRIVE = "#5b2a86"; // the way of the question stays blue

export function show() {
  drawn.clearLayers();
  for (const name of ["sent", "calibrating", "found"]) fill(by(name));
  if (!now.costmap) return;
  listRuns();
  listCalibrations();
}
dropZone(by("runs-files"), files => upload(files));

const words = key => (key === "held_fixes" ? "repeated positions" : key.replaceAll("_", " "));
const counted = counts => Object.entries(counts).map(([reason, count]) => `${words(reason)}: ${number(count, 0)}`).join(", ") || "nothing";

async function upload(files, mapping = []) {
  const here = by("sent"), form = new FormData(), query = new URLSearchParams({ heightmap_id: now.costmap.heightmap_id });
  fill(here, make("p", {}, `Reading ${files.length} file${files.length > 1 ? "s" : ""}…`), make("progress", { "aria-label": "Reading the runs" }));
  for (const file of files) form.append("file", file, file.name);
  for (const entry of mapping) query.append("map", entry);
  try {
    const sent = await ask(`v1/runs?${query}`, { method: "POST", body: form });
    fill(here, h3("What was read"), readOf(sent), sent.runs.flatMap(run => run.warnings).map(one => warn(one)));
    listRuns(sent.id);
  } catch (error) {
    const naming = error.status === 422 ? await columns.form(files, mapping => upload(files, mapping), error.context.reading) : null;
    fill(here, naming ? alarm(error.message.replace(/; a mapping says.*/, ".")) : errorNote(error), naming, /do not belong together/.test(error.message) ? note("Open the cost map of the ground where they were driven, or send its heightmap: New map.") : null);
  }
}

const readOf = ({ runs }) => runs.map(run => make("div", {}, make("p", { class: "note" }, make("b", {}, run.name), ` ${metres(run.metres)} in ${number(run.segments, 0)} segments${run.energy_j === null ? "" : `, ${energy(run.energy_j)}`}; repaired: ${counted(run.repairs)}; left out: ${counted(run.left_out)}`), preview(run)));

/** The first rows as they were understood, and where each column is from. */
function preview({ name, first_rows: rows, reading, confidence }) {
  const keys = Object.keys(rows), from = key => `${reading[key] ?? key}${confidence[key] < 0.9 ? `, ${percent(confidence[key])} sure` : ""}`;
  if (!keys.length) return null;
  const cells = rows[keys[0]].map((_, k) => keys.map(key => (rows[key][k] === null ? "" : `${+rows[key][k].toPrecision(9)}`)));
  return make("details", {}, make("summary", {}, "First rows as understood"), table([keys, ...cells], `First rows of ${name}`), note(keys.map(key => `${key}: ${from(key)}`).join("; ")));
}

async function listRuns(chosen) {
  const here = by("runs-list");
  await attempt(here, async () => {
    const { items } = await ask("v1/runs?limit=100");
    if (!items.length) { fill(here, note("No runs are kept yet.")); return; }
    const boxes = items.filter(one => one.runs).map(one => [one, make("input", { type: "checkbox", checked: one.id === chosen || (!chosen && one === items[0]) })]);
    const quick = make("input", { type: "checkbox", id: "quick" });
    fill(here, make("details", { open: true }, make("summary", {}, "Learn from"),
      boxes.map(([one, box]) => make("label", { class: "check" }, box, `${one.runs.map(run => run.name).slice(0, 3).join(", ")}${one.runs.length > 3 ? `, and ${one.runs.length - 3} more` : ""} (${number(one.runs.reduce((sum, run) => sum + run.segments, 0), 0)} segments)`)),
      make("label", { class: "check" }, quick, "Quick: does not leave each run out in turn; sooner, but the errors shown are too small"),
      row(button({ class: "main", id: "calibrate", onclick: () => calibrate(boxes.filter(([, box]) => box.checked).map(([one]) => one.id), quick.checked) }, "Calibrate the model"))));
  });
}

const baseModel = () => (now.costmap.model.startsWith("cal-") ? now.costmap.provenance?.model?.base?.name ?? "default" : now.costmap.model);

async function calibrate(runs, quick) {
  const said = by("calibrating");
  if (!runs.length) { fill(said, alarm("Choose at least one set of runs.")); return; }
  const ends = now.start && now.goal ? { start: now.start, goal: now.goal } : {};
  fill(said, note("Asking…"));
  await attempt(said, async () => {
    await watch(await send("v1/calibrations", { heightmap_id: now.costmap.heightmap_id, runs, model: baseModel(), robot: sentRobot(now.costmap.robot), quick, ...ends }));
  });
}

async function watch(calibration) {
  const made = await watched(by("calibrating"), `v1/calibrations/${calibration.id}`, "Calibration");
  listCalibrations();
  if (made.status === "done") { await open(made); by("found").scrollIntoView(); }
}

async function listCalibrations() {
  const here = by("calibrations");
  await attempt(here, async () => {
    const { items } = await ask("v1/calibrations?limit=100"), mine = items.filter(one => one.heightmap_id === now.costmap?.heightmap_id);
    if (!mine.length) { fill(here, note("None on this ground yet.")); return; }
    fill(here, mine.map(one => row(button({ onclick: async () => (one.status === "done" ? open(await ask(`v1/calibrations/${one.id}`)) : watch(one)), disabled: ["failed", "cancelled"].includes(one.status) }, `${one.found ? one.found.join(", ") || "Nothing missing" : time(one.created_at)}, from model ${one.model}`), make("span", { class: "quiet" }, one.status === "failed" ? one.problem.detail : one.status === "done" ? time(one.created_at) : one.status))));
  });
}

const STATES = { before: "model before", corrected: "with its constants fitted", after: "calibrated", after_planner: "calibrated, known before a drive" };
const interval = ({ value, ci95, unit, name }, alone) => `${alone ? "" : `${words(name)} `}${+value.toPrecision(3)} ${unit} (95 %: ${ci95.map(end => +end.toPrecision(3)).join(" to ")})`;
const sure = p => (p < 0.001 ? "p < 0.001" : `p = ${p.toPrecision(2)}`);

const swatch = colour => patch(colour, "swatch");

const line = (points, words, style) => L.polyline(points.map(leaf), { pane: "runs", ...style }).bindTooltip(make("span", {}, words), { sticky: true }).addTo(drawn);

/** What a calibration found, and what to do with it. */
async function open(made) {
  const report = made.report, unit = report.target === "charge_as" ? "A s" : "J", route = report.route?.before ? report.route : null, drive = report.next_drive?.points ? report.next_drive : null;
  const advice = report.confirmed === false ? "Not confirmed" : report.confirmed_in_plans === false ? "Not confirmed for plans" : "";
  drawn.clearLayers();
  fill(by("found"),
    h2(report.effects.length ? `Found: ${report.effects.map(one => one.label).join(", ")}` : "No missing effect was found"),
    advice ? warn(`${advice}: keep the model that you have.`) : null,
    report.effects.map(one => make("div", { class: "verdict likely" }, make("b", {}, one.label), one.meaning, make("br"), one.form === "curve" ? "" : one.coefficients.map(each => interval(each, one.coefficients.length === 1)).join("; "), ` · ${sure(one.p_value)} · explains ${percent(one.share_of_residual_variance)} of what the model missed`)),
    h3("Error per metre"),
    table([["", "mean relative", `RMSE [${unit}/m]`], ...Object.entries(STATES).filter(([state]) => report.error[state]).map(([state, name]) => [name, percent(report.error[state].mean_relative, 1), number(report.error[state].rmse, 1)])], "Error before and after"),
    report.validation.whole_procedure ? null : warn("Quick: these are errors of the fit. On new runs they are larger."),
    note(`${number(report.segments.fit, 0)} segments; left out: ${counted(report.runs.left_out)}`),
    report.confounded.map(([name, ...rivals]) => warn(`These runs cannot distinguish ${words(name)} from ${rivals.map(words).join(", ")}.`)),
    make("div", { class: "row" },
      made.calibrated_model && !advice ? button({ class: "main", id: "use-model", onclick: () => again(made.calibrated_model) }, "Cost map with this model") : null,
      make("a", { class: "button", href: `v1/calibrations/${made.id}/report.html`, target: "_blank", rel: "noopener" }, "Whole report")),
    route ? make("div", {}, h3("What changes on a route"), make("p", {}, `By the calibrated model the way before costs ${energy(route.before.energy_j)} over ${metres(route.before.length_m)}; the new way costs ${energy(route.after.energy_j)} over ${metres(route.after.length_m)}.`)) : null,
    drive ? make("div", {}, h3("What to drive next"), make("p", {}, `${drive.kind}, ${metres(drive.total_length_m)} in all, at ${drive.speeds_mps.map(speed => number(speed, 2)).join(" and ")} m/s: it measures ${drive.label} more precisely${drive.expected_interval_share ? `; its interval shrinks to ${percent(drive.expected_interval_share)}` : ""}.`), drive.placed ? routeButtons("next-drive", format => [`v1/calibrations/${made.id}/next-drive?format=${format}`]) : null) : null,
    route || drive?.placed ? note("On the map: ", route ? [swatch(BEFORE), "before ", swatch(AFTER), "after "] : "", drive?.placed ? [swatch(DRIVE), "next drive"] : "") : null,
    make("div", { id: "measured" }));
  if (route) {
    line(route.before.path, "before", { color: BEFORE, weight: 4, dashArray: "2 7" });
    line(route.after.path, "after", { color: AFTER, weight: 3 });
  }
  if (drive?.placed) line(drive.points, `next drive: ${drive.kind}`, { color: DRIVE, weight: 3, dashArray: "1 6" });
  await measured.show(by("measured"), made, drawn);
}

/** The same map by the calibrated model. */
function again(model) {
  by("tab-map").click();
  build({ heightmap_id: now.costmap.heightmap_id, robot: sentRobot(now.costmap.robot), model, spacing_m: now.costmap.spacing_m, headings: now.costmap.headings });
}

on("costmap", show);
