// Measured against predicted: the residual of each segment on the map, and both along a run.

import { ask } from "./api.js";
import { draw, fill, h3, make, note, number, row, select } from "./dom.js";
import { leaf, map } from "./map.js";

/** Blue: less was measured than predicted; red: more. Both are seen with any colour vision. */
const shade = share => { const k = Math.max(-1, Math.min(1, share)); return k < 0 ? `hsl(215 75% ${80 + 45 * k}%)` : `hsl(12 80% ${80 - 40 * k}%)`; };
const dots = L.canvas({ pane: "runs", padding: 0.3 });

export async function show(here, calibration, layer) {
  let found;
  try { found = await ask(`v1/calibrations/${calibration.id}/segments`); } catch { return; }
  const names = found.runs.map(run => run.name);
  const chart = make("div", {}), state = { run: 0, after: false };
  const which = select(names.map((name, k) => [k, name]), 0, k => { state.run = +k; along(); }, { "aria-label": "Run" });
  const marks = L.layerGroup().addTo(layer);
  function places() {
    marks.clearLayers();
    const all = found.runs.flatMap(run => run.measured), usual = all.reduce((sum, value) => sum + Math.abs(value), 0) / all.length || 1;
    for (const run of found.runs) run.x.forEach((x, k) => {
      const predicted = (state.after ? run.after : run.before)[k], residual = run.measured[k] - predicted;
      L.circleMarker(leaf([x, run.y[k]]), { renderer: dots, radius: 4, weight: 0.5, color: "#333", fillColor: shade(residual / usual), fillOpacity: 0.9 })
        .bindTooltip(make("span", {}, `${run.name}: measured ${number(run.measured[k], 0)}, predicted ${number(predicted, 0)} ${found.unit}`)).addTo(marks);
    });
  }
  function along() {
    const run = found.runs[state.run], wide = 340, tall = 150, top = Math.max(...run.measured, ...run.before, ...run.after, 1);
    const line = values => values.map((value, k) => `${k ? "L" : "M"}${(34 + (wide - 40) * k / Math.max(1, values.length - 1)).toFixed(1)} ${(tall - 20 - (tall - 32) * Math.max(0, value) / top).toFixed(1)}`).join("");
    const svg = draw("svg", { viewBox: `0 0 ${wide} ${tall}`, class: "figure", role: "img", "aria-label": `Measured and predicted energy of each segment of ${run.name}` },
      draw("line", { x1: 34, x2: wide - 6, y1: tall - 20, y2: tall - 20, class: "grid" }), draw("text", { x: 30, y: 16, class: "axis", "text-anchor": "end" }, number(top, 0)), draw("text", { x: 30, y: tall - 18, class: "axis", "text-anchor": "end" }, "0"), draw("text", { x: wide - 6, y: tall - 5, class: "axis", "text-anchor": "end" }, `${run.measured.length} segments of 1 m`));
    for (const [values, stroke, dash] of [[run.measured, "var(--ink)", ""], [run.before, "var(--shortest)", "3 3"], [run.after, "var(--optimal)", ""]]) {
      const path = draw("path", { d: line(values), class: "curve", "stroke-dasharray": dash });
      path.style.stroke = stroke;
      path.style.strokeWidth = "1.4";
      svg.append(path);
    }
    fill(chart, svg);
  }
  const toggle = make("input", { type: "checkbox", onchange: () => { state.after = toggle.checked; places(); } });
  fill(here, h3("Measured against predicted"), note("On the map: red took more energy than predicted, blue less."), make("label", { class: "check" }, toggle, "Compare with the calibrated model"),
    row(which), chart, note(`${found.unit} per segment: `, make("i", { class: "swatch" }), "measured ", make("i", { class: "swatch shortest" }), "before ", make("i", { class: "swatch optimal" }), "after"));
  places();
  along();
  const all = found.runs.flatMap(run => run.x.map((x, k) => leaf([x, run.y[k]])));
  if (all.length) map.fitBounds(L.latLngBounds(all), { padding: [40, 40], maxZoom: 4 });
}
