// Draws the ground and the routes that the page around it sends.

const EXAGGERATION = 0.25; // of the longer side: so high is the highest place drawn at most

/** A path laid on the ground that is drawn: a long straight piece would go through a hill. */
function onGround(path, x, y, z, low, lift) {
  const cell = Math.abs(x[1] - x[0]), out = { x: [], y: [], z: [] };
  const height = (px, py) => {
    const col = Math.max(0, Math.min(x.length - 1.001, (px - x[0]) / (x[1] - x[0]))), row = Math.max(0, Math.min(y.length - 1.001, (py - y[0]) / (y[1] - y[0])));
    const i = Math.floor(row), j = Math.floor(col), a = row - i, b = col - j, at = (r, c) => z[r]?.[c] ?? low;
    return (1 - a) * ((1 - b) * at(i, j) + b * at(i, j + 1)) + a * ((1 - b) * at(i + 1, j) + b * at(i + 1, j + 1));
  };
  path.forEach(([px, py], k) => {
    const [qx, qy] = path[Math.max(0, k - 1)], parts = Math.max(1, Math.ceil(Math.hypot(px - qx, py - qy) / cell));
    for (let part = k ? 1 : parts; part <= parts; part += 1) {
      const mx = qx + (px - qx) * part / parts, my = qy + (py - qy) * part / parts;
      out.x.push(mx - x[0]);
      out.y.push(my - y.at(-1));
      out.z.push(height(mx, my) + lift);
    }
  });
  return out;
}

window.addEventListener("message", ({ data, origin }) => {
  if (origin !== window.location.origin || !data.surface) return;
  const { surface: { x, y, z }, routes, dark } = data, known = z.flat().filter(value => value !== null);
  const low = Math.min(...known), high = Math.max(...known), wide = Math.abs(x.at(-1) - x[0]), deep = Math.abs(y.at(-1) - y[0]), longest = Math.max(wide, deep);
  const tall = Math.max(0.05, Math.min(EXAGGERATION, 3 * (high - low) / longest));
  const lift = 0.012 * (high - low), narrow = window.innerWidth < 600, ink = dark ? "#e8ecef" : "#1d2329";
  const lines = routes.map(({ name, colour, path }) => ({ type: "scatter3d", mode: "lines", name, ...onGround(path, x, y, z, low, lift), line: { color: colour, width: 8 } }));
  const axis = title => ({ title: { text: title }, nticks: narrow ? 4 : 0, color: ink, gridcolor: dark ? "#3a434c" : "#d6dbe0" });
  const view = document.getElementById("view"), far = Math.max(1, 1.5 * window.innerHeight / window.innerWidth);
  view.replaceChildren();
  window.Plotly.newPlot(view, [{ type: "surface", x: x.map(value => value - x[0]), y: y.map(value => value - y.at(-1)), z, colorscale: [[0, "#9dbb94"], [0.4, "#d5d5a4"], [0.7, "#ead9b0"], [1, "#f4ead8"]], showscale: false, contours: { z: { show: true, usecolormap: false, color: "#6b6154", width: 1 } }, name: "ground" }, ...lines],
    { margin: { l: 0, r: 0, t: 0, b: 0 }, paper_bgcolor: dark ? "#1d2329" : "#ffffff", font: { color: ink }, legend: { x: 0, y: 1 }, scene: { camera: { eye: { x: 0.3 * far, y: -1.75 * far, z: 1.15 * far }, center: { x: 0, y: 0, z: -0.25 } }, aspectmode: "manual", aspectratio: { x: 1.6 * wide / longest, y: 1.6 * deep / longest, z: 1.6 * tall }, xaxis: axis("east [m]"), yaxis: axis("north [m]"), zaxis: axis("height [m]") } },
    { responsive: true, displaylogo: false, displayModeBar: false }).then(() => { view.dataset.drawn = "yes"; });
});
window.parent.postMessage("ready", window.location.origin);
