// When the columns of a log have other names: say which is which, and send the log with the names that are known.

import { fill, make } from "./dom.js";

/** What a run needs, and what a column of it may be called. */
const NEEDED = [["t", "Time [s]"], ["x", "x [m]"], ["y", "y [m]"], ["voltage", "Voltage [V]"], ["current", "Current [A]"]];
const LIKELY = { t: /^(t|time|stamp|timestamp|sec)/i, x: /^(x|east)/i, y: /^(y|north)/i, voltage: /volt|^u$|^v$|v_?bat/i, current: /curr|amp|^i$|i_?bat/i };

const headOf = text => text.split(/\r?\n/).find(line => line.trim() && !line.startsWith("#")) ?? "";
const separatorOf = head => [",", ";", "\t"].map(mark => [head.split(mark).length, mark]).sort(([a], [b]) => b - a)[0][1];

/** A form to name the columns, or nothing where the files are no tables of text. */
export async function form(files, sendAgain) {
  if (!files.every(file => /\.(csv|txt|tsv)$/i.test(file.name))) return null;
  const head = headOf(await files[0].slice(0, 65536).text()), separator = separatorOf(head);
  const names = head.split(separator).map(name => name.trim().replace(/^"|"$/g, ""));
  if (names.length < 3 || NEEDED.every(([name]) => names.includes(name))) return null;
  const choices = NEEDED.map(([name, label]) => {
    const guess = names.includes(name) ? name : names.find(one => LIKELY[name].test(one));
    const list = make("select", {}, make("option", { value: "" }, "not logged"), names.map(one => make("option", { value: one, selected: one === guess }, one)));
    return [name, label, list];
  });
  const said = make("div", { "aria-live": "polite" });
  const go = async () => {
    const chosen = choices.filter(([, , list]) => list.value);
    const twice = chosen.find(([, , list], k) => chosen.slice(0, k).some(([, , other]) => other.value === list.value));
    if (twice) { fill(said, make("p", { class: "error", role: "alert" }, `The column ${twice[2].value} is chosen twice.`)); return; }
    const renamed = Object.fromEntries(chosen.map(([name, , list]) => [list.value, name]));
    sendAgain(await Promise.all(files.map(async file => {
      const text = await file.text(), first = headOf(text), at = text.indexOf(first);
      const line = first.split(separator).map(one => renamed[one.trim().replace(/^"|"$/g, "")] ?? one).join(separator);
      return new File([text.slice(0, at) + line + text.slice(at + first.length)], file.name, { type: file.type });
    })));
  };
  return make("div", { id: "columns" }, make("h3", {}, "Which column is which?"), choices.map(([, label, list]) => make("label", { class: "field wide" }, label, list)), make("div", { class: "row" }, make("button", { type: "button", class: "main", onclick: go }, "Send with these columns")), said);
}
