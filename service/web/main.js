// Starts the page: asks what the service can do, opens what the link says, and joins the parts.

import { answered } from "./answers.js";
import { ask, kept, Latest, onConnection } from "./api.js";
import * as basemap from "./basemap.js";
import { button, by, errorNote, fill, make } from "./dom.js";
import * as ground from "./ground.js";
import * as knownGround from "./known_ground.js";
import * as link from "./link.js";
import * as loop from "./loop.js";
import { map, showCostmap, showHeightmap } from "./map.js";
import * as mapPanel from "./map_panel.js";
import "./drives.js";
import "./pieces.js";
import "./profile.js";
import { hint } from "./question.js";
import * as robots from "./robot.js";
import "./roses.js";
import * as routePanel from "./route_panel.js";
import * as savePanel from "./save_panel.js";
import { draft, now, on, set } from "./state.js";
import { open as open3d } from "./three_d.js";

const tabs = [...by("tabs").children];

function choose(tab) {
  for (const one of tabs) {
    const chosen = one === tab;
    one.setAttribute("aria-selected", String(chosen));
    if (chosen) by("map").dataset.tab = tab.id; // what belongs to one panel is seen with it alone
    one.tabIndex = chosen ? 0 : -1;
    by(one.getAttribute("aria-controls")).hidden = !chosen;
  }
}
tabs.forEach((tab, k) => {
  tab.addEventListener("click", () => choose(tab));
  tab.addEventListener("keydown", event => {
    const step = { ArrowRight: 1, ArrowLeft: -1 }[event.key];
    if (!step) return;
    const next = tabs[(k + step + tabs.length) % tabs.length];
    choose(next);
    next.focus();
  });
});

/** A line over everything; nothing hides it. */
const banner = words => { by("banner").hidden = !words; fill(by("banner"), words, " ", words && button({ onclick: () => banner(null) }, "Close")); };
onConnection(there => banner(there ? null : "The service does not answer. The page asks again every two seconds."));
window.addEventListener("unhandledrejection", ({ reason }) => { if (reason?.name !== "AbortError") banner(reason?.message ?? String(reason)); });

async function listMaps() {
  const { costmaps, name, label } = await kept();
  const done = costmaps.filter(one => one.status === "done");
  const grounds = [...new Set(done.map(one => one.heightmap_id))].sort((a, b) => (b === now.costmap?.heightmap_id) - (a === now.costmap?.heightmap_id)); // models of this ground first
  fill(by("maps"), now.costmap ? null : make("option", { value: "" }, "none chosen"), grounds.map(ground => make("optgroup", { label: name(ground) },
    done.filter(one => one.heightmap_id === ground).map(one => make("option", { value: one.id, selected: one.id === now.costmap?.id }, label(one))))));
  by("maps").disabled = !done.length;
}

const latest = new Latest();
const found = async costmap => [costmap, ...await Promise.all([ask(`v1/costmaps/${costmap.id}/layers`), ask(`v1/heightmaps/${costmap.heightmap_id}`)])];

/** Opens a cost map, or what is asked for it; a question on the same ground stays, and so does its answer, to compare. */
async function openCostmap(asked, { changes = {}, seen } = {}) {
  const mine = {};
  draft(mine, "opening the cost map …");
  const opened = await latest.run(async () => found(await asked)).finally(() => draft(mine));
  if (!opened) return;
  const [costmap, layers, heightmap] = opened, former = now.costmap, same = former && former.heightmap_id === costmap.heightmap_id;
  ground.hide();
  const { robot, model } = former ?? {}, { answer } = now, other = same && JSON.stringify(robot) !== JSON.stringify(costmap.robot);
  const words = same && [other && (robot.mass_kg !== costmap.robot.mass_kg ? `robot of ${robot.mass_kg} kg` : model === costmap.model && "other values of the robot"), model !== costmap.model && `model ${model}`].filter(Boolean).join(", ");
  const route = words && answer?.path && answered("answer") ? { ...answer, words } : null;
  const battery = former?.robot.battery_wh === costmap.robot.battery_wh ? now.battery : { ...now.battery, capacity_wh: null };
  set({ ...(same ? {} : { start: null, goal: null, stops: [], avoid: [], ground: [], answer: null, reach: null, homeward: null }), drive: null, battery, before: route, costmap, layers, heightmap, cursor: null, ...changes });
  mapPanel.show();
  document.body.classList.add("has-map");
  by("view-3d").hidden = !about.plotly;
  if (now.drive) choose(by("tab-drives")); else if (now.start && now.goal) toRoute(); else choose(by("tab-map"));
  hint();
  window.scrollTo(0, 0);
  await Promise.all([showCostmap(costmap, layers, same ? link.read().seen : seen), listMaps()]);
}

async function openGround({ heightmap, costmap, sample }) {
  try {
    if (costmap?.status === "done") { await openCostmap(costmap, { changes: sample ? ofSample() : {} }); return; }
    const here = heightmap ?? await ask(`v1/heightmaps/${costmap.heightmap_id}`);
    set({ costmap: null, layers: null, heightmap: here, ground: [], start: null, goal: null, stops: [], before: null });
    document.body.classList.remove("has-map");
    choose(by("tab-map"));
    const wishing = mapPanel.wish(here);
    await Promise.all([wishing, showHeightmap(here), listMaps()]);
    if (costmap) await mapPanel.watch(costmap);
    if (sample) { sampleOpen = true; await mapPanel.build({ heightmap_id: here.id, model: "default" }); }
  } catch (error) { ground.welcome(error.message); }
}

let routed = null; // map whose route's tab was opened
const toRoute = () => { routed = now.costmap.id; choose(by("tab-route")); };
on("answer", () => { if (now.answer && routed !== now.costmap.id) toRoute(); });

let about = null, sampleOpen = false;
const ofSample = () => { const { start, goal, capacity_wh } = about.sample; return { start, goal, battery: { ...now.battery, capacity_wh } }; };

async function begin() {
  const asked = link.read();
  about = await ask("page/start.json");
  savePanel.use(about.path_formats);
  robots.use(about.robot);
  knownGround.use(about.kinds);
  routePanel.start(about.planners);
  mapPanel.use(about, costmap => {
    const changes = sampleOpen ? ofSample() : {};
    sampleOpen = false;
    openCostmap(costmap, { changes }).catch(error => ground.welcome(error.message));
  });
  ground.use(about, openGround);
  if (about.basemap) basemap.use(about.basemap);
  savePanel.show();
  loop.show();
  by("new-map").addEventListener("click", () => ground.welcome());
  by("maps").addEventListener("change", ({ target }) => {
    if (target.value) openCostmap(ask(`v1/costmaps/${target.value}`)).catch(error => { target.value = now.costmap?.id ?? ""; throw error; });
  });
  by("view-3d").addEventListener("click", () => open3d(about.plotly));
  if (asked.map) {
    try {
      const costmap = await ask(`v1/costmaps/${asked.map}`);
      if (costmap.status === "done") await openCostmap(costmap, asked); else await openGround({ costmap });
    } catch (error) { await ground.welcome(error.message); }
  } else await Promise.all([ground.welcome(), listMaps()]);
  document.documentElement.dataset.readyAt = Math.round(performance.now());
  document.documentElement.dataset.ready = "yes";
}

begin().catch(error => { by("welcome").hidden = false; fill(by("welcome-said"), errorNote(error), button({ onclick: () => window.location.reload() }, "Try again")); });
window.joulemap = { map, now };
