// When the columns of a log have other names: say which is which, and in which unit.

import { alarm, button, fill, h3, live, make, row, select, table } from "./dom.js";

const SHOWN = 5; // rows
/** What a run needs, how a column of it is often called, and the units that it may be in. */
const LENGTHS = ["m", "cm", "mm", "km", "ft"], ANGLES = ["deg", "rad", "degE7"];
const NEEDED = {
  t: ["Time (needed)", /^(t$|time|stamp|sec)/i, ["s", "ms", "us", "ns", "min", "h"]], x: ["x, east", /^(x|east)/i, LENGTHS], y: ["y, north", /^(y|north)/i, LENGTHS],
  lat: ["or latitude", /lat/i, ANGLES], lon: ["and longitude", /lon|lng/i, ANGLES],
  voltage: ["Voltage", /volt|^u$|^v$|v_?bat/i, ["V", "mV", "cV", "dV"]], current: ["Current (or power: needed)", /curr|amp|^i$|i_?bat/i, ["A", "mA", "cA", "dA"]], power: ["or power", /watt|power/i, ["W", "kW", "mW"]],
};

/** The header of a file and its first rows, as cells. */
async function headOf(file) {
  const lines = (await file.slice(0, 65536).text()).split(/\r?\n/).filter(line => line.trim() && !line.startsWith("#")).slice(0, 1 + SHOWN), head = lines[0] ?? "";
  const mark = [",", ";", "\t"].reduce((best, one) => (head.split(one).length > head.split(best).length ? one : best));
  return lines.map(line => line.split(mark).map(cell => cell.trim().replace(/^"|"$/g, "")));
}

/** A form to name the columns, or nothing where the files are no tables of text; `send` is called with the mapping. `reading`: what was recognised. */
export async function form(files, send, reading = {}) {
  if (!files.every(file => /\.(csv|txt|tsv|log)$/i.test(file.name))) return null;
  const head = await headOf(files[0]), names = head[0] ?? [];
  if (names.length < 3 || ["t", "x", "y", "voltage", "current"].every(name => names.includes(name))) return null;
  const choices = Object.entries(NEEDED).map(([name, [label, likely, units]]) => {
    const minus = reading[name]?.startsWith("-"), read = reading[name]?.slice(minus ? 1 : 0), known = names.filter(one => one && read?.startsWith(one)).sort((a, b) => b.length - a.length)[0];
    const guess = known ?? (names.includes(name) ? name : names.find(one => likely.test(one)));
    const list = select([["", "not logged"], ...names.map(one => [one, one])], guess, () => {}, { "aria-label": label });
    const unit = select([["", "auto"], ...units.map(one => [`:${one}`, one])], "", () => {}, { "aria-label": `unit of ${label}` });
    const sign = name === "current" || name === "power" ? select([["", "+ draws"], ["-", "− draws"]], minus ? "-" : "", () => {}, { "aria-label": `sign of ${label}` }) : null;
    return { name, label, list, unit, sign };
  });
  const said = live();
  const go = () => {
    const chosen = choices.filter(({ list }) => list.value), twice = chosen.find(({ list }, k) => chosen.slice(0, k).some(other => other.list.value === list.value));
    if (twice) fill(said, alarm(`The column ${twice.list.value} is chosen twice.`)); else send(chosen.map(({ name, list, unit, sign }) => `${name}=${sign?.value ?? ""}${list.value}${unit.value}`));
  };
  return make("div", { id: "columns" }, h3("Which column is which?"), table(head, `First rows of ${files[0].name}`), choices.map(({ label, list, unit, sign }) => make("div", { class: "column" }, make("span", {}, label), list, unit, sign)),
    row(button({ class: "main", onclick: go }, "Send with these columns")), said);
}
