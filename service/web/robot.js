// The robot: a form with units and presets, or a TOML file.

import { alarm, by, field, fill, make, select } from "./dom.js";

const USUAL = ["mass_kg", "battery_wh", "speed_mps", "wheel_radius_m", "max_grade_deg", "max_cross_slope_deg"];
/** Places to begin: no robot of any maker, so that its owner looks into its data sheet. */
const PRESETS = Object.fromEntries([...by("presets").content.children].map(({ value, text }) => [text, JSON.parse(value)]));
let fields = {}, values = {};

/** The fields that the service knows, with their limits. */
export function use(properties) {
  fields = Object.fromEntries(Object.entries(properties).map(([name, { description, examples, anyOf }]) => {
    const limits = anyOf.find(one => one.type !== "null"), [, label, unit] = /^([^[(;,]*[^[(;, ])[^[]*(?:\[(.*?)\])?/.exec(description);
    return [name, { label: label[0].toUpperCase() + label.slice(1), unit: unit ?? "", usual: examples[0], text: limits.type === "string", min: limits.minimum, max: limits.maximum, description }];
  }));
}

/** What differs from the default robot. */
export const robot = () => ({ ...values });
export const set = given => { values = Object.fromEntries(Object.entries(given).filter(([name, value]) => value !== fields[name]?.usual)); };

/** Flat TOML: `key = value` lines. What is wrong with a value, the service says. */
function fromToml(text) {
  const found = {};
  text.split("\n").forEach((line, k) => {
    const bare = line.replace(/^((?:[^"'#]|"[^"]*"|'[^']*')*)#.*$/, "$1").trim();
    if (!bare) return;
    const parts = /^([A-Za-z0-9_-]+)\s*=\s*(?:"(.*)"|'(.*)'|([+-]?[\d_.eE+-]+))$/.exec(bare);
    if (!parts) throw new Error(`Line ${k + 1} of the robot file is "${bare.slice(0, 60)}"; a line looks like mass_kg = 35.0`);
    found[parts[1]] = parts[4] === undefined ? parts[2] ?? parts[3] : Number(parts[4].replaceAll("_", ""));
  });
  return found;
}

/** Puts the form there; `said` is called with what became of a robot file, and whether it is bad. */
export function form(place, said) {
  const here = make("div", { id: "robot" });
  const one = name => {
    const { label, unit, usual, text, min, max, description } = fields[name];
    const input = make("input", { type: text ? "text" : "number", step: "any", min, max, value: values[name] ?? usual, title: description, onchange: () => {
      if (!input.reportValidity()) return;
      const value = text ? input.value.trim() : input.valueAsNumber;
      if (value === "" || Number.isNaN(value) || value === usual) delete values[name]; else values[name] = value;
      preset.value = "";
    } });
    return field(label, input, text ? undefined : unit);
  };
  const file = make("input", { type: "file", accept: ".toml", "aria-label": "Robot file (TOML)", onchange: async () => {
    try { set(fromToml(await file.files[0].text())); show(); preset.value = ""; said(`Robot read from ${file.files[0].name}`); } catch (error) { said(error.message, true); }
  } });
  const preset = select([...Object.keys(PRESETS).map(name => [name, name]), ["", "Own values"]], Object.keys(PRESETS).find(name => JSON.stringify(PRESETS[name]) === JSON.stringify(values)) ?? "", name => { if (name) { set(PRESETS[name]); show(); } });
  function show() {
    const unknown = Object.keys(values).filter(name => !(name in fields));
    fill(here, unknown.length ? alarm(`Not fields of a robot: ${unknown.join(", ")}`) : null, USUAL.map(one),
      make("details", {}, make("summary", {}, "All fields"), Object.keys(fields).filter(name => !USUAL.includes(name)).map(one)));
  }
  show();
  fill(place, field("Robot", preset), here, make("label", { class: "row note" }, "or a robot file (TOML) ", file));
}
