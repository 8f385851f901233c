// The address of the page holds what is shown, so that a link opens the same view again.

import { now, on } from "./state.js";

const point = text => {
  const values = (text ?? "").split(",").map(Number);
  return values.length === 2 && values.every(Number.isFinite) ? values : null;
};
const written = place => place.map(value => +value.toFixed(2)).join(",");

/** What a link says; fields that it does not have, or that are no numbers, are left out. */
export function read(hash = location.hash) {
  const given = new URLSearchParams(hash.slice(1)), found = { map: given.get("map") };
  const start = point(given.get("from")), goal = point(given.get("to"));
  const stops = (given.get("stops") ?? "").split(";").map(point).filter(Boolean);
  const [charge, reserve, full] = (given.get("battery") ?? "").split(",").map(Number);
  const view = given.get("view"), heading = Number(given.get("heading"));
  found.changes = {
    ...(start && { start }), ...(goal && { goal }), ...(stops.length && { stops }),
    ...(["ground", "mean", "heading", "directionality"].includes(view) && { view }),
    ...(Number.isFinite(heading) && { heading }),
    ...(charge > 0 && charge <= 1 && reserve >= 0 && reserve <= 1 && { battery: { charge, reserve, capacity_wh: full > 0 ? full : null } }),
    ...(given.get("back") === "1" && { roundTrip: true }),
    ...(given.get("order") === "1" && { inOrder: true }),
    ...(given.get("drive") && { drive: given.get("drive") }),
    ...(Number(given.get("others")) > 0 && { alternatives: Math.min(Number(given.get("others")), 5) }),
  };
  const objective = given.get("objective"), [quantile, power] = ["quantile", "max_power_w"].map(name => Number(given.get(name)));
  if (objective || power > 0) found.changes.aim = { objective: ["quantile", "arrival"].includes(objective) ? objective : "mean", quantile: quantile >= 0.5 && quantile <= 0.99 ? quantile : 0.95, max_power_w: power > 0 ? power : null };
  const avoid = (given.get("avoid") ?? "").split("|").map(ring => ring.split(";").map(point).filter(Boolean)).filter(ring => ring.length > 2);
  if (avoid.length) found.changes.avoid = avoid;
  const seen = (given.get("at") ?? "").split(",").map(Number);
  if (seen.length === 3 && seen.every(Number.isFinite) && seen[2] > 0) found.seen = { x: seen[0], y: seen[1], span: seen[2] };
  return found;
}

let where = null;

/** The address of the view as it is now. */
export function address() {
  const parts = new URLSearchParams();
  if (now.costmap) parts.set("map", now.costmap.id);
  if (now.start) parts.set("from", written(now.start));
  if (now.goal) parts.set("to", written(now.goal));
  if (now.stops.length) parts.set("stops", now.stops.map(written).join(";"));
  if (now.stops.length && now.inOrder) parts.set("order", "1");
  parts.set("battery", Object.values(now.battery).filter(value => value !== null).join(","));
  if (now.roundTrip) parts.set("back", "1");
  if (now.drive) parts.set("drive", now.drive);
  if (now.alternatives) parts.set("others", now.alternatives);
  for (const [name, value] of Object.entries(now.aim)) if (value && value !== "mean" && (name !== "quantile" || now.aim.objective === name)) parts.set(name, value);
  if (now.avoid.length) parts.set("avoid", now.avoid.map(ring => ring.map(written).join(";")).join("|"));
  parts.set("view", now.view);
  if (now.view === "heading") parts.set("heading", now.heading);
  if (where) parts.set("at", [where.x, where.y, where.span].map(value => +value.toFixed(2)).join(","));
  return `${location.pathname}#${parts.toString().replace(/%2C/g, ",").replace(/%3B/g, ";")}`;
}

export function sees(place) {
  where = place;
  write();
}

let waiting = 0;
function write() {
  clearTimeout(waiting);
  waiting = setTimeout(() => { if (now.costmap) history.replaceState(null, "", address()); }, 200);
}

on("costmap drive start goal stops inOrder battery roundTrip alternatives avoid aim view heading", write);
