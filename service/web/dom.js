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

export const by = id => document.getElementById(id);

/** Nothing but these children. */
export const fill = (node, ...children) => node.replaceChildren(...children.flat().filter(child => child !== null && child !== undefined));

const rounded = (value, digits) => value.toLocaleString("en", { minimumFractionDigits: digits, maximumFractionDigits: digits }).replace(/,/g, "\u2009");

export function metres(value) {
  return Math.abs(value) >= 10_000 ? `${rounded(value / 1000, 1)} km` : `${rounded(value, Math.abs(value) < 100 ? 1 : 0)} m`;
}

export function joules(value) {
  const size = Math.abs(value);
  if (size >= 1e6) return `${rounded(value / 3600, 0)} Wh`;
  return size >= 1000 ? `${rounded(value / 1000, size < 1e5 ? 2 : 1)} kJ` : `${rounded(value, 0)} J`;
}

export const percent = (share, digits = 0) => `${rounded(100 * share, digits)} %`;

export function minutes(seconds) {
  if (seconds < 90) return `${rounded(seconds, 0)} s`;
  return seconds < 5400 ? `${rounded(seconds / 60, 0)} min` : `${rounded(seconds / 3600, 1)} h`;
}

export const number = (value, digits = 1) => rounded(value, digits);

const kind = (tag, own = {}) => (...children) => make(tag, own, children.flat());
export const h2 = kind("h2"), h3 = kind("h3");
export const note = kind("p", { class: "note" }), warn = kind("p", { class: "note warn" }), row = kind("div", { class: "row" });
/** A place whose words a screen reader says when they change. */
export const live = (id = null) => make("div", { id, "aria-live": "polite" });
/** A labelled control, with its unit; or one that needs the width. */
export const field = (label, control, unit) => make("label", { class: `field${unit === undefined ? " wide" : ""}` }, label, control, unit === undefined ? null : make("span", { class: "unit" }, unit));
export const fold = (title, own, ...children) => make("details", own, make("summary", {}, title), ...children);
export const alarm = kind("p", { class: "error", role: "alert" }), button = ({ ...own }, ...children) => make("button", { type: "button", ...own }, ...children);

/** The words of an error, for a person. */
export const errorNote = error => alarm(error.message);

/** A table; the first row is the head. Cells are text or nodes; numbers are put to the right. */
export function table([head, ...rows], caption) {
  const cell = (kind, value) => make(kind, typeof value === "number" ? { class: "number" } : {}, typeof value === "number" ? number(value, 0) : value);
  return make("div", { class: "scroll", tabindex: "0", role: "region", "aria-label": caption },
    make("table", {}, make("thead", {}, make("tr", {}, head.map(text => make("th", { scope: "col" }, text)))), make("tbody", {}, rows.map(row => make("tr", {}, row.map(value => cell("td", value)))))));
}
