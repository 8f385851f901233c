// What the page shows now, in one place; whoever depends on a part of it listens for that part.

const parts = {
  start: null, goal: null, stops: [], inOrder: false, // [x, y] in metres; whether the stops keep their order
  costmap: null, layers: null, heightmap: null,
  view: "mean", heading: 0, show: { contours: true, blocked: true, roses: true },
  battery: { charge: 1, reserve: 0.2, capacity_wh: null }, roundTrip: false, // capacity: null is that of the robot
  planner: "astar", alternatives: 0, avoid: [], ground: [], aim: { objective: "mean", quantile: 0.95, max_power_w: null },
  snap: null, // the places that are to be moved off blocked ground
  confidence: 0.95, reachOpen: false, turnBack: false,
  answer: null, reach: null, homeward: null, // see answers.js
  drafts: new Map(), // what changes the question and is not finished: whatever it is -> words for it
  cursor: null, before: null, drive: null, // the id of the drive that is watched
};
const listeners = new Map();

export const now = parts;

/** Energy of the full battery [J]. */
export const capacity = () => 3600 * (now.battery.capacity_wh ?? now.costmap.robot.battery_wh);

/** Calls `listener` after each change of one of these parts; of "any", after all others. */
export function on(names, listener) {
  for (const name of names.split(" ")) listeners.set(name, [...(listeners.get(name) ?? []), listener]);
}

/** Changes parts and tells those who listen, each of them once. */
export function set(changes) {
  const concerned = new Set();
  for (const [name, value] of Object.entries(changes)) {
    if (!(name in parts)) throw new Error(`the page has no state ${name}`);
    parts[name] = value;
    for (const listener of listeners.get(name) ?? []) concerned.add(listener);
  }
  for (const listener of [...concerned, ...(listeners.get("any") ?? [])]) listener(parts);
}

/** Says that the question is being changed, or without words that it no longer is. */
export function draft(key, words) {
  const drafts = new Map(now.drafts);
  if (words ? drafts.get(key) !== words && drafts.set(key, words) : drafts.delete(key)) set({ drafts });
}
