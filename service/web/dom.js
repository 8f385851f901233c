// Makes elements, and writes numbers with their units.

/** An element: `make("p", { class: "note" }, "text", other)`; properties that begin with "on" are listeners. */
export function make(tag, properties = {}, ...children) {
  const node = document.createElement(tag);
  for (const [name, value] of Object.entries(properties)) {
    if (name.startsWith("on")) node.addEventListener(name.slice(2), value);
    else if (name === "class") node.className = value;
    else if (value === undefined || value === null) continue;
    else if (name in node && typeof value !== "string") node[name] = value;
    else node.setAttribute(name, value);
  }
  node.append(...children.flat().filter(child => child !== null && child !== undefined));
  return node;
}

/** An element of SVG. */
export function draw(tag, properties = {}, ...children) {
  const node = document.createElementNS("http://www.w3.org/2000/svg", tag);
  for (const [name, value] of Object.entries(properties)) node.setAttribute(name, value);
  node.append(...children);
  return node;
}

/** A small piece of a colour, for a legend. */
export function patch(colour, kind = "box") {
  const node = make("i", { class: kind });
  node.style.background = colour;
  return node;
}

/** Words for a screen that is touched. */
export const touched = words => (matchMedia("(pointer: coarse)").matches ? words.replaceAll("Click", "Tap").replaceAll("click", "tap") : words);

export const by = id => document.getElementById(id);

/** Nothing but these children. */
export const fill = (node, ...children) => node.replaceChildren(...children.flat().filter(child => child !== null && child !== undefined));

export const number = (value, digits = 1) => value.toLocaleString("en", { minimumFractionDigits: digits, maximumFractionDigits: digits }).replace(/,/g, "\u202f");

/** Decimals of three digits; those of the greatest number of a list are those of all of it. */
const decimals = most => Math.min(4, Math.max(0, 2 - Math.floor(Math.log10(Math.abs(most) || 1))));
export const metres = (value, most = value) => (Math.abs(most) >= 10_000 ? `${number(value / 1000, 1)} km` : `${number(value, Math.min(1, decimals(most)))} m`);
/** An energy [J] in Wh, as batteries are labelled, and as a share of the full battery. */
export const energy = (value, most = value) => `${number(value / 3600, decimals(most / 3600))} Wh`;
export const ofBattery = (value, most, full) => percent(value / full, decimals(100 * most / full));
export const percent = (share, digits = 0) => `${number(100 * share, digits)} %`;

export function minutes(seconds) {
  if (seconds < 90) return `${number(seconds, 0)} s`;
  return seconds < 5400 ? `${number(seconds / 60, 0)} min` : `${number(seconds / 3600, 1)} h`;
}

export const time = stamp => new Date(stamp).toLocaleString("en-GB", { day: "numeric", month: "short", hour: "2-digit", minute: "2-digit", second: "2-digit" });

const kind = (tag, own = {}) => (...children) => make(tag, own, children.flat());
export const h2 = kind("h2"), h3 = kind("h3");
export const note = kind("p", { class: "note" }), warn = kind("p", { class: "note warn" }), row = kind("div", { class: "row" });
/** A place whose words a screen reader says when they change. */
export const live = (id = null) => make("div", { id, "aria-live": "polite" });
/** A labelled control, with its unit; or one that needs the width. */
export const field = (label, control, unit) => make("label", { class: `field${unit === undefined ? " wide" : ""}` }, label, control, unit === undefined ? null : make("span", { class: "unit" }, unit));
export const alarm = kind("p", { class: "error", role: "alert" }), button = ({ ...own }, ...children) => make("button", { type: "button", ...own }, ...children);

/** The words of an error, for a person. */
export const errorNote = error => alarm(error.message);

/** Does something; what goes wrong is said there. */
export async function attempt(here, work) {
  try { await work(); } catch (error) { if (error.name !== "AbortError") fill(here, errorNote(error)); }
}

/** A list to choose from: `options` are pairs of a value and its words. */
export const select = (options, chosen, change, own) => make("select", { onchange: ({ target }) => change(target.value), ...own }, options.map(([value, words]) => make("option", { value, selected: value === chosen }, words)));

/** A table; the first row is the head. Cells are text or nodes; numbers are put to the right. */
export function table([head, ...rows], caption) {
  const right = value => (/^[\d.\u202f]+( \S+)?$/.test(value) ? { class: "number" } : {}), cell = value => make("td", right(value), typeof value === "number" ? number(value, 0) : value);
  return make("div", { class: "scroll", tabindex: "0", role: "region", "aria-label": caption },
    make("table", {}, make("thead", {}, make("tr", {}, head.map((text, k) => make("th", { scope: "col", ...right(rows[0]?.[k]) }, text)))), make("tbody", {}, rows.map(row => make("tr", {}, row.map(cell))))));
}
